"""Options of commands that draw the scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Literal

import tyro

from app.cli.options import Flag
from app.errors import ConfigError
from app.strict import check_range

_SIZES = 64, 8192  # [px]

DarkOption = Annotated[Flag, tyro.conf.arg(help="A dark ground, the default.")]
LightOption = Annotated[Flag, tyro.conf.arg(help="A light ground.")]


@dataclass(frozen=True)
class Picture:
    """What a picture shows, and how large it is."""

    layer: Literal["determinant", "reachability", "score", "none"] = "score"
    """What the border is coloured by; none hides it."""
    view: Literal["iso", "top", "front", "side", "hand"] = "iso"
    """Where the scene is looked at from."""
    width: int = 1280
    """[px] of each picture."""
    height: int = 720
    """[px] of each picture."""
    page: bool = False
    """The whole dashboard, not the scene alone."""

    def __post_init__(self) -> None:
        check_range("--width", self.width, *_SIZES, "px")
        check_range("--height", self.height, *_SIZES, "px")


def is_dark(*, dark: bool, light: bool) -> bool:
    """Whether the ground is dark: it is, unless `--light` is given.

    Raises:
        ConfigError: Both are given.
    """
    if dark and light:
        raise ConfigError("--dark and --light: only one of them")
    return not light
