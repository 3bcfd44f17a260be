"""The loop: it executes commands, publishes consistent snapshots, and reports its errors."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from dataclasses import fields

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.errors import AssetError, LoopError, TargetError, UnknownNameError
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.loop.commands import (
    Choose,
    Compare,
    Configure,
    Pause,
    Play,
    Pull,
    Release,
    Reset,
    Restart,
    Speed,
    StepOnce,
)
from app.simulation.loop.loop import SimulationLoop
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import DT, Session
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Trace

START = LINES["guiding-lateral"].start
PULL = Pull((START[0], START[1] - 0.25, START[2]))
PATIENCE = 60.0  # [s] of real time until a wait has failed; the machine may be busy


@pytest.fixture(scope="module")
def q_start(robot: RobotModel, border_data: BorderData) -> np.ndarray:
    return StartSolver(robot, border_data.pairs, Config().border.d_b).solve(START)


@pytest.fixture
def make_session(robot: RobotModel, border_data: BorderData) -> Callable[[], Session]:
    return lambda: Session(robot, border_data, Config(), physics="kinematic", seed=3)


@pytest.fixture
def loop(make_session, q_start):
    loop = SimulationLoop(make_session, q_start)
    loop.start()
    yield loop
    loop.stop()


def until(loop: SimulationLoop, holds: Callable[[Snapshot], bool]) -> Snapshot:
    """The first snapshot seen for which `holds` is true."""
    deadline = time.monotonic() + PATIENCE
    while time.monotonic() < deadline:
        if loop.error is not None:
            raise loop.error
        if holds(snapshot := loop.latest()):
            return snapshot
        time.sleep(0.002)
    raise AssertionError(f"not seen within {PATIENCE} s; last: {loop.latest()}")


def arrays(snapshot: Snapshot) -> list[np.ndarray]:
    """All arrays in a snapshot, those in its readings included."""
    records = [
        [getattr(snapshot, field.name) for field in fields(snapshot)],
        *snapshot.pairs,
        *snapshot.acting,
        *snapshot.pulls,
        *snapshot.ghosts,
    ]
    return [value for record in records for value in record if isinstance(value, np.ndarray)]


def test_loop_begins_at_the_start_without_a_pull(loop, q_start):
    first = loop.history(-1.0)[0]
    assert first.t == 0.0
    np.testing.assert_array_equal(first.q_m, q_start)
    np.testing.assert_allclose(first.p_ee, START, atol=1e-5)
    assert first.hand_target is None
    assert (first.mode, first.controller, first.paused) == ("guiding", "dbb", False)


def test_pull_moves_the_end_effector_and_a_release_ends_the_force(loop):
    loop.send(PULL)
    pulled = until(loop, lambda s: s.beta_m > 0.05)
    np.testing.assert_array_equal(pulled.hand_target, PULL.target)
    assert np.linalg.norm(pulled.hand_force) > 0.1
    assert pulled.p_ee[1] < START[1] - 0.02
    assert [reading.name for reading in pulled.acting]
    loop.send(Release(0))
    free = until(loop, lambda s: s.hand_target is None)
    np.testing.assert_array_equal(free.hand_force, 0.0)
    assert free.ee_error == 0.0


def test_snapshot_is_consistent(loop, robot):
    """Its end-effector pose, distances and forces agree with its joints and base pose."""
    loop.send(PULL)
    s = until(loop, lambda s: s.beta_m > 0.05)
    state = RobotState(robot)
    state.update(Measurement(s.base_pose, s.base_velocity, s.q_m, np.zeros(7)))
    np.testing.assert_allclose(state.T_world_ee.translation, s.p_ee, atol=1e-9)
    w, x, y, z = s.wxyz_ee
    R = pin.Quaternion(w, x, y, z).toRotationMatrix()
    np.testing.assert_allclose(R, state.T_world_ee.rotation, atol=1e-9)
    for pair in s.pairs:
        apart = np.linalg.norm(pair.p_b - pair.p_a)  # p_b is a mean over the link
        assert -1e-6 <= apart - abs(pair.d) < 0.01
    assert [pair.mobile for pair in s.pairs] == [True, True, False, False, False]
    active = {pair.name: pair for pair in s.pairs if pair.mobile and pair.beta > 0}
    assert {reading.name for reading in s.acting} == set(active)
    for reading in s.acting:  # (14): from the acting point to the closest point on the link
        direction = (active[reading.name].p_b - reading.p_act)[:2]
        cosine = (
            direction @ reading.f[:2] / np.linalg.norm(direction) / np.linalg.norm(reading.f[:2])
        )
        assert cosine == pytest.approx(1.0, abs=1e-6)
    assert s.ee_error == pytest.approx(np.linalg.norm(s.hand_target - s.p_ee))


def test_published_snapshot_never_changes(loop):
    loop.send(PULL)
    early = until(loop, lambda s: s.beta_m > 0.0)
    before = [array.copy() for array in arrays(early)]
    until(loop, lambda s: s.t > early.t + 0.1)
    for then, now in zip(before, arrays(early), strict=True):
        np.testing.assert_array_equal(then, now)


def test_snapshot_is_read_only(loop):
    loop.send(PULL)
    snapshot = until(loop, lambda s: bool(s.acting))
    assert len(arrays(snapshot)) > 20
    for array in arrays(snapshot):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(AttributeError):
        snapshot.t = 0.0


def test_pause_stops_simulated_time_until_it_ends(loop):
    until(loop, lambda s: s.t > 0.05)
    loop.send(Pause(True))
    paused = until(loop, lambda s: s.paused)
    time.sleep(0.2)
    assert loop.latest().t == paused.t
    loop.send(Pause(False))
    on = until(loop, lambda s: not s.paused and s.t > paused.t)
    assert on.t - paused.t < 0.1 + 20 * DT  # the loop does not catch up after the pause
    assert loop.error is None


def test_configuration_applies_during_and_after_a_pause(loop):
    loop.send(Pause(True))
    until(loop, lambda s: s.paused)
    wide = Config().replace("border.d_b", 0.30)
    loop.send(Configure(wide))
    assert until(loop, lambda s: s.config == wide).paused
    loop.send(Pause(False))
    on = until(loop, lambda s: not s.paused and s.beta_m > 0.0)  # the start is inside this buffer
    assert on.config == wide


def test_reset_restarts_the_simulation_also_during_a_pause(loop, q_start):
    loop.send(PULL)
    until(loop, lambda s: s.beta_m > 0.02)
    loop.send(Pause(True))
    until(loop, lambda s: s.paused)
    loop.send(Reset())
    anew = until(loop, lambda s: s.t == 0.0)
    assert anew.paused
    np.testing.assert_array_equal(anew.q_m, q_start)
    np.testing.assert_array_equal(anew.base_pose, 0.0)
    assert anew.hand_target is None
    assert [s.t for s in loop.history(-1.0)] == [0.0]
    loop.send(Reset())
    again = until(loop, lambda s: s.run > anew.run)  # the time of both is zero
    assert (again.t, again.follows(anew)) == (0.0, False)
    loop.send(Pause(False))
    assert until(loop, lambda s: s.t > 0.1).hand_target is None  # the pull has ended


def test_reset_does_not_change_the_configuration(loop):
    config = Config().replace("force.f_max", 123.0)
    loop.send(Configure(config))
    loop.send(Reset())
    assert until(loop, lambda s: s.config == config and s.t > 0.05).config.force.f_max == 123.0


def test_history_is_ordered_at_50_hz_and_begins_after_a_time(loop):
    until(loop, lambda s: s.t > 0.5)
    history = loop.history(-1.0)
    t = np.array([s.t for s in history])
    np.testing.assert_allclose(np.diff(t), 0.02, atol=1e-9)
    cut = history[5].t
    later = loop.history(cut)
    assert later[0].t == history[6].t
    assert loop.history(1e9) == []


def test_files_of_free_motion_name_plant_and_seed(loop, robot):
    until(loop, lambda s: s.t > 0.05)
    meta = Trace.of_snapshots(robot, loop.history(-1.0)).meta
    assert (meta.scenario, meta.physics, meta.seed) == ("", "kinematic", 3)


def test_commands_are_executed_in_order(loop):
    loop.send(Pause(True))
    for d_b in (0.1, 0.2, 0.3, 0.25):
        loop.send(Configure(Config().replace("border.d_b", d_b)))
    loop.send(Pause(False))
    loop.send(Pause(True))
    loop.send(Configure(Config().replace("border.d_b", 0.12)))
    last = until(loop, lambda s: s.config.border.d_b == 0.12)
    assert last.paused


def test_invalid_pull_raises_at_the_sender_and_the_loop_continues(loop):
    for target in ((0.7, 0.0, -0.01), (0.7, float("nan"), 0.2)):
        with pytest.raises(TargetError):
            loop.send(Pull(target))
    t = loop.latest().t
    assert until(loop, lambda s: s.t > t + 0.05).hand_target is None
    assert loop.error is None


class FailingSession(Session):
    """A session whose plant fails after some steps; counts how often it is closed."""

    closed = 0

    def step(self, *lead, **options):
        if self.t > 0.05:
            raise FloatingPointError("the plant exploded")
        return super().step(*lead, **options)

    def close(self):
        type(self).closed += 1
        super().close()


def test_error_in_the_session_is_reported_by_the_loop(
    robot: RobotModel, border_data: BorderData, q_start
):
    FailingSession.closed = 0
    loop = SimulationLoop(
        lambda: FailingSession(robot, border_data, Config(), physics="kinematic"), q_start
    )
    loop.start()
    deadline = time.monotonic() + PATIENCE
    while loop.error is None and time.monotonic() < deadline:
        time.sleep(0.005)
    assert isinstance(loop.error, FloatingPointError)
    loop.stop()
    assert FailingSession.closed == 1
    assert loop.latest().t <= 0.06  # the last snapshot stays available
    loop.send(Reset())  # sending is still possible


def test_session_that_cannot_be_made_is_reported_by_start(q_start):
    def fail() -> Session:
        raise AssetError("no such mesh")

    loop = SimulationLoop(fail, q_start)
    with pytest.raises(LoopError, match="no such mesh") as caught:
        loop.start()
    assert isinstance(caught.value.__cause__, AssetError)
    loop.stop()


def test_session_is_made_in_the_thread_of_the_loop(make_session, q_start):
    made_in: list[int] = []

    def make() -> Session:
        made_in.append(threading.get_ident())
        return make_session()

    loop = SimulationLoop(make, q_start)
    loop.start()
    loop.stop()
    assert len(made_in) == 1
    assert made_in[0] != threading.get_ident()


@pytest.mark.parametrize("paused", [False, True])
def test_stop_ends_the_thread(make_session, q_start, paused):
    before = set(threading.enumerate())
    loop = SimulationLoop(make_session, q_start)
    loop.start()
    loop.send(Pause(paused))
    assert set(threading.enumerate()) - before
    loop.stop()
    assert not set(threading.enumerate()) - before
    loop.stop()  # a second stop, and a stop before a start, have no effect
    SimulationLoop(make_session, q_start).stop()


def test_another_controller_is_used_at_once_also_during_a_pause(loop: SimulationLoop) -> None:
    loop.send(PULL)
    until(loop, lambda s: bool(s.acting) and s.avoidance_acceleration.any())
    loop.send(Choose("repulsive"))
    chosen = until(loop, lambda s: s.controller == "repulsive" and s.t > 0)
    later = until(loop, lambda s: s.controller == "repulsive" and s.t > chosen.t + 0.05)
    assert not later.acting
    assert not later.avoidance_acceleration.any()
    loop.send(Pause(True))
    loop.send(Choose("none"))
    until(loop, lambda s: s.paused and s.controller == "none")


def test_an_unknown_controller_is_refused_and_changes_nothing(loop: SimulationLoop) -> None:
    with pytest.raises(UnknownNameError, match="barrier, dbb, hqp, none, repulsive"):
        loop.send(Choose("dbbb"))
    assert until(loop, lambda s: s.t > 0.1).controller == "dbb"


def test_playing_a_scenario_ends_a_pause(loop):
    loop.send(Pause(True))
    until(loop, lambda s: s.paused)
    loop.send(Play(LINES["tracking"]))
    assert until(loop, lambda s: s.scenario == "tracking" and s.t > 0.1).paused is False


def test_scenario_plays_until_a_reset(loop: SimulationLoop) -> None:
    loop.send(Play(LINES["tracking"].changed(duration=2.0)))
    led = until(loop, lambda s: s.mode == "tracking" and s.t > 0.1)
    assert (led.scenario, led.scenario_ends, led.busy) == ("tracking", 2.0, "")
    np.testing.assert_allclose(loop.history(-1.0)[0].p_ee, LINES["tracking"].start, atol=1e-5)
    loop.send(Reset())
    free = until(loop, lambda s: s.scenario == "")
    assert (free.scenario_ends, free.mode) == (None, "guiding")
    np.testing.assert_allclose(free.p_ee, START, atol=1e-3)


def test_impossible_scenario_is_refused_in_the_snapshot(
    loop: SimulationLoop,
) -> None:
    before = until(loop, lambda s: s.t > 0.05)
    loop.send(Play(LINES["tracking"].changed(move=(0.0, 0.0, -2.0))))
    refused = until(loop, lambda s: s.refusal is not None)
    assert refused.refusal.number == 1
    assert "below the floor" in refused.refusal.message
    on = until(loop, lambda s: s.t > refused.t)
    assert (on.scenario, on.busy, on.t > before.t) == ("", "", True)


def test_a_single_step_advances_by_one_snapshot_and_pauses(loop: SimulationLoop) -> None:
    loop.send(StepOnce())
    t = until(loop, lambda s: s.paused).t
    for k, seconds in enumerate((0.02, 0.02, 0.1, 0.005)):
        loop.send(StepOnce(seconds))
        at = until(loop, lambda s, t=t: s.t > t)
        assert at.paused, k
        assert at.t == pytest.approx(t + seconds, abs=1e-9)
        assert [s.t for s in loop.history(t)] == [at.t]
        t = at.t
    time.sleep(0.1)
    assert loop.latest().t == t


def test_commanded_speed_persists_after_a_reset(loop: SimulationLoop) -> None:
    loop.send(Speed(0.25))
    until(loop, lambda s: s.speed == 0.25)
    loop.send(Reset())
    begun, t = time.monotonic(), until(loop, lambda s: s.t < 0.05).t
    later = until(loop, lambda s: s.t >= t + 0.1)
    assert time.monotonic() - begun > 0.3  # [s] four times the simulated time
    assert later.speed == 0.25
    assert later.realtime_factor < 0.3


def test_flood_of_commands_is_merged_into_a_few(loop: SimulationLoop, monkeypatch) -> None:
    """Of ten thousand commands fewer than 500 are executed, and the newest is the last."""
    executed: list[object] = []
    carry_out = loop._carry_out
    monkeypatch.setattr(
        loop, "_carry_out", lambda command, *to: (executed.append(command), carry_out(command, *to))
    )
    loop.send(Pause(True))
    until(loop, lambda s: s.paused)
    steps: list[float] = []
    monkeypatch.setattr("app.simulation.loop.loop._IDLE", 0.05)
    for k in range(10_000):
        d_b = (0.10, 0.12, 0.14, 0.16)[k % 4]
        loop.send(Configure(CONFIGS[d_b]) if k % 2 else Pull((0.4, 0.7, 0.3 + 1e-5 * k)))
        steps.append(loop.latest().t)
    loop.send(Pause(False))
    s = until(loop, lambda s: s.hand_target is not None and s.hand_target[2] > 0.3 + 0.09997)
    assert s.config == CONFIGS[0.16]
    assert len(executed) < 500
    assert len(set(steps)) == 1  # no simulated time passes during the pause


CONFIGS = {d_b: Config().replace("border.d_b", d_b) for d_b in (0.10, 0.12, 0.14, 0.16)}


def test_restart_begins_the_scenario_again(loop: SimulationLoop) -> None:
    loop.send(Play(LINES["tracking"]))
    until(loop, lambda s: s.scenario == "tracking" and s.t > 0.1)
    loop.send(Pull((0.4, 0.7, 0.4)))
    until(loop, lambda s: s.scenario == "")
    loop.send(Restart())
    again = until(loop, lambda s: s.scenario == "tracking")
    assert again.hand_target is None


def test_elbow_is_pulled_at_its_point_and_the_snapshot_names_the_person(loop) -> None:
    loop.send(Pull((0.2, 0.6, 1.0), "panda_link4", (0.0, 0.05, 0.0), who=3))
    loop.send(PULL)
    s = until(loop, lambda s: len(s.pulls) == 2 and np.linalg.norm(s.pulls[0].force) > 1.0)
    assert [(reading.who, reading.link) for reading in s.pulls] == [(3, "panda_link4"), (0, None)]
    np.testing.assert_array_equal(s.hand_target, PULL.target)
    np.testing.assert_array_equal(s.pulls[1].force, s.hand_force)
    np.testing.assert_allclose(s.pulls[1].point, s.p_ee)
    loop.send(Release(0))
    s = until(loop, lambda s: len(s.pulls) == 1)
    assert (s.pulls[0].who, s.hand_target) == (3, None)
    with pytest.raises(UnknownNameError, match="did you mean 'panda_link4'"):
        loop.send(Pull((0.2, 0.6, 1.0), "panda_lin4"))


def test_ghosts_run_beside_the_robot_in_the_snapshot(loop: SimulationLoop) -> None:
    loop.send(Compare(("none", "repulsive"), "force"))
    begun = until(loop, lambda s: len(s.ghosts) == 2)
    loop.send(PULL)
    s = until(loop, lambda s: s.t > begun.t and s.beta_m > 0.05)
    assert [ghost.controller for ghost in s.ghosts] == ["none", "repulsive"]
    assert [score.controller for score in s.scores] == ["dbb", "none", "repulsive"]
    assert (s.same, s.busy) == ("force", "")
    loop.send(Compare())
    alone = until(loop, lambda s: not s.ghosts)
    assert (alone.scores, alone.same, alone.t >= s.t) == ((), "", True)
    assert np.linalg.norm(until(loop, lambda later: later.t > alone.t).hand_force) > 0.1


def test_ghosts_and_robot_of_a_snapshot_have_the_same_time(loop) -> None:
    loop.send(Compare(("dbb",)))
    until(loop, lambda s: bool(s.ghosts))
    loop.send(PULL)
    t = until(loop, lambda s: np.linalg.norm(s.hand_force) > 5.0).t
    for k in range(20):
        loop.send(Speed(1.0 + 0.01 * k))
        s = until(loop, lambda s, k=k: s.speed == 1.0 + 0.01 * k)
        np.testing.assert_allclose(s.ghosts[0].q_m, s.q_m, atol=1e-6)
        np.testing.assert_allclose(s.ghosts[0].base_pose, s.base_pose, atol=1e-6)
    assert s.t >= t
