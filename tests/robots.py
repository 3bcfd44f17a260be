"""The paper's robot and random states of it, for tests."""

from __future__ import annotations

from functools import cache
from importlib.util import find_spec

import numpy as np
import pytest

from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.robot.shapes import Shape
from app.robot.state import Measurement, RobotState

needs_pybullet = pytest.mark.skipif(
    find_spec("pybullet") is None,
    reason="pybullet, and the meshes of the paper's robot with it, have no wheels for this Python",
)


@cache
def husky_panda() -> RobotModel:
    """The compiled model; treat it as frozen."""
    return RobotModel(load_robot("husky_panda"))


def with_mobile_shapes(shapes: tuple[Shape, ...]) -> RobotModel:
    """The paper's robot with other shapes of the mobile body l_m."""
    description = husky_panda().description
    first, *others = description.bodies
    bodies = (first.model_copy(update={"shapes": shapes}), *others)
    return RobotModel(description.model_copy(update={"bodies": bodies}))


def random_measurement(rng: np.random.Generator) -> Measurement:
    """Random readings: pose and velocity of the base, joint positions within the limits, speeds."""
    model = husky_panda()
    return Measurement(
        rng.uniform(-3, 3, 3),
        rng.uniform(-1, 1, 2),
        rng.uniform(model.q_lower, model.q_upper),
        rng.uniform(-1, 1, model.n_m),
    )


def random_state(rng: np.random.Generator) -> RobotState:
    """The state at a random measurement."""
    state = RobotState(husky_panda())
    state.update(random_measurement(rng))
    return state
