"""A run that is asked for, by a scenario's name or by a case: whole, or up to some times."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from app.cli.common import load_robot_and_border, say
from app.cli.options import Setup, check_name, configured
from app.cli.records import Given
from app.config import Config
from app.jobs.progress import progress_bar
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.scenarios.leading import Scenario

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.robot.model import RobotModel
    from app.simulation.case import RunCase
    from app.simulation.run import RunResult
    from app.simulation.trace.snapshot import Snapshot
    from app.simulation.trace.trace import Trace
    from app.studies.pulls.case import Case

_CASE = ".json"


class Wanted(NamedTuple):
    """What is run, with what, and with which parameters."""

    scenario: Scenario
    setup: Setup
    config: Config

    @classmethod
    def named(cls, word: str, setup: Given, config: Path | None) -> Wanted:
        """The run of a scenario by its name, or of a case by its file.

        Raises:
            DbbError: There is no such scenario or case, or the case has already what is given.
        """
        # Imported here: it takes longer than to find a mistake in what was asked.
        from app.robot.assets import load_robot

        if not is_case(word):
            chosen, tuned = Setup(**setup), configured(config)
            return cls(scenario_of(load_robot(chosen.robot), word), chosen, tuned)
        from app.studies.pulls.case import check_no_others

        own = {name: setup.get(name) for name in ("robot", "seed")}
        check_no_others({**own, "config": config}, word)
        return cls.of(read(Path(word)), setup)

    @classmethod
    def of(cls, case: Case | RunCase, setup: Given) -> Wanted:
        """The run of a case, with another controller or plant if they are given."""
        own = {name: getattr(case, name) for name in ("robot", "controller", "physics", "seed")}
        return cls(case.scenario(), Setup(**(own | setup)), case.config())

    def result(self, model: RobotModel, data: BorderData, *, drawn: bool) -> RunResult:
        """All of it, under a bar of progress; see `run_scenario`."""
        # Imported here: it takes longer than to find a mistake in what was asked.
        from app.simulation.run import run_scenario

        scenario, setup, config = self
        with progress_bar(f"{scenario.name}, {setup.controller}", scenario.duration) as progress:
            return run_scenario(
                model,
                data,
                scenario,
                config,
                controller=setup.controller,
                physics=setup.physics,
                seed=setup.seed,
                on_progress=progress,
                drawn=drawn,
            )

    def filmed(
        self, model: RobotModel, data: BorderData, times: Sequence[float], controller: str = ""
    ) -> list[Snapshot]:
        """Snapshots up to the last of some times [s], of another controller if it is named."""
        from app.simulation.run import filmed, steps_of

        scenario, setup, config = self
        controller = controller or setup.controller
        with progress_bar(f"{scenario.name}, {controller}", max(times)) as on_progress:
            steps = steps_of(
                model,
                data,
                scenario,
                config,
                controller=controller,
                physics=setup.physics,
                seed=setup.seed,
            )
            return filmed(steps, scenario, times, on_progress)


def is_case(word: str) -> bool:
    """Whether a word is the file of a case rather than the name of a scenario.

    Raises:
        UnknownNameError: It is neither.
    """
    if not word.lower().endswith(_CASE):
        check_name("scenario", word, SCENARIOS)
        return False
    return True


def read(path: Path) -> Case | RunCase:
    """The case of a file; what differs since it was written is said.

    Raises:
        DbbError: It is none.
    """
    from app.studies.pulls.case import read_case

    case = read_case(path)
    for difference in case.differences():
        say(difference)
    return case


def trace_of(path: Path) -> Trace:
    """The run of a log, or of a case, which is run for it.

    Raises:
        DbbError: It is neither.
    """
    from app.simulation.trace.trace import read_trace

    if path.suffix.lower() != _CASE:
        return read_trace(path)
    wanted = Wanted.of(read(path), {})
    return wanted.result(*load_robot_and_border(wanted.setup.robot), drawn=True).trace
