"""All figures of `dbb bench`, in one run."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any

import numpy as np

from app.border.cache import BorderData
from app.border.sampling import SamplingConfig, sample_clouds
from app.config import Config
from app.control.controller import Controller, ControlLoop
from app.control.quantities import ControlStep
from app.robot.link_pairs import find_link_pairs
from app.robot.model import RobotModel
from benchmarks.memory import peak_memory
from benchmarks.step.density import by_points
from benchmarks.step.floor import Floor
from benchmarks.step.paths import PATHS, Moment, Path, record
from benchmarks.step.rollouts import time_rollouts
from benchmarks.step.timing import time_stages, time_steps

POINTS = (50_000, 500_000, 5_000_000)
"""Numbers of points of the synthetic borders."""
Array = np.ndarray

_PROCESSES = 2
_REPEATS = 3  # [-] measurements of each control step
_RESELECTED = (0.10, 0.12, 0.18, 0.20, 0.15)  # [m] sequence of selected d_b


def bench(
    model: RobotModel,
    data: BorderData,
    *,
    seed: int = 0,
    points: Sequence[int] = POINTS,
    border: bool = True,
    on_stage: Callable[[str], None] = lambda _: None,
) -> dict[str, Any]:
    """Measure all results of `dbb bench`.

    Args:
        model: The robot.
        data: Its pairs and clouds.
        seed: Seed of the simulated paths, the synthetic borders, and the QP that the libraries
            solve directly, for comparison. Other measurements have fixed seeds.
        points: Numbers of points of the borders for `step_p50_us_by_points`.
        border: Whether to measure the sampling of a new border, which takes minutes.
        on_stage: Called with the name of each measurement before it starts.
    """
    load = os.getloadavg()[0]
    on_stage("recording paths of the end-effector")
    paths = record(model, data, seed)
    on_stage("control steps")
    steps = _steps(model, data, paths, seed)
    on_stage("stages of a step")
    stages = time_stages(ControlLoop(model, data, Config()), paths)
    on_stage("another d_b")
    reselect = _reselect(model, data)
    memory = peak_memory()
    on_stage("rollouts")
    rollouts = time_rollouts(model.description.name, (1, _PROCESSES))
    on_stage("borders of many points")
    by_count = by_points(model, data, paths[:1], points, seed)
    if border:
        on_stage("sampling a new border")
    return {
        "robot": model.description.name,
        "seed": seed,
        "cores": os.cpu_count(),
        "load_before": load,
        **steps,
        "stages_p50_us": stages,
        "step_p50_us_by_points": by_count,
        "border_build_s": _build(model) if border else None,
        "border_reselect_ms": reselect,
        "rollout_realtime_factor": {str(n): x for n, x in rollouts.factors.items()},
        "rollout_scaling": rollouts.scaling,
        "peak_memory_mb": memory,
        "peak_memory_all_mb": peak_memory(),
    }


def _steps(model: RobotModel, data: BorderData, paths: Sequence[Path], seed: int) -> dict[str, Any]:
    """Durations of all control steps, and of the calls of `Floor` in active steps of two paths.

    Each step is measured `_REPEATS` times; the `own` durations are the shortest ones, which exclude
    other work of the machine.
    """
    floor, loop = Floor(model, data.pairs, seed), ControlLoop(model, data, Config())
    floors: list[float] = []

    def after(moment: Moment, step: ControlStep) -> None:
        near = (step.beta[: step.n_mob] > 0.0).any()
        floors.append(floor.time(moment) if near else np.nan)

    alone, *again = (time_steps(loop, paths) for _ in range(_REPEATS))
    own = np.min([alone.step, *(times.step for times in again)], axis=0)
    beside = time_steps(loop, (paths[0], paths[-1]), after)
    bare = np.array(floors)
    active = alone.step[alone.both]
    names = [pair.name for pair in data.pairs.all]
    p50, floor_p50 = float(np.median(active)), float(np.median(bare[beside.both]))
    return {
        "paths": [{"name": p.name, "start_m": p.start, "move_m": p.move} for p in PATHS],
        "steps": len(alone.step),
        "active_steps": len(active),
        "active_steps_by_pair": dict(zip(names, alone.active.sum(axis=0).tolist(), strict=True)),
        "border_points": {name: len(cloud) for name, cloud in data.clouds.items()},
        "step_p50_us": p50,
        "step_p99_us": float(np.percentile(active, 99)),
        "step_max_us": float(active.max()),
        "step_all_p50_us": float(np.median(alone.step)),
        "step_all_p99_us": float(np.percentile(alone.step, 99)),
        "step_all_max_us": float(alone.step.max()),
        "step_own_p50_us": float(np.median(own[alone.both])),
        "step_own_p99_us": float(np.percentile(own[alone.both], 99)),
        "step_all_own_p50_us": float(np.median(own)),
        "step_all_own_p99_us": float(np.percentile(own, 99)),
        **_figures("guided", alone.step[alone.guided_by_one], bare[beside.guided_by_one]),
        **_figures("tracking", alone.step[alone.tracking_by_both], bare[beside.tracking_by_both]),
        "floor_p50_us": floor_p50,
        "floor_ratio": p50 / floor_p50,
        "floor_qps": [
            dict(zip(("unknowns", "equalities", "inequalities"), floor.size, strict=True))
        ],
    }


def _figures(name: str, steps: Array, floors: Array) -> dict[str, float | None]:
    """Median and 99th percentile [µs] of steps, ratio to the direct calls; None without steps."""
    if not (len(steps) and len(floors)):
        return dict.fromkeys((f"{name}_p50_us", f"{name}_p99_us", f"{name}_ratio"))
    p50, p99 = np.percentile(steps, (50, 99)).tolist()
    ratio = p50 / float(np.median(floors))
    return {f"{name}_p50_us": p50, f"{name}_p99_us": p99, f"{name}_ratio": ratio}


def _reselect(model: RobotModel, data: BorderData) -> float:
    """[ms] median duration of `Controller.configure` with a new d_b, and thus a new border."""
    controller, times = Controller(model, data, Config()), []
    for d_b in _RESELECTED:
        config = Config().replace("border.d_b", d_b)
        begin = perf_counter()
        controller.configure(config)
        times.append(1e3 * (perf_counter() - begin))
    return float(np.median(times))


def _build(model: RobotModel) -> float:
    """[s] duration of the sampling of pairs and clouds with two processes; no result is stored."""
    sampling = SamplingConfig()
    begin = perf_counter()
    pairs = find_link_pairs(model, samples=sampling.pair_samples, seed=sampling.seed)
    sample_clouds(model, pairs.mobile, sampling, progress=False, processes=_PROCESSES)
    return perf_counter() - begin
