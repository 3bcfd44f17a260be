"""Steps of a simulation that tests collect, and the tilt of a base."""

from __future__ import annotations

import math

from app.simulation.plants.mujoco_wheels import MujocoWheels
from app.simulation.session import Step


def kept(step: Step) -> Step:
    """The step with a copy of its control quantities, which the next step would overwrite."""
    return step._replace(control=step.control.copy())


def tilt(plant: MujocoWheels) -> float:
    """[rad] angle between the vertical axes of base and world; 0 if the base is level."""
    _, x, y, _ = plant.world.q[3:7]
    return math.acos(min(1.0, 1.0 - 2.0 * (x * x + y * y)))
