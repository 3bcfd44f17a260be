"""Texts that are written over pictures."""

from __future__ import annotations

from collections.abc import Sequence

from PIL import Image, ImageDraw, ImageFont

from app.dashboard.scene.colours import BACKGROUND, Rgb

INK: dict[bool, Rgb] = {True: (240, 240, 245), False: (25, 30, 38)}
"""On a dark and on a light ground."""
_HEIGHT = 0.04  # [-] of a line, of the picture's height
_LEAST = 12  # [px] of a line that can be read
_SPACING = 1.4  # [-] from line to line


def label(
    picture: Image.Image, lines: Sequence[str | tuple[str, Rgb]], *, dark: bool
) -> Image.Image:
    """The picture with lines of text in its upper left corner, some of colours of their own."""
    size = max(round(_HEIGHT * picture.height), _LEAST)
    font, draw = ImageFont.load_default(size), ImageDraw.Draw(picture)
    for k, line in enumerate(lines):
        text, colour = (line, INK[dark]) if isinstance(line, str) else line
        at = size, size // 2 + round(_SPACING * k * size)
        ground, stroke = BACKGROUND[dark], max(size // 12, 1)
        draw.text(at, text, colour, font, stroke_width=stroke, stroke_fill=ground)
    return picture
