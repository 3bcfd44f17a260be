"""Package for a user's own robot: it makes a robot's folder from a URDF, and checks a robot."""

from functools import partial
from importlib import import_module

from app.jobs.pool import Workers
from app.system import usable_cores

ROOT = "floor_point"
"""Link of the base's frame: its origin is on the floor, below the middle between the driven wheels
or, for a holonomic base or with --wheel-radius, below the origin of --base."""
SIDES = ("guiding-lateral", "guiding-front")
"""Scenarios of guiding towards the side and towards the front of the base."""


def helpers(processes: int | None = None) -> Workers:
    """Worker processes for `app.onboarding.new_robot.finish`; each first imports `new_robot`.

    Their number is `processes` (default: the number of usable cores), but at most two, one for each
    of the `SIDES`. If the number is 1, the calling process does the work instead.
    """
    prepare = partial(import_module, "app.onboarding.new_robot")
    return Workers(prepare, min(processes or usable_cores(), len(SIDES)))
