"""A scenario from start to end, headless and as fast as it goes."""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing
from time import perf_counter
from typing import NamedTuple

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.loop.gc_freeze import settled
from app.simulation.plants.choice import chosen_plant
from app.simulation.scenarios.begin import begin
from app.simulation.scenarios.leading import Scenario
from app.simulation.session import DT, Session, Step
from app.simulation.trace.recording import Recorder


class RunResult(NamedTuple):
    """Figures of a run and its recorder."""

    figures: dict[str, object]
    recorder: Recorder


def steps_of(
    model: RobotModel,
    data: BorderData,
    scenario: Scenario,
    config: Config,
    *,
    controller: str = "dbb",
    physics: str | None = None,
    seed: int = 0,
) -> Generator[tuple[Session, Step], None, None]:
    """The control steps of a scenario, one by one, with the session after each.

    The session is closed when the last step has been taken, or the iterator is.

    Args:
        model: The robot.
        data: Its pairs and clouds.
        scenario: What happens.
        config: Parameters.
        controller: One of `app.control.controller.CONTROLLERS`.
        physics: Kind of plant; the default one if not given.
        seed: Of everything random in the run.

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
        for _ in range(round(scenario.duration / DT)):
            yield session, session.step(*leader(session))
    finally:
        session.close()


def run_scenario(
    model: RobotModel,
    data: BorderData,
    scenario: Scenario,
    config: Config,
    *,
    controller: str = "dbb",
    physics: str | None = None,
    seed: int = 0,
    on_progress: Callable[[float], None] = lambda _: None,
    on_step: Callable[[Session, Step], None] | None = None,
    log: bool = True,
) -> RunResult:
    """Run a scenario and take its figures; arguments and errors are those of `steps_of`.

    Args:
        model: The robot.
        data: Its pairs and clouds.
        scenario: What happens.
        config: Parameters.
        controller: One of `app.control.controller.CONTROLLERS`.
        physics: Kind of plant; the default one if not given.
        seed: Of everything random in the run.
        on_progress: Called now and then with the simulated time [s].
        on_step: Called after each control step, such as to take snapshots.
        log: Whether the recorder keeps rows for the log, or figures only.
    """
    physics = chosen_plant(physics)
    recorder: Recorder | None = None
    begun = perf_counter()
    steps = steps_of(
        model, data, scenario, config, controller=controller, physics=physics, seed=seed
    )
    with settled(), closing(steps):
        for k, (session, step) in enumerate(steps):
            if recorder is None:
                recorder, begun = Recorder(session.model, log=log), perf_counter() - step.duration
            recorder.add(step)
            if on_step is not None:
                on_step(session, step)
            if k % 100 == 0:
                on_progress(session.t)
    elapsed = perf_counter() - begun
    assert recorder is not None, "a scenario lasts at least one step"
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
