"""A scenario from start to end, headless and as fast as it goes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from time import perf_counter
from typing import Any, NamedTuple, TypedDict

from typing_extensions import Unpack

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.case import Planned
from app.simulation.loop.pacing import settled
from app.simulation.scenarios.leading import Scenario, Setting
from app.simulation.session import DT, Session, Step
from app.simulation.trace.metrics import metrics
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Recorder, Trace


class RunResult(NamedTuple):
    """Figures of a run and its trace."""

    figures: dict[str, Any]
    trace: Trace


class RunOptions(TypedDict, total=False):
    """What a scenario is run with; the defaults are those of `Session`."""

    controller: str
    """One of `app.control.CONTROLLERS`."""
    physics: str | None
    """Kind of plant; None is the default one."""
    seed: int
    """Of everything random in the run."""


def begin(setting: Setting, robot: RobotModel, **options: Unpack[RunOptions]) -> Session:
    """A new session at the beginning of a setting; `robot` is without the door that it may hold.

    Raises:
        ConfigError: The plant has no doors, and the setting has one.
        UnknownNameError: No such controller or plant.
    """
    session = Session(
        setting.model, setting.data, setting.config, plant=robot, door=setting.door, **options
    )
    session.reset(setting.q_m, setting.base_pose)
    return session


def steps_of(
    model: RobotModel,
    data: BorderData,
    scenario: Scenario,
    config: Config,
    **options: Unpack[RunOptions],
) -> Generator[tuple[Session, Step], None, None]:
    """The control steps of a scenario, one by one, with the session after each.

    The session is closed when the last step has been taken, or the iterator is.

    Raises:
        UnreachableError: No start of the arm for this scenario.
        TargetError: The hand would be led below the floor.
        ConfigError: The plant has no doors, and the scenario has one.
        UnknownNameError: No such controller or plant.
    """
    setting = scenario.setting(model, data, config, options.get("seed", 0))
    session = begin(setting, model, **options)
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
    on_progress: Callable[[float], None] = lambda _: None,
    on_step: Callable[[Session, Step], None] | None = None,
    drawn: bool = False,
    **options: Unpack[RunOptions],
) -> RunResult:
    """Run a scenario and take its figures.

    Arguments and errors are those of `steps_of`. `on_progress` is called now and then with the
    simulated time [s], `on_step` after each control step. A trace that is `drawn` has snapshots, to
    be written and replayed.
    """
    recorder = Recorder(scenario, drawn=drawn)
    begun: float | None = None
    steps = steps_of(model, data, scenario, config, **options)
    with settled(), closing(steps):
        for k, (session, step) in enumerate(steps):
            begun = begun or perf_counter() - step.duration
            recorder.add(session, step)
            if on_step is not None:
                on_step(session, step)
            if k % 100 == 0:
                on_progress(session.t)
    assert begun is not None, "a scenario lasts at least one step"
    elapsed = perf_counter() - begun
    trace = recorder.trace()
    figures = {
        "scenario": scenario.name,
        "controller": options.get("controller", "dbb"),
        "robot": model.description.name,
        "seed": trace.meta.seed,
        "duration_s": scenario.duration,
        "physics": trace.meta.physics,
        **metrics(trace),
        "realtime_factor": scenario.duration / elapsed,
    }
    return RunResult(figures, trace)


def run_planned(planned: Planned, model: RobotModel, data: BorderData, **how: Any) -> RunResult:
    """Do a run; what else it takes and what it raises stands at `run_scenario`."""
    return run_scenario(model, data, planned.scenario, planned.config, **planned.driven, **how)


def filmed(
    steps: Generator[tuple[Session, Step], None, None],
    scenario: Scenario,
    times: Sequence[float],
    on_progress: Callable[[float], None] = lambda _: None,
) -> list[Snapshot]:
    """Snapshots of a run up to the last of some times [s], those at the times themselves included.

    The steps, as `steps_of` gives them, are ended here. `on_progress` is called now and then with
    the simulated time [s].
    """
    last = round(scenario.duration / DT) - 1
    wanted = {min(round(t / DT), last) for t in times}
    recorder = Recorder(scenario, quantities=(), drawn=True, also=wanted)
    with closing(steps):
        for k, (session, step) in enumerate(steps):
            recorder.add(session, step)
            if k % 100 == 0:
                on_progress(step.t)
            if k == max(wanted):
                break
    return recorder.snapshots
