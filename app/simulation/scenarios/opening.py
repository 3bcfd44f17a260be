"""The opening of the refrigerator's door, by its adaptive controller at a session's sensors."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from app.control.door_opening import DoorOpening, DoorOpeningGains, HandReading
from app.simulation.scenarios.leading import DoorReading, Lead

if TYPE_CHECKING:
    from app.simulation.plants.door import Door
    from app.simulation.session import Session


class Opener:
    """The adaptive controller at the sensors of a session."""

    def __init__(self, door: Door, session: Session, *, rate: float, guess: float) -> None:
        """Begin with the hand at the handle.

        Args:
            door: That the hand holds.
            session: At its start.
            rate: [deg/s] of the door's turning that the hand's speed gives.
            guess: [deg] by how much the first guess of the direction to the hinge is wrong.
        """
        self._door = door
        T_ee = session.T_world_ee
        speed = math.radians(rate) * door.handle_radius
        gains = DoorOpeningGains(speed=speed)
        turn = -door.side * math.radians(guess)
        turned = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])
        radial = turned @ door.radial(T_ee.translation)
        self._opening = DoorOpening(T_ee, radial, gains, session.physics.dt)

    def __call__(self, session: Session) -> Lead:
        """What leads the hand in the next control step."""
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
