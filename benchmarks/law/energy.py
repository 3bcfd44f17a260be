"""The work of a random force near the border: a person must not gain energy from the robot."""

from __future__ import annotations

from contextlib import closing
from typing import Any, NamedTuple

import numpy as np

from app.errors import StudyError
from app.simulation.loop.pacing import gc_frozen
from app.simulation.people import PersonForces
from app.simulation.session import DT, Session
from benchmarks.law.motions import Waves, random_waves
from benchmarks.law.options import Options
from benchmarks.law.release import NAMED
from benchmarks.law.report import Report, largest, least
from benchmarks.law.robot import load
from benchmarks.law.starts import posture
from benchmarks.law.work import played

Array = np.ndarray

PLACES = "front", "wheel axis", "lateral"
_RMS = 6.0  # [N] root mean square of the random force
_SPRING = 40.0  # [N/m] stiffness of the spring that holds the end-effector near the border
_INWARDS = 0.7  # [-] position of the spring's anchor on the named pull, from start to end


class Restless(NamedTuple):
    """A run of some seconds at a place; the force depends on `number`."""

    options: Options
    place: str
    number: int
    seconds: float


def energy(options: Options, count: int = 2, seconds: float = 20.0) -> Report:
    """Push the end-effector near the border with random forces, and compute the person's work.

    Args:
        options: See `Options`.
        count: Number of runs at each place.
        seconds: [s] duration of each run.
    """
    cases = [Restless(options, place, k, seconds) for place in PLACES for k in range(count)]
    rows = played(_play, cases, options.jobs, "runs")
    summary = {
        "runs": len(rows),
        "work_least_j": least(rows, "work_least_j"),
        "below_zero": sum(row["work_least_j"] < 0.0 for row in rows),
        "base_speed_max_mps": largest(rows, "base_speed_max_mps"),
        "least_distance_m": least(rows, "least_distance_m"),
        "failures": sum(row["failures"] for row in rows),
    }
    return Report("energy", rows, summary)


def _play(case: Restless) -> dict[str, Any]:
    """The row of one run.

    The person's force is the random force and that of a spring. Its work is exact, because the
    force is constant within a step.
    """
    options, robot = case.options, load(case.options.robot)
    start, move = NAMED[case.place]
    anchor = np.array(start) + _INWARDS * np.array(move)
    force = _force(np.random.default_rng([options.seed, PLACES.index(case.place), case.number]))
    q_m = posture(options.robot, start, tries=16)
    if q_m is None:
        raise StudyError(f"{case.place}: the arm of {options.robot} does not reach {start}")
    session = Session(robot.model, robot.data, robot.config, controller=options.controller)
    work = lowest = damped = base_speed = 0.0
    nearest, inside, steps = np.inf, 0, round(case.seconds / DT)
    with gc_frozen(), closing(session):
        session.reset(q_m)
        p, given = session.T_world_ee.translation.copy(), np.zeros(3)
        for _ in range(steps):
            wanted = force.at(session.t)[0] + _SPRING * (anchor - p)
            step = session.step(forces=PersonForces(wanted))
            p_now = session.state.T_world_ee.translation.copy()  # before this step's force
            work += float(given @ (p_now - p))
            p, given, lowest = p_now, wanted, min(lowest, work)
            qd = step.truth.qd_m
            damped += float(robot.model.joint_damping @ qd**2) * DT
            base_speed = max(base_speed, abs(float(step.truth.base_velocity[0])))
            d = min(step.distances[: robot.n_mobile])
            nearest, inside = min(nearest, d), inside + (d < robot.config.border.d_b)
        failures = int(session.controller.last.failures)
    return {
        "place": case.place,
        "number": case.number,
        "work_j": work,
        "work_least_j": lowest,
        "joint_damping_j": damped,
        "base_speed_max_mps": base_speed,
        "least_distance_m": nearest,
        "share_inside": inside / steps,
        "failures": failures,
    }


def _force(rng: np.random.Generator) -> Waves:
    """(3,) [N] random force of a person over time, without the force of the spring."""
    waves = random_waves(np.zeros(3), rng, 1.0)
    rms = np.sqrt(0.5 * (waves.amplitude**2).sum(axis=0))
    return waves._replace(amplitude=_RMS / np.sqrt(3.0) * waves.amplitude / rms)
