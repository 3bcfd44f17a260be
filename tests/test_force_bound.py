"""The bound of a push towards a body that the arm can balance within its torque limits."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller
from app.control.limits import force_bound, steady_torques
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.session import Session
from app.simulation.trace.snapshot import QUANTITIES
from app.simulation.trace.trace import Recorder
from tests.nearest import SmoothMonitor
from tests.robots import random_measurement


class Distance(NamedTuple):
    """A pair's distance, its Jacobian and its rate."""

    d: float
    J: np.ndarray
    d_dot: float


class Near:
    """A random state at rest, and its nearest pair with the base."""

    def __init__(self, robot: RobotModel, border_data: BorderData, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.state = RobotState(robot)
        self._monitor = SmoothMonitor(self.state, border_data.pairs.mobile)
        while True:
            m = random_measurement(rng)
            self.state.update(m._replace(base_velocity=np.zeros(2), qd_m=np.zeros(7)))
            self._nearest = int(np.argmin(self._monitor.distances()))
            if 0.02 < self.distance().d < 0.15:
                return

    def distance(self) -> Distance:
        """The distance of the nearest pair in the present state."""
        found, i = (
            self._monitor.find_nearest(Config().activation.closest_point_smoothing),
            self._nearest,
        )
        n, core = found.points[:, 2], found.points[:, 3]
        J, _, d_dot = self.state.distance_motions(found.joints, core, n)
        return Distance(float(found.d[i]), J[i], float(d_dot[i]))

    def bound(self, d: float | None = None) -> float:
        """[N] the bound of the nearest pair; `d` [m] replaces the pair's distance."""
        distance, state = self.distance(), self.state
        d = distance.d if d is None else d
        M, g, tau_max = state.M, state.g, state.model.tau_max
        return force_bound(d, distance.J, distance.d_dot, M, g, tau_max)


@pytest.mark.parametrize("seed", range(10))
def test_torque_limits_at_rest_balance_exactly_the_bound(robot, border_data, seed):
    near = Near(robot, border_data, seed)
    bound = near.bound()
    needed = near.state.g[2:] + bound * near.distance().J[2:]
    assert bound > 0.0
    assert np.max(np.abs(needed) / robot.tau_max) == pytest.approx(1.0)


@pytest.mark.parametrize("seed", range(10))
def test_approach_reduces_the_bound_by_the_force_that_stops_it(robot, border_data, seed):
    near = Near(robot, border_data, seed)
    state, still, (d, J, _) = near.state, near.bound(), near.distance()
    J = J[2:]
    M = state.M[2:, 2:]
    along = np.linalg.solve(M, J)
    along /= J @ along  # (n_m,) joint motion of least energy at unit rate of the distance
    speed = 0.2
    state.update(state.measurement._replace(qd_m=-speed * along))
    force = still - near.bound()
    energy = 0.5 * speed**2 * along @ M @ along
    assert min(force, still) * d == pytest.approx(min(energy, still * d), rel=1e-6)
    state.update(state.measurement._replace(qd_m=speed * along))
    assert near.bound() == pytest.approx(still)  # the bodies separate


def test_bound_of_touching_bodies_is_zero(robot, border_data):
    near = Near(robot, border_data, 0)
    assert near.bound(d=0.0) == 0.0


@pytest.mark.parametrize("seed", range(5))
def test_steady_torques_plus_own_inertia_are_the_torques_of_a_motion(robot, border_data, seed):
    """The force of the bound brings one joint to its torque limit."""
    near = Near(robot, border_data, seed)
    state, rng = near.state, np.random.default_rng(seed)
    qdd = rng.uniform(-20.0, 20.0, 9)
    load = steady_torques(state.M, state.h, qdd)
    np.testing.assert_allclose(load + np.diag(state.M) * qdd, state.M @ qdd + state.h, atol=1e-9)
    d, J, d_dot = near.distance()
    bound = force_bound(d, J, d_dot, state.M, load, robot.tau_max)
    share = np.abs(load[2:] + bound * J[2:]) / robot.tau_max
    assert bound > 0.0
    assert share.max() == pytest.approx(1.0)


def test_bound_is_in_a_table_at_50_hz(robot, border_data):
    session, recorder = Session(robot, border_data, Config(), physics="kinematic"), Recorder()
    target = session.T_world_ee.translation + np.array([0.1, 0.0, 0.0])
    for _ in range(41):
        recorder.add(session, session.step(pull=target))
    bounds = recorder.trace().of("force_bound")
    assert np.flatnonzero(np.isfinite(bounds)).tolist() == [0, 20, 40]


def test_bound_is_in_every_snapshot(robot, border_data):
    near = Near(robot, border_data, 0)
    state, control = near.state, Controller(robot, border_data, Config()).last
    control.beta[0], (control.d[0], control.J[0], control.d_dot[0]) = 0.5, near.distance()
    control.h[:], control.M[:], control.J_ee[:] = state.g, state.M, state.J_ee
    control.qdd[:], control.solved[...] = 0.0, 1.0
    nobody = SimpleNamespace(hand=np.zeros(3))
    session: Any = SimpleNamespace(model=robot)
    quantity: Any = QUANTITIES["force_bound"]

    def step(t: float, **fields: Any) -> Any:
        return SimpleNamespace(
            **{"t": t, "pulls": ("a pull",), "control": control, "person": nobody} | fields
        )

    assert quantity.take(session, step(0.007)) == near.bound()
    assert math.isnan(quantity.take(session, step(0.007, pulls=())))
    control.solved[...] = 0.0  # the fallback command
    assert math.isnan(quantity.take(session, step(0.007)))
