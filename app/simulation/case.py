"""A run to be done, and a case: all that it takes to do it again exactly, as a file."""

import json
from importlib.metadata import version
from pathlib import Path
from typing import Any, Literal, NamedTuple

from pydantic import Field, ValidationError, field_validator
from typing_extensions import Self

from app.config import Config, present_name, tunables
from app.control import CONTROLLERS
from app.errors import CaseError, DbbError, check_name
from app.simulation.plants import chosen_plant
from app.simulation.scenarios import SCENARIOS
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.line import RANDOM_PULL
from app.simulation.scenarios.pulled import CHALLENGE
from app.strict import MOST_SEEDS, Finite, Strict, explain, file_text, parsed

_PLAYED: dict[str, Scenario] = SCENARIOS | {each.name: each for each in (CHALLENGE, RANDOM_PULL)}
_MOST = 1000  # [-] options, parameters or figures of a case; there are about a hundred
FORMAT = "dbb_case"  # the key that only such a file has


class Planned(NamedTuple):
    """A run to be done: all that its figures follow from."""

    robot: str
    scenario: Scenario
    config: Config
    controller: str = "dbb"
    physics: str | None = None
    """Kind of plant; the default one if None."""
    seed: int = 0
    """Of everything random."""


class RunCase(Strict):
    """What `dbb run`, `screenshot`, `film`, `report`, `replay`, `serve` and the page play again."""

    dbb_case: Literal[1] = 1
    """Number of the file's layout."""
    version: str = Field(default_factory=lambda: version("dbb-mobile-manipulator"))
    """Of the program that wrote it."""
    robot: str
    played: str
    """Name of the scenario."""
    options: dict[str, Any] = Field(max_length=_MOST)
    """Of the scenario, all of them."""
    controller: str
    physics: str
    seed: int = Field(default=0, ge=0, le=MOST_SEEDS)
    parameters: dict[str, float | str] = Field(max_length=_MOST)
    """All of them, by their paths."""
    figures: dict[str, Finite] = Field(default_factory=dict, max_length=_MOST)
    """What came of it, by the names of `dbb run`'s figures."""

    @field_validator("parameters")
    @classmethod
    def _accept_former_names(cls, values: dict[str, float | str]) -> dict[str, float | str]:
        return {present_name(path): value for path, value in values.items()}

    @classmethod
    def of(cls, run: Planned) -> Self:
        """The case of a run."""
        return cls(
            robot=run.robot,
            played=run.scenario.name,
            options={name: getattr(run.scenario, name) for name in run.scenario.options},
            controller=run.controller,
            physics=chosen_plant(run.physics),
            seed=run.seed,
            parameters={path: run.config.value(path) for path in sorted(tunables())},
        )

    def planned(self) -> Planned:
        """The run; raises what `scenario` and `config` do."""
        run = self.controller, self.physics, self.seed
        return Planned(self.robot, self.scenario(), self.config(), *run)

    def scenario(self) -> Scenario:
        """What is played.

        Raises:
            DbbError: There is no such scenario, or its options are none that it can have.
        """
        check_name("scenario", self.played, _PLAYED)
        options = {name: _tuples(value) for name, value in self.options.items()}
        return _PLAYED[self.played].changed(**options)

    def config(self) -> Config:
        """The parameters, as far as there are such ones by now.

        Raises:
            ConfigError: One is out of its range.
        """
        known = {path: value for path, value in self.parameters.items() if path in tunables()}
        return Config().changed(known)

    def differences(self) -> list[str]:
        """What is not as it was when the case was written, a line each."""
        now, found = version("dbb-mobile-manipulator"), []
        if self.version != now:
            found.append(f"the case was written by dbb {self.version}, this is {now}")
        for path in sorted(self.parameters.keys() - tunables().keys()):
            found.append(f"there is no parameter {path} any more; it was {self.parameters[path]}")
        for path in sorted(tunables().keys() - self.parameters.keys()):
            found.append(f"the case has no {path} yet; it is {Config().value(path)}")
        return found

    def changes(self, figures: dict[str, Any]) -> list[str]:
        """Which of its figures did not come out as they are in the case, a line each."""
        return [
            f"{name} was {value!r}, is now {figures.get(name)!r}"
            for name, value in self.figures.items()
            if figures.get(name) != value
        ]

    def text(self) -> str:
        """The file."""
        return json.dumps(self.model_dump(mode="json"), indent=1) + "\n"

    @classmethod
    def read(cls, text: str, where: object) -> Self:
        """The case of a file's text.

        Raises:
            CaseError: It is none; says what is wrong. Names and options are checked too.
        """
        try:
            content = parsed(json.loads, text)
        except ValueError as error:
            raise CaseError(f"{where} is no case: not JSON ({error})") from None
        if not isinstance(content, dict) or FORMAT not in content:
            raise CaseError(f"{where} is no case: it has no {FORMAT!r}")
        try:
            case = cls.model_validate_json(json.dumps(content))
            check_name("controller", case.controller, CONTROLLERS)
            case.scenario()
            case.config()
        except ValidationError as error:
            raise CaseError(f"{where} is no case: {explain(error, cls)}") from None
        except DbbError as error:
            raise CaseError(f"{where} is no case of today: {error}") from None
        return case


def read_case(path: Path) -> RunCase:
    """The case of a file.

    Raises:
        CaseError: There is no such file, or it holds no case; says what is wrong.
    """
    try:
        return RunCase.read(file_text(path), path)
    except OSError as error:
        raise CaseError(f"cannot read the case {path}: {error.strerror}") from None
    except ValueError as error:
        raise CaseError(f"{path} is no case: not JSON ({error})") from None


def _tuples(value: Any) -> Any:
    """Lists of a file as the records have them."""
    return tuple(map(_tuples, value)) if isinstance(value, list | tuple) else value
