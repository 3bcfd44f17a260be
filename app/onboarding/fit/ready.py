"""The ready pose: clear of everything, able to move every way, the hand where a person takes it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel
from app.simulation.scenarios.posture import PostureSearch, manipulability

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
_BAD = 1e3  # [-] makes the worth of the worst pose more than zero: a pose is always chosen


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
    rng, judge = np.random.default_rng(seed), _Judge(model, pairs, d_b)
    search, middle = judge.search, judge.search.middle
    span = np.minimum(search.span, 2 * np.pi)  # nobody waits with a joint wound up
    poses = middle + (rng.random((_SAMPLES, model.n_m)) - 0.5) * (1 - 2 * _KEPT) * span
    best = max(map(judge.manipulability, poses)) or 1.0

    def worth(q_m: Array) -> float:
        ready = judge.look(q_m)
        return (
            _BAD
            + 1.5 * min(ready.clearance, _ENOUGH) / _ENOUGH
            + ready.manipulability / best
            + judge.placed()
            - 0.5 * float(np.mean(np.abs(q_m - middle) / span))
        )

    found = search.best(poses, worth).q_m
    assert found is not None
    return judge.look(np.round(found, 2))


def judge_ready(model: RobotModel, pairs: LinkPairs, q_m: Array, *, d_b: float) -> Ready:
    """What is near in a pose that was given."""
    return _Judge(model, pairs, d_b).look(np.asarray(q_m, dtype=float))


class _Judge:
    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        self.search = PostureSearch(model, pairs, d_b)
        self._names = [pair.name for pair in pairs.all]
        self._mount = model.p_base()

    def look(self, q_m: Array) -> Ready:
        """What is near in a pose."""
        m = self.manipulability(q_m)
        distances = self.search.distances()
        i = int(np.argmin(distances)) if distances else -1
        clearance = distances[i] - self.search.d_b if distances else np.inf
        return Ready(q_m, float(clearance), self._names[i] if distances else "", m)

    def manipulability(self, q_m: Array) -> float:
        """√det(J Jᵀ) of the hand in a pose, of its place alone with fewer than six joints."""
        self.search.place(q_m)
        return manipulability(self.search.J_hand if len(q_m) >= 6 else self.search.J_hand[:3])

    def placed(self) -> float:
        """[-] how well the hand is placed: up to 1.2, far below 0 where it cannot be used."""
        at = self.search.state.T_world_ee
        out = at.translation - self._mount
        away = float(np.hypot(*out[:2]))
        if self.search.above_floor() < _FLOOR or away < 0.05:
            return -10.0
        ahead = out[0] / away  # 1 in front, 0 beside, -1 behind
        points = at.rotation[:, 2]
        outwards = max(float(points[:2] @ out[:2]) / away, -float(points[2]))
        return 0.5 * max(ahead, 0.6 if ahead > -0.3 else ahead) + 0.7 * outwards
