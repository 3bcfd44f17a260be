"""Contacts while two people pull the arm to random places.

One person pulls the end-effector and another person a link that is random in each run, to random
places above and around the base, with releases from time to time.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.people import Hold, held_links
from app.simulation.run import run_from_spec
from app.simulation.scenarios import free_start
from app.simulation.scenarios.leading import Driver, Scenario, Setting, StepInput
from app.simulation.session import DT, Session
from benchmarks.law.options import Options
from benchmarks.law.report import Report, largest, least
from benchmarks.law.robot import load
from benchmarks.law.work import played

_DURATION = 15.0  # [s]
_ALONE = 4.0  # [s] time at the end in which nobody holds the robot
_STIFFNESS = 300.0, 2500.0  # [N/m] range of the person's stiffness
_FARTHEST = 0.9  # [m] largest horizontal distance of a place from the base's centre
_HEIGHTS = 0.05, 1.3  # [m] range of the heights of places
_AT_A_PLACE = 0.4, 2.5  # [s] range of the time at a place
_LET_GO = 0.25  # [-] probability of a release in place of a pull to the next place


class Walk(NamedTuple):
    """The number of a run, with the options and the largest force [N] of each person."""

    options: Options
    number: int
    force: float


class PullEvent(NamedTuple):
    """A person pulls the robot from a control step on, or releases it.

    Attributes:
        step: Number of the control step.
        who: Number of the person.
        target: (3,) [m] target in the world; None means that the person releases the robot.
        link: Name of the pulled link; None is the end-effector.
    """

    step: int
    who: int
    target: tuple[float, float, float] | None
    link: str | None


@dataclass(frozen=True)
class Wandering(Scenario):
    """People pull the robot from its free start; `pulls` are in the order of their steps."""

    pulls: tuple[PullEvent, ...]

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        q_m = free_start(model, data, config, None, seed)
        return Setting(model, data, np.zeros(3), q_m, config)

    def driver(self, session: Session) -> Driver:
        holds: dict[int, Hold] = {}
        waiting = list(reversed(self.pulls))

        def lead(session: Session) -> StepInput:
            while waiting and waiting[-1].step <= round(session.t / DT):
                _, who, target, link = waiting.pop()
                if target is None:
                    holds.pop(who, None)
                else:
                    holds[who] = Hold(who, np.array(target), link)
            return StepInput(holds=tuple(holds.values()))

        return lead


def wander(options: Options, count: int = 12, force: float = 50.0, first: int = 0) -> Report:
    """Pull end-effector and links from place to place around the base.

    Args:
        options: See `Options`.
        count: Number of runs.
        force: [N] largest force of each of the two people.
        first: Number of the first run.
    """
    walks = [Walk(options, number, force) for number in range(first, first + count)]
    rows = played(play, walks, options.jobs, "wander")
    return Report("wander", rows, _summary(rows))


def play(walk: Walk) -> dict[str, Any]:
    """The row of one run."""
    options, number, force = walk
    robot = load(options.robot)
    rng = np.random.default_rng([options.seed, number])
    links = [None, str(rng.choice(held_links(robot.model)))]
    pulls = sorted(
        (pull for who, link in enumerate(links) for pull in _pulls(rng, who, link)),
        key=lambda pull: pull.step,
    )
    stiffness = float(rng.uniform(*_STIFFNESS))
    config = robot.config.changed({"hand.f_max": force, "hand.stiffness": stiffness})
    scenario = Wandering("wander", _DURATION, "two people wander", tuple(pulls))
    run = RunSpec(options.robot, scenario, config, options.controller, None, options.seed)
    figures = run_from_spec(run, robot.model, robot.data).figures
    return {
        "case": f"{number}, {links[1]}",
        "person": f"{force:.0f} N, {stiffness:.0f} N/m",
        "least_distance_m": figures["min_clearance_m"],
        "least_between_links_m": figures["arm_min_clearance_m"],
        "contact_steps": figures["contacts"],
        "arm_contact_steps": figures["arm_contacts"],
        "joint_speed_share": figures["joint_speed_share_max"],
        "base_speed_final_mps": figures["base_speed_final_mps"],
        "failures": figures["solver_failures"],
    }


def _pulls(rng: np.random.Generator, who: int, link: str | None) -> list[PullEvent]:
    """The pulls of person `who` at a link (None: end-effector), with a release before the end."""
    found, t = [], rng.uniform(0.0, 1.0)
    while t < _DURATION - _ALONE:
        angle, r = rng.uniform(-np.pi, np.pi), rng.uniform(0.0, _FARTHEST)
        place = (float(r * np.cos(angle)), float(r * np.sin(angle)), float(rng.uniform(*_HEIGHTS)))
        gone = rng.random() < _LET_GO
        found.append(PullEvent(round(t / DT), who, None if gone else place, link))
        t += rng.uniform(*_AT_A_PLACE)
    return [*found, PullEvent(round((_DURATION - _ALONE) / DT), who, None, link)]


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    return {
        "runs": len(rows),
        "least_distance_m": least(rows, "least_distance_m"),
        "least_between_links_m": least(rows, "least_between_links_m"),
        "with_contact": sum(row["contact_steps"] + row["arm_contact_steps"] > 0 for row in rows),
        "joint_speed_share_max": largest(rows, "joint_speed_share"),
        "base_speed_final_max_mps": largest(rows, "base_speed_final_mps"),
        "failures": sum(row["failures"] for row in rows),
    }
