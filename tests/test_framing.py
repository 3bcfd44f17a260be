"""Cameras: the relevant objects fill the free part of the picture."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Coroutine
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.dashboard.drag import SCALE
from app.dashboard.scene import camera as camera_module
from app.dashboard.scene.camera import (
    FIELD_OF_VIEW,
    PRESETS,
    UP,
    Camera,
    Window,
    fit,
    placed,
)
from app.simulation.loop.commands import Reset
from app.simulation.plants.door import DoorView
from app.simulation.scenarios.refrigerator import RefrigeratorScenario
from app.simulation.trace.snapshot import GhostReading, Snapshot
from tests.dashboards import parts
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda

Array = np.ndarray

AHEAD = np.array([1.0, 0.0, 0.0])


def on_picture(points: Array, eye: Array, target: Array, window: Window) -> Array:
    """(N, 2) picture coordinates: -1 left and bottom, 1 right and top."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    u, v, depth = np.array([right, np.cross(right, forward), forward]) @ (points - eye).T
    assert depth.min() > 0.0
    high = np.tan(FIELD_OF_VIEW / 2)
    return np.stack([u / depth / high / window.aspect, v / depth / high], axis=1)


@given(
    seed=st.integers(0, 10**6),
    size=st.floats(0.05, 3.0),
    aspect=st.floats(0.4, 4.0),
    covered=st.floats(0.0, 0.45),
    above=st.floats(0.0, 0.25),
)
def test_fit_shows_all_points_from_the_least_distance(
    seed: int, size: float, aspect: float, covered: float, above: float
) -> None:
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(20, 3)) * size + rng.normal(size=3)
    away = rng.normal(size=3) + np.array([0.5, 0.0, 0.0])
    window = Window(aspect, covered, above)
    eye, target = fit(points, away, window)
    np.testing.assert_allclose(np.cross(target - eye, away), 0.0, atol=1e-6)
    seen = on_picture(points, eye, target, window)
    free = 2.0 - 2.0 * covered - 2.0 * above
    low, high = seen.min(axis=0), seen.max(axis=0)
    floor, roof = np.array([-1.0, 2.0 * covered - 1.0]), np.array([1.0, 1.0 - 2.0 * above])
    assert (low > floor).all()
    assert (high < roof).all()
    # In one direction the margin is reached on both sides.
    room = np.array([low - floor, roof - high]) / [2.0, free]
    assert np.min(np.max(room, axis=0)) == pytest.approx(0.05, abs=1e-6)


def test_window_size_of_the_browser_is_limited_to_valid_values() -> None:
    assert Window.of(0, 0, 0.1, 0.1) == Window.of(float("nan"), 10, 0.1, 0.1) == Window()
    assert Window.of(1e9, 1, 9.0, 9.0) == Window(4.0, 0.55, 0.25)
    assert Window.of(800, 1000, 0.2, 0.1) == Window(0.8, 0.1, 0.2)


@pytest.mark.slow
@pytest.mark.parametrize("window", [Window(0.85, 0.23), Window(1.6, 0.18), Window()])
@pytest.mark.parametrize("name", [name for name in PRESETS if PRESETS[name].of == "robot"])
def test_preset_shows_the_whole_robot_at_any_pose(name: str, window: Window) -> None:
    loop = ScriptedLoop(husky_panda())
    loop.place((2.0, -1.0, 0.7))
    snapshot, extent = loop.latest(), parts().extent
    c, s = np.cos(snapshot.base_pose[2]), np.sin(snapshot.base_pose[2])
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    arrows = snapshot.p_ee + SCALE * np.eye(3)  # arrows of the gizmo, which the mouse must reach
    points = np.vstack([extent @ R.T + [*snapshot.base_pose[:2], 0.0], snapshot.p_ee, arrows])
    eye, target = placed(PRESETS[name], [snapshot], extent, window)
    seen = on_picture(points, eye, target, window)
    assert (np.abs(seen) < 1.0).all()
    assert seen[:, 1].min() > 2.0 * window.covered - 1.0


def beside(snapshot: Snapshot, *away: float) -> Snapshot:
    """The snapshot with ghosts at these distances [m] ahead of it."""
    ghosts = (
        GhostReading(
            "none",
            snapshot.base_pose + x * AHEAD,
            snapshot.q_m,
            snapshot.wheel_angles,
            snapshot.p_ee + x * AHEAD,
            0.1,
        )
        for x in away
    )
    return replace(snapshot, ghosts=tuple(ghosts))


def test_near_ghosts_are_in_the_picture_and_far_ones_are_not() -> None:
    extent, window = parts().extent, Window(0.85, 0.23)
    shown = beside(ScriptedLoop(husky_panda()).latest(), 0.6, 5.0)
    eye, target = placed(PRESETS["iso"], [shown], extent, window)
    near, far = (on_picture(extent + x * AHEAD, eye, target, window) for x in (0.6, 5.0))
    assert (np.abs(near) < 1.0).all()
    assert np.abs(far).max() > 1.0


def test_film_camera_shows_every_pose_of_the_run() -> None:
    loop, extent, window = ScriptedLoop(husky_panda()), parts().extent, Window()
    shown = []
    for x in (0.0, 0.4, 3.0):
        loop.place((x, 0.0, 0.0))
        shown.append(loop.latest())
    eye, target = placed(PRESETS["side"], shown, extent, window)
    for x in (0.0, 0.4, 3.0):
        seen = on_picture(extent + x * AHEAD, eye, target, window)
        assert (np.abs(seen) < 1.0).all()


class Eye:
    """A browser's camera that reports its state 0.5 s after a command."""

    def __init__(self) -> None:
        self.time = 0.0
        self.position = np.zeros(3)
        self._state = SimpleNamespace(image_width=1280, image_height=720)

    def on_update(self, hear: Callable[[Eye], Coroutine[None, None, None]]) -> None:
        self._hear = hear

    look_at = np.zeros(3)

    def answer(self, moved: float = 0.0, width: int = 1280) -> None:
        """Report position and page width [px], after a motion of `moved` [m] by the user."""
        self.time += 0.5
        self.position = self.position + np.array([moved, 0.0, 0.0])
        self._state.image_width = width
        asyncio.run(self._hear(self))


@pytest.fixture
def looking(monkeypatch: pytest.MonkeyPatch) -> tuple[Camera, Eye, ScriptedLoop]:
    """A camera that follows the base, before panels reduce the width of the page's scene."""
    eye, loop = Eye(), ScriptedLoop(husky_panda())
    monkeypatch.setattr(camera_module, "monotonic", lambda: eye.time)
    client: Any = SimpleNamespace(camera=eye, atomic=nullcontext)
    camera = Camera(client)
    camera.extent = parts().extent
    camera.use("iso", loop.latest())
    eye.answer()
    return camera, eye, loop


def go_on(camera: Camera, eye: Eye, loop: ScriptedLoop, *, moved: float = 0.0) -> None:
    """Move the base by 0.1 m for each picture, and let the camera follow."""
    for _ in range(3):
        x = loop.latest().base_pose[0] + 0.1
        loop.place((x, 0.0, 0.0))
        camera.settle(loop.latest())
        camera.follow(loop.latest().base_pose[:2], on=True)
        eye.answer(moved)


def settled(camera: Camera, eye: Eye, loop: ScriptedLoop, *, busy: bool = False) -> bool:
    """Whether the camera is placed again once the panels have their width."""
    before = eye.position
    eye.answer(width=620)
    camera.settle(loop.latest(), busy=busy)
    return bool(np.linalg.norm(eye.position - before) > 0.05)


@pytest.mark.slow
def test_following_camera_is_placed_again_when_the_panels_appear(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, eye, loop = looking
    first = eye.position
    go_on(camera, eye, loop)
    np.testing.assert_allclose(eye.position - first, [0.3, 0.0, 0.0], atol=1e-9)
    assert settled(camera, eye, loop)
    _, target = placed(PRESETS["iso"], [loop.latest()], parts().extent)
    assert eye.position[0] > target[0]


def test_camera_moved_by_the_user_is_not_placed_again(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, eye, loop = looking
    go_on(camera, eye, loop, moved=0.01)
    assert not settled(camera, eye, loop)


def test_camera_does_not_move_during_a_drag(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, eye, loop = looking
    assert not settled(camera, eye, loop, busy=True)
    assert settled(camera, eye, loop), "the camera must move after the drag"


@pytest.mark.parametrize("follow", [True, False])
def test_reset_brings_the_robot_back_into_view(
    looking: tuple[Camera, Eye, ScriptedLoop], follow: bool
) -> None:
    camera, eye, loop = looking

    def seen() -> bool:
        base = loop.latest().base_pose
        points = parts().extent + np.array([base[0], base[1], 0.0])
        return camera_module.sees(eye.position, eye.look_at, points, camera.window)

    camera.find(loop.latest(), on=follow)
    loop.place((30.0, 0.0, 0.0))
    camera.find(loop.latest(), on=follow)
    eye.answer()
    assert seen() == follow, "only the following camera shows it before the reset"
    loop.send(Reset())
    if not follow:
        eye.position, eye.look_at = np.array([30.0, 1.0, 1.0]), np.array([30.0, 0.0, 0.0])
        eye.answer()
    assert not seen()
    camera.find(loop.latest(), on=follow)
    eye.answer()
    assert seen()


def test_reset_keeps_a_user_view_that_shows_the_robot(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, eye, loop = looking
    camera.find(loop.latest(), on=True)
    eye.answer(moved=0.1)
    place = eye.position
    loop.place((0.5, 0.0, 0.0))
    camera.find(loop.latest(), on=True)
    loop.send(Reset())
    camera.find(loop.latest(), on=True)
    np.testing.assert_array_equal(eye.position, place)


def test_camera_finds_a_ghost_whose_end_effector_leaves_the_picture(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, eye, loop = looking
    before = eye.position
    camera.find(beside(loop.latest(), 0.02), on=True)
    np.testing.assert_array_equal(eye.position, before)
    shown = beside(loop.latest(), 1.2)
    camera.find(shown, on=True)
    lens = camera_module.lens_of(eye.position, eye.look_at, 1.0, camera.window)
    assert lens.has(lens.pixel(shown.ghosts[0].p_ee))
    assert not np.array_equal(eye.position, before)


def test_pair_view_always_shows_the_end_effector(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, eye, loop = looking
    camera.use("pair", loop.latest())
    raised = replace(loop.latest(), p_ee=loop.latest().p_ee + np.array([0.0, 0.8, 0.8]))
    for shown in (loop.latest(), raised):
        eye.answer()
        camera.find(shown, on=True)
        lens = camera_module.lens_of(eye.position, eye.look_at, 1.0, camera.window)
        assert lens.has(lens.pixel(shown.p_ee))


def test_new_client_sees_the_door_while_it_is_opened(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, _, loop = looking
    camera.begin(loop.latest())
    assert camera.preset == "iso"
    view = DoorView(RefrigeratorScenario().door, 0.5, np.zeros(3))
    camera.begin(replace(loop.latest(), door=view))
    assert camera.preset == "door"


@pytest.mark.parametrize("hinge", ["left", "right"])
def test_door_view_shows_the_open_and_the_closed_door(hinge: Any) -> None:
    door = RefrigeratorScenario(hinge=hinge).door
    view = DoorView(door, np.deg2rad(63.0), np.zeros(3))
    snapshot = replace(ScriptedLoop(husky_panda()).latest(), door=view)
    window = Window(0.85, 0.23)
    eye, target = placed(PRESETS["door"], [snapshot], parts().extent, window)
    _, width, height = door.size
    corners = [np.array([0.0, -door.side * u, v]) for u in (0.0, width) for v in (0.0, height)]
    points = [door.pose(angle).act(c) for angle in (0.0, view.angle) for c in corners]
    seen = on_picture(np.array([*points, *parts().extent]), eye, target, window)
    assert (np.abs(seen) < 1.0).all(), "door and base must be visible"
    assert (eye - door.pose(0.0).translation) @ door.pose(0.0).rotation[:, 0] < 0.0, (
        "the camera must be in front of the door"
    )


def test_camera_waits_for_a_slow_browser_before_the_next_step(
    looking: tuple[Camera, Eye, ScriptedLoop],
) -> None:
    camera, eye, loop = looking
    before = eye.position
    camera.use("top", loop.latest())
    wanted, eye.position = eye.position, before
    eye.answer()
    loop.place((0.1, 0.0, 0.0))
    camera.follow(loop.latest().base_pose[:2], on=True)
    np.testing.assert_array_equal(eye.position, before, "no step from an outdated position")
    eye.position = wanted
    eye.answer()
    camera.follow(loop.latest().base_pose[:2], on=True)
    np.testing.assert_allclose(eye.position, wanted + np.array([0.1, 0.0, 0.0]))
