"""Inputs of controllers in each step of some paths, recorded once, for repeated timing."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import NamedTuple

from app.border.cache import BorderData
from app.config import Config
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.run import begin
from app.simulation.scenarios import LINES
from app.simulation.scenarios.line import LineScenario
from app.simulation.session import DT


class Moment(NamedTuple):
    """The arguments of `ControlLoop.step`."""

    measurement: Measurement
    reference: Reference | None


Path = list[Moment]

_LATERAL, _FOLD = LINES["guiding-lateral"], LINES["guiding-fold"]
PATHS: tuple[LineScenario, ...] = (
    _LATERAL,  # both pairs of L_m
    LINES["guiding-front"],
    LINES["guiding-above"],
    _FOLD,
    _FOLD.changed(start=(0.30, 0.45, 0.90), move=(0.0, -0.50, -0.10)),  # all pairs of the arm
    replace(_LATERAL, name="tracking-lateral", mode="tracking"),  # the same, tracked
)
"""Hand paths of 48 s in which every pair is active at times; for the paper's robot."""


def record(
    model: RobotModel,
    data: BorderData,
    seed: int,
    on_progress: Callable[[float], None] = lambda _: None,
) -> list[Path]:
    """Run all `PATHS` and record the inputs of the controller, one list per path.

    Args:
        model: The robot.
        data: Its pairs and clouds.
        seed: Of the plant.
        on_progress: Called now and then with the simulated time so far [s].

    Raises:
        UnreachableError: No start of the arm for a path.
    """
    recorded: list[Path] = []
    before = 0.0
    for scenario in PATHS:
        setting = scenario.setting(model, data, Config(), seed)
        session = begin(setting, model, controller="dbb", physics=None, seed=seed)
        try:
            driver = scenario.driver(session)
            path: Path = []
            for k in range(round(scenario.duration / DT)):
                lead = driver(session)
                step = session.step(*lead)
                path.append(Moment(step.measurement, lead.reference))
                if k % 200 == 0:
                    on_progress(before + session.t)
        finally:
            session.close()
        recorded.append(path)
        before += scenario.duration
    return recorded
