"""One case of a study, which is a row of its table: what was drawn, then what came of it.

The columns that were drawn are all that it takes to run it again exactly.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from app.config import Config
from app.errors import AssetError, DbbError
from app.robot.description import load_robot
from app.simulation.case import Planned
from app.simulation.scenarios.line import RANDOM_PULL
from app.studies.pulls.parameters import PARAMETERS, StudyParameters
from app.studies.runs import Row, flattened, rounded

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.robot.model import RobotModel

TIMES = ("step_p50_us", "step_p99_us", "realtime_factor")
"""Figures of a run that depend on the machine: no study keeps them."""
COLUMNS = {
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
    "payload": "payload_kg",
    "sensor_delay": "sensor_delay_s",
    "sensor_period": "sensor_period_s",
    "dropped": "dropped",
    "unknown_load": "unknown_load_kg",
    "stated_period": "stated_period_s",
    "fault_at": "fault_at_s",
}
"""Where a row has what was drawn: the hand's largest speed, times of the pull (None for what does
not happen), and parameters, by their names in `StudyRange`."""
_OF_LINE = ("duration", "moving", "release_at", "regrasp_at")
_OF_TRACKING = {"stuck", "left_way"}
_KNOWN = {"scenario", "controller", "robot", "seed", "duration_s", "physics", *TIMES, *_OF_TRACKING}


def planned_of(row: Row, parameters: StudyParameters) -> Planned:
    """The run of a case, by what was drawn: the columns of its row.

    Doing it raises a `CaseError` on a robot of another arm.
    """
    joints = sum(f"q{i}_rad" in row for i in range(1, len(row)))
    drawn = {path: row[COLUMNS[name]] for name, path in PARAMETERS.items()}
    drawn["disturbance.begins"] = row[COLUMNS["fault_at"]]
    config = load_robot(parameters.robot).config.changed(drawn)
    scenario = RANDOM_PULL.changed(
        start=tuple(row[f"start_{axis}_m"] for axis in "xyz"),
        move=tuple(row[f"move_{axis}_m"] for axis in "xyz"),
        q_m=tuple(row[f"q{i}_rad"] for i in range(1, joints + 1)),
        **{name: row[COLUMNS[name]] for name in _OF_LINE},
    )
    run = scenario, config, parameters.controller, parameters.physics, row["seed"]
    return Planned(parameters.robot, *run)


def play_case(drawn: Row, parameters: StudyParameters, model: RobotModel, data: BorderData) -> Row:
    """The row of a case: what was drawn, and what came of it.

    A run that breaks off is a row too: `error` says why, and its figures are missing.

    Raises:
        AssetError: The robot's files are not there, for this case as for any other.
    """
    # Imported here: cases are drawn where nothing is run.
    from app.simulation.run import run_planned

    try:
        result = run_planned(planned_of(drawn, parameters), model, data)
    except AssetError:
        raise
    except (DbbError, ValueError, ArithmeticError) as error:
        return broken_off(drawn, f"{type(error).__name__}: {error}")
    figures = flat(result.figures)
    nan = not (result.trace.finite and all(map(_finite, figures.values())))
    kept = {key: rounded(value) if _finite(value) else None for key, value in figures.items()}
    return {**drawn, **kept, "nan": nan, "error": None}


def broken_off(drawn: Row, why: str) -> Row:
    """The row of a case that came to no figures."""
    return {**drawn, "nan": False, "error": why}


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


def flat(figures: Mapping[str, Any]) -> Row:
    """A run's figures in columns, without those of the machine and those that the case has."""
    return flattened({key: value for key, value in figures.items() if key not in _KNOWN})


def _at_most_zero(distance: float | None) -> bool:
    return distance is not None and distance <= 0.0


def _finite(value: object) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
