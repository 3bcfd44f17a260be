"""Lines and arrows: polylines of one colour, and arrows to one scale."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import viser

from app.dashboard.scene.colours import Rgb, linear

METRES_PER_NEWTON = 1 / 400  # [m/N] of a force: 0.1 m is 40 N
METRES_PER_ACCELERATION = 0.2  # [s²] of v̇: 0.2 m is 1 m/s²
RADIANS_PER_ACCELERATION = 0.4  # [s²] arc of ω̇: 0.4 rad is 1 rad/s²
LEAST_FORCE = 0.5  # [N] weaker forces get no arrow, whose head would be longer than itself


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
