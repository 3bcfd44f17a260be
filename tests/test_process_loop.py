"""A loop in a separate process has the interface of the loop in a thread."""

from __future__ import annotations

import time
from dataclasses import fields, replace
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from app.config import Config
from app.errors import LoopError, TargetError
from app.simulation.loop.commands import Configure, Pause, Play, Pull, Release, Reset
from app.simulation.loop.process_loop import ProcessLoop, _post, loop_child
from app.simulation.scenarios import SCENARIOS
from app.simulation.session import Session
from app.simulation.trace.trace import History
from tests.fakes import ScriptedLoop

pytestmark = pytest.mark.slow

PATIENCE = 20.0  # [s]


def wait_for(condition) -> None:
    deadline = time.monotonic() + PATIENCE
    while not condition():
        assert time.monotonic() < deadline, "condition not met in time"
        time.sleep(0.01)


class Fragile(Session):
    """A session that fails in the step after a pull."""

    def step(self, *lead, **options):
        step = super().step(*lead, **options)
        if step.hand_target is not None:
            raise ZeroDivisionError("the plant is gone")
        return step


class StubbornError(Exception):
    """An exception that cannot be pickled."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


def fail_to_make() -> Session:
    raise StubbornError("this", "that")


@pytest.fixture
def make_loop(robot, border_data):
    loops = []

    def make(kind: type[Session] = Session) -> ProcessLoop:
        make_session = partial(kind, robot, border_data, Config(), physics="kinematic")
        loops.append(ProcessLoop(make_session, np.array(robot.description.arm.ready_position)))
        loops[-1].start()
        return loops[-1]

    yield make
    for loop in loops:
        loop.stop()


def test_commands_reach_the_child_and_snapshots_and_refusals_return(make_loop):
    loop = make_loop()
    wait_for(lambda: loop.latest().t > 0.1)
    times = [snapshot.t for snapshot in loop.history(0.05)]
    assert times == sorted(times)
    assert times[0] > 0.05
    x, y, z = loop.latest().p_ee
    with pytest.raises(TargetError):
        loop.send(Pull((x, y, -0.1)))
    loop.send(Pull((x, y, z + 0.05)))
    wait_for(lambda: np.linalg.norm(loop.latest().hand_force) > 1.0)
    loop.send(Release(0))
    wait_for(lambda: not loop.latest().hand_force.any())
    loop.send(Configure(Config().replace("border.d_b", 0.2)))
    wait_for(lambda: loop.latest().config.border.d_b == 0.2)
    loop.send(Pause(True))
    wait_for(lambda: loop.latest().paused)
    stopped = loop.latest().t
    loop.send(Reset())
    wait_for(lambda: loop.latest().t < stopped)
    loop.send(Play(SCENARIOS["guiding-lateral"].changed(move=(0.0, 0.0, -2.0))))
    wait_for(lambda: loop.latest().refusal is not None)
    assert loop.latest().refusal.number == 1
    loop.send(Play(SCENARIOS["way-out"]))
    wait_for(lambda: loop.latest().scenario == "way-out")
    assert loop.error is None
    loop._child.end(at_once=True)
    wait_for(lambda: loop.error is not None)
    assert "status -9" in str(loop.error), "a killed child must be an error with its status"


def test_waiting_child_simulates_its_task_until_it_is_stopped(robot, border_data):
    make_session = partial(Session, robot, border_data, Config(), physics="kinematic")
    with loop_child() as child:
        loop = ProcessLoop(make_session, np.array(robot.description.arm.ready_position), child)
        loop.start()
        wait_for(lambda: loop.latest().t > 0.1)
        loop.stop()
        assert child.ended(PATIENCE) == 0
        assert loop.error is None
        loop.send(Pause(True))  # has no effect


def test_child_without_a_task_is_ended():
    with loop_child() as child:
        begin = time.monotonic()
    assert child.ended() is not None
    assert time.monotonic() - begin < 5.0, "the child must end without delay"


def test_task_that_cannot_be_pickled_is_an_error(robot):
    loop = ProcessLoop(lambda: None, np.array(robot.description.arm.ready_position))
    with pytest.raises(LoopError, match=r"could not start: .*lambda"):
        loop.start()
    loop.stop()


def test_error_in_the_child_arrives_with_its_traceback(make_loop):
    loop = make_loop(Fragile)
    loop.send(Pull(tuple(loop.latest().p_ee)))
    wait_for(lambda: loop.error is not None)
    assert isinstance(loop.error, ZeroDivisionError)
    assert "the plant is gone" in str(loop.error)
    assert "in step" in str(loop.error.__cause__)


def test_error_that_cannot_be_pickled_arrives_as_text(robot):
    loop = ProcessLoop(fail_to_make, np.array(robot.description.arm.ready_position))
    with pytest.raises(LoopError, match="StubbornError: this and that"):
        loop.start()
    loop.stop()


def test_a_busy_child_loses_no_snapshot(robot):
    """It forwards all new snapshots, also if several have come since the last check."""
    loop, sent = ScriptedLoop(robot), []
    first = loop.latest()
    batches = [[0.0], [0.02, 0.04, 0.06], [0.08]]

    def poll(_):
        if not batches:
            raise EOFError
        for t in batches.pop(0):
            history.add(replace(first, t=first.t + t))
        return False

    history = History()
    history.add(first)
    child = SimpleNamespace(
        error=None, silence=0.0, latest=lambda: history.latest, history=history.after
    )
    with pytest.raises(EOFError):
        _post(child, SimpleNamespace(poll=poll), SimpleNamespace(send=sent.append))
    times = [round(each.t - first.t, 3) for each in sent if each is not None]
    assert list(dict.fromkeys(times)) == [0.0, 0.02, 0.04, 0.06, 0.08]


def test_old_snapshots_of_a_history_are_bytes_with_the_same_content(robot):
    snapshot, history = ScriptedLoop(robot).latest(), History()
    for k in range(1100):
        history.add(replace(snapshot, t=0.02 * k))
    first, *_, last = history.after(-1.0)
    assert last.snapshot is history.latest
    assert first.snapshot is first.snapshot is not snapshot
    for field in fields(snapshot):
        before, after = (getattr(s, field.name) for s in (snapshot, first.snapshot))
        assert repr(before) == repr(after)
    assert first.snapshot.config is snapshot.config


def test_history_is_ordered_and_restarts_when_time_goes_back(robot):
    snapshot = ScriptedLoop(robot).latest()
    history = History()
    for t in (0.0, 0.02, 0.04, 0.04, 0.06):
        history.add(replace(snapshot, t=t))
    changed = replace(snapshot, t=0.06, paused=True)
    history.add(changed)
    assert [s.t for s in history.after(0.01)] == [0.02, 0.04, 0.06]
    assert [s.snapshot for s in history.after(0.05)] == [changed]
    history.add(replace(snapshot, t=0.0))
    assert [s.t for s in history.after(-1.0)] == [0.0]
    assert history.latest.t == 0.0
