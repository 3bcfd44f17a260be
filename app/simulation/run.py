"""A scenario from start to end, headless and as fast as it goes."""

from __future__ import annotations

from collections.abc import Callable
from time import perf_counter
from typing import NamedTuple

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.begin import begin
from app.simulation.leading import Scenario
from app.simulation.recording import Recorder
from app.simulation.session import DT


class RunResult(NamedTuple):
    """Figures of a run and its recorder."""

    figures: dict[str, object]
    recorder: Recorder


def run_scenario(
    model: RobotModel,
    data: BorderData,
    scenario: Scenario,
    config: Config,
    *,
    controller: str = "dbb",
    physics: str = "planar",
    seed: int = 0,
    on_progress: Callable[[float], None] = lambda _: None,
) -> RunResult:
    """Run a scenario and take its figures.

    Args:
        model: The robot.
        data: Its pairs and clouds.
        scenario: What happens.
        config: Parameters.
        controller: One of `app.control.controller.CONTROLLERS`.
        physics: Kind of plant.
        seed: Of everything random in the run.
        on_progress: Called now and then with the simulated time [s].

    Raises:
        UnreachableError: No start of the arm for this scenario.
        TargetError: The hand would be led below the floor.
        ConfigError: The plant has no doors, and the scenario has one.
        UnknownNameError: No such controller or plant.
    """
    setting = scenario.setting(model, data, config, seed)
    session = begin(setting, model, controller=controller, physics=physics, seed=seed)
    try:
        leader = scenario.leader(session)
        recorder = Recorder(setting.model)
        begun = perf_counter()
        for k in range(round(scenario.duration / DT)):
            step = session.step(*leader(session))
            recorder.add(step)
            if k % 100 == 0:
                on_progress(session.t)
        elapsed = perf_counter() - begun
    finally:
        session.close()
    figures: dict[str, object] = {
        "scenario": scenario.name,
        "controller": controller,
        "robot": model.description.name,
        "seed": seed,
        "duration_s": scenario.duration,
        "physics": physics,
        **recorder.figures(),
        "realtime_factor": scenario.duration / elapsed,
    }
    return RunResult(figures, recorder)
