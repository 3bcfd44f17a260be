"""The log of a run, taken while it runs."""

from __future__ import annotations

from pathlib import Path

from app.errors import LogError
from app.robot.model import RobotModel
from app.simulation.scenarios.leading import Scenario
from app.simulation.session import Session, Step
from app.simulation.trace.log import LogTable
from app.simulation.trace.log_meta import LogMeta
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.tape import Tape


class RunLog:
    """Takes every control step of a run and keeps a row of each twentieth."""

    def __init__(self, model: RobotModel, scenario: Scenario, physics: str, seed: int) -> None:
        """An empty log.

        Args:
            model: The robot.
            scenario: Which leads the hand.
            physics: Kind of plant.
            seed: Of everything random in the run.
        """
        self._model = model
        self._about = {"scenario": scenario.name, "physics": physics, "seed": seed}
        self._table: LogTable | None = None
        self._tape = Tape(self._take, scenario)

    def add(self, session: Session, step: Step) -> None:
        """Look at one control step."""
        self._tape.add(session, step)

    def write(self, path: Path) -> None:
        """Write it as CSV or Parquet, by the ending of its name.

        Raises:
            LogError: Its ending is neither, or nothing has run.
            OutputError: It cannot be written there.
        """
        if self._table is None:
            raise LogError(f"{path}: a log of no snapshots")
        self._table.write(path)

    def _take(self, snapshot: Snapshot) -> None:
        if self._table is None:
            self._table = LogTable(LogMeta.of(self._model, snapshot, **self._about))
        self._table.add(snapshot)
