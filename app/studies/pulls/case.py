"""A case of a study as a row of a table: the random quantities, then the results of the run.

Robot, controller, plant and the random quantities determine the run.
"""

import math
from collections.abc import Mapping
from typing import Any

from app.border.cache import BorderData
from app.config import parameter
from app.errors import AssetError, DbbError
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.run import run_from_spec
from app.simulation.scenarios.line import RANDOM_PULL
from app.studies.pulls.parameters import PARAMETERS, StudyParameters
from app.studies.runs import Row, flattened, rounded

TIMES = ("step_p50_us", "step_p99_us", "realtime_factor")
"""Results of a run that depend on the machine, which a study does not store."""
_ENDINGS = {"-": "", "s": "_s", "rad": "_rad", "m/s": "_mps", "N": "_n", "N/m": "_npm", "kg": "_kg"}
COLUMNS = {
    "speed": "speed_mps",
    "duration": "duration_s",
    "moving": "moving",
    "release_at": "release_at_s",
    "regrasp_at": "regrasp_at_s",
    **{name: name + _ENDINGS[parameter(path).unit] for name, path in PARAMETERS.items()},
    "fault_at": "fault_at_s",
}
"""The column of each random quantity, by the quantity's name in `StudyRange` or, for `_OF_LINE`, in
`LineScenario`. The columns of release and new grasp are None if the event does not happen.
`fault_at_s` is a time, not a share of the pull."""
_OF_LINE = ("duration", "moving", "release_at", "regrasp_at")
_NOT_STORED = {
    *("scenario", "controller", "robot", "seed", "duration_s", "physics"),  # equal to the inputs
    *("stuck", "left_way"),  # no numbers
    *TIMES,
}


def spec_of(row: Row, parameters: StudyParameters) -> RunSpec:
    """The run of a case, from the random quantities in its row.

    Executing this run raises a `TargetError` if the robot's arm does not have as many joints as the
    row.
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
    return RunSpec(parameters.robot, *run)


def play_case(drawn: Row, parameters: StudyParameters, model: RobotModel, data: BorderData) -> Row:
    """Run a case with the random quantities `drawn`, and return its row with the results.

    If the run stops with an error, `error` in the row is the reason, and the row has no results.
    Otherwise `error` is None, and `nan` is true if a torque, a pose of the base or a result is not
    finite.

    Raises:
        AssetError: The robot's files are missing.
    """
    try:
        result = run_from_spec(spec_of(drawn, parameters), model, data)
    except AssetError:
        raise
    except (DbbError, ValueError, ArithmeticError) as error:
        return stopped(drawn, f"{type(error).__name__}: {error}")
    results = flat(result.figures)
    nan = not (result.trace.finite and all(map(_finite, results.values())))
    stored = {key: rounded(value) if _finite(value) else None for key, value in results.items()}
    return {**drawn, **stored, "nan": nan, "error": None}


def stopped(drawn: Row, reason: str) -> Row:
    """The row of a case whose run stopped with an error."""
    return {**drawn, "nan": False, "error": reason}


def met_base(row: Row) -> bool:
    """Whether the arm touched the base in the plant, or their convex bodies met.

    The convex bodies enclose the links, so they can meet without a contact.
    """
    return bool(row.get("contacts")) or _at_most_zero(row.get("min_clearance_m"))


def met_itself(row: Row) -> bool:
    """Whether the arm touched itself in the plant, or convex bodies of a pair of L_m^c met."""
    return bool(row.get("arm_contacts")) or _at_most_zero(row.get("arm_min_clearance_m"))


def entered_buffer(row: Row, d_b: float) -> bool:
    """Whether the arm came nearer to the base than d_b [m]; false for a run without results."""
    distance = row.get("min_clearance_m")
    return distance is not None and distance < d_b


def failed(row: Row) -> bool:
    """Whether a case failed.

    The reasons are a contact of the arm with the base or itself, an overlap of their convex bodies,
    a control step with the fallback command, a NaN, and an error. A contact with the floor is none.
    """
    broken = row["nan"] or row["error"] or row.get("solver_failures")
    return bool(broken) or met_base(row) or met_itself(row)


def flat(results: Mapping[str, Any]) -> Row:
    """The results of a run by the columns of a study's table."""
    return flattened({key: value for key, value in results.items() if key not in _NOT_STORED})


def _at_most_zero(distance: float | None) -> bool:
    return distance is not None and distance <= 0.0


def _finite(value: object) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
