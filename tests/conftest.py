"""Fixtures that many tests share: the paper's robot, compiled once, and its border from the cache."""

import pytest
from robots import husky_panda

from app.border.cache import BorderData, load_border_data
from app.robot.model import RobotModel


@pytest.fixture(scope="session")
def robot() -> RobotModel:
    """The paper's robot; treat it as frozen."""
    return husky_panda()


@pytest.fixture(scope="session")
def border_data(robot: RobotModel) -> BorderData:
    """Pairs and clouds of the paper's robot, as they ship."""
    return load_border_data(robot, progress=False)
