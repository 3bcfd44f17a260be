"""Strong pulls: the smallest distance of arm and base, and the end-effector's speed afterwards."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from app.config import Config
from app.simulation.trace.snapshot import EVERY, QUANTITIES
from benchmarks.law.draws import named_pull, random_pull, side
from benchmarks.law.options import Options
from benchmarks.law.pull import Pull, joint_share, moments
from benchmarks.law.report import Report, largest, least
from benchmarks.law.robot import load
from benchmarks.law.work import played

_FIXED = (0.369, 0.639, 0.30), (-0.245, -0.424, 0.0)
"""[m] start and displacement of the fixed pulls."""
_FIXED_LEAD = 0.54  # [s] duration of the displacement
_FIXED_HELD = 0.36  # [s] time of holding after the displacement
_FIXED_STIFFNESS = 2000.0  # [N/m]
_FIXED_FORCES = 40.0, 60.0, 80.0, 100.0  # [N]
_ABOVE = 0.2  # [-] share of the random pulls that start over the base
_THROWN = 1.1  # [-] ratio to the person's speed above which the arm is out of control
_CLAIMED = 80.0  # [N] largest force for which the summary has separate counts


class Held(NamedTuple):
    """A pull, and the time [s] for which the person holds the end-effector at its end."""

    pull: Pull
    held_s: float


def pulls(
    options: Options, count: int = 24, held: float = 1.5, first: int = 0, column: float = 0.0
) -> Report:
    """Pull the end-effector hard towards the base or into the arm's own column.

    Args:
        options: See `Options`.
        count: Number of random pulls, in addition to four fixed pulls.
        held: [s] time for which the person holds the end-effector at the end of a random pull.
        first: Number of the first random pull; the fixed pulls run only with 0.
        column: [-] share of the random pulls towards the arm's own column.
    """
    rows = played(play, cases(options, count, held, first, column), options.jobs, "pulls")
    return Report("pulls", rows, _summary(rows))


def cases(
    options: Options, count: int, held: float, first: int = 0, column: float = 0.0
) -> list[Held]:
    """The fixed pulls if `first` is 0, then random pulls."""
    found = [
        Held(
            named_pull(
                options, f"fixed, {f_max:g} N", *_FIXED, _FIXED_LEAD, _FIXED_STIFFNESS, f_max
            ),
            _FIXED_HELD,
        )
        for f_max in (_FIXED_FORCES if first == 0 else ())
    ]
    for k in range(first, first + count):
        rng = np.random.default_rng([options.seed, k])
        pull = random_pull(
            options,
            k,
            rng,
            f_max=(30.0, 100.0),
            stiffness=(300.0, 3000.0),
            above=_ABOVE,
            column=column,
        )
        found.append(Held(pull, held))
    return found


def play(case: Held) -> dict[str, Any]:
    """The row of one pull."""
    pull = case.pull
    robot = load(pull.robot)
    n, tau_max = robot.n_mobile, robot.model.tau_max
    force = person = back = torque = 0.0
    nearest = links = math.inf
    contacts, floor, shares, bounds, moment = 0, 0, [], [], None
    bound = QUANTITIES["force_bound"].take
    assert bound is not None
    steps = moments(pull)
    for moment in steps:
        step = moment.step
        if step.t > pull.lead_s + case.held_s:
            break
        d = min(step.distances[:n])
        if d < nearest:
            nearest, back = d, 0.0
        links = min((links, *step.distances[n:]))
        back = max(back, float(np.linalg.norm(moment.v)))  # since the nearest instant
        person = max(person, moment.person_speed)
        force = max(force, float(np.linalg.norm(step.person.hand)))
        torque = max(torque, float(np.max(np.abs(step.control.u_cmd) / tau_max)))
        contacts += step.contacts.arm_base or step.contacts.arm_arm
        floor += step.contacts.arm_floor
        if len(shares) % EVERY == 0:
            bounds.append(bound(moment.session, step))
        shares.append(joint_share(step, robot.model))
    steps.close()
    assert moment is not None
    return {
        "case": pull.name,
        "side": side(pull.start, pull.robot),
        "person": f"{pull.f_max:.0f} N, {pull.stiffness:.0f} N/m",
        "f_max_n": pull.f_max,
        "force_max_n": force,
        "force_bound_min_n": min((b for b in bounds if not math.isnan(b)), default=None),
        "person_speed_mps": person,
        "least_distance_m": nearest,
        "overlap_m": max(0.0, -nearest),
        "least_between_links_m": links,
        "contact_steps": contacts,
        "floor_contact_steps": floor,
        "hand_speed_after_mps": back,
        "thrown": nearest < Config().border.d_b and back > _THROWN * person,
        "torque_share": torque,
        "joint_speed_share": max(shares),
        "steps": len(shares),
        "steps_over_1": sum(s > 1.0 for s in shares),
        "steps_over_1.01": sum(s > 1.01 for s in shares),
        "failures": int(moment.session.controller.last.failures),
    }


def _summary(rows: list[dict[str, Any]]) -> dict[str, Any]:
    claimed = [row for row in rows if row["f_max_n"] <= _CLAIMED]
    free = [row for row in rows if not row["floor_contact_steps"]]  # the floor's force is no pull
    within = [row for row in free if row["force_max_n"] <= (row["force_bound_min_n"] or 0.0)]
    return {
        "pulls": len(rows),
        "entered_the_buffer": sum(row["least_distance_m"] < Config().border.d_b for row in rows),
        "up_to_80_n": len(claimed),
        "overlaps": sum(row["overlap_m"] > 0.0 for row in rows),
        "overlaps_up_to_80_n": sum(row["overlap_m"] > 0.0 for row in claimed),
        "least_distance_m": least(rows, "least_distance_m"),
        "least_distance_up_to_80_n_m": least(claimed, "least_distance_m"),
        "least_between_links_m": least(rows, "least_between_links_m"),
        "with_contact": sum(row["contact_steps"] > 0 for row in rows),
        "thrown_faster_than_the_person": sum(row["thrown"] for row in rows),
        "hand_speed_after_max_mps": largest(rows, "hand_speed_after_mps"),
        "joint_speed_share_max": largest(rows, "joint_speed_share"),
        "joint_speed_over_1.01": sum(row["joint_speed_share"] > 1.01 for row in rows),
        "without_floor_contact": len(free),
        "within_the_force_bound": len(within),
        "joint_speed_share_max_within_it": largest(within, "joint_speed_share"),
        "failures": sum(row["failures"] for row in rows),
    }
