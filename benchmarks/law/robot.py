"""The robot of a measurement, loaded once in each process."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from app.border.cache import BorderData, load_border_data
from app.border.mobile import MobileBody
from app.config import Config
from app.robot.description import load_robot
from app.robot.model import RobotModel

Array = np.ndarray


class Robot(NamedTuple):
    """A robot with the data of its border and the box around its base.

    Attributes:
        model: The robot.
        data: Its pairs and clouds.
        lower, upper: (3,) [m] corners of the base's box, in the base's frame.
    """

    model: RobotModel
    data: BorderData
    lower: Array
    upper: Array

    @property
    def config(self) -> Config:
        """The parameters of the robot's own description."""
        return self.model.description.config

    @property
    def pair_names(self) -> list[str]:
        """Names of all pairs, in the order of the distances of a step."""
        pairs = self.data.pairs
        return [pair.name for pair in (*pairs.mobile, *pairs.manipulator)]

    @property
    def n_mobile(self) -> int:
        """Number of pairs of arm and base (L_m)."""
        return len(self.data.pairs.mobile)


@cache
def load(name: str) -> Robot:
    """The robot with a name.

    Raises:
        UnknownNameError: The robot does not exist.
    """
    model = RobotModel(load_robot(name))
    body = MobileBody(model)
    return Robot(model, load_border_data(model, progress=False), body.lower, body.upper)
