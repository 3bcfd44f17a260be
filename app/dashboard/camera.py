"""One viewer's camera: views by name, and a camera that follows the base."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import viser

from app.simulation.snapshot import Snapshot

Array = np.ndarray

FIELD_OF_VIEW = np.deg2rad(42.0)  # [rad] vertical; longer than viser's 75°, so less distortion
_LEAST_STEP = 1e-3  # [m] nobody sees less


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
    """Moves the camera of one client."""

    def __init__(self, client: viser.ClientHandle) -> None:
        self._client = client
        self._followed: Array | None = None

    def use(self, name: str, snapshot: Snapshot) -> None:
        """Look from a preset at the robot as it is in a snapshot.

        Args:
            name: A key of `PRESETS`.
            snapshot: Where base and hand are.
        """
        eye, target = placed(PRESETS[name], snapshot)
        camera = self._client.camera
        with self._client.atomic():
            camera.up_direction = np.array([0.0, 0.0, 1.0])
            camera.position = eye
            camera.look_at = target
            camera.fov = FIELD_OF_VIEW
        self._followed = None

    def follow(self, base_position: Array, *, on: bool) -> None:
        """Carry the camera along by what the base has moved since the last call.

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
        if np.linalg.norm(step) < _LEAST_STEP:
            return
        self._followed = np.array(base_position)
        # Setting the position carries the point that is looked at along, by the same step.
        self._client.camera.position = self._client.camera.position + step


def placed(preset: Preset, snapshot: Snapshot) -> tuple[Array, Array]:
    """Eye and target of a preset (3,) [m] in the world, turned with the base."""
    x, y, phi = snapshot.base_pose
    c, s = np.cos(phi), np.sin(phi)
    R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
    origin = snapshot.p_ee if preset.of_hand else np.array([x, y, 0.0])
    return origin + R @ preset.eye, origin + R @ preset.target
