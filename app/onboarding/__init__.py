"""A user's own robot: from its URDF to a description, a border and a report; and its check."""

from functools import partial
from importlib import import_module

from app.jobs.pool import Workers
from app.system import usable_cores

ROOT = "floor_point"
"""Link at the point on the floor below the middle between the wheels: the base's frame."""
SIDES = ("guiding-lateral", "guiding-front")
"""Scenarios that move the end-effector towards the base."""


def helpers(processes: int | None = None) -> Workers:
    """Processes for `app.onboarding.new_robot.finish`, on all usable cores or a given number.

    At most one for each side. They import that module, which takes seconds, when the `with` begins;
    so enter it before this process imports the module.
    """
    prepare = partial(import_module, "app.onboarding.new_robot")
    return Workers(prepare, min(processes or usable_cores(), len(SIDES)))
