"""A pull: a person pulls the end-effector along a line, holds it there, and then can release it."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import closing
from typing import NamedTuple

import numpy as np

from app.config import Config
from app.robot.model import RobotModel
from app.simulation.loop.pacing import gc_frozen
from app.simulation.people import PersonHand
from app.simulation.session import DT, Session, Step
from benchmarks.law.robot import load

Array = np.ndarray
Point = tuple[float, float, float]


class Pull(NamedTuple):
    """The parameters of a pull.

    Attributes:
        name: Displayed name.
        robot: Name of the robot.
        controller: Name of the controller.
        q_m: (n_m,) [rad or m] joint positions at the start, with the base at the origin.
        start: (3,) [m] position of the end-effector at the start.
        move: (3,) [m] displacement of the person's target.
        lead_s: [s] duration of this displacement, which is a cubic in time.
        stiffness: [N/m] stiffness of the person's hand.
        f_max: [N] largest force of the person.
    """

    name: str
    robot: str
    controller: str
    q_m: tuple[float, ...]
    start: Point
    move: Point
    lead_s: float
    stiffness: float
    f_max: float

    def target(self, t: float) -> Array:
        """(3,) [m] target of the person's hand at time t [s]; never below the floor."""
        s = min(max(t / self.lead_s, 0.0), 1.0)
        place = np.array(self.start) + s * s * (3 - 2 * s) * np.array(self.move)
        place[2] = max(place[2], 0.0)
        return place

    def config(self) -> Config:
        """The default parameters with this person, whose stiffness can be out of its range."""
        hand = {"stiffness": self.stiffness, "f_max": self.f_max}
        config = Config()
        return config.model_copy(update={"hand": config.hand.model_copy(update=hand)})


class Moment(NamedTuple):
    """One step of a pull.

    Attributes:
        session: The session after the step.
        step: The quantities of the control step.
        p, v: (3,) [m] and [m/s] position and velocity of the end-effector at the start of the step.
        person_speed: [m/s] speed of the person's hand; 0 after the release.
    """

    session: Session
    step: Step
    p: Array
    v: Array
    person_speed: float


def moments(pull: Pull) -> Generator[Moment, bool | None, None]:
    """The steps of a pull, without end; the person lets go when the caller sends True."""
    robot, config = load(pull.robot), pull.config()
    session = Session(robot.model, robot.data, config, controller=pull.controller)
    with gc_frozen(), closing(session):
        session.reset(np.array(pull.q_m))
        shadow, held, before = PersonHand(config.hand, DT), True, np.array(pull.start)
        while True:
            target = pull.target(session.t) if held else None
            step = session.step(pull=target)
            state, speed = session.state, 0.0
            p, v = state.T_world_ee.translation.copy(), state.v_ee[:3].copy()
            if target is not None:  # a copy of the session's person, whose place is private
                shadow.force(p, v, target)
                place = shadow.motion[0].copy()
                speed, before = math.dist(place, before) / DT, place
            let_go = yield Moment(session, step, p, v, speed)
            held = held and not let_go


def joint_share(step: Step, model: RobotModel) -> float:
    """[-] largest |q̇| / q̇_max of the arm's joints; q̇_max is the speed limit."""
    return float(np.max(np.abs(step.truth.qd_m) / model.qd_max))
