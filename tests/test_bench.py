"""`dbb bench`: recorded paths, the floor, borders of many points."""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pytest

from app.border.cache import BorderData
from app.border.mobile import MobileBody
from app.border.offset import offset_contours
from app.config import Config
from app.control.controller import ControlLoop
from app.robot.model import RobotModel
from benchmarks.step import bench as bench_module
from benchmarks.step import paths as paths_module
from benchmarks.step.density import points_on
from benchmarks.step.floor import Floor
from benchmarks.step.rollouts import Rollouts, time_rollouts
from benchmarks.step.timing import time_stages, time_steps

pytestmark = pytest.mark.slow

KEYS = {
    "step_p50_us",
    "step_p99_us",
    "step_max_us",
    "floor_p50_us",
    "step_all_p50_us",
    "guided_p50_us",
    "guided_p99_us",
    "guided_ratio",
    "tracking_p50_us",
    "tracking_p99_us",
    "tracking_ratio",
    "stages_p50_us",
    "step_p50_us_by_points",
    "border_build_s",
    "border_reselect_ms",
    "rollout_realtime_factor",
    "peak_memory_mb",
}


@pytest.fixture(scope="module")
def recorded(robot: RobotModel, border_data: BorderData) -> list[paths_module.Path]:
    """Short paths: lateral guiding with two active pairs of L_m (arm and base), fold, tracking."""
    with pytest.MonkeyPatch.context() as patch:
        lateral, *_, fold, tracking = paths_module.PATHS
        chosen = (lateral.changed(duration=2.5), fold.changed(duration=0.3))
        patch.setattr(paths_module, "PATHS", (*chosen, tracking.changed(duration=2.5)))
        return paths_module.record(robot, border_data, seed=0)


def test_timed_steps_match_the_recorded_paths(recorded, robot, border_data) -> None:
    assert [len(path) for path in recorded] == [2500, 300, 2500]
    assert recorded[0][0].reference is None
    assert recorded[2][0].reference is not None
    times = time_steps(ControlLoop(robot, border_data, Config()), recorded)
    assert len(times.step) == 5300
    assert times.both.any()
    assert times.guided_by_one.any()
    assert times.tracking_by_both.any()
    assert (times.step > 1.0).all()
    np.testing.assert_array_equal(times.mobile, times.active[:, :2].sum(axis=1))


def test_stage_times_cover_the_named_stages_of_a_step(recorded, robot, border_data) -> None:
    stages = time_stages(ControlLoop(robot, border_data, Config()), recorded[:1])
    assert set(stages) == {"update_estimate", "pinocchio", "distances", "algorithm_2", "rest"}
    assert min(stages.values()) > 0.5


def test_floor_times_the_library_calls_and_solves_one_qp(recorded, robot, border_data) -> None:
    floor = Floor(robot, border_data.pairs, seed=0)
    assert floor.size == (7, 0, 16)
    assert all(floor.time(moment) > 1.0 for moment in recorded[0][:50])
    info = floor._qp.results.info
    assert max(info.pri_res, info.dua_res) < 1e-7


def test_synthetic_points_lie_on_the_offset_surface(robot: RobotModel) -> None:
    points = points_on(offset_contours(robot, 0.15), 3000, np.random.default_rng(0))
    distances = MobileBody(robot).distance(points)
    assert np.abs(distances - 0.15).max() < 1.5e-3  # chords between heights


def test_rollout_speed_is_a_multiple_of_real_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("benchmarks.step.rollouts._RUNS", ("guiding-front",))
    begin = perf_counter()
    rollouts = time_rollouts("husky_panda", (1, 2), rounds=1, seconds=0.5)
    passed = perf_counter() - begin
    assert rollouts.factors.keys() == {1, 2}
    assert all(x > n * 0.5 / passed for n, x in rollouts.factors.items())
    assert rollouts.scaling == pytest.approx(rollouts.factors[2] / rollouts.factors[1])


def test_bench_reports_every_figure(monkeypatch, recorded, robot, border_data) -> None:
    some = [path[::40] for path in recorded]
    monkeypatch.setattr(bench_module, "record", lambda *_: some)
    rollouts = Rollouts({1: 3.0, 2: 5.0}, 1.7)
    monkeypatch.setattr(bench_module, "time_rollouts", lambda *_: rollouts)
    stages: list[str] = []
    result = bench_module.bench(
        robot, border_data, points=(1000, 3000), border=False, on_stage=stages.append
    )
    assert result.keys() > KEYS
    assert result["border_build_s"] is None
    assert result["rollout_realtime_factor"] == {"1": 3.0, "2": 5.0}
    assert set(result["step_p50_us_by_points"]["points"]) == {"1000", "3000"}
    assert result["step_own_p50_us"] <= result["step_p50_us"]
    assert result["step_own_p99_us"] <= result["step_p99_us"]
    assert result["floor_ratio"] == pytest.approx(result["step_p50_us"] / result["floor_p50_us"])
    assert len(stages) == 6
