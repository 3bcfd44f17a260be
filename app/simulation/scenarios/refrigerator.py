"""§4.2.3: the arm opens a refrigerator with an unknown hinge; the door approaches the base."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from app.simulation.scenarios.leading import Driver, Scenario, Setting, check_point
from app.strict import Array, check_range

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.config import Config
    from app.robot.model import RobotModel
    from app.simulation.plants.door import Door
    from app.simulation.session import Session

_HINGE_BESIDE = 0.10  # [m] lateral distance of the hinge from the base's axis, by default
_FREE_TURN = math.radians(62)  # [rad] door angle at which the door meets a base at rest, by default
_FRONT = 0.495  # [m] distance of the front of the paper's base from the base's centre
_FARTHEST = 0.53  # [m] largest distance of the base's front from a door with a reachable handle
_WIDE = 0.60  # [m] door width above which the base starts nearer to the handle
_RANGES = {
    "door_width": (0.40, 0.80, "m"),
    "door_friction": (0.0, 10.0, "N m"),
    "door_angle": (0.0, 60.0, "deg"),
    "door_yaw": (-180.0, 180.0, "deg"),
    "radial_guess": (-60.0, 60.0, "deg"),
    "opening_rate": (0.5, 6.0, "deg/s"),
}
_FIRMNESS = {
    "task.posture_stiffness": 100.0,  # [1/s²]
    "task.posture_damping": 20.0,  # [1/s]
    "task.base_weight": 1e6,  # [-]
}


@dataclass(frozen=True)
class RefrigeratorScenario(Scenario):
    """The end-effector holds the handle of a refrigerator's door and opens it."""

    name: str = "refrigerator"
    duration: float = 45.0
    about: str = "the arm opens a refrigerator's door, which approaches the base"
    hinge: Literal["left", "right"] = "left"
    """Side of the hinge, seen from the robot in front of the door."""
    hinge_position: tuple[float, float] | None = None
    """[m] x and y of the hinge in the world; default: 1 m ahead of the origin and 0.1 m beside the
    x axis."""
    door_width: float = 0.60
    """[m] distance from the hinge to the free edge."""
    door_friction: float = 1.0
    """[N m] friction of the hinge."""
    door_angle: float = 0.0
    """[deg] opening angle at the start."""
    door_yaw: float = 0.0
    """[deg] viewing direction of a person in front of the closed door; 0 is the world's x axis."""
    radial_guess: float = 30.0
    """[deg] error of the initial estimate of the direction towards the hinge; a positive error
    turns the estimate away from the robot, into the refrigerator."""
    opening_rate: float = 2.15
    """[deg/s] desired rotation rate of the door."""
    base: tuple[float, float, float] | None = None
    """[m] [m] [deg] x, y and heading of the base at the start; default: in front of the door, at a
    distance such that doors up to 0.6 m wide meet the paper's base, at rest, at the same angle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        for name, (low, high, unit) in _RANGES.items():
            check_range(f"--{name.replace('_', '-')}", getattr(self, name), low, high, unit)
        check_point("--hinge-position", self.hinge_position or (0.0, 0.0), 2)
        *place, heading = self.base or (0.0, 0.0, 0.0)
        check_point("--base", place, 2)
        check_range("--base", heading, -360.0, 360.0, "deg")

    @property
    def door(self) -> Door:
        """The door that the options describe."""
        from app.simulation.plants.door import Door

        side = 1.0 if self.hinge == "left" else -1.0
        return Door(
            hinge=self.hinge,
            hinge_position=self.hinge_position or (1.0, side * _HINGE_BESIDE),
            yaw=math.radians(self.door_yaw),
            width=self.door_width,
            friction=self.door_friction,
        )

    @property
    def base_pose(self) -> Array:
        """(3,) x, y [m] and heading [rad] of the base at the start."""
        if self.base is not None:
            return np.array([*self.base[:2], math.radians(self.base[2])])
        door = self.door
        away = _FRONT + min(math.sin(_FREE_TURN) * door.width, _FARTHEST)
        beside = _HINGE_BESIDE + 2 / 3 * max(door.width - _WIDE, 0.0)
        at = door.pose(0.0).act(np.array([-away, -door.side * beside, 0.0]))
        return np.array([at[0], at[1], door.yaw])

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """The start of the run; the door is the last body of the controller's robot."""
        # Imported here: scipy would delay the start of every command.
        from app.simulation.plants.door import OpenDoor, with_door
        from app.simulation.scenarios.start import find_grasp

        door, angle, base_pose = self.door, math.radians(self.door_angle), self.base_pose
        d_b = config.border.d_b
        x, y, heading = base_pose.tolist()
        q_m, T_ee = find_grasp(model, data.pairs, d_b, (x, y, heading), door, angle, seed=seed)
        holding, holding_data = with_door(model, data, door, T_ee.inverse() * door.pose(angle))
        held = OpenDoor(door, angle)
        return Setting(holding, holding_data, base_pose, q_m, self.adapted(config), held)

    def adapted(self, config: Config) -> Config:
        """Raise the posture task's gains and the cost of base motion to the minima `_FIRMNESS`.
        With low gains, the door's force, which the controller does not model, would swing the
        elbow; with a low cost, the base would move to maintain the arm's posture.
        """
        firm = {path: max(float(config.value(path)), low) for path, low in _FIRMNESS.items()}
        return config.changed(firm)

    def driver(self, session: Session) -> Driver:
        from app.simulation.scenarios.door_opening import opener

        return opener(self.door, session, rate=self.opening_rate, guess=self.radial_guess)
