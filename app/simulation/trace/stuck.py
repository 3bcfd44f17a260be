"""A tracked hand that stops short of its target: where, and what holds it there."""

from __future__ import annotations

from typing import Literal, NamedTuple

import numpy as np

from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.session import Step

Array = np.ndarray
Reason = Literal["still moving", "joint limits", "border against hand", "full stretch", "unknown"]

SHORT = 1e-3
"""[m] from its target at which a hand counts as stuck."""
_RESTING = 1e-6  # [m/s, m/s²] below which a reference rests
_MOVING = 1e-3  # [m/s] towards the target at which the hand is still on its way
_AT_LIMIT = 0.005  # [-] of a joint's range
_STRETCHED = 0.05  # [-] smallest singular value of the arm's Jacobian
_PUSHED = 0.01  # [m/s²] of the hand away from its target, by the border's push on the base


class Stuck(NamedTuple):
    """Where a hand stands that does not reach its target, and why.

    Attributes:
        ee_error_m: [m] from the hand to its target.
        hand_m: (3,) [m] where it is, in the world.
        target_m: (3,) [m] where it should be.
        reasons: All that hold; "unknown" if none does.
        joints: Names of those at their position limits.
    """

    ee_error_m: float
    hand_m: tuple[float, ...]
    target_m: tuple[float, ...]
    reasons: tuple[Reason, ...]
    joints: tuple[str, ...]


def find_stuck(model: RobotModel, step: Step) -> Stuck | None:
    """Whether the hand stops short in this step; None while its reference moves, or without one.

    The reasons are those of the true robot and of what the controller put on the base: joints at
    their position limits; a push of the border on the base that takes the hand away from its
    target; an arm at full stretch, whose smallest singular value of the hand's Jacobian is near
    zero.
    """
    reference = step.reference
    if reference is None or step.ee_error <= SHORT:
        return None
    if max(np.abs(reference.velocity).max(), np.abs(reference.acceleration).max()) > _RESTING:
        return None
    state = RobotState(model)
    state.update(step.truth)
    hand, target = state.T_world_ee.translation, reference.pose.translation
    towards = (target - hand) / np.linalg.norm(target - hand)
    joints = _at_limits(model, step.truth.q_m)
    found: dict[Reason, bool] = {
        "still moving": bool(state.v_ee[:3] @ towards > _MOVING),
        "joint limits": bool(joints),
        "border against hand": _pushed_away(state, step) @ towards < -_PUSHED,
        "full stretch": _least_motion(state) < _STRETCHED,
    }
    reasons: tuple[Reason, ...] = tuple(reason for reason, holds in found.items() if holds)
    return Stuck(
        step.ee_error, tuple(hand.tolist()), tuple(target.tolist()), reasons or ("unknown",), joints
    )


def _at_limits(model: RobotModel, q_m: Array) -> tuple[str, ...]:
    margin = _AT_LIMIT * (model.q_upper - model.q_lower)
    at = (q_m < model.q_lower + margin) | (q_m > model.q_upper - margin)
    names = model.description.arm.joints
    return tuple(name for name, is_at in zip(names, at.tolist(), strict=True) if is_at)


def _pushed_away(state: RobotState, step: Step) -> Array:
    """(3,) [m/s²] of the hand, by what avoidance adds to the base's acceleration."""
    model = state.model
    return state.J_ee[:3, : model.n_b] @ (model.J_m_inv @ step.output.inserted.base_acceleration)


def _least_motion(state: RobotState) -> float:
    J = state.J_ee[:, state.model.n_b :]
    return float(np.linalg.svd(J, compute_uv=False)[-1])
