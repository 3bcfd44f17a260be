"""Check of the arm against its base: whether it can hold its hand while the base moves under it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.config import AdmittanceConfig
from app.control.admittance import largest_command
from app.robot.bases.kind import Axis
from app.robot.link_pairs import PairDistances, candidate_pairs, sample_joints
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest

Array = np.ndarray

_POSES, _SAMPLES = 100, 2000
_NEAR = 0.30  # [m] from the base within which a pose counts
_LEFT = 0.10  # [-] of the base's motion of the hand that the arm may leave over
_LEVER = 0.3  # [m] at which a turning hand counts as much as a moving one
_NOTHING = 1e-6  # [m/s or rad/s] what is left where the base does not move the hand
_OFTEN = 0.25  # [-] share of poses from which on it is warned of


class Carried(NamedTuple):
    """How often the base takes the hand along with it.

    Attributes:
        axis: Of the base's motion.
        speed: [m/s or rad/s] at which it was asked.
        place: [-] share of the poses in which the arm cannot keep its hand's place.
        pose: [-] share in which it cannot keep place and orientation.
    """

    axis: Axis
    speed: float
    place: float
    pose: float

    @property
    def text(self) -> str:
        """As it is told after "while the base"."""
        if self.axis.angular:
            return f"turns at {self.speed:g} rad/s"
        return f"moves {self.axis.way} at {self.speed:g} m/s"


def carried_hand(model: RobotModel, *, seed: int = 0) -> tuple[Carried, ...]:
    """How often the arm is too slow, or lacks a joint, to hold its hand where it is.

    At random poses near the base, clear of it, for each of the base's axes at the largest speed
    that it is commanded: see `lost_hand`.
    """
    base, state, n_b = model.description.base, RobotState(model), model.n_b
    speeds = largest_command(base, AdmittanceConfig())
    poses = _near_poses(model, np.random.default_rng(seed))
    lost = np.zeros((len(poses), n_b, 2))
    for k, q_m in enumerate(poses):
        state.update_kinematics(at_rest(model, q_m))
        for i in range(n_b):
            moved = state.J_ee[:, :n_b] @ model.J_m_inv[:, i] * speeds[i]
            lost[k, i] = lost_hand(state.J_ee[:, n_b:], moved, model.qd_max)
    shares = lost.mean(axis=0).tolist()
    return tuple(
        Carried(axis, speed, *share)
        for axis, speed, share in zip(base.axes, speeds.tolist(), shares, strict=True)
    )


def lost_hand(J_arm: Array, moved: Array, qd_max: Array) -> tuple[bool, bool]:
    """Whether the arm loses its hand's place, and whether place or orientation, to the base.

    Looked at is what is least left over of J_arm q̇ = -J_base ν within the joints' velocity limits;
    for the orientation too, an angular part counts with a lever of 0.3 m. A part is lost if more
    than a tenth of the base's motion is left of it: of that part's, or of the other's by the lever
    where that is more.

    Args:
        J_arm: (6, n_m) Jacobian of the hand, linear above angular.
        moved: (6,) [m/s, rad/s] J_base ν, velocity of the hand with the arm at rest.
        qd_max: (n_m,) [rad/s or m/s] largest speeds of the joints.
    """
    linear, angular = float(np.linalg.norm(moved[:3])), float(np.linalg.norm(moved[3:]))
    left = np.linalg.norm(_least(J_arm[:3], moved[:3], qd_max))
    place = bool(left > _LEFT * linear + _NOTHING)
    scale = np.repeat([1.0, _LEVER], 3)
    both = _least(scale[:, None] * J_arm, scale * moved, qd_max)
    most = _LEFT * max(linear, _LEVER * angular) + _NOTHING
    pose = max(np.linalg.norm(both[:3]), np.linalg.norm(both[3:])) > most
    return place, place or bool(pose)


def _least(J: Array, moved: Array, qd_max: Array) -> Array:
    """What is least left over of J q̇ = -moved with |q̇| ≤ q̇_max."""
    from scipy.optimize import lsq_linear

    found = lsq_linear(J, -moved, (-qd_max, qd_max), method="bvls")
    return J @ found.x + moved


def holding_warning(carried: tuple[Carried, ...]) -> str:
    """A sentence on the base's axes along which the arm often cannot hold its hand, or nothing."""
    often = [each for each in carried if each.place > _OFTEN]
    if not often:
        return ""
    ways = ", or while it ".join(
        f"{each.text} (in {each.place:.0%} of poses near it; with its orientation too in "
        f"{each.pose:.0%})"
        for each in often
    )
    return (
        f"the arm cannot hold its hand's place while the base {ways}: there the base gives way "
        "less, as far as the hand stays where it is"
    )


def _near_poses(model: RobotModel, rng: np.random.Generator) -> Array:
    """(N, n_m) random poses with no bodies in contact and the arm near the base, or any such."""
    mobile = model.body_names[0]
    distances = PairDistances(model, candidate_pairs(model))
    clear, near = [], []
    for q_m in sample_joints(model, _SAMPLES, rng):
        distances.update(model.configuration((0.0, 0.0, 0.0), q_m))
        d = distances.distances()
        if min(d, default=1.0) <= 0.0:
            continue
        clear.append(q_m)
        to_base = [x for x, pair in zip(d, distances.pairs, strict=True) if pair.a == mobile]
        if min(to_base, default=0.0) < _NEAR:
            near.append(q_m)
        if len(near) == _POSES:
            break
    return np.array(near if len(near) >= _POSES // 4 else clear[:_POSES] or [model.q_lower])
