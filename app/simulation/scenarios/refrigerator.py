"""§4.2.3: the arm opens a refrigerator whose hinge it does not know; the door nears the base."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

import numpy as np

from app.border.cache import BorderData
from app.config import Config
from app.control.door_opening import DoorOpening, DoorOpeningGains, HandReading
from app.errors import ConfigError
from app.robot.model import RobotModel
from app.simulation.plants.door import Door, OpenDoor, with_door
from app.simulation.scenarios.leading import DoorReading, Lead, Leader, Scenario, Setting

if TYPE_CHECKING:
    from app.simulation.session import Session

Array = np.ndarray

_HINGE_BESIDE = 0.10  # [m] from the base's axis, when the base stands where it is put by default
_FREE_TURN = math.radians(62)  # of the door, before it meets a base at its default place
_FRONT = 0.495  # [m] from the base's centre to its front
_FARTHEST = 0.53  # [m] from the base's front to a closed door whose handle the arm still reaches
_WIDE = 0.60  # [m] width of a door from which on the base stands nearer to the handle
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
    """The hand holds the handle of a closed door and opens it."""

    name: str = "refrigerator"
    duration: float = 45.0
    about: str = "the arm opens a refrigerator's door, which comes towards the base"
    hinge: Literal["left", "right"] = "left"
    """Side of the hinge for the robot that stands before the door."""
    hinge_position: tuple[float, float] | None = None
    """[m] of the hinge in the world; by default 1 m ahead of the origin and 0.1 m to its side."""
    door_width: float = 0.60
    """[m] from the hinge to the free edge."""
    door_friction: float = 1.0
    """[N m] of the hinge."""
    door_angle: float = 0.0
    """[deg] how far the door is open at the start."""
    door_yaw: float = 0.0
    """[deg] where one looks who stands before the closed door; 0 is along the world's x axis."""
    radial_guess: float = 30.0
    """[deg] by how much the first guess of the direction towards the hinge is wrong; positive is
    turned into the door."""
    opening_rate: float = 2.15
    """[deg/s] the hand's speed, as the door's turning that it gives at the handle's radius."""
    base: tuple[float, float, float] | None = None
    """x [m], y [m] and heading [rad] of the base at the start; by default before the door, so far
    away that doors up to 0.6 m wide meet the base when they are open by the same angle."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.hinge not in ("left", "right"):
            raise ConfigError(f"--hinge: {self.hinge!r} is neither left nor right")
        for name, (low, high, unit) in _RANGES.items():
            value = getattr(self, name)
            if not low <= value <= high:
                option = name.replace("_", "-")
                raise ConfigError(
                    f"--{option}: {value:g} {unit} is not within {low:g} to {high:g} {unit}"
                )
        for name, size in (("hinge_position", 2), ("base", 3)):
            place = getattr(self, name)
            if place is not None and not _finite(place, size):
                option = name.replace("_", "-")
                raise ConfigError(f"--{option}: {place!r} is not {size} finite numbers")

    @property
    def door(self) -> Door:
        """The door."""
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
            return np.array(self.base)
        door = self.door
        away = _FRONT + min(math.sin(_FREE_TURN) * door.width, _FARTHEST)
        beside = _HINGE_BESIDE + 2 / 3 * max(door.width - _WIDE, 0.0)
        at = door.pose(0.0).act(np.array([-away, -door.side * beside, 0.0]))
        return np.array([at[0], at[1], door.yaw])

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """See `Scenario.setting`; the controller's robot has the door as its last body.

        Raises:
            UnreachableError: The hand cannot hold the handle from there.
        """
        # Imported here: scipy would make every command start later.
        from app.simulation.scenarios.grasp import GraspSolver

        door, angle, base_pose = self.door, math.radians(self.door_angle), self.base_pose
        q_m, T_ee = GraspSolver(model, data.pairs, config.border.d_b).solve(
            base_pose, door, angle, seed=seed
        )
        holding, holding_data = with_door(model, data, door, T_ee.inverse() * door.pose(angle))
        return Setting(
            holding, holding_data, base_pose, q_m, self.adapted(config), OpenDoor(door, angle)
        )

    def adapted(self, config: Config) -> Config:
        """See `Scenario.adapted`."""
        return _firm(config)

    def leader(self, session: Session) -> Leader:
        """See `Scenario.leader`."""
        return _Opener(self, session)


def _finite(place: Sequence[float], size: int) -> bool:
    values = np.array(place, dtype=float)
    return values.shape == (size,) and bool(np.isfinite(values).all())


def _firm(config: Config) -> Config:
    """The lowest level at least as firm as it has to be where the hand pushes on something.

    The controller does not know of the door's force, whose counterpart in the null space of the
    hand's task would swing the elbow away. The base has to be as much costlier, or it would move to
    keep the arm's posture.
    """
    for path, least in _FIRMNESS.items():
        section, _, name = path.partition(".")
        config = config.replace(path, max(getattr(getattr(config, section), name), least))
    return config


class _Opener:
    """The adaptive controller at the sensors of a session."""

    def __init__(self, scenario: RefrigeratorScenario, session: Session) -> None:
        door = self._door = scenario.door
        T_ee = session.T_world_ee
        speed = math.radians(scenario.opening_rate) * door.handle_radius
        gains = DoorOpeningGains(speed=speed)
        turn = -door.side * math.radians(scenario.radial_guess)
        turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        guess = turned @ door.radial(T_ee.translation)
        self._opening = DoorOpening(T_ee, guess, gains, session.physics.dt)

    def __call__(self, session: Session) -> Lead:
        assert session.physics.door is not None
        wrench = session.physics.door.wrench()
        T_ee, velocity = session.T_world_ee, session.controller.state.v_ee[:3]
        truth = self._door.radial(T_ee.translation)
        guess = self._opening.radial(T_ee)
        reading = DoorReading(
            session.physics.door.angle(),
            wrench.force,
            float(wrench.force[:2] @ truth),
            math.atan2(truth[0] * guess[1] - truth[1] * guess[0], float(truth @ guess[:2])),
        )
        reference = self._opening.step(HandReading(T_ee, velocity, wrench.force, wrench.torque))
        return Lead(reference=reference, door=reading)
