"""Colours of what is drawn: a perceptual map for the border, a traffic light for distances."""

from __future__ import annotations

import numpy as np

Array = np.ndarray
Rgb = tuple[int, int, int]

_VIRIDIS = np.array(
    [
        (68, 1, 84),
        (72, 36, 117),
        (65, 68, 135),
        (53, 95, 141),
        (42, 120, 142),
        (33, 145, 140),
        (34, 168, 132),
        (68, 191, 112),
        (122, 209, 81),
        (189, 223, 38),
        (253, 231, 37),
    ],
    dtype=float,
)
"""(11, 3) evenly spaced anchors of matplotlib's public-domain map, low to high."""

SERIES: tuple[str, ...] = ("#e4572e", "#f2a541", "#3b8ea5", "#7b6cd9", "#4caf7d", "#b56576")
"""One colour a link pair, in the order of the snapshot; distinct on white and on black."""

REST: Rgb = (128, 138, 150)
"""A pair outside of its buffer."""
NEAR: Rgb = (232, 170, 40)
"""A pair that has just entered its buffer."""
FULL: Rgb = (222, 49, 40)
"""A pair so near that its task is in full force."""
PERSON: Rgb = (32, 150, 230)
"""What the person does."""
ACTING: Rgb = (222, 49, 140)
"""The acting point and its force."""
ACCELERATION: Rgb = (60, 190, 90)
"""What is asked of the base."""
TRAIL_BASE: Rgb = (240, 140, 40)
"""Where the base has been."""
TRAIL_HAND: Rgb = PERSON
"""Where the hand has been."""
GHOSTS: tuple[Rgb, Rgb] = ((150, 110, 230), (40, 180, 170))
"""Robots of other controllers."""


def viridis(u: Array) -> Array:
    """Colours of values between 0 and 1.

    Args:
        u: (N,) values, clipped to [0, 1].

    Returns:
        (N, 3) uint8.
    """
    at = np.linspace(0.0, 1.0, len(_VIRIDIS))
    u = np.clip(u, 0.0, 1.0)
    return np.stack([np.interp(u, at, channel) for channel in _VIRIDIS.T], axis=-1).astype(np.uint8)


def viridis_css() -> str:
    """The same map as a gradient of CSS, low at the left."""
    return ", ".join(f"rgb({r:.0f},{g:.0f},{b:.0f})" for r, g, b in _VIRIDIS)


def distance_colour(d: float, d_b: float, d_full: float) -> Rgb:
    """Grey outside of the buffer, from amber at the border to red where the task is in full force.

    Args:
        d: [m] signed distance of the pair.
        d_b: [m] buffer distance.
        d_full: [m] distance of full force, below `d_b`.
    """
    if d >= d_b:
        return REST
    u = np.clip((d_b - d) / (d_b - d_full), 0.0, 1.0)
    r, g, b = ((1.0 - u) * np.array(NEAR) + u * np.array(FULL)).round()
    return int(r), int(g), int(b)


def css(colour: Rgb) -> str:
    """The colour as CSS writes it."""
    return "rgb({},{},{})".format(*colour)


def linear(colours: Array) -> Array:
    """Colours as viser takes them for single segments of lines, which it does not convert.

    Args:
        colours: (N, 3) uint8 as on a screen (sRGB).

    Returns:
        (N, 3) uint8 linear in light.
    """
    u = np.asarray(colours, float) / 255.0
    light = np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4)
    return (255.0 * light).round().astype(np.uint8)
