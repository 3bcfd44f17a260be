"""The challenge: visitors' pulls, played again step by step by each controller."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from app.control import CONTROLLERS
from app.dashboard.job import Job
from app.jobs.process import Report
from app.simulation.case import RunCase
from app.system import write_whole

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.robot.model import RobotModel
    from app.simulation.run import RunResult
    from app.simulation.session import Session, Step

FIGURES = (
    "min_clearance_m",
    "arm_min_clearance_m",
    "contacts",
    "arm_contacts",
    "hand_force_max_n",
    "hand_speed_max_mps",
    "base_path_m",
)
"""Those of a run that a case keeps, to be compared to the bit."""


class Tried(NamedTuple):
    """What a controller made of the pulls.

    Attributes:
        least: [m] the least distance of all pairs, at any control step.
        met: Whether parts of the robot met, or were inside of one another.
        pull: [N] the hardest pull of one person.
        speed: [m/s] of the fastest hand.
        figures: Those of `FIGURES`.
    """

    controller: str
    least: float
    met: bool
    pull: float
    speed: float
    figures: dict[str, float]


class Challenge(Job):
    """The last challenge of all viewers, and what came of it.

    Attributes:
        case: What was pulled, once it has ended; with its figures once it was played again.
        tried: What controllers made of it so far, the one that was challenged first.
    """

    def __init__(self) -> None:
        """Nobody has tried yet."""
        super().__init__()
        self.case: RunCase | None = None
        self.tried: tuple[Tried, ...] = ()
        self._taken: RunCase | None = None

    def take(self, case: RunCase | None) -> None:
        """Look at a challenge that has ended, unless it is the same one."""
        if case is None or case == self._taken:
            return
        if self.progress is not None:
            self.cancel()  # of the challenge before; this one begins when that has ended
            return
        self._taken, self.case, self.tried = case, case, ()
        if case.options["pulls"]:
            self.start("Make it collide", "is played again", lambda: self._try_all(case))

    def _try_all(self, case: RunCase) -> None:
        for name in (case.controller, *(c for c in CONTROLLERS if c != case.controller)):
            found = self.run(try_again, case.text(), name)
            if not self.tried:
                self.case = case.model_copy(update={"figures": found.figures})
            self.tried = (*self.tried, found)


def try_again(report: Report, text: str, controller: str) -> Tried:
    """What a controller makes of the pulls of a case."""
    from app.studies.pulls.case import met_base, met_itself

    case = RunCase.read(json.loads(text), "the challenge")
    hardest = 0.0

    def on_step(_: Session, step: Step) -> None:
        nonlocal hardest
        for force in (step.person.hand, *(push.force for push in step.person.pushes)):
            hardest = max(hardest, math.hypot(*force.tolist()))

    figures = _play(report, case, controller, *_loaded(case), on_step=on_step).figures
    distances = [figures[name] for name in FIGURES[:2] if figures[name] is not None]
    return Tried(
        controller,
        min(distances),
        met_base(figures) or met_itself(figures),
        hardest,
        figures["hand_speed_max_mps"],
        {name: figures[name] for name in FIGURES if figures[name] is not None},
    )


def write_case_replay(report: Report, text: str, page: Path) -> None:
    """The replay of a case as a page."""
    from app.dashboard.export.offscreen import Look, replay_html

    case = RunCase.read(json.loads(text), "the challenge")
    model, data = _loaded(case)
    trace = _play(report, case, case.controller, model, data, drawn=True).trace
    report("drawing the pictures", -1.0)
    write_whole(page, replay_html(trace, model, data.clouds, Look()))


def _loaded(case: RunCase) -> tuple[RobotModel, BorderData]:
    """Its robot, and the robot's border."""
    from app.border.cache import load_border_data
    from app.robot.description import load_robot
    from app.robot.model import RobotModel

    model = RobotModel(load_robot(case.robot))
    return model, load_border_data(model, progress=False)


def _play(
    report: Report,
    case: RunCase,
    controller: str,
    model: RobotModel,
    data: BorderData,
    **more: Any,
) -> RunResult:
    from app.simulation.run import run_scenario

    scenario = case.scenario()
    return run_scenario(
        model,
        data,
        scenario,
        case.config(),
        controller=controller,
        physics=case.physics,
        seed=case.seed,
        on_progress=lambda t: report(f"{controller} plays it again", t / scenario.duration),
        **more,
    )
