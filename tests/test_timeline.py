"""The timeline of one viewer."""

from __future__ import annotations

import pickle
from dataclasses import replace

import pytest

from app.dashboard.record import BIN, MOST_MARKED, Strip, Timeline
from app.dashboard.shared import SharedState
from app.errors import ConfigError, LogError
from app.simulation.trace import trace
from app.simulation.trace.trace import History
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda

FRAME = 0.02  # [s] between two snapshots


class Past:
    """A loop that has run for some seconds and stands still."""

    def __init__(self, seconds: float) -> None:
        self._snapshot = ScriptedLoop(husky_panda()).latest()
        self._history = History()
        self._history.add(replace(self._snapshot, t=0.0))
        self.strip = Strip(husky_panda().body_names)
        self._data = SharedState(self, husky_panda(), {}, parts=object())
        self._data.keepers = [self.strip]
        self._runs = 0
        self.run(0.0, seconds)

    def run(self, begin: float, end: float) -> None:
        self._runs += begin == 0.0
        for k in range(round(begin / FRAME), round(end / FRAME) + 1):
            self._history.add(replace(self._snapshot, t=k * FRAME, run=self._runs))
            self._data.update()

    def latest(self):
        return self._history.latest

    def stored(self, after=-1.0):
        return self._history.after(after)

    def history(self, after):
        return [stored.snapshot for stored in self._history.after(after)]


def line_of(past: Past) -> Timeline:
    return Timeline(past, past.strip)


def test_timeline_begins_live_and_follows_the_simulation():
    past = Past(2.0)
    timeline = line_of(past)
    assert timeline.live
    past.run(2.0, 5.0)
    assert timeline.shown().t == pytest.approx(5.0)


@pytest.mark.parametrize("t", [5.98, 5.5, 2.67, 1.0])
def test_past_instant_stays_shown_while_the_simulation_continues(t):
    past = Past(6.0)
    timeline = line_of(past)
    timeline.go_to(t)
    assert timeline.shown().t == pytest.approx(t, abs=FRAME / 2)
    past.run(6.0, 9.0)
    assert timeline.shown().t == pytest.approx(t, abs=FRAME / 2)
    timeline.go_live()
    assert timeline.shown().t == pytest.approx(9.0)


def test_steps_move_by_single_snapshots():
    timeline = line_of(Past(6.0))
    timeline.go_to(3.0)
    timeline.step(FRAME)
    assert timeline.shown().t == pytest.approx(3.0 + FRAME)
    timeline.step(-2 * FRAME)
    assert timeline.shown().t == pytest.approx(3.0 - FRAME)


def test_instants_older_than_a_minute_are_shown_at_lower_resolution():
    timeline = line_of(Past(90.0))
    timeline.go_to(10.0)
    assert timeline.shown().t == pytest.approx(10.0, abs=2 * BIN)
    timeline.go_to(-5.0)
    assert timeline.shown().t == pytest.approx(0.0, abs=2 * BIN)


def test_steps_beyond_the_last_minute_reach_the_next_stored_instant():
    timeline = line_of(Past(90.0))
    timeline.go_to(10.0)
    at = timeline.shown().t
    timeline.step(FRAME)
    assert at < timeline.shown().t <= at + 4 * BIN
    timeline.step(-FRAME)
    assert timeline.shown().t == pytest.approx(at)


def test_a_mark_of_the_end_at_the_start_is_refused_and_keeps_the_start():
    timeline = line_of(Past(6.0))
    timeline.go_to(3.0)
    timeline.mark_begin()
    with pytest.raises(LogError, match="later than the start"):
        timeline.mark_end()
    assert (timeline.begin, timeline.end) == (pytest.approx(3.0), None)


def test_an_end_without_a_start_marks_the_longest_interval():
    timeline = line_of(Past(MOST_MARKED + 30.0))
    timeline.mark_end()
    assert timeline.begin == pytest.approx(30.0, abs=2 * BIN)


@pytest.mark.parametrize("moved", ["the start", "the end"])
def test_a_second_mark_cannot_exceed_the_longest_interval(moved):
    timeline = line_of(Past(MOST_MARKED + 60.0))
    first, second = (MOST_MARKED + 40.0, 10.0) if moved == "the start" else (1.0, 150.0)
    mark(timeline, first, first + 1.0)
    timeline.go_to(second)
    timeline.mark_begin() if moved == "the start" else timeline.mark_end()
    assert timeline.end - timeline.begin == pytest.approx(MOST_MARKED, abs=2 * BIN)
    stored = timeline.interval()
    assert stored[-1].t - stored[0].t <= MOST_MARKED + 1e-9
    assert (timeline.begin if moved == "the start" else timeline.end) == pytest.approx(second)


def test_a_new_start_keeps_the_stored_snapshots_of_the_interval():
    past = Past(20.0)
    timeline = line_of(past)
    for t, mark in ((5.0, timeline.mark_begin), (15.0, timeline.mark_end)):
        timeline.go_to(t)
        mark()
    past.run(20.02, 100.0)  # then the loop has only the last 60 s
    timeline.go_to(8.0)
    timeline.mark_begin()
    times = [snapshot.t for snapshot in timeline.interval()]
    assert len(times) == pytest.approx((times[-1] - times[0]) / FRAME + 1)
    assert times[0] == pytest.approx(8.0, abs=2 * BIN)
    assert times[-1] == pytest.approx(15.0)


def test_plots_unpack_one_snapshot_per_interval(monkeypatch):
    past = Past(90.0)
    unpacked, loads = [], pickle.loads
    monkeypatch.setattr(trace.pickle, "loads", lambda b: unpacked.append(b) or loads(b))
    timeline = line_of(past)
    assert len(timeline.between(70.0, 90.0, 0.08)) == pytest.approx(250, abs=1)
    assert unpacked == []
    found = timeline.between(40.0, 60.0, 0.08)
    assert len(found) == len(unpacked) == pytest.approx(250, abs=1)
    assert [s.t for s in found] == [s.t for s in timeline.between(40.0, 60.0, 0.08)]
    assert len(unpacked) == len(found)


def test_restart_returns_to_live_and_removes_an_open_mark():
    past = Past(6.0)
    timeline = line_of(past)
    timeline.go_to(5.0)
    timeline.mark_begin()
    past.run(0.0, 0.1)
    assert timeline.shown().t == pytest.approx(0.1)
    assert timeline.live
    assert timeline.begin is None


def mark(timeline: Timeline, begin: float, end: float) -> None:
    timeline.go_to(begin)
    timeline.mark_begin()
    timeline.go_to(end)
    timeline.mark_end()


def test_marked_interval_is_exported():
    timeline = line_of(Past(6.0))
    mark(timeline, 2.0, 5.0)
    times = [snapshot.t for snapshot in timeline.interval()]
    assert times[0] == pytest.approx(2.0)
    assert times[-1] == pytest.approx(5.0)
    assert len(times) == round(3.0 / FRAME) + 1


@pytest.mark.parametrize("then", [(6.0, 100.0), (0.0, 1.0)])
def test_marked_interval_stays_complete_later_and_after_a_restart(then):
    past = Past(6.0)
    timeline = line_of(past)
    mark(timeline, 2.0, 5.0)
    past.run(*then)
    timeline.shown()
    assert len(timeline.interval()) == round(3.0 / FRAME) + 1


def test_marks_of_an_earlier_run_do_not_limit_those_of_the_present_run():
    past = Past(6.0)
    timeline = line_of(past)
    mark(timeline, 2.0, 5.0)
    assert not timeline.earlier
    past.run(0.0, 4.0)
    timeline.shown()
    assert timeline.earlier
    timeline.go_to(3.0)
    timeline.mark_begin()
    assert not timeline.earlier
    assert (timeline.begin, timeline.end) == (pytest.approx(3.0), None)
    mark(timeline, 1.0, 2.0)
    past.run(0.0, 4.0)
    timeline.shown()
    timeline.go_to(3.0)
    timeline.mark_end()
    assert {snapshot.run for snapshot in timeline.interval()} == {3}
    assert (timeline.begin, timeline.end) == (0.0, pytest.approx(3.0))


def test_open_interval_is_stored_from_its_begin_and_ends_automatically():
    past = Past(6.0)
    timeline = line_of(past)
    timeline.go_to(5.0)
    timeline.mark_begin()
    timeline.go_live()
    for second in range(6, 100):
        past.run(second, second + 1)
        timeline.shown()
    assert len(timeline.interval()) == round(95.0 / FRAME) + 1
    timeline.begin = 100.0 - MOST_MARKED  # an interval of the greatest length
    past.run(100.0, 101.0)
    timeline.shown()
    assert timeline.end == pytest.approx(100.0)


def test_whole_history_is_exported_without_marks():
    past = Past(6.0)
    assert len(line_of(past).interval()) == len(past.history(-1.0))


def test_interval_without_a_duration_is_refused():
    timeline = line_of(Past(6.0))
    timeline.go_to(0.0)
    timeline.mark_end()
    with pytest.raises(LogError, match="no duration"):
        timeline.interval()


def test_end_before_the_begin_removes_the_begin():
    timeline = line_of(Past(6.0))
    timeline.go_to(5.0)
    timeline.mark_begin()
    timeline.go_to(2.0)
    timeline.mark_end()
    assert timeline.begin == pytest.approx(0.0)
    assert timeline.end == pytest.approx(2.0)


@pytest.mark.parametrize("speed", [0.25, 1.0, 4.0])
def test_replay_runs_at_its_speed_to_the_present_and_stops_on_request(speed, monkeypatch):
    clock = [100.0]
    monkeypatch.setattr("app.dashboard.record.monotonic", lambda: clock[0])
    timeline = line_of(Past(12.0))
    timeline.play(speed)
    assert timeline.plays
    assert timeline.shown().t == pytest.approx(2.0, abs=FRAME), (
        "a replay from the present shows the last 10 s"
    )
    clock[0] += 1.0
    assert timeline.shown().t == pytest.approx(2.0 + speed, abs=FRAME)
    timeline.play(speed)
    clock[0] += 1.0
    assert not timeline.plays
    assert timeline.shown().t == pytest.approx(2.0 + speed, abs=FRAME), (
        "the replay stays where it stopped"
    )
    timeline.play(speed)
    clock[0] += 100.0
    timeline.shown()
    assert timeline.live
    assert not timeline.plays


@pytest.mark.parametrize("speed", [0.0, -1.0, 99.0, float("nan")])
def test_a_speed_beyond_its_range_is_refused(speed):
    timeline = line_of(Past(2.0))
    with pytest.raises(ConfigError, match="replay speed"):
        timeline.play(speed)
    assert timeline.live
