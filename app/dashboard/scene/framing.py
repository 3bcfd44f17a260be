"""Framing: the nearest camera that sees all of a robot in the free part of a picture."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

Array = np.ndarray

FIELD_OF_VIEW = np.deg2rad(42.0)  # [rad] vertical; longer than viser's 75°, so less distortion
_MARGIN = 0.10  # [-] of the free part that stays empty, both sides together
_ASPECTS = (0.4, 4.0)  # [-] that are believed
_MOST_COVERED = 0.45  # [-]
UP = np.array([0.0, 0.0, 1.0])


class Window(NamedTuple):
    """The part of a page in which a scene is drawn.

    Attributes:
        aspect: [-] its width over its height.
        covered: [-] share of its height, from below, that something else lies over.
    """

    aspect: float = 1.5
    covered: float = 0.0

    @classmethod
    def of(cls, width: float, height: float, covered: float) -> Window:
        """Of what a browser says of itself, which may be nothing yet.

        Args:
            width: [px]
            height: [px]
            covered: [px] of the height.
        """
        if not (0 < width < np.inf and 0 < height < np.inf):
            return ANY_WINDOW
        aspect = float(np.clip(width / height, *_ASPECTS))
        return cls(aspect, min(covered / height, _MOST_COVERED))


ANY_WINDOW = Window()
"""One that nothing is known of yet."""


def fit(points: Array, away: Array, window: Window) -> tuple[Array, Array]:
    """The nearest camera that sees all points, in the middle of the free part.

    Args:
        points: (N, 3) [m].
        away: (3,) from what is looked at towards the camera; not upright.
        window: Where the picture is drawn.

    Returns:
        (3,) [m] the eye, and (3,) [m] a point before it on the middle of the picture, as far away
        as the middle of the points.
    """
    forward = -away / np.linalg.norm(away)
    right = np.cross(forward, UP)
    right /= np.linalg.norm(right)
    axes = np.array([right, np.cross(right, forward), forward])
    u, v, depth = axes @ points.T
    high = np.tan(FIELD_OF_VIEW / 2)
    across = _Strip(u, depth, -high * window.aspect, high * window.aspect)
    along = _Strip(v, depth, -high * (1 - 2 * window.covered), high)
    nearest = min(across.nearest, along.nearest)
    eye = axes.T @ np.array([across.middle(nearest), along.middle(nearest), nearest])
    return eye, eye + ((depth.min() + depth.max()) / 2 - nearest) * forward


class _Strip:
    """What one direction of the picture asks of the camera.

    A point at u and depth w is seen at (u − u₀)/(w − w₀) from a camera at u₀, w₀, which has to be
    between low and high: two half-planes of (u₀, w₀) a point.
    """

    def __init__(self, u: Array, depth: Array, low: float, high: float) -> None:
        spare = _MARGIN / 2 * (high - low)
        self._low, self._high = low + spare, high - spare
        self._least = float(np.max(u - self._high * depth))
        self._most = float(np.min(u - self._low * depth))

    @property
    def nearest(self) -> float:
        """[m] the depth of the camera that is nearest to the points."""
        return (self._most - self._least) / (self._high - self._low)

    def middle(self, depth: float) -> float:
        """[m] where a camera at a depth has as much room on either side."""
        return (self._least + self._high * depth + self._most + self._low * depth) / 2
