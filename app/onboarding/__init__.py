"""A user's own robot: conversion of a URDF to a description, a border and a report; checks."""

from functools import partial
from importlib import import_module

from app.jobs.pool import Workers
from app.system import usable_cores

ROOT = "floor_point"
"""Link of the base's frame: its origin is on the floor, below the middle between the driven wheels
or, without them, below the origin of --base."""
SIDES = ("guiding-lateral", "guiding-front")
"""Scenarios of guiding towards the side and towards the front of the base."""


def helpers(processes: int | None = None) -> Workers:
    """Worker processes for `app.onboarding.new_robot.finish`, which import its module at the start.

    Their number is `processes` (default: one for each usable core), but at most one for each of
    `SIDES`. With a number of one, this process does the work.
    """
    prepare = partial(import_module, "app.onboarding.new_robot")
    return Workers(prepare, min(processes or usable_cores(), len(SIDES)))
