"""Options of commands that draw the scene."""

from __future__ import annotations

from typing import Annotated, Literal

import tyro

from app.errors import ConfigError

LayerOption = Literal["determinant", "reachability", "score", "none"]
"""What the border is coloured by."""
ViewOption = Literal["iso", "top", "front", "side", "hand"]
"""Where the scene is looked at from."""
Flag = Annotated[bool, tyro.conf.FlagCreatePairsOff]
"""Given or not."""


def is_dark(*, dark: bool, light: bool) -> bool:
    """Whether the ground is dark: it is, unless `--light` is given.

    Raises:
        ConfigError: Both are given.
    """
    if dark and light:
        raise ConfigError("--dark and --light: only one of them")
    return not light
