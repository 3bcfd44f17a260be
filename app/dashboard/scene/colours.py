"""Colours of dark and light pages and of the drawn objects, and a colour map for the border."""

import numpy as np
import viser

from app.strict import Array

Rgb = tuple[int, int, int]

BRAND: Rgb = (24, 104, 176)  # of buttons, whose text is white: the contrast is 5.8 to 1
BACKGROUND: dict[bool, Rgb] = {True: (20, 20, 20), False: (255, 255, 255)}  # True: a dark page
VIRIDIS = "440154 482475 414487 355f8d 2a788e 21918c 22a884 44bf70 7ad151 bddf26 fde725"
"""Evenly spaced colours of matplotlib's public-domain map "viridis", low to high."""
SERIES: tuple[str, ...] = ("#e4572e", "#f2a541", "#3b8ea5", "#7b6cd9", "#4caf7d", "#b56576")
"""Colours of curves and link pairs, in their order; distinct on white and on black."""
BETA = "#8e6bd8"  # activation β
PERSON: Rgb = (32, 150, 230)  # actions of a person
ACTING: Rgb = (222, 49, 140)  # the acting point and its force
ACCELERATION: Rgb = (60, 190, 90)  # commanded acceleration of the base
TRAIL_BASE: Rgb = (240, 140, 40)  # path of the base
TRAIL_EE: Rgb = PERSON  # path of the end-effector
GHOSTS: tuple[Rgb, Rgb] = ((150, 110, 230), (40, 180, 170))  # robots of other controllers


def viridis(u: Array) -> Array:
    """Return colours (N, 3) uint8 of values (N,), which are clipped to [0, 1]."""
    colours = np.frombuffer(bytes.fromhex(VIRIDIS), np.uint8).reshape(-1, 3)
    at = np.linspace(0.0, 1.0, len(colours))  # `interp` clips to its ends
    return np.stack([np.interp(u, at, channel) for channel in colours.T], axis=-1).astype(np.uint8)


def css(colour: Rgb) -> str:
    return "rgb({},{},{})".format(*colour)


def ink(ground: Rgb) -> str:
    """Return black or white for text on the colour `ground`; the contrast is at least 4.5 to 1."""
    luminance = float(linear(np.array(ground)) / 255.0 @ (0.2126, 0.7152, 0.0722))
    return "black" if luminance > 0.179 else "white"


def linear(colours: Array) -> Array:
    """Convert sRGB (..., 3) uint8 to the linear colours of arrows and segments' ends in viser."""
    u = np.asarray(colours, float) / 255.0
    light = np.where(u <= 0.04045, u / 12.92, ((u + 0.055) / 1.055) ** 2.4)
    return (255.0 * light).round().astype(np.uint8)


def set_theme(gui: viser.GuiApi, *, dark: bool) -> None:
    gui.configure_theme(dark_mode=dark, show_logo=False, show_share_button=False, brand_color=BRAND)
