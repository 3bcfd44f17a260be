"""Polylines of one colour, as the segments that viser draws."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from app.dashboard.scene.colours import Rgb

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
        name, np.zeros((1, 2, 3)), colour, thickness=pixels, thickness_units="screen", visible=False
    )


def set_polyline(line: viser.LineSegmentsHandle, points: Array, colour: Rgb) -> None:
    """Draw a line through points (K, 3) [m], K ≥ 2; `set_polylines` of one."""
    set_polylines(line, [points], colour)


def set_polylines(line: viser.LineSegmentsHandle, lines: Sequence[Array], colour: Rgb) -> None:
    """Draw lines through points (K, 3) [m] each, K ≥ 2.

    One colour for all of it: viser takes colours of single segments for linear ones, which washes
    them out, and a line that goes over to them stays white now and then.
    """
    if not np.array_equal(line.colors, colour):
        line.colors = np.array(colour, np.uint8)
    segments = [np.stack([points[:-1], points[1:]], axis=1) for points in lines]
    line.points = np.concatenate(segments).astype(np.float32)
