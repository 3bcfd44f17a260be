"""Run a scenario from start to end, without a display and as fast as possible."""

from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from itertools import islice
from time import perf_counter
from typing import Any, NamedTuple

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.loop.pacing import gc_frozen
from app.simulation.scenarios.leading import Scenario, Setting
from app.simulation.session import DT, Session, Step, check_posture
from app.simulation.trace.metrics import metrics
from app.simulation.trace.snapshot import EVERY, Snapshot, make_snapshot
from app.simulation.trace.trace import Recorder, Trace


class RunResult(NamedTuple):
    figures: dict[str, Any]  # scenario, robot and other data of the run, and its `metrics`
    trace: Trace


def begin(
    setting: Setting, robot: RobotModel, controller: str, physics: str | None, seed: int
) -> Session:
    """A session at a setting; the plant has `robot`, without a door. Errors: `Session`, `reset`."""
    model, data, base_pose, q_m, config, door = setting
    check_posture(model, q_m)  # before the plant loads
    session = Session(model, data, config, controller, physics, seed, plant=robot, door=door)
    session.reset(q_m, base_pose)
    return session


def steps_of(
    run: RunSpec,
    model: RobotModel,
    data: BorderData,
    on_progress: Callable[[float], None] = lambda _: None,
) -> Generator[tuple[Session, Step], None, None]:
    """Execute the control steps of a run; yield each step with the session after the step.
    `on_progress` is called every 100 steps with the simulated time [s]. The session is closed after
    the last step, after an error, or when the iterator is closed. This raises the errors of
    `Scenario.setting`, `begin`, `Scenario.driver` and `Session.step`.
    """
    scenario = run.scenario
    setting = scenario.setting(model, data, run.config, run.seed)
    session = begin(setting, model, run.controller, run.physics, run.seed)
    with closing(session):
        driver = scenario.driver(session)
        for k in range(round(scenario.duration / DT)):
            step = session.step(*driver(session))
            if k % 100 == 0:
                on_progress(session.t)
            yield session, step


def run_from_spec(
    run: RunSpec,
    model: RobotModel,
    data: BorderData,
    *,
    on_progress: Callable[[float], None] = lambda _: None,
    on_step: Callable[[Session, Step], None] | None = None,
    drawn: bool = False,
) -> RunResult:
    """Execute a run and compute its figures of merit. `on_step` is called after each control step;
    `on_progress` and the errors are as in `steps_of`. With `drawn`, the trace has snapshots, which
    log files and the player need.
    """
    scenario = run.scenario
    recorder = Recorder(scenario, drawn=drawn)
    begun: float | None = None
    with gc_frozen(), closing(steps_of(run, model, data, on_progress)) as steps:
        for session, step in steps:
            begun = begun or perf_counter() - step.duration
            recorder.add(session, step)
            if on_step is not None:
                on_step(session, step)
    assert begun is not None, "a scenario lasts at least one step"
    elapsed = perf_counter() - begun
    trace = recorder.trace()
    figures = {
        "scenario": scenario.name,
        "controller": run.controller,
        "robot": model.description.name,
        "seed": trace.meta.seed,
        "duration_s": scenario.duration,
        "physics": trace.meta.physics,
        **metrics(trace),
        "realtime_factor": scenario.duration / elapsed,
    }
    return RunResult(figures, trace)


def run_scenario(
    model: RobotModel,
    data: BorderData,
    scenario: Scenario,
    config: Config,
    *,
    controller: str = "dbb",
    physics: str | None = None,
    seed: int = 0,
    **how: Any,
) -> RunResult:
    """Run a scenario with a robot; `run_from_spec` documents further arguments and the errors."""
    spec = RunSpec(model.description.name, scenario, config, controller, physics, seed)
    return run_from_spec(spec, model, data, **how)


def filmed(
    run: RunSpec,
    model: RobotModel,
    data: BorderData,
    times: Sequence[float],
    on_progress: Callable[[float], None] = lambda _: None,
) -> list[Snapshot]:
    """Execute a run until the latest of `times` [s]; return the snapshots at 50 Hz and at `times`.
    There must be at least one time; a time after the end of the run selects the run's last step.
    `on_progress` and the errors are as in `steps_of`.
    """
    scenario, snapshots = run.scenario, []
    last = round(scenario.duration / DT) - 1
    required = {min(round(t / DT), last) for t in times}
    about = {"scenario": scenario.name, "scenario_ends": scenario.duration}
    with closing(steps_of(run, model, data, on_progress)) as steps:
        for k, (session, step) in enumerate(islice(steps, max(required) + 1)):
            if k % EVERY == 0 or k in required:
                snapshots.append(make_snapshot(session, step, None, **about))
    return snapshots
