"""Playing a case: its run, as one row of the study's table."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from app.border.cache import BorderData
from app.config import Config
from app.errors import DbbError
from app.robot.model import RobotModel
from app.simulation.run import RunResult, run_scenario
from app.studies.pulls.case import Case
from app.studies.pulls.parameters import StudyParameters
from app.studies.pulls.rounding import rounded

Row = dict[str, Any]
"""Numbers, texts, truths and None, by columns that end in their unit; no NaN."""

TIMES = ("step_p50_us", "step_p99_us", "realtime_factor")
"""Figures of a run that depend on the machine: no study keeps them."""

_INPUTS = {
    "speed": "speed_mps",
    "duration": "duration_s",
    "moving": "moving",
    "release_at": "release_at_s",
    "regrasp_at": "regrasp_at_s",
    "base_delay": "base_delay_s",
    "encoder_noise": "encoder_noise_rad",
    "mass_error": "mass_error",
    "slip": "slip",
    "v_max": "v_max_mps",
    "hand_f_max": "hand_f_max_n",
    "hand_stiffness": "hand_stiffness_npm",
    "hand_mass": "hand_mass_kg",
}
_KNOWN = {"scenario", "controller", "robot", "seed", "duration_s", "physics", "stuck", *TIMES}


def run_case(case: Case, model: RobotModel, data: BorderData, *, log: bool = True) -> RunResult:
    """The run of a case.

    Args:
        case: What happens.
        model: The robot.
        data: Its pairs and clouds.
        log: Whether rows are kept for a log, or figures only.

    Raises:
        DbbError: It cannot be run on this robot.
    """
    return run_scenario(
        model,
        data,
        case.scenario(),
        case.config(),
        controller=case.controller,
        physics=case.physics,
        seed=case.seed,
        log=log,
    )


def play_case(case: Case, model: RobotModel, data: BorderData) -> Row:
    """One row: what was drawn, and what came of it.

    A run that breaks off is a row too: `error` says why, and its figures are missing.
    """
    try:
        result = run_case(case, model, data, log=False)
    except (DbbError, ValueError, ArithmeticError) as error:
        return {**inputs_of(case), "nan": False, "error": f"{type(error).__name__}: {error}"}
    figures = flat(result.figures)
    nan = not (result.recorder.finite and all(map(_finite, figures.values())))
    kept = {key: rounded(value) if _finite(value) else None for key, value in figures.items()}
    return {**inputs_of(case), **kept, "nan": nan, "error": None}


def met_base(row: Row) -> bool:
    """Whether arm and base met: in the plant, or their convex bodies, which are fatter."""
    return bool(row.get("contacts")) or _at_most_zero(row.get("min_clearance_m"))


def met_itself(row: Row) -> bool:
    """The same of two bodies of the arm."""
    return bool(row.get("arm_contacts")) or _at_most_zero(row.get("arm_min_clearance_m"))


def entered_buffer(row: Row) -> bool:
    """Whether the arm came into the buffer of the base."""
    distance = row.get("min_clearance_m")
    return distance is not None and distance < Config().border.d_b


def failed(row: Row) -> bool:
    """Whether a case is one to look at: a contact, a QP without solution, a NaN, a broken run."""
    broken = row["nan"] or row["error"] or row.get("solver_failures")
    return bool(broken) or met_base(row) or met_itself(row)


def inputs_of(case: Case) -> Row:
    """What was drawn, by columns."""
    row: Row = {"case": case.number, "kind": case.kind, "redraws": case.redraws, "seed": case.seed}
    row |= {f"start_{axis}_m": v for axis, v in zip("xyz", case.start, strict=True)}
    row |= {f"move_{axis}_m": v for axis, v in zip("xyz", case.move, strict=True)}
    row |= {column: getattr(case, name) for name, column in _INPUTS.items()}
    return row | {f"q{i}_rad": q for i, q in enumerate(case.q_m, start=1)}


def case_of(row: Row, parameters: StudyParameters) -> Case:
    """The case whose row of a study's table this is; the inverse of `inputs_of`."""
    joints = sum(f"q{i}_rad" in row for i in range(1, len(row)))
    return Case(
        study_seed=parameters.seed,
        number=row["case"],
        kind=row["kind"],
        redraws=row["redraws"],
        robot=parameters.robot,
        controller=parameters.controller,
        physics=parameters.physics,
        start=(row["start_x_m"], row["start_y_m"], row["start_z_m"]),
        move=(row["move_x_m"], row["move_y_m"], row["move_z_m"]),
        seed=row["seed"],
        q_m=tuple(row[f"q{i}_rad"] for i in range(1, joints + 1)),
        **{name: row[column] for name, column in _INPUTS.items()},
    )


def flat(figures: Mapping[str, Any]) -> Row:
    """A run's figures without those of the machine and those that the case has anyway.

    Figures by pair or axis become columns of their own: `min_distance_m` of `lm-lEE` becomes
    `min_distance_lm-lEE_m`.
    """
    row: Row = {}
    for key, value in figures.items():
        if key in _KNOWN:
            continue
        if isinstance(value, Mapping):
            row |= {_joined(key, inner): v for inner, v in value.items()}
        else:
            row[key] = value
    return row


def _joined(key: str, inner: str) -> str:
    return f"{key[:-2]}_{inner}_m" if key.endswith("_m") else f"{key}_{inner}"


def _at_most_zero(distance: float | None) -> bool:
    return distance is not None and distance <= 0.0


def _finite(value: object) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
