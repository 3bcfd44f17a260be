"""Random postures of the arm inside the buffer of its base."""

from __future__ import annotations

import numpy as np

from app.robot.link_pairs import PairDistances
from app.simulation.scenarios.start import PostureSearch
from benchmarks.law.robot import Robot

Array = np.ndarray

_NEAR = 0.01  # [m] smallest distance of any pair, and smallest depth in the base's buffer
_MARGIN = 0.05  # [-] smallest distance from a joint's limits, as a share of its range


def posture_in_buffer(robot: Robot, rng: np.random.Generator) -> Array:
    """(n_m,) random joint positions with the arm inside the base's buffer and without contact."""
    model, pairs, d_b = robot.model, robot.data.pairs, robot.config.border.d_b
    reader, n = PairDistances(model, pairs.all), robot.n_mobile
    search = PostureSearch(model, pairs, d_b)
    margin = _MARGIN * (model.q_upper - model.q_lower)
    while True:
        q = rng.uniform(model.q_lower + margin, model.q_upper - margin)
        reader.update(model.configuration((0.0, 0.0, 0.0), q))
        d = reader.distances()
        if min(d) < _NEAR or min(d[:n]) > d_b - _NEAR:
            continue
        search.place(q)
        if search.above_floor() > 0.0:
            return q
