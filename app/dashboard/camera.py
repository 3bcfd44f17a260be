"""One viewer's camera: views by name, and a camera that follows the base."""

from __future__ import annotations

from time import monotonic
from typing import NamedTuple

import numpy as np
import viser

from app.simulation.snapshot import Snapshot

Array = np.ndarray

FIELD_OF_VIEW = np.deg2rad(42.0)  # [rad] vertical; longer than viser's 75°, so less distortion
_LEAST_STEP = 1e-3  # [m] nobody sees less
_ECHO = 0.3  # [s] after which what comes back from a browser holds what was set
_PATIENCE = 2.0  # [s] after which nothing is waited for any more


class Preset(NamedTuple):
    """A place of the camera, in the base's frame; for the hand, from the hand on.

    Attributes:
        eye: (3,) [m] where the camera is.
        target: (3,) [m] what it looks at.
        of_hand: Whether both are relative to the hand instead of the base.
    """

    eye: Array
    target: Array
    of_hand: bool = False


class Framing(NamedTuple):
    """What of a robot has to be in the picture, in the base's frame.

    Attributes:
        centre: (3,) [m] of the box around it in its ready pose.
        half: (3,) [m] half of that box's size.
    """

    centre: Array
    half: Array


SUITED = Framing(np.array([0.08, 0.0, 0.585]), np.array([0.57, 0.34, 0.585]))
"""Of the paper's robot, for which the presets were chosen; other robots shift and scale them."""
_MIDDLE = np.array([0.20, 0.0, 0.40])  # [m] between the base and the hand before it
PRESETS = {
    "iso": Preset(np.array([1.85, 1.85, 1.40]), np.array([0.32, 0.0, 0.40])),
    # Not quite from above: the camera's up direction has to be seen.
    "top": Preset(np.array([0.19, 0.0, 3.3]), np.array([0.20, 0.0, 0.0])),
    "front": Preset(np.array([3.1, 0.0, 0.62]), _MIDDLE),
    "side": Preset(np.array([0.20, -3.1, 0.62]), _MIDDLE),
    "hand": Preset(np.array([0.55, 0.75, 0.45]), np.zeros(3), of_hand=True),
}
"""Views by name."""


class Camera:
    """Moves the camera of one client.

    What is set here comes back from the browser after a while, and with it what the viewer has
    done meanwhile. So one step after the other: a step from a place that is still on its way to
    the browser would be lost.
    """

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._framing = SUITED
        self._followed: Array | None = None
        self._set: Array | None = None
        self._set_at = 0.0
        client.camera.on_update(self._hear)

    def fit(self, framing: Framing) -> None:
        """From now on show a robot of this size."""
        self._framing = framing

    def use(self, name: str, snapshot: Snapshot) -> None:
        """Look from a preset at the robot as it is in a snapshot.

        Args:
            name: A key of `PRESETS`.
            snapshot: Where base and hand are.
        """
        eye, target = placed(PRESETS[name], snapshot, self._framing)
        camera = self._client.camera
        with self._client.atomic():
            camera.up_direction = np.array([0.0, 0.0, 1.0])
            camera.position = eye
            camera.look_at = target
            camera.fov = FIELD_OF_VIEW
        self._followed = np.array(snapshot.base_pose[:2])
        self._set, self._set_at = eye, monotonic()

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
        self._followed = np.array(base_position)
        self._set, self._set_at = self._client.camera.position + step, monotonic()
        # Setting the position carries the point that is looked at along, by the same step.
        self._client.camera.position = self._set

    async def _hear(self, camera: viser.CameraHandle) -> None:
        """Something has come back: is it what was set, or later than that?"""
        there = self._set is not None and np.linalg.norm(camera.position - self._set) < _LEAST_STEP
        if there or monotonic() > self._set_at + _ECHO:
            self._set = None


def placed(
    preset: Preset, snapshot: Snapshot, framing: Framing = SUITED
) -> tuple[Array, Array]:  # fmt: skip
    """Eye and target of a preset (3,) [m] in the world, turned with the base.

    Args:
        preset: The view.
        snapshot: Where base and hand are.
        framing: Of the robot.
    """
    preset = fitted(preset, framing)
    x, y, phi = snapshot.base_pose
    c, s = np.cos(phi), np.sin(phi)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    origin = snapshot.p_ee if preset.of_hand else np.array([x, y, 0.0])
    return origin + R @ preset.eye, origin + R @ preset.target


def fitted(preset: Preset, framing: Framing) -> Preset:
    """A preset that shows of a robot what it shows of the paper's; a mast is not cut."""
    size = np.linalg.norm(framing.half) / np.linalg.norm(SUITED.half)
    scale = max(size, framing.half[2] / SUITED.half[2])
    target = preset.target if preset.of_hand else preset.target + framing.centre - SUITED.centre
    return Preset(target + scale * (preset.eye - preset.target), target, preset.of_hand)


def set_first_look(server: viser.ViserServer, eye: Array, target: Array) -> None:
    """Where whoever opens the page of a server looks from at first.

    Args:
        server: Of the page.
        eye: (3,) [m] in the world.
        target: (3,) [m] what is looked at.
    """
    camera = server.initial_camera
    camera.position, camera.look_at, camera.fov = eye, target, FIELD_OF_VIEW
