"""A robot of one's own: from its URDF to a description, a border and a report; and its check."""

from functools import partial
from importlib import import_module

from app.jobs.pool import Workers
from app.system import usable_cores

ROOT = "floor_point"
"""Link of the point on the floor below the middle between the wheels: the base's frame."""
SIDES = ("guiding-lateral", "guiding-front")
"""Scenarios that lead the hand towards the base."""


def helpers(processes: int | None = None) -> Workers:
    """Processes for `app.onboarding.new_robot.finish`, on all usable cores or so many.

    There are no more than sides. They import that module, which takes seconds, as soon as they are
    entered; so enter them before this process imports it.
    """
    prepare = partial(import_module, "app.onboarding.new_robot")
    return Workers(prepare, min(processes or usable_cores(), len(SIDES)))
