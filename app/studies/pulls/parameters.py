"""What makes a study the study that it is."""

from __future__ import annotations

import hashlib
from functools import cache
from pathlib import Path

from pydantic import Field

from app.simulation.plants.choice import default_plant
from app.strict import Strict
from app.studies.pulls.draw_range import StudyRange

_ROOMS = ("robot", "border", "avoidance", "control", "simulation")
_MODULES = ("case", "draw", "place", "play", "sources")


class StudyParameters(Strict):
    """All that its cases follow from; how many of them are wanted is no part of it."""

    seed: int = 0
    robot: str = "husky_panda"
    controller: str = "dbb"
    physics: str = Field(default_factory=default_plant)
    ranges: StudyRange = StudyRange()
    inside: bool = False
    """Whether only cases inside of the stated envelope are drawn."""


@cache
def code_digest() -> str:
    """16 hexadecimal digits of all code that a case's figures depend on.

    Workers elsewhere, and a study that is gone on with, must have the same.
    """
    here = Path(__file__).parent
    root = here.parent.parent
    files = [root / "config.py", *(here / f"{name}.py" for name in _MODULES)]
    files += [path for room in _ROOMS for path in sorted((root / room).rglob("*.py"))]
    digest = hashlib.blake2b(digest_size=8)
    for path in files:
        digest.update(str(path.relative_to(root)).encode() + b"\0" + path.read_bytes() + b"\0")
    return digest.hexdigest()
