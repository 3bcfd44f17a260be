"""Cameras: what has to be seen is in the free part of the picture, and as large as can be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.dashboard.camera import PRESETS, placed
from app.dashboard.framing import FIELD_OF_VIEW, UP, Window, fit
from app.dashboard.robot import RobotParts
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda

Array = np.ndarray


def on_picture(points: Array, eye: Array, target: Array, window: Window) -> Array:
    """(N, 2) where points are seen: -1 left and at the bottom, 1 right and at the top."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    u, v, depth = np.array([right, np.cross(right, forward), forward]) @ (points - eye).T
    assert depth.min() > 0.0
    high = np.tan(FIELD_OF_VIEW / 2)
    return np.stack([u / depth / high / window.aspect, v / depth / high], axis=1)


@given(
    seed=st.integers(0, 10**6), size=st.floats(0.05, 3.0),
    aspect=st.floats(0.4, 4.0), covered=st.floats(0.0, 0.45),
)  # fmt: skip
def test_all_is_seen_and_from_no_nearer_it_would_be(
    seed: int, size: float, aspect: float, covered: float
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, 3)) * size + rng.normal(size=3)
    away = rng.normal(size=3) + np.array([0.5, 0.0, 0.0])
    window = Window(aspect, covered)
    eye, target = fit(points, away, window)
    np.testing.assert_allclose(np.cross(target - eye, away), 0.0, atol=1e-6)
    seen = on_picture(points, eye, target, window)
    free = 2.0 - 2.0 * covered
    low, high = seen.min(axis=0), seen.max(axis=0)
    assert (low > [-1.0, 1.0 - free]).all()
    assert (high < 1.0).all()
    # In one direction the margin is touched on both sides.
    room = np.array([low - [-1.0, 1.0 - free], 1.0 - high]) / [2.0, free]
    assert np.min(np.max(room, axis=0)) == pytest.approx(0.05, abs=1e-6)


def test_what_a_browser_says_of_its_window_is_believed_within_reason() -> None:
    assert Window.of(0, 0, 100) == Window.of(float("nan"), 10, 100) == Window()
    assert Window.of(1e9, 1, 100) == Window(4.0, 0.45)
    assert Window.of(800, 1000, 100) == Window(0.8, 0.1)


@pytest.mark.parametrize("window", [Window(0.85, 0.23), Window(1.6, 0.18), Window()])
@pytest.mark.parametrize("name", [name for name in PRESETS if not PRESETS[name].of_hand])
def test_a_preset_shows_the_whole_robot_wherever_it_stands(name: str, window: Window) -> None:
    loop = ScriptedLoop(husky_panda())
    loop.place((2.0, -1.0, 0.7))
    snapshot, extent = loop.latest(), RobotParts(husky_panda()).extent
    c, s = np.cos(snapshot.base_pose[2]), np.sin(snapshot.base_pose[2])
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    points = np.vstack([extent @ R.T + [*snapshot.base_pose[:2], 0.0], snapshot.p_ee])
    eye, target = placed(PRESETS[name], snapshot, extent, window)
    seen = on_picture(points, eye, target, window)
    assert (np.abs(seen) < 1.0).all()
    assert seen[:, 1].min() > 2.0 * window.covered - 1.0
