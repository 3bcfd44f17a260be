"""Laws of the whole avoidance over random paths: continuity, symmetry, invariance, energy."""

from __future__ import annotations

import numpy as np
import pytest
from app.control.hqp import HierarchicalQP, Limits, Objective
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from app.avoidance.activation import activation
from app.avoidance.repulsion import RepulsiveRow
from app.avoidance.self_collision import SelfCollisionAvoidance
from app.avoidance.task import repulsive_rows
from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.control.transition import TaskTransition
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.run import run_scenario
from app.simulation.scenario import LINES
from tests.robots import husky_panda

Array = np.ndarray

MIRROR = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""The arm's left-right mirror image, joint by joint."""
LOW = np.array([0.3, 0.5, -0.3, -2.6, -0.5, 1.2, 0.0])
HIGH = np.array([2.2, 1.6, 0.6, -1.2, 0.5, 2.6, 1.0])
"""[rad] postures with the hand low beside, before or over the base."""


def avoidance_of(kind: str = "surface") -> tuple[RobotState, SelfCollisionAvoidance]:
    model = husky_panda()
    data = load_border_data(model, progress=False)
    state = RobotState(model)
    config = Config().replace("border.kind", kind)
    return state, SelfCollisionAvoidance(state, data.pairs, data.clouds, config)


STATE, AVOIDANCE = avoidance_of()

postures = st.tuples(*(st.floats(a, b) for a, b in zip(LOW, HIGH, strict=True))).map(np.array)


def base_demand(q_m: Array, base_pose: Array | None = None) -> Array:
    """β_m ẍ_m at rest in a posture."""
    pose = np.zeros(3) if base_pose is None else base_pose
    STATE.update(Measurement(pose, np.zeros(2), q_m, np.zeros(7)))
    avoidance = AVOIDANCE.update()
    return avoidance.beta_m * avoidance.xdd_m


@settings(max_examples=80, deadline=None)
@given(q_m=postures, towards=postures)
def test_a_path_a_hundred_times_finer_has_steps_as_much_smaller(q_m: Array, towards: Array) -> None:
    """What is asked of the base is continuous in the posture, wherever the arm is.

    Where the base's outline has two nearest points (its medial axis) no method is; there the hand
    is deep inside of the base or over its top, where the force vanishes.
    """
    direction = (towards - q_m) / max(float(np.abs(towards - q_m).max()), 1e-6)
    here = base_demand(q_m)
    coarse = np.abs(base_demand(q_m + 1e-3 * direction) - here).max()
    fine = np.abs(base_demand(q_m + 1e-5 * direction) - here).max()
    distances = [p.closest.d for p in AVOIDANCE.update().mobile]
    if min(distances) < 0.02:
        return
    assert fine < 0.05 * coarse + 2e-3


@settings(max_examples=40, deadline=None)
@given(q_m=postures)
def test_left_and_right_are_mirror_images(q_m: Array) -> None:
    """The mirrored hand gets the mirrored force at the mirrored point (the forearm is lopsided)."""
    forces = []
    for posture in (q_m, MIRROR * q_m):
        base_demand(posture)
        hand = AVOIDANCE.update().mobile[0]
        assert hand.closest.pair.name == "lm-lEE"
        forces.append(hand)
    left, right = forces
    assume(left.closest.d > 0.0)  # inside of the base the nearest side may be either
    assert (left.acting is None) == (right.acting is None)
    np.testing.assert_allclose(right.f, left.f * [1.0, -1.0, 1.0], atol=1.0)
    if left.acting is not None and right.acting is not None:
        p_act = left.acting.p_act * [1.0, -1.0, 1.0]
        np.testing.assert_allclose(right.acting.p_act, p_act, atol=2e-3)


@settings(max_examples=40, deadline=None)
@given(
    q_m=postures, x=st.floats(-5, 5), y=st.floats(-5, 5), yaw=st.floats(-np.pi, np.pi)
)  # fmt: skip
def test_where_the_world_frame_stands_does_not_matter(
    q_m: Array, x: float, y: float, yaw: float
) -> None:
    here, there = base_demand(q_m), base_demand(q_m, np.array([x, y, yaw]))
    np.testing.assert_allclose(there, here, atol=1e-3 + 1e-3 * np.abs(here).max())


@pytest.mark.parametrize("seed", range(4))
def test_the_transition_gives_no_energy_to_what_runs_into_two_buffers_and_leaves_them(
    seed: int,
) -> None:
    """A unit mass against two walls, whose rows enter and leave one after the other.

    Without damping what comes out is as fast as what went in, with damping never faster; a row
    that jumped in or out would pump.
    """
    rng = np.random.default_rng(seed)
    transition, limits = TaskTransition(HierarchicalQP(2)), Limits(np.eye(2), *np.full((2, 2), 1e4))
    limits = limits._replace(l=-limits.u)
    free = Objective(np.eye(2), np.zeros(2))
    for k_v, most in ((0.0, 1.002), (30.0, 1.0)):
        d, v, dt = np.array([0.16, 0.16]), -rng.uniform(0.2, 1.0, 2), 2e-4
        before = float(v @ v)
        for _ in range(20_000):
            rows = [
                repulsive_rows(
                    RepulsiveRow(J, 0.0, 60.0 - k_v * (J @ v)), activation(x, 0.15, 0.05)
                )
                for J, x in zip(np.eye(2), d, strict=True)
            ]
            v = v + dt * transition.solve(rows, (), free, limits).qdd
            d = d + dt * v
            if (d > 0.15).all() and (v > 0.0).all():
                break
        assert (d > 0.15).all()
        assert float(v @ v) <= before * most
        if k_v == 0.0:
            assert float(v @ v) >= before * 0.998


@pytest.mark.parametrize("seed", [0])
def test_a_run_is_the_same_for_the_same_seed(
    robot: RobotModel, border_data: BorderData, seed: int
) -> None:
    scenario = LINES["guiding-lateral"].changed(duration=0.6)
    config = Config().replace("disturbance.encoder_noise", 1e-4)
    first, again = (
        run_scenario(robot, border_data, scenario, config, physics="kinematic", seed=seed)
        for _ in range(2)
    )
    for row, same in zip(first.recorder.rows, again.recorder.rows, strict=True):
        # The QP solver's last digits depend on where its memory lies.
        np.testing.assert_allclose(list(row.values()), list(same.values()), atol=1e-7)
