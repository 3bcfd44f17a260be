"""Pacing to real time, with a simulated clock."""

from __future__ import annotations

import pytest

from app.simulation.loop import pacing
from app.simulation.loop.pacing import Pacer

PERIOD = 0.001  # [s]


class Clock:
    """A wall clock that advances by work and sleep only."""

    def __init__(self) -> None:
        self.now = 100.0

    def read(self) -> float:
        return self.now

    def sleep(self, seconds: float) -> None:
        assert seconds > 0
        self.now += seconds


@pytest.fixture
def clock(monkeypatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(pacing, "perf_counter", clock.read)
    monkeypatch.setattr(pacing, "sleep", clock.sleep)
    return clock


def steps(pacer: Pacer, clock: Clock, works: list[float]) -> None:
    """Make steps with these computing times [s]."""
    for work in works:
        clock.now += work
        pacer.worked(work)
        pacer.wait()


def test_fast_steps_take_real_time(clock):
    pacer, begin = Pacer(PERIOD), clock.now
    steps(pacer, clock, [0.0003] * 3000)
    assert clock.now - begin == pytest.approx(3.0, abs=PERIOD)
    assert pacer.realtime_factor == pytest.approx(1.0, abs=1e-3)
    assert pacer.overruns == 0


def test_a_short_delay_is_compensated_by_faster_steps(clock):
    pacer, begin = Pacer(PERIOD), clock.now
    steps(pacer, clock, [0.1] + [0.0003] * 999)
    assert clock.now - begin == pytest.approx(1.0, abs=PERIOD)
    assert 100 < pacer.overruns < 200


def test_a_long_delay_is_not_compensated(clock):
    pacer, begin = Pacer(PERIOD), clock.now
    steps(pacer, clock, [5.0] + [0.0003] * 1000)
    assert clock.now - begin == pytest.approx(6.0, abs=2 * PERIOD)
    assert pacer.overruns == 1


def test_slow_steps_reduce_the_real_time_factor_and_are_overruns(clock):
    pacer = Pacer(PERIOD)
    steps(pacer, clock, [0.002] * 2000)
    assert pacer.realtime_factor == pytest.approx(0.5, rel=1e-2)
    assert pacer.overruns == 2000


def test_a_stall_longer_than_the_window_reduces_the_real_time_factor(clock):
    pacer = Pacer(PERIOD)
    steps(pacer, clock, [0.0003] * 100)
    steps(pacer, clock, [3.0])
    assert pacer.realtime_factor < 0.01


def test_the_real_time_factor_covers_only_the_last_second(clock):
    pacer = Pacer(PERIOD)
    steps(pacer, clock, [0.004] * 1000)
    steps(pacer, clock, [0.0003] * 2500)
    assert pacer.realtime_factor == pytest.approx(1.0, abs=0.01)


def test_a_pause_does_not_count_as_a_delay(clock):
    pacer = Pacer(PERIOD)
    steps(pacer, clock, [0.0003] * 500)
    clock.now += 60.0
    pacer.restart()
    begin = clock.now
    steps(pacer, clock, [0.0003] * 500)
    assert clock.now - begin == pytest.approx(0.5, abs=PERIOD)
    assert pacer.overruns == 0
    assert pacer.realtime_factor == pytest.approx(1.0, abs=0.01)


def test_step_time_is_the_mean_computing_time_of_the_controller(clock):
    pacer = Pacer(PERIOD)
    assert (pacer.step_time_us, pacer.realtime_factor) == (0.0, 1.0)
    steps(pacer, clock, [0.0002, 0.0004] * 10)
    assert pacer.step_time_us == pytest.approx(300.0)


@pytest.mark.parametrize("speed", [0.1, 0.5, 2.0])
def test_the_real_time_factor_is_simulated_time_over_real_time(clock, speed):
    pacer, begin = Pacer(PERIOD, speed), clock.now
    steps(pacer, clock, [0.0003] * 3000)
    assert clock.now - begin == pytest.approx(3.0 / speed, rel=1e-3)
    assert pacer.realtime_factor == pytest.approx(speed, rel=2e-3)
    assert pacer.overruns == 0


def test_an_unreachable_speed_is_reported_as_the_reached_one(clock):
    pacer = Pacer(PERIOD)
    pacer.speed = 4.0
    pacer.restart()
    assert pacer.realtime_factor == 4.0  # no measurement yet
    steps(pacer, clock, [0.0005] * 3000)
    assert pacer.realtime_factor == pytest.approx(2.0, rel=2e-3)
    assert pacer.overruns > 2900
