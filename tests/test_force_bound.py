"""The force that the arm can bear: held up to it by torques within their limits, not beyond."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from app.avoidance.closest_points import ClosestPoints, DistanceMonitor
from app.avoidance.task import distance_jacobian
from app.border.cache import BorderData
from app.control.limits import force_bound
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.trace.snapshot import QUANTITIES
from tests.robots import random_measurement


def near(robot: RobotModel, border_data: BorderData, seed: int) -> tuple[RobotState, ClosestPoints]:
    """A random state with an arm that moves nowhere, and its nearest pair with the base."""
    rng = np.random.default_rng(seed)
    state = RobotState(robot)
    monitor = DistanceMonitor(state, border_data.pairs.mobile)
    while True:
        m = random_measurement(rng)
        state.update(m._replace(base_velocity=np.zeros(2), qd_m=np.zeros(7)))
        closest = min(monitor.find_closest_points(), key=lambda each: each.d)
        if 0.02 < closest.d < 0.15:
            return state, closest


@pytest.mark.parametrize("seed", range(10))
def test_at_rest_torques_within_their_limits_hold_the_bound_and_no_more(robot, border_data, seed):
    state, closest = near(robot, border_data, seed)
    bound = force_bound(state, closest)
    J = distance_jacobian(state, closest).J[2:]
    needed = state.g[2:] + bound * J
    assert bound > 0.0
    assert np.max(np.abs(needed) / robot.tau_max) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(10))
def test_a_pair_that_comes_nearer_bears_less_by_what_stops_it_within_its_distance(
    robot, border_data, seed
):
    state, closest = near(robot, border_data, seed)
    still, J = force_bound(state, closest), distance_jacobian(state, closest).J[2:]
    M = state.M[2:, 2:]
    along = np.linalg.solve(M, J)
    along /= J @ along  # (n_m,) joints' motion at a unit speed of the distance, the least energy
    speed = 0.2
    state.update(state.measurement._replace(qd_m=-speed * along))
    force = still - force_bound(state, closest)
    energy = 0.5 * speed**2 * along @ M @ along
    assert min(force, still) * closest.d == pytest.approx(min(energy, still * closest.d), rel=1e-6)
    state.update(state.measurement._replace(qd_m=speed * along))
    assert force_bound(state, closest) == pytest.approx(still)  # it goes away


def test_bodies_that_touch_bear_nothing(robot, border_data):
    state, closest = near(robot, border_data, 0)
    assert force_bound(state, closest._replace(d=0.0)) == 0.0


def test_a_snapshot_has_it_always_and_a_table_50_times_a_second(robot, border_data):
    state, closest = near(robot, border_data, 0)
    pair = SimpleNamespace(closest=closest, beta=0.5)
    avoidance = SimpleNamespace(mobile=[pair, SimpleNamespace(closest=closest, beta=0.0)])
    session: Any = SimpleNamespace(controller=SimpleNamespace(state=state))
    quantity: Any = QUANTITIES["force_bound"]

    def step(t: float, **fields: Any) -> Any:
        output = SimpleNamespace(avoidance=avoidance)
        return SimpleNamespace(**{"t": t, "pulls": ("a pull",), "output": output} | fields)

    rows = [quantity.row(session, step(k / 1000))[0] for k in range(41)]
    known = [k for k, force in enumerate(rows) if not math.isnan(force)]
    assert known == [0, 20, 40]
    assert quantity.take(session, step(0.007)) == rows[0] == force_bound(state, closest)
    assert math.isnan(quantity.take(session, step(0.007, pulls=())))
