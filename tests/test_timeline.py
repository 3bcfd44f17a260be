"""One viewer's place in time."""

from __future__ import annotations

from dataclasses import replace

import pytest

from app.dashboard.panels.timeline import FRAME, REACH, Timeline
from app.simulation.trace.history import History
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda


class Past:
    """A loop that has run for some seconds and stands still."""

    def __init__(self, seconds: float) -> None:
        self._snapshot = ScriptedLoop(husky_panda()).latest()
        self._history = History()
        self.run(0.0, seconds)

    def run(self, begin: float, end: float) -> None:
        for k in range(round(begin / FRAME), round(end / FRAME) + 1):
            self._history.add(replace(self._snapshot, t=k * FRAME))

    def latest(self):
        return self._history.latest

    def history(self, after):
        return self._history.after(after)


def test_it_begins_live_and_follows_the_simulation():
    past = Past(2.0)
    timeline = Timeline(past)
    assert timeline.live
    past.run(2.0, 5.0)
    assert timeline.shown().t == pytest.approx(5.0)


@pytest.mark.parametrize("back", [0.02, 0.5, 3.33, 5.0])
def test_looking_back_shows_that_instant_though_the_simulation_goes_on(back):
    past = Past(6.0)
    timeline = Timeline(past)
    timeline.look_back(back)
    assert timeline.shown().t == pytest.approx(6.0 - back, abs=FRAME / 2)
    past.run(6.0, 9.0)
    assert timeline.shown().t == pytest.approx(6.0 - back, abs=FRAME / 2)
    assert timeline.back == pytest.approx(back, abs=FRAME / 2)
    timeline.go_live()
    assert timeline.shown().t == pytest.approx(9.0)


def test_looking_back_is_measured_from_where_the_viewer_stopped():
    past = Past(6.0)
    timeline = Timeline(past)
    timeline.look_back(1.0)
    past.run(6.0, 8.0)
    timeline.look_back(2.0)
    assert timeline.shown().t == pytest.approx(4.0)


def test_steps_go_on_and_back_by_single_snapshots():
    timeline = Timeline(Past(6.0))
    timeline.look_back(3.0)
    timeline.step(FRAME)
    assert timeline.shown().t == pytest.approx(3.0 + FRAME)
    timeline.step(-2 * FRAME)
    assert timeline.shown().t == pytest.approx(3.0 - FRAME)


@pytest.mark.parametrize("back", [1e9, REACH])
def test_nobody_looks_back_farther_than_what_is_kept(back):
    past = Past(70.0)
    timeline = Timeline(past)
    timeline.look_back(back)
    assert timeline.shown().t == pytest.approx(past.history(-1.0)[0].t)
    timeline.step(-5.0)
    assert timeline.shown().t == pytest.approx(past.history(-1.0)[0].t)


def test_a_restart_of_the_simulation_ends_looking_back_and_the_marks():
    past = Past(6.0)
    timeline = Timeline(past)
    timeline.look_back(1.0)
    timeline.mark_begin()
    past.run(0.0, 0.1)
    assert timeline.shown().t == pytest.approx(0.1)
    assert timeline.live
    assert timeline.begin is None


def test_the_marked_interval_is_what_is_exported():
    timeline = Timeline(Past(6.0))
    timeline.look_back(4.0)
    timeline.mark_begin()
    timeline.look_back(1.0)
    timeline.mark_end()
    times = [snapshot.t for snapshot in timeline.interval()]
    assert times[0] == pytest.approx(2.0)
    assert times[-1] == pytest.approx(5.0)
    assert len(times) == round(3.0 / FRAME) + 1


def test_without_marks_all_that_is_kept_is_exported():
    past = Past(6.0)
    assert len(Timeline(past).interval()) == len(past.history(-1.0))


def test_an_end_before_the_begin_takes_the_begin_away():
    timeline = Timeline(Past(6.0))
    timeline.look_back(1.0)
    timeline.mark_begin()
    timeline.look_back(4.0)
    timeline.mark_end()
    assert timeline.begin is None
    assert timeline.end == pytest.approx(2.0)
