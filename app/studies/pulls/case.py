"""One case of a study: all that it takes to run it again, exactly."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import Field, ValidationError

from app.border.cache import BorderData
from app.config import Config
from app.errors import CaseError, ConfigError
from app.robot.model import RobotModel
from app.simulation.person import checked_target
from app.simulation.scenarios.leading import Setting
from app.simulation.scenarios.line import LineScenario
from app.strict import Finite, Positive, Strict, Vector3, explain
from app.studies.pulls.draw_range import PARAMETERS

_KEY = "case"  # under which the file of a failure keeps it, beside its figures
_FORMER = {"strength", "noise", "delay", "base_speed"}  # fields of cases before hands had springs


@dataclass(frozen=True)
class PosedLine(LineScenario):
    """A pull along a line from a posture of the arm that is given and not searched."""

    q_m: tuple[float, ...]
    """(n_m,) [rad or m] the arm's joints at the start."""

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """See `Scenario.setting`.

        Raises:
            CaseError: The posture is of another arm.
            TargetError: The hand would be led below the floor.
        """
        q_m = np.array(self.q_m)
        if len(q_m) != model.n_m:
            raise CaseError(
                f"{self.name}: a posture of {len(q_m)} joints; the arm of "
                f"{model.description.name} has {model.n_m}"
            )
        checked_target(np.add(self.start, self.move))
        return Setting(model, data, np.zeros(3), q_m, config)


class Case(Strict):
    """A person pulls the hand from a start towards the base, on a robot that is not as modelled."""

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
    base_delay: Finite
    """[s] between a velocity command and the base's drive."""
    encoder_noise: Finite
    """[rad] standard deviation of the noise of each joint's measured position."""
    mass_error: Finite
    """[-] by how much the controller takes the arm's masses for too large."""
    slip: Finite
    """[-] share of the base's motion that is lost at the ground."""
    v_max: Finite
    """[m/s] the largest speed that the admittance law may command."""
    hand_f_max: Finite
    """[N] largest force of the person's spring and damper."""
    hand_stiffness: Finite
    """[N/m] of that spring."""
    hand_mass: Finite
    """[kg] of the person's hand and forearm."""
    seed: int = Field(ge=0)
    """[-] of everything random in the run."""

    @property
    def name(self) -> str:
        """As in `case-00017`."""
        return f"case-{self.number:05d}"

    def scenario(self) -> PosedLine:
        """The pull."""
        return PosedLine(
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

    def config(self) -> Config:
        """The parameters: the defaults, but for what the case draws.

        Raises:
            ConfigError: A value is out of its parameter's range.
        """
        config = Config()
        for name, path in PARAMETERS.items():
            config = config.replace(path, getattr(self, name))
        return config


def check_no_others(**options: object) -> None:
    """Refuse options that a replayed case already answers.

    Args:
        options: By their names; None was not given.

    Raises:
        ConfigError: Names the first that was.
    """
    for name, value in options.items():
        if value is not None:
            option = "SCENARIO" if name == "scenario" else f"--{name.replace('_', '-')}"
            raise ConfigError(f"{option}: --replay-case takes it from its file; leave one of them")


def read_case(path: Path) -> Case:
    """The case of a file: one of a study's `failures`, or a case alone.

    Raises:
        CaseError: There is no such file, or it holds no case; says what is wrong.
    """
    try:
        content: Any = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise CaseError(f"cannot read the case {path}: {error.strerror}") from None
    except ValueError as error:
        raise CaseError(f"{path} is no case: not JSON ({error})") from None
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
