"""The ready pose: clear of everything, able to move every way, the hand where a person takes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.avoidance.distances import DistanceMonitor
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest
from app.simulation.scenarios.posture import manipulability
from app.simulation.scenarios.start import FloorDistance

Array = np.ndarray

RULE = (
    "chosen: of random poses within the middle 80 % of each joint's range, the one with the most "
    "clearance (counted up to 0.15 m beyond the buffer), manipulability (against the best), hand "
    "in front of or beside the base, forwards or down, and joints near their middle"
)
_SAMPLES = 6000
_KEPT = 0.1  # [-] share of a joint's range kept from either limit
_ENOUGH = 0.15  # [m] beyond the buffer
_FLOOR = 0.1  # [m] between the arm and the floor


class Ready(NamedTuple):
    """A pose and what is near in it.

    Attributes:
        q_m: (n_m,) [rad or m]
        clearance: [m] least distance of a pair beyond the buffer; negative inside of it.
        nearest: Name of that pair.
        manipulability: √det(J Jᵀ) of the hand.
    """

    q_m: Array
    clearance: float
    nearest: str
    manipulability: float


def find_ready(model: RobotModel, pairs: LinkPairs, *, d_b: float, seed: int) -> Ready:
    """The best of random poses by the rule.

    Args:
        model: The robot with its bodies.
        pairs: The pairs that avoidance watches.
        d_b: [m] buffer distance.
        seed: Of the poses.
    """
    rng = np.random.default_rng(seed)
    span = model.q_upper - model.q_lower
    span = np.minimum(span, 2 * np.pi)  # nobody waits with a joint wound up
    middle = (model.q_upper + model.q_lower) / 2
    poses = middle + (rng.random((_SAMPLES, model.n_m)) - 0.5) * (1 - 2 * _KEPT) * span
    judge = _Judge(model, pairs, d_b)
    found = [judge.look(q) for q in poses]
    best = max(each.manipulability for each, _ in found) or 1.0
    scores = [
        1.5 * min(each.clearance, _ENOUGH) / _ENOUGH
        + each.manipulability / best
        + place
        - 0.5 * float(np.mean(np.abs(each.q_m - middle) / span))
        for each, place in found
    ]
    return _tidy(judge, found[int(np.argmax(scores))][0])


def judge_ready(model: RobotModel, pairs: LinkPairs, q_m: Array, *, d_b: float) -> Ready:
    """What is near in a pose that was given."""
    return _Judge(model, pairs, d_b).look(np.asarray(q_m, dtype=float))[0]


def _tidy(judge: _Judge, ready: Ready) -> Ready:
    """The same with two decimals."""
    return judge.look(np.round(ready.q_m, 2))[0]


class _Judge:
    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        self._state, self._d_b = RobotState(model), d_b
        self._monitor = DistanceMonitor(self._state, pairs.all)
        self._names = [pair.name for pair in pairs.all]
        self._floor = FloorDistance(self._state)
        self._mount = model.p_base()

    def look(self, q: Array) -> tuple[Ready, float]:
        """A pose, and how well the hand is placed: up to 1, below 0 where it cannot be used."""
        state = self._state
        state.update_kinematics(at_rest(state.model, q))
        distances = self._monitor.distances()
        i = int(np.argmin(distances)) if distances else -1
        clearance = distances[i] - self._d_b if distances else np.inf
        J = state.J_ee[:, state.model.n_b :]
        m = manipulability(J) if len(q) >= 6 else float(np.sqrt(np.linalg.det(J[:3] @ J[:3].T)))
        ready = Ready(q, float(clearance), self._names[i] if distances else "", m)
        return ready, self._placed()

    def _placed(self) -> float:
        at = self._state.T_world_ee
        out = at.translation - self._mount
        away = float(np.hypot(*out[:2]))
        if self._floor.least() < _FLOOR or away < 0.05:
            return -10.0
        ahead = out[0] / away  # 1 in front, 0 beside, -1 behind
        points = at.rotation[:, 2]
        outwards = max(float(points[:2] @ out[:2]) / away, -float(points[2]))
        return 0.5 * max(ahead, 0.6 if ahead > -0.3 else ahead) + 0.7 * outwards
