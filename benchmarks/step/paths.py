"""Inputs of the controller in each step of some paths, recorded once for repeated measurements."""

from __future__ import annotations

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
"""Paths of the end-effector, 48 s in total. Each pair of the paper's robot is active at times."""


def record(model: RobotModel, data: BorderData, seed: int) -> list[Path]:
    """Run all `PATHS`, and record the inputs of the controller, one list for each path.

    Args:
        model: The robot.
        data: Its pairs and clouds.
        seed: Seed of the plant.

    Raises:
        UnreachableError: The arm cannot reach the start of a path.
    """
    recorded: list[Path] = []
    for scenario in PATHS:
        setting = scenario.setting(model, data, Config(), seed)
        session = begin(setting, model, controller="dbb", physics=None, seed=seed)
        try:
            driver = scenario.driver(session)
            path: Path = []
            for _ in range(round(scenario.duration / DT)):
                lead = driver(session)
                step = session.step(*lead)
                path.append(Moment(step.measurement, lead.reference))
        finally:
            session.close()
        recorded.append(path)
    return recorded
