"""Laws of the whole avoidance over random paths: continuity, symmetry, invariance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from app.avoidance.self_collision import SelfCollisionAvoidance
from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.run import run_scenario
from app.simulation.scenarios import LINES
from app.simulation.trace.snapshot import QUANTITIES
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


def paths_in_the_buffer(count: int) -> list[tuple[Array, Array]]:
    """Random short ways between postures at which an arm beside the base is inside its buffer."""
    rng, found = np.random.default_rng(3), []
    while len(found) < count:
        q_m, towards = rng.uniform(LOW, HIGH, (2, 7))
        base_demand(q_m)
        distances = [p.closest.d for p in AVOIDANCE.update().mobile]
        if 0.03 < min(distances) < 0.12:
            found.append((q_m, q_m + 0.05 * (towards - q_m) / np.abs(towards - q_m).max()))
    return found


def jump_on(path: tuple[Array, Array], demand: Callable[[Array], Array]) -> float:
    """[m/s² or rad/s²] what is left of the largest step of a path as the path is refined there."""
    begin, end = path
    for _ in range(6):
        shares = np.linspace(0.0, 1.0, 11)[:, None]
        places = begin + shares * (end - begin)
        asked = np.array([demand(q_m) for q_m in places])
        steps = np.abs(np.diff(asked, axis=0)).max(axis=1)
        k = int(steps.argmax())
        begin, end = places[k], places[k + 1]
    return float(steps[k])


@pytest.mark.slow
def test_what_is_asked_of_the_base_is_continuous_wherever_the_arm_is() -> None:
    """Each path is refined where it is steepest, to steps of 5e-8 rad: a jump would be left over.

    Where the base's outline has two nearest points (its medial axis) no method is continuous; that
    is deep inside of the base or over its top, where the force vanishes.
    """
    paths = paths_in_the_buffer(60)
    assert max(jump_on(path, base_demand) for path in paths) < 1e-3
    state, with_points = avoidance_of("points")

    def demand(q_m: Array) -> Array:
        state.update(Measurement(np.zeros(3), np.zeros(2), q_m, np.zeros(7)))
        found = with_points.update()
        return found.beta_m * found.xdd_m

    assert max(jump_on(path, demand) for path in paths[:20]) > 0.02  # the paper's points jump


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
@given(q_m=postures, x=st.floats(-5, 5), y=st.floats(-5, 5), yaw=st.floats(-np.pi, np.pi))
def test_where_the_world_frame_stands_does_not_matter(
    q_m: Array, x: float, y: float, yaw: float
) -> None:
    here, there = base_demand(q_m), base_demand(q_m, np.array([x, y, yaw]))
    np.testing.assert_allclose(there, here, atol=1e-3 + 1e-3 * np.abs(here).max())


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
    for name in set(QUANTITIES) - {"duration_us"}:
        # The QP solver's last digits depend on where its memory lies.
        np.testing.assert_allclose(again.trace.of(name), first.trace.of(name), atol=1e-7)
