"""People who hold the robot, each with one hand, at the end-effector or any point of the arm."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.config import HandConfig
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.person import PersonHand
from app.simulation.plants.interface import Push

Array = np.ndarray

_ARM = 2  # pinocchio's first joint of the arm; 1 is the planar joint of the base


class Hold(NamedTuple):
    """Where somebody holds the robot, and where to.

    Attributes:
        who: Number of the person.
        target: (3,) [m] where the point is pulled, in the world.
        link: Name of a frame of the arm, one of `held_links`; None is the end-effector.
        point: (3,) [m] the point that is held, in the link's frame; without a link it is the
            end-effector's origin.
    """

    who: int
    target: Array
    link: str | None = None
    point: tuple[float, float, float] = (0.0, 0.0, 0.0)


class PullReading(NamedTuple):
    """One person's pull at one instant; positions and force in the world."""

    who: int
    link: str | None
    """As in `Hold`."""
    point: Array
    """(3,) [m] where the robot is held."""
    target: Array
    """(3,) [m] where to."""
    force: Array
    """(3,) [N] the person's force on that point."""


class PersonForces(NamedTuple):
    """What people do to the robot in one control step.

    Attributes:
        hand: (3,) [N] sum of the forces on the end-effector's origin, in the world.
        pushes: Those on other points of the arm.
    """

    hand: Array
    pushes: tuple[Push, ...] = ()


class People:
    """One `PersonHand` for each who holds; forces on the same point add up."""

    def __init__(self, model: RobotModel, config: HandConfig, dt: float) -> None:
        """Nobody holds the robot.

        Args:
            model: The robot.
            config: Strength of each of them.
            dt: [s] between two calls of `pull`.
        """
        self._model, self._config, self._dt = model, config, dt
        self._hands: dict[tuple[object, ...], PersonHand] = {}

    @property
    def config(self) -> HandConfig:
        """Strength of each of them; may be replaced at any time."""
        return self._config

    @config.setter
    def config(self, config: HandConfig) -> None:
        self._config = config
        for hand in self._hands.values():
            hand.config = config

    def pull(self, state: RobotState, holds: Sequence[Hold]) -> list[PullReading]:
        """What each does in one period; who is not among them lets go.

        Whoever takes another point lets go of the one before, and takes hold without a jerk.

        Args:
            state: The robot as it is.
            holds: All that hold, at most one for each `who`.

        Raises:
            TargetError: A target lies below the floor, or is not three finite numbers.
        """
        hands, readings = {}, []
        for hold in holds:
            grip = _grip(hold)
            hand = hands[grip] = self._hands.get(grip) or PersonHand(self._config, self._dt)
            p, v = self._motion(state, hold)
            force = hand.force(p, v, hold.target)
            readings.append(PullReading(hold.who, hold.link, p.copy(), hold.target, force))
        self._hands = hands
        return readings

    def forces(self, holds: Sequence[Hold], readings: Sequence[PullReading]) -> PersonForces:
        """The forces of these pulls, as a plant takes them."""
        hand, pushes = np.zeros(3), []
        for hold, reading in zip(holds, readings, strict=True):
            if hold.link is None:
                hand = hand + reading.force
            else:
                joint, p = held_point(self._model, hold.link, hold.point)
                pushes.append(Push(self._model.pin.names[joint], p, reading.force))
        return PersonForces(hand, tuple(pushes))

    def _motion(self, state: RobotState, hold: Hold) -> tuple[Array, Array]:
        """Position (3,) [m] and velocity (3,) [m/s] of the held point, in the world."""
        if hold.link is None:
            return state.T_world_ee.translation, state.v_ee[:3]
        joint, p = held_point(self._model, hold.link, hold.point)
        p_world = state.data.oMi[joint].act(p)
        return p_world, state.point_velocity(joint, p_world)


def held_links(model: RobotModel) -> tuple[str, ...]:
    """Names of the frames at which the arm can be held: its joints, links and the end-effector."""
    names = [frame.name for frame in model.pin.frames if frame.parentJoint >= _ARM]
    return tuple(dict.fromkeys(names))


def held_point(model: RobotModel, link: str, point: Sequence[float]) -> tuple[int, Array]:
    """The joint that carries a point of a link's frame, and (3,) [m] the point in its frame."""
    frame: pin.Frame = model.pin.frames[model.pin.getFrameId(link)]
    return frame.parentJoint, frame.placement.act(np.array(point, dtype=float))


def _grip(hold: Hold) -> tuple[object, ...]:
    """What has to stay the same for a hold to go on."""
    return hold.who, hold.link, hold.point
