"""Colours of dark and light pages and of the drawn objects, and a colour map for the border."""

import numpy as np
import viser

from app.strict import Array

Rgb = tuple[int, int, int]

BRAND: Rgb = (24, 104, 176)  # of buttons, whose text is white: the contrast is 5.9 to 1
BACKGROUND: dict[bool, Rgb] = {True: (20, 20, 20), False: (255, 255, 255)}
"""Background of the scene on a dark and on a light page."""

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
"""(11, 3) evenly spaced colours of matplotlib's public-domain map "viridis", low to high."""

SERIES: tuple[str, ...] = ("#e4572e", "#f2a541", "#3b8ea5", "#7b6cd9", "#4caf7d", "#b56576")
"""Colours of curves and link pairs, in their order; distinct on white and on black."""

BETA = "#8e6bd8"  # activation β
CLEAR: Rgb = (128, 138, 150)  # a pair outside its buffer
NEAR: Rgb = (235, 205, 70)  # a pair inside its buffer, without a reaction
YIELDS: Rgb = (240, 150, 40)  # a pair for which the base gives way
RESISTS: Rgb = (224, 84, 36)  # a pair that only the arm keeps apart
CONTACT: Rgb = (226, 16, 56)  # contact or overlap
PERSON: Rgb = (32, 150, 230)  # actions of a person
ACTING: Rgb = (222, 49, 140)  # the acting point and its force
ACCELERATION: Rgb = (60, 190, 90)  # commanded acceleration of the base
TRAIL_BASE: Rgb = (240, 140, 40)  # path of the base
TRAIL_HAND: Rgb = PERSON  # path of the end-effector
GHOSTS: tuple[Rgb, Rgb] = ((150, 110, 230), (40, 180, 170))  # robots of other controllers


def viridis(u: Array) -> Array:
    """Return colours (N, 3) uint8 of values (N,), which are clipped to [0, 1]."""
    at = np.linspace(0.0, 1.0, len(_VIRIDIS))
    u = np.clip(u, 0.0, 1.0)
    return np.stack([np.interp(u, at, channel) for channel in _VIRIDIS.T], axis=-1).astype(np.uint8)


def viridis_css() -> str:
    """Return the colour map as a CSS gradient, low at the left."""
    return ", ".join(f"rgb({r:.0f},{g:.0f},{b:.0f})" for r, g, b in _VIRIDIS)


def css(colour: Rgb) -> str:
    """Return a colour as CSS."""
    return "rgb({},{},{})".format(*colour)


def ink(ground: Rgb) -> str:
    """Return black or white for text on the colour `ground`; the contrast is at least 4.5 to 1."""
    luminance = float(linear(np.array(ground)) / 255.0 @ (0.2126, 0.7152, 0.0722))
    return "black" if luminance > 0.179 else "white"


def linear(colours: Array) -> Array:
    """Convert colours (..., 3) uint8 from sRGB to linear colours of the same type.

    viser expects linear colours for arrows and for single segments of lines.
    """
    u = np.asarray(colours, float) / 255.0
    light = np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4)
    return (255.0 * light).round().astype(np.uint8)


def set_theme(gui: viser.GuiApi, *, dark: bool) -> None:
    """Set a dark or a light theme."""
    gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False, brand_color=BRAND)
