"""Camera of one viewer: views by name, and following the base."""

from __future__ import annotations

from time import monotonic
from typing import NamedTuple

import numpy as np
import viser

from app.dashboard.drag import SCALE
from app.dashboard.scene.framing import ANY_WINDOW, FIELD_OF_VIEW, UP, Window, fit
from app.dashboard.viser_compat import image_size
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

_LEAST_STEP = 1e-3  # [m] nobody sees less
_ECHO = 0.3  # [s] after which what comes back from a browser holds what was set
_PATIENCE = 2.0  # [s] after which nothing is waited for any more
_SETTLING = 8.0  # [s] in which a page still takes its shape
_COVERED = 168.0  # [px] of the scene, from below, that the time line lies over


class Preset(NamedTuple):
    """A way to look at the robot, in the base's frame.

    Attributes:
        away: (3,) from what is looked at towards the camera.
        of_hand: Whether the hand alone is looked at, instead of the whole robot.
    """

    away: Array
    of_hand: bool = False


PRESETS = {
    "iso": Preset(np.array([1.5, 1.8, 1.0])),
    # Not quite from above: the camera's up direction has to be seen.
    "top": Preset(np.array([-0.01, 0.0, 3.3])),
    "front": Preset(np.array([2.9, 0.0, 0.22])),
    "side": Preset(np.array([0.0, -3.1, 0.22])),
    "hand": Preset(np.array([0.55, 0.75, 0.45]), of_hand=True),
}
"""Views by name."""
_CORNERS = np.stack(np.meshgrid(*[(-1.0, 1.0)] * 3), axis=-1).reshape(-1, 3)
_HAND = 0.12 * _CORNERS  # [m] what has to be seen around the hand
_NEAR_HAND = 0.22 * _CORNERS  # [m] the same if the hand alone is looked at


class _Look(NamedTuple):
    """A preset that was looked from.

    Attributes:
        name: Of it.
        window: Where the picture was to be drawn then.
        eye: (3,) [m] where the camera was put, and has been carried to since.
        at: [s] when.
    """

    name: str
    window: Window
    eye: Array
    at: float


class Camera:
    """Moves the camera of one client.

    What is set here comes back from the browser after a while, and with it what the viewer has
    done meanwhile. So one step after the other: a step from a place that is still on its way to
    the browser would be lost.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._extent = np.zeros((1, 3))
        self._looked: _Look | None = None
        self._arrived = False
        self._followed: Array | None = None
        self._set: Array | None = None
        self._set_at = 0.0
        client.camera.on_update(self._hear)

    @property
    def window(self) -> Window:
        """Where the viewer's scene is drawn, as far as that is known."""
        return Window.of(*image_size(self._client), _COVERED)

    def fit(self, extent: Array) -> None:
        """From now on show a robot of this extent (N, 3) [m], in the base's frame."""
        self._extent = extent

    def use(self, name: str, snapshot: Snapshot) -> None:
        """Look from a preset at the robot as it is in a snapshot.

        Args:
            name: A key of `PRESETS`.
            snapshot: Where base and hand are.
        """
        window = self.window
        eye, target = placed(PRESETS[name], snapshot, self._extent, window)
        self.put(eye, target)
        self._followed = np.array(snapshot.base_pose[:2])
        self._looked = _Look(name, window, eye, self._set_at)

    def put(self, eye: Array, target: Array) -> None:
        """Look from a place (3,) [m] in the world at another one."""
        camera = self._client.camera
        with self._client.atomic():
            camera.up_direction = UP
            camera.position = eye
            camera.look_at = target
            camera.fov = FIELD_OF_VIEW
        self._followed = self._looked = None
        self._set, self._set_at, self._arrived = eye, monotonic(), False

    def settle(self, snapshot: Snapshot, *, busy: bool = False) -> None:
        """Look again if the page has taken another shape since; call it until it has settled.

        A page's panels come with its first picture, and narrow the scene only then.

        Args:
            snapshot: Where base and hand are.
            busy: Whether the viewer holds something, under whom the scene must not move.
        """
        look, window = self._looked, self.window
        if look is None:
            return
        if busy or monotonic() > look.at + _SETTLING or self._left(look):
            self._looked = None  # the page has settled, or the viewer has begun
        elif look.window != window:
            self.use(look.name, snapshot)
            self._looked = self._looked and self._looked._replace(at=look.at)

    def follow(self, base_position: Array, *, on: bool) -> None:
        """Carry the camera along by what the base has moved since the last step.

        Args:
            base_position: (2,) [m] the base's centre in the world.
            on: Whether to do so; off forgets where the base was.
        """
        if not on:
            self._followed = None
            return
        if self._followed is None:
            self._followed = np.array(base_position)
        step = np.append(base_position - self._followed, 0.0)
        waiting = self._set is not None and monotonic() < self._set_at + _PATIENCE
        if waiting or np.linalg.norm(step) < _LEAST_STEP:
            return
        self._followed, look = np.array(base_position), self._looked
        if look is not None:
            self._looked = None if self._left(look) else look._replace(eye=look.eye + step)
        self._set, self._set_at = self._client.camera.position + step, monotonic()
        # Setting the position carries the point that is looked at along, by the same step.
        self._client.camera.position = self._set

    def _left(self, look: _Look) -> bool:
        """Whether the viewer has moved the camera away; unknown while a step is on its way."""
        away = float(np.linalg.norm(self._client.camera.position - look.eye))
        return self._arrived and self._set is None and away > _LEAST_STEP

    async def _hear(self, camera: viser.CameraHandle) -> None:
        """Something has come back: is it what was set, or later than that?"""
        there = self._set is not None and bool(
            np.linalg.norm(camera.position - self._set) < _LEAST_STEP
        )
        self._arrived = self._arrived or there
        if there or monotonic() > self._set_at + _ECHO:
            self._set = None


def placed(
    preset: Preset, snapshot: Snapshot, extent: Array, window: Window = ANY_WINDOW
) -> tuple[Array, Array]:
    """Eye and target of a preset (3,) [m] in the world, turned with the base.

    Args:
        preset: The view.
        snapshot: Where base and hand are.
        extent: (N, 3) [m] of the robot in its ready pose, in the base's frame.
        window: Where the picture is drawn.
    """
    x, y, phi = snapshot.base_pose
    c, s = np.cos(phi), np.sin(phi)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    origin = np.array([x, y, 0.0])
    hand = R.T @ (snapshot.p_ee - origin)
    arrows = hand + SCALE * R  # tips, whose axes are the world's: those of Rᵀ in the base's frame
    seen = hand + _NEAR_HAND if preset.of_hand else np.vstack([extent, hand + _HAND])
    seen = np.vstack([seen, arrows])
    eye, target = fit(seen, preset.away, window)
    return origin + R @ eye, origin + R @ target


def set_first_look(server: viser.ViserServer, eye: Array, target: Array) -> None:
    """Where new viewers of a server look from at first.

    Args:
        server: Of the page.
        eye: (3,) [m] in the world.
        target: (3,) [m] what is looked at.
    """
    camera = server.initial_camera
    camera.position, camera.look_at, camera.fov = eye, target, FIELD_OF_VIEW
