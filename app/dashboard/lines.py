"""Polylines as viser draws them: segments, each of whose ends has a colour."""

from __future__ import annotations

import numpy as np
import viser

from app.dashboard.colours import Rgb

Array = np.ndarray


def hidden_line(
    scene: viser.SceneApi, name: str, colour: Rgb, pixels: float
) -> viser.LineSegmentsHandle:
    """A line without length, to be given points later.

    Args:
        scene: Where to.
        name: Scene node.
        colour: Of the line.
        pixels: Its width on the screen.
    """
    return scene.add_line_segments(
        name, np.zeros((1, 2, 3)), colour, thickness=pixels, thickness_units="screen",
        visible=False,
    )  # fmt: skip


def set_polyline(line: viser.LineSegmentsHandle, points: Array, colour: Rgb) -> None:
    """Draw a line through points (K, 3) [m], K ≥ 2; within `atomic`, as two messages are sent."""
    line.colors = np.tile(np.array(colour, np.uint8), (len(points) - 1, 2, 1))
    line.points = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
