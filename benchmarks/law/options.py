"""Options of all measurements."""

from __future__ import annotations

from dataclasses import dataclass

from app.cli.options import Json


@dataclass(frozen=True)
class Options:
    """Options of every measurement."""

    robot: str = "husky_panda"
    """Name of the robot."""
    controller: str = "dbb"
    """Name of the controller."""
    seed: int = 0
    """Seed of all random numbers."""
    jobs: int = 1
    """Number of parallel processes."""
    json: Json = False
