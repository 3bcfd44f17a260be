"""Releases inside the buffer: motion of the base without a person."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from app.config import Config
from app.simulation.session import DT
from benchmarks.law.draws import named_pull, random_pull, side
from benchmarks.law.options import Options
from benchmarks.law.pull import Pull, joint_share, moments
from benchmarks.law.report import Report, largest, least
from benchmarks.law.robot import load
from benchmarks.law.work import played

NAMED = {
    "front": ((0.92, 0.10, 0.30), (-0.30, 0.0, 0.0)),
    "wheel axis": ((0.0, 0.72, 0.45), (0.0, -0.25, 0.0)),
    "lateral": ((0.30, 0.72, 0.30), (0.0, -0.25, 0.0)),
    "rear side": ((-0.20, 0.70, 0.50), (0.0, -0.25, 0.0)),
}
"""[m] start and displacement of the named pulls."""
_ASKED_FRONT, _ASKED = 0.3, 0.6  # [m] largest accepted path of the base: at the front, elsewhere
_ASKED_SPEED = 1.0  # [mm/s] largest accepted speed of the base after `_REST`
_REST = 10.0  # [s] time after the release


class Release(NamedTuple):
    """A pull and its release.

    Attributes:
        pull: The pull.
        inside_s: [s] time from the arm's entry into the buffer to the release.
        after_s: [s] duration of the measurement after the release.
    """

    pull: Pull
    inside_s: float
    after_s: float


def release(options: Options, count: int = 12, seconds: float = 15.0, first: int = 0) -> Report:
    """Guide the end-effector into the buffer, release it there, and measure the base's motion.

    Args:
        options: See `Options`.
        count: Number of random releases. In addition there are eight releases at the four `NAMED`
            places, two at each place.
        seconds: [s] duration of the measurement after the release.
        first: Number of the first random release. The releases at named places run only if this is
            0.
    """
    cases = []
    for name, (start, move) in NAMED.items() if first == 0 else ():
        for lead in (2.0, 1.0):
            pull = named_pull(options, f"{name}, {lead:g} s", start, move, lead, 300.0, 40.0)
            cases.append(Release(pull, 0.5 * lead, seconds))
    for k in range(first, first + count):
        rng = np.random.default_rng([options.seed, k])
        pull = random_pull(
            options, k, rng, f_max=(40.0, 100.0), stiffness=(300.0, 3000.0), lead=(1.0, 4.0)
        )
        cases.append(Release(pull, float(rng.uniform(0.05, 1.5)), seconds))
    rows = played(play, cases, options.jobs, "releases")
    return Report("release", rows, _summary(rows))


def play(case: Release) -> dict[str, Any]:
    """The row of one release; `path_m` is None if the arm did not enter the buffer in time."""
    pull, d_b = case.pull, Config().border.d_b
    robot = load(pull.robot)
    n = robot.n_mobile
    steps, released, entered = moments(pull), None, None
    path = turned = force = share = 0.0
    speed_late: float | None = None
    nearest, contacts, d_release, let_go = math.inf, 0, None, False
    moment = next(steps)
    while True:
        step = moment.step
        d = min(step.distances[:n])
        nearest = min(nearest, d)
        contacts += step.contacts.arm_base or step.contacts.arm_arm
        share = max(share, joint_share(step, robot.model))
        force = max(force, float(np.linalg.norm(step.person.hand)))
        if released is None:
            if entered is None and d < d_b:
                entered = step.t
            let_go = entered is not None and step.t >= entered + case.inside_s
            if let_go:
                released, d_release = step.t, d
            elif step.t > pull.lead_s + 3.0:
                break
        else:
            *v, w = step.truth.base_velocity
            speed = float(np.linalg.norm(v))
            path, turned = path + speed * DT, turned + abs(float(w)) * DT
            if step.t >= released + _REST:
                speed_late = max(speed_late or 0.0, 1e3 * speed)
            if step.t >= released + case.after_s:
                break
        moment = steps.send(let_go)
    steps.close()
    return {
        "case": pull.name,
        "side": side(pull.start, pull.robot),
        "person": f"{pull.f_max:.0f} N, {pull.stiffness:.0f} N/m",
        "force_max_n": force,
        "d_release_m": d_release,
        "path_m": None if released is None else path,
        "turned_rad": None if released is None else turned,
        "speed_after_10s_mmps": speed_late,
        "least_distance_m": nearest,
        "contact_steps": contacts,
        "joint_speed_share": share,
        "failures": int(moment.session.controller.last.failures),
    }


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    released = [row for row in rows if row["path_m"] is not None]
    front = [row for row in released if row["side"] == "front"]
    return {
        "releases": len(released),
        "never_in_the_buffer": len(rows) - len(released),
        "path_front_max_m": largest(front, "path_m"),
        "path_front_asked_m": _ASKED_FRONT,
        "path_max_m": largest(released, "path_m"),
        "path_asked_m": _ASKED,
        "path_too_long": sum(
            row["path_m"] > (_ASKED_FRONT if row["side"] == "front" else _ASKED) for row in released
        ),
        "speed_after_10s_max_mmps": largest(released, "speed_after_10s_mmps"),
        "speed_asked_mmps": _ASKED_SPEED,
        "still_moving": sum(
            (row["speed_after_10s_mmps"] or 0.0) >= _ASKED_SPEED for row in released
        ),
        "least_distance_m": least(rows, "least_distance_m"),
        "with_contact": sum(row["contact_steps"] > 0 for row in rows),
        "failures": sum(row["failures"] for row in rows),
    }
