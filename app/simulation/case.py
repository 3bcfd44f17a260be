"""Planned runs, and case files: with the same code, robot and machine, a case repeats a run."""

import json
from functools import cache
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_type_hints

from pydantic import Field, ValidationError, create_model, field_validator, model_validator
from typing_extensions import Self

from app.config import Config, present_name, tunables
from app.control import CONTROLLERS
from app.errors import CaseError, DbbError, check_name
from app.robot.assets import check_robot_name
from app.simulation.plants import chosen_plant
from app.simulation.scenarios import SCENARIOS
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.line import RANDOM_PULL
from app.strict import MAX_SEEDS, Strict, explain, file_text, from_json

_PLAYED: dict[str, Scenario] = SCENARIOS | {RANDOM_PULL.name: RANDOM_PULL}
_MAX_ENTRIES = 1000  # [-] largest number of options, or of parameters; usual numbers are below 100
FORMAT = "dbb_case"  # the key that identifies a case file


class RunSpec(NamedTuple):
    """A planned run: all data that determine its results."""

    robot: str
    scenario: Scenario
    config: Config
    controller: str = "dbb"  # name of the controller
    physics: str | None = None  # name of the plant; None for the default one
    seed: int = 0  # seed of all random numbers


class RunCase(Strict):
    """The contents of a case file: `dbb run`, `dbb serve` and other commands repeat its run."""

    dbb_case: Literal[1] = 1  # version of the file format
    version: str = Field(default_factory=lambda: version("dbb-mobile-manipulator"))
    """Version of the program that wrote the file."""
    robot: str
    played: str  # name of the scenario
    options: dict[str, Any] = Field(max_length=_MAX_ENTRIES)  # all options of the scenario
    controller: str
    physics: str
    seed: int = Field(default=0, ge=0, le=MAX_SEEDS)
    parameters: dict[str, float | str] = Field(max_length=_MAX_ENTRIES)  # all, by their paths

    @model_validator(mode="before")
    @classmethod
    def _drop_figures(cls, data: Any) -> Any:
        """Drop the entry `figures`, the results of the run: earlier versions wrote it."""
        return {k: v for k, v in data.items() if k != "figures"} if isinstance(data, dict) else data

    @field_validator("parameters")
    @classmethod
    def _accept_former_names(cls, values: dict[str, float | str]) -> dict[str, float | str]:
        return {present_name(path): value for path, value in values.items()}

    @classmethod
    def of(cls, run: RunSpec) -> Self:
        return cls(
            robot=run.robot,
            played=run.scenario.name,
            options={name: getattr(run.scenario, name) for name in run.scenario.options},
            controller=run.controller,
            physics=chosen_plant(run.physics),
            seed=run.seed,
            parameters={path: run.config.value(path) for path in sorted(tunables())},
        )

    def spec(self) -> RunSpec:
        """The planned run; raises the errors of `scenario` and `config`."""
        scenario, config = self.scenario(), self.config()
        return RunSpec(self.robot, scenario, config, self.controller, self.physics, self.seed)

    def scenario(self) -> Scenario:
        """The scenario; raises a DbbError if it does not exist, or an option is invalid."""
        check_name("scenario", self.played, _PLAYED)
        played = _PLAYED[self.played]
        record = _options_of(type(played))
        known = {name: value for name, value in self.options.items() if name in record.model_fields}
        try:
            options = record.model_validate_json(json.dumps(known), strict=True)
        except ValidationError as error:
            raise CaseError(f"options of {self.played}: {explain(error, record)}") from None
        return played.changed(**self.options | {name: getattr(options, name) for name in known})

    def config(self) -> Config:
        """The defaults, changed by the case's known parameters; may raise a ConfigError."""
        known = {path: value for path, value in self.parameters.items() if path in tunables()}
        return Config().changed(known)

    def differences(self) -> list[str]:
        """Texts: one if another version wrote the case, one per unknown or missing parameter."""
        now, known, own = version("dbb-mobile-manipulator"), tunables(), self.parameters
        lines = []
        if self.version != now:
            lines.append(f"dbb {self.version} wrote the case; this is dbb {now}")
        for path in sorted(own.keys() - known.keys()):
            lines.append(f"this version has no parameter {path}; its value was {own[path]}")
        for path in sorted(known.keys() - own.keys()):
            default = Config().value(path)
            lines.append(f"the case has no {path}; the default {default} is used")
        return lines

    def text(self) -> str:
        return json.dumps(self.model_dump(mode="json"), indent=1) + "\n"

    @classmethod
    def read(cls, text: str, where: object) -> Self:
        """Read a case from a text; raises a CaseError that names the file `where` and the fault."""
        try:
            content = from_json(text)
        except ValueError as error:
            raise CaseError(f"{where} is not a case: it is not JSON ({error})") from None
        if not isinstance(content, dict) or FORMAT not in content:
            raise CaseError(f"{where} is not a case: it has no {FORMAT!r}")
        try:
            case = cls.model_validate_json(json.dumps(content), strict=True)
            check_robot_name(case.robot)
            check_name("controller", case.controller, CONTROLLERS)
            chosen_plant(case.physics)
            case.spec()
        except ValidationError as error:
            raise CaseError(f"{where} is not a case: {explain(error, cls)}") from None
        except DbbError as error:
            raise CaseError(f"{where} is not a valid case: {error}") from None
        return case


def read_case(path: Path) -> RunCase:
    """Read a case from a file; raises a CaseError that names the fault."""
    try:
        return RunCase.read(file_text(path), path)
    except OSError as error:
        raise CaseError(f"cannot read the case {path}: {error.strerror}") from None
    except ValueError as error:
        raise CaseError(f"{path} is not a case: it is not JSON ({error})") from None


@cache
def _options_of(kind: type[Scenario]) -> type[Strict]:
    """A pydantic model with the fields of a scenario class, each None by default."""
    hints = get_type_hints(kind).items()
    options: dict[str, Any] = {name: (hint | None, None) for name, hint in hints}
    return create_model(kind.__name__, __base__=Strict, **options)
