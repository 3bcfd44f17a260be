"""Reactive self-collision avoidance for a mobile manipulator.

The package implements the method of Jang, Kim and Park: a force at a point of the distance buffer
border (DBB) around the base moves the base away from the arm, and QPs with a continuous task
transition compute the accelerations.

Example of a robot's own loop at 1 kHz; `sensors` and `send` are functions of the robot::

    from app import ControlLoop, Measurement, RobotModel, load_robot

    loop = ControlLoop(RobotModel(load_robot("husky_panda")))
    while (readings := sensors()) is not None:  # base pose and velocity, the arm's q and q̇
        command = loop.step(Measurement(*readings))
        send(command.u_a, command.base_velocity)  # [N m or N], [m/s and rad/s]

If the second argument of `step` is a `Reference`, the end-effector tracks it; otherwise a person
guides the arm. The module of each name below is imported at the first use of the name.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from app.border.cache import BorderData as BorderData
    from app.border.cache import load_border_data as load_border_data
    from app.config import Config as Config
    from app.config_file import read_config as read_config
    from app.control.controller import Command as Command
    from app.control.controller import Controller as Controller
    from app.control.controller import ControlLoop as ControlLoop
    from app.control.quantities import ControlStep as ControlStep
    from app.control.tasks import Reference as Reference
    from app.errors import DbbError as DbbError
    from app.errors import MeasurementError as MeasurementError
    from app.robot.assets import robot_names as robot_names
    from app.robot.description import RobotDescription as RobotDescription
    from app.robot.description import load_description as load_description
    from app.robot.description import load_robot as load_robot
    from app.robot.model import RobotModel as RobotModel
    from app.robot.state import Measurement as Measurement
    from app.robot.state import RobotState as RobotState

__version__ = "1.0.0"

_NAMES = {
    "border.cache": ("BorderData", "load_border_data"),
    "config": ("Config",),
    "config_file": ("read_config",),
    "control.controller": ("Command", "ControlLoop", "Controller"),
    "control.quantities": ("ControlStep",),
    "control.tasks": ("Reference",),
    "errors": ("DbbError", "MeasurementError"),
    "robot.assets": ("robot_names",),
    "robot.description": ("RobotDescription", "load_description", "load_robot"),
    "robot.model": ("RobotModel",),
    "robot.state": ("Measurement", "RobotState"),
}
_MODULES = {name: f"app.{module}" for module, names in _NAMES.items() for name in names}

__all__ = sorted(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> object:
    """Import a name of the interface from its module; another name raises an AttributeError."""
    if name not in _MODULES:
        raise AttributeError(f"module 'app' has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)


def __dir__() -> list[str]:
    """The sorted names of the interface and of this module."""
    return sorted({*globals(), *_MODULES})
