"""Continuity, symmetry and invariance of the complete avoidance on random paths."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from app.border.cache import load_border_data
from app.config import Config
from app.control.controller import Controller
from app.control.quantities import ControlStep
from app.robot.state import at_rest
from tests.robots import husky_panda

Array = np.ndarray

MIRROR = np.array([-1.0, 1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""The arm's left-right mirror image, joint by joint."""
LOW = np.array([0.3, 0.5, -0.3, -2.6, -0.5, 1.2, 0.0])
HIGH = np.array([2.2, 1.6, 0.6, -1.2, 0.5, 2.6, 1.0])
"""[rad] `LOW` and `HIGH` are the bounds of random joint positions. The end-effector is near the
base: beside it, in front of it or above it."""


@cache
def controller_with(border: str) -> Controller:
    """The method with a kind of border, "surface" or "points"."""
    model = husky_panda()
    data = load_border_data(model, progress=False)
    return Controller(model, data, Config().replace("border.kind", border))


def step_at(q_m: Array, base_pose: Array | None = None, border: str = "surface") -> ControlStep:
    """The first step of a guided arm at rest in a posture; the next step overwrites it."""
    controller = controller_with(border)
    controller.reset()
    return controller.step(at_rest(husky_panda(), q_m, base_pose))


postures = st.tuples(*(st.floats(a, b) for a, b in zip(LOW, HIGH, strict=True))).map(np.array)


def base_demand(q_m: Array, base_pose: Array | None = None, border: str = "surface") -> Array:
    """β_m ẍ_m at rest in a posture."""
    return step_at(q_m, base_pose, border).base_avoidance


def paths_in_the_buffer(count: int) -> list[tuple[Array, Array]]:
    """Random short paths from postures inside the buffer of the base."""
    rng, found = np.random.default_rng(3), []
    while len(found) < count:
        q_m, towards = rng.uniform(LOW, HIGH, (2, 7))
        step = step_at(q_m)
        if 0.03 < step.d[: step.n_mob].min() < 0.12:
            found.append((q_m, q_m + 0.05 * (towards - q_m) / np.abs(towards - q_m).max()))
    return found


def jump_on(path: tuple[Array, Array], demand: Callable[[Array], Array]) -> float:
    """[m/s² or rad/s²] Largest change along a path after refinement at its steepest part."""
    begin, end = path
    for _ in range(6):
        shares = np.linspace(0.0, 1.0, 11)[:, None]
        places = begin + shares * (end - begin)
        demands = np.array([demand(q_m) for q_m in places])
        steps = np.abs(np.diff(demands, axis=0)).max(axis=1)
        k = int(steps.argmax())
        begin, end = places[k], places[k + 1]
    return float(steps[k])


@pytest.mark.slow
def test_the_base_demand_is_continuous_along_random_paths() -> None:
    """Only a jump stays large when a path is refined to steps of 5e-8 rad.

    Above the medial axis of the base's outline, the nearest point of the border jumps. This causes
    no jump of the demand, because the force is zero above the base.
    """
    paths = paths_in_the_buffer(60)
    assert max(jump_on(path, base_demand) for path in paths) < 1e-3
    by_points = partial(base_demand, border="points")
    assert max(jump_on(path, by_points) for path in paths[:20]) > 0.02  # the paper's points jump


@given(q_m=postures)
def test_mirrored_postures_get_mirrored_forces_at_mirrored_points(q_m: Array) -> None:
    """Only for the end-effector, because the forearm is not symmetric."""
    left, right = (step_at(posture).copy() for posture in (q_m, MIRROR * q_m))
    assert left.pairs[0].name == right.pairs[0].name == "lm-lEE"
    assume(left.d[0] > 0.0)  # inside the base, either side may be the nearest
    np.testing.assert_allclose(right.f[0], left.f[0] * [1.0, -1.0, 1.0], atol=1.0)
    # NaN in both if there is no acting point
    np.testing.assert_allclose(right.p_act[0], left.p_act[0] * [1.0, -1.0, 1.0], atol=2e-3)


@given(q_m=postures, x=st.floats(-5, 5), y=st.floats(-5, 5), yaw=st.floats(-np.pi, np.pi))
def test_the_base_demand_does_not_depend_on_the_base_pose(
    q_m: Array, x: float, y: float, yaw: float
) -> None:
    here, there = base_demand(q_m), base_demand(q_m, np.array([x, y, yaw]))
    np.testing.assert_allclose(there, here, atol=1e-3 + 1e-3 * np.abs(here).max())
