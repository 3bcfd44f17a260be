"""Arrows of one shape: forces and accelerations."""

from __future__ import annotations

import numpy as np
import viser

from app.dashboard.scene.colours import Rgb, linear
from app.dashboard.scene.scales import METRES_PER_NEWTON

Array = np.ndarray

HEAD_LENGTH = 0.035  # [m]


def hidden_arrow(scene: viser.SceneApi, name: str, colour: Rgb) -> viser.ArrowHandle:
    """An arrow without length, to be given points later.

    Args:
        scene: Where to.
        name: Scene node.
        colour: Of the arrow.
    """
    return scene.add_arrows(
        name,
        np.zeros((1, 2, 3)),
        linear(np.array([colour]))[0],
        shaft_radius=0.008,
        head_radius=0.020,
        head_length=HEAD_LENGTH,
        visible=False,
    )


def arrow(start: Array, force: Array) -> Array:
    """(1, 2, 3) [m] start and end of the arrow of a force [N] that acts at `start`."""
    return np.array([[start, np.asarray(start) + METRES_PER_NEWTON * np.asarray(force)]])
