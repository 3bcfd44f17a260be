"""One case of a study: all that it takes to run it again exactly, and its run as a row."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import Field, ValidationError

from app.config import Config
from app.errors import CaseError, DbbError
from app.simulation.case import FORMAT, Planned, RunCase
from app.simulation.scenarios.line import StartedLine
from app.strict import Finite, Positive, Vector3, explain, parsed
from app.studies.pulls.parameters import PARAMETERS, StudyParameters, one_of_each
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
}
"""Where a row has what was drawn, by its name in `Case`."""
_OF_TRACKING = {"stuck", "left_way"}
_KNOWN = {"scenario", "controller", "robot", "seed", "duration_s", "physics", *TIMES, *_OF_TRACKING}

_KEY = "case"  # under which the file of a failure keeps it, beside its figures
_FORMER = {"strength", "noise", "delay", "base_speed"}  # fields of cases before hands had springs


class Case(one_of_each(Finite)):
    """A person pulls the hand from a start towards the base, on a robot that is not as modelled.

    It has a value of each of `PARAMETERS` too, in the unit of its interval in `StudyRange`.
    """

    study_seed: int = Field(ge=0)
    """[-] of the study that drew it."""
    number: int = Field(ge=0)
    """[-] of the case in that study."""
    kind: str
    """From where the pull comes, and whether towards the base or along it."""
    redraws: int = Field(ge=0)
    """[-] starts that were drawn before and that the arm does not reach clear of its buffers."""
    robot: str
    controller: str
    physics: str
    start: Vector3
    """[m] where the hand starts, in the world; the base stands at the origin, facing +x."""
    move: Vector3
    """[m] how far it is pulled."""
    speed: Positive
    """[m/s] largest speed of the person's hand on its way."""
    duration: Positive
    """[s] of the run."""
    moving: float = Field(gt=0.0, le=1.0)
    """[-] share of the duration in which the hand is pulled; then it is held."""
    q_m: tuple[Finite, ...]
    """(n_m,) [rad or m] the arm's joints at the start."""
    release_at: Finite | None
    """[s] when the person lets go, or None."""
    regrasp_at: Finite | None
    """[s] when the person takes hold again, or None."""
    seed: int = Field(ge=0)
    """[-] of everything random in the run."""

    @property
    def name(self) -> str:
        """As in `case-00017`."""
        return f"case-{self.number:05d}"

    def scenario(self) -> StartedLine:
        """The pull."""
        return StartedLine(
            self.name,
            self.duration,
            f"{self.kind}, case {self.number} of a study",
            "guiding",
            self.start,
            self.move,
            self.moving,
            self.q_m,
            release_at=self.release_at,
            regrasp_at=self.regrasp_at,
        )

    def planned(self) -> Planned:
        """The run; doing it raises a `CaseError` on a robot of another arm."""
        run = self.scenario(), self.config(), self.controller, self.physics, self.seed
        return Planned(self.robot, *run)

    def differences(self) -> list[str]:
        """See `RunCase.differences`: a study's case names no version."""
        return []

    def changes(self, figures: Row) -> list[str]:
        """See `RunCase.changes`: a study keeps them in its table."""
        del figures
        return []

    def config(self) -> Config:
        """The parameters: the defaults, but for what the case draws.

        Raises:
            ConfigError: A value is out of its parameter's range.
        """
        config = Config()
        for name, path in PARAMETERS.items():
            config = config.replace(path, getattr(self, name))
        return config


def read_case(path: Path) -> Case | RunCase:
    """The case of a file: of the page, one of a study's `failures`, or such a case alone.

    Raises:
        CaseError: There is no such file, or it holds no case; says what is wrong.
    """
    try:
        content: Any = parsed(json.loads, path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CaseError(f"cannot read the case {path}: {error.strerror}") from None
    except ValueError as error:
        raise CaseError(f"{path} is no case: not JSON ({error})") from None
    if isinstance(content, dict) and FORMAT in content:
        return RunCase.read(content, path)
    if isinstance(content, dict) and _KEY in content:
        content = content[_KEY]
    if isinstance(content, dict) and _FORMER & content.keys():
        raise CaseError(
            f"{path} is a case of an older version of dbb study, whose person had no spring and no "
            "mass of its own; draw such cases anew by dbb study"
        )
    try:
        return Case.model_validate_json(json.dumps(content))
    except ValidationError as error:
        raise CaseError(f"{path} is no case: {explain(error, Case)}") from None


def play_case(case: Case, model: RobotModel, data: BorderData) -> Row:
    """One row: what was drawn, and what came of it.

    A run that breaks off is a row too: `error` says why, and its figures are missing.
    """
    # Imported here: cases are read where nothing is run.
    from app.simulation.run import run_planned

    try:
        result = run_planned(case.planned(), model, data)
    except (DbbError, ValueError, ArithmeticError) as error:
        return {**inputs_of(case), "nan": False, "error": f"{type(error).__name__}: {error}"}
    figures = flat(result.figures)
    nan = not (result.trace.finite and all(map(_finite, figures.values())))
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
    row |= {column: getattr(case, name) for name, column in COLUMNS.items()}
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
        **{name: row[column] for name, column in COLUMNS.items()},
    )


def flat(figures: Mapping[str, Any]) -> Row:
    """A run's figures in columns, without those of the machine and those that the case has."""
    return flattened({key: value for key, value in figures.items() if key not in _KNOWN})


def _at_most_zero(distance: float | None) -> bool:
    return distance is not None and distance <= 0.0


def _finite(value: object) -> bool:
    return not isinstance(value, float) or math.isfinite(value)
