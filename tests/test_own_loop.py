"""Readings of real robots: the loop behaves as with a simulator and reports each fault."""

from __future__ import annotations

import copy
import pickle
from collections.abc import Callable, Sequence
from datetime import datetime
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config, DisturbanceConfig, parameter
from app.control import CONTROLLERS, estimate
from app.control.contract import JointOrder, rounding
from app.control.controller import Controller, ControlLoop
from app.control.inputs import gains_struct
from app.control.quantities import ControlStep
from app.control.readings import (
    HISTORY,
    PERIOD,
    _find_lag,
    _find_period,
    _measure_from,
    count_periods,
)
from app.control.tasks import Reference
from app.errors import ConfigError, MeasurementError, UnknownNameError
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, at_rest
from app.simulation.people import Hold
from app.simulation.plants.interface import PointLoad
from app.simulation.plants.kinematic import Kinematic
from app.simulation.run import run_scenario
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import Disturbances, Session, VelocityTracking
from tests.bases import robot_on

Array = np.ndarray
Degradation = Callable[[int, Measurement], Measurement]

PULL = np.array([-12.0, 0.0, 0.0])  # [N] on the end-effector, into the buffer
LATERAL, FRONTAL = np.array([0.0, -40.0, 0.0]), np.array([-30.0, 0.0, -10.0])
FRONT, SIDE = (0.92, 0.10, 0.30), (0.30, 0.72, 0.35)  # [m] starts of the end-effector
NAN = np.full(7, np.nan)


class Run(NamedTuple):
    """The results of a simulated robot in its own control loop."""

    base: Array
    """(3,) x, y [m] and heading [rad] of the base at the end."""
    share: float
    """[-] largest ratio of a joint's speed to its speed limit."""
    nearest: float
    """[m] smallest distance of a pair."""
    faults: dict[str, float]
    """[s] time of the first report of each fault."""
    robot: RobotModel
    seen: list[Measurement]
    """True readings before each step."""
    sent: Measurement
    """The last readings."""

    @property
    def ee(self) -> Array:
        """(k, 3) [m] path of the end-effector."""
        state, path = RobotState(self.robot), []
        for each in self.seen:
            state.update_kinematics(each)
            path.append(state.p_ee.copy())
        return np.array(path)


@pytest.fixture(scope="module")
def starts(robot: RobotModel, border_data: BorderData) -> dict[tuple[float, ...], Array]:
    solver = StartSolver(robot, border_data.pairs, Config().border.d_b)
    return {start: solver.solve(start) for start in (FRONT, SIDE)}


@pytest.fixture(scope="module")
def run(robot: RobotModel, border_data: BorderData, starts) -> Callable[..., Run]:
    """Return a function that runs a loop.

    `degrade` changes the readings, `driven` the base's commands; in a stall there is no step.
    """

    def run(
        degrade: Degradation = lambda k, m: m,
        *,
        stated: float = 0.001,
        real: float = 0.001,
        time: float = 1.6,
        start: Any = FRONT,
        pull: Array | Callable[[int], Array] = PULL,
        reference: Callable[[float, pin.SE3], Reference] | None = None,
        driven: Callable[[Array], Array] = lambda v: v,
        stalls: Callable[[int], bool] = lambda k: False,
        created: Callable[[ControlLoop], None] = lambda loop: None,
        **options: Any,
    ) -> Run:
        loop = ControlLoop(robot, border_data, dt=stated, **options)
        created(loop)
        plant, seen = Kinematic(robot, dt=real), RobotState(robot)
        plant.reset(np.zeros(3), starts[start] if isinstance(start, tuple) else start)
        seen.update_kinematics(plant.measure())
        origin, nearest, faults, path = seen.T_world_ee.copy(), np.inf, {}, []
        for k in range(round(time / real)):
            sent = plant.measure()
            path.append(sent)
            wanted = reference(k * real, origin) if reference else None
            if not stalls(k):
                command = loop.step(degrade(k, sent), wanted)
            nearest = min(nearest, float(command.step.d.min()))
            for name in command.faults:
                faults.setdefault(name, k * real)
            force = pull(k) if callable(pull) else pull
            plant.step(command.u_a, driven(np.asarray(command.base_velocity)), force)
        sent = plant.measure()
        share = (np.abs([each.qd_m for each in path]) / robot.qd_max).max()
        return Run(sent.base_pose, float(share), nearest, faults, robot, path, sent)

    return run


@pytest.fixture(scope="module")
def plain(run) -> Run:
    """The run without a fault."""
    return run()


def ready(robot: RobotModel) -> Measurement:
    """The readings of an arm that rests in its ready posture."""
    return at_rest(robot, np.array(robot.description.arm.ready_position))


def every_nth(n: int) -> Degradation:
    last: list[Measurement] = []

    def degrade(k: int, m: Measurement) -> Measurement:
        if k % n == 0:
            last[:] = [m]
        return last[0]

    return degrade


def late(n: int) -> Degradation:
    seen: list[Measurement] = []

    def degrade(k: int, m: Measurement) -> Measurement:
        seen.append(m)
        return seen[max(0, k - n)]

    return degrade


def late_every_nth(n: int) -> Degradation:
    delay, repeat = late(n), every_nth(n)
    return lambda k, m: repeat(k, delay(k, m))


def lossy(share: float, every: int = 1) -> Degradation:
    """Pass on each `every`-th reading, lose a `share` of these, and repeat the last one between."""
    rng, last = np.random.default_rng(0), []

    def degrade(k: int, m: Measurement) -> Measurement:
        if not last or (k % every == 0 and rng.random() > share):
            last[:] = [m]
        return last[0]

    return degrade


def noisy(noise: float, degrade: Degradation) -> Degradation:
    """Add white noise to positions and velocities.

    Its standard deviation is `noise` [rad] for positions, and 60 `noise` [rad/s] for velocities.
    """
    rng = np.random.default_rng(0)

    def degrade_with_noise(k: int, m: Measurement) -> Measurement:
        q, v = noise * rng.standard_normal((2, 7))
        m = degrade(k, m)
        return m._replace(q_m=m.q_m + q, qd_m=m.qd_m + 60.0 * v)

    return degrade_with_noise


def starting_at(degrade: Degradation, begin: int) -> Degradation:
    """Apply `degrade` from the step `begin` on."""

    def later(k: int, m: Measurement) -> Measurement:
        degraded = degrade(k, m)
        return m if k < begin else degraded

    return later


def filtered(noise: float = 0.0) -> Degradation:
    """Add white noise with the standard deviation `noise` [rad] to the positions.

    The velocities are computed from these positions by a filter with a delay of 8 ms.
    """
    rng, tracking = np.random.default_rng(0), list[VelocityTracking]()

    def degrade(k: int, m: Measurement) -> Measurement:
        if not tracking:
            tracking.append(VelocityTracking(m.q_m, m.qd_m, 0.001))
        q = m.q_m + noise * rng.standard_normal(7)
        return m._replace(q_m=q, qd_m=tracking[0].update(q))

    return degrade


def both(first: Degradation, second: Degradation) -> Degradation:
    return lambda k, m: second(k, first(k, m))


def every_nth_without_velocities(n: int) -> Degradation:
    repeat = every_nth(n)
    return lambda k, m: repeat(k, m)._replace(qd_m=NAN)


def odometry_every_nth(n: int) -> Degradation:
    repeat = every_nth(n)
    return lambda k, m: m._replace(base_pose=repeat(k, m).base_pose)


def starting_at_pose(begin: int) -> Degradation:
    """No base pose before the step `begin`; then one that is far from the origin."""
    origin = np.array([3.0, 1.0, 0.0])
    return lambda k, m: m._replace(base_pose=NAN[:3] if k < begin else m.base_pose + origin)


EPOCH = 1.7e9  # [s] time stamps of a real clock are large numbers


def stamped(degrade: Degradation, real: float = 0.001) -> Degradation:
    """Readings with time stamps; the loop knows the time."""

    def degraded(k: int, m: Measurement) -> Measurement:
        now = EPOCH + k * real
        return degrade(k, m._replace(time=now))._replace(now=now)

    return degraded


READINGS = {
    "no velocities": (lambda: lambda k, m: m._replace(qd_m=NAN), {"velocity"}),
    "one velocity missing": (
        lambda: lambda k, m: m._replace(qd_m=np.where(np.arange(7) == 6, np.nan, m.qd_m)),
        {"velocity"},
    ),
    "velocities of zero": (lambda: lambda k, m: m._replace(qd_m=np.zeros(7)), {"velocity"}),
    "velocities in degrees": (lambda: lambda k, m: m._replace(qd_m=57.3 * m.qd_m), {"velocity"}),
    "50 Hz": (lambda: every_nth(20), {"repeated"}),
    "30 Hz": (lambda: every_nth(33), {"repeated"}),
    "50 Hz without velocities": (
        lambda: every_nth_without_velocities(20),
        {"repeated", "velocity"},
    ),
    "half of them lost": (lambda: lossy(0.5), {"repeated"}),
    "5 ms late": (lambda: late(5), {"lag"}),
    "20 ms late": (lambda: late(20), {"lag"}),
    "20 ms late at 50 Hz": (lambda: late_every_nth(20), {"lag", "repeated"}),
    "12 ms late with noise": (lambda: noisy(2e-5, late(12)), {"lag"}),
    "20 ms late with noise": (lambda: noisy(5e-5, late(20)), {"lag"}),
    "late from the middle of a motion": (lambda: starting_at(late(1), 390), {"lag", "repeated"}),
    "12 ms late from the middle of a motion": (
        lambda: both(filtered(8e-5), starting_at(late(12), 390)),
        {"lag"},
    ),
    "9 ms late and each 27 ms from the middle of a motion": (
        lambda: starting_at(both(late(9), every_nth(27)), 400),
        {"lag", "repeated"},
    ),
    "velocities that a filter delays": (lambda: filtered(), set()),
    "noise, and velocities that a filter delays": (lambda: filtered(7e-5), set()),
    "noise, each 9 ms, 40 % lost": (
        lambda: both(filtered(2e-5), lossy(0.4, 9)),
        {"repeated"},
    ),
    "with noise": (lambda: noisy(1e-4, lambda _, m: m), set()),
    "one impossible velocity": (
        lambda: lambda k, m: m._replace(qd_m=m.qd_m + 1e200 * (k == 500)),
        {"velocity"},
    ),
    "each second position missing": (
        lambda: lambda k, m: m._replace(q_m=np.where(np.arange(7) == 3 + 9 * (k % 2), NAN, m.q_m)),
        {"invalid"},
    ),
    "one impossible position": (
        lambda: lambda k, m: m._replace(q_m=m.q_m + 10.0 * (k == 500) * (np.arange(7) == 3)),
        {"implausible"},
    ),
    "no base pose": (lambda: lambda k, m: m._replace(base_pose=NAN[:3]), {"invalid"}),
    "no base velocity": (lambda: lambda k, m: m._replace(base_velocity=NAN[:2]), {"velocity"}),
    "50 Hz without base velocity": (
        lambda: both(every_nth(20), lambda k, m: m._replace(base_velocity=NAN[:2])),
        {"repeated", "velocity"},
    ),
    "a base pose from 0.3 s on": (lambda: starting_at_pose(300), {"invalid"}),
    "odometry at 5 Hz": (lambda: odometry_every_nth(200), set()),
}


@pytest.mark.parametrize("case", READINGS)
def test_poor_readings_are_reported_and_change_the_motion_little(
    run, plain: Run, case: str
) -> None:
    make, faults = READINGS[case]
    found = run(make())
    assert set(found.faults) == faults
    assert found.share < 1.05
    assert found.nearest > 0.02
    np.testing.assert_allclose(found.base, plain.base, atol=0.06)


@pytest.mark.parametrize(
    ("every", "delay", "pull", "most"),
    [(25, 12, LATERAL, 1.8), (25, 12, FRONTAL, 1.8), (3, 19, LATERAL, 1.8), (3, 19, FRONTAL, 1.8)],
)
def test_rare_readings_of_unknown_delay_hardly_make_the_arm_oscillate(
    run, every: int, delay: int, pull: Array, most: float
) -> None:
    """With the gains of fast readings, light joints reached 2 to 17 times their speed limits."""
    late_and_rare = starting_at(both(late(delay), every_nth(every)), 20)
    start = SIDE if pull is LATERAL else FRONT
    found = run(late_and_rare, start=start, pull=pull, time=0.9)
    assert found.share < most
    assert found.nearest > 0.03


def blind_times(run, *args: Any, **options: Any) -> Array:
    """(k,) [ms] blind time of each step of a run."""
    found: list[float] = []

    def watch(loop: ControlLoop) -> None:
        step = loop.step

        def watched(*readings: Any) -> Any:
            command = step(*readings)
            found.append(1e3 * float(command.step.blind_time))
            return command

        loop.step = watched  # type: ignore[method-assign]

    run(*args, created=watch, **options)
    return np.array(found)


@pytest.mark.parametrize("force", [20.0, 40.0, 60.0])
@pytest.mark.parametrize("start", [FRONT, SIDE])
def test_no_pull_casts_doubt_on_perfect_readings(
    run, start: tuple[float, ...], force: float
) -> None:
    """The pull begins at once, and ends before a joint hits its mechanical stop."""
    direction = LATERAL if start is SIDE else FRONTAL
    pull = force * direction / np.linalg.norm(direction)
    np.testing.assert_array_equal(blind_times(run, start=start, pull=pull, time=0.2), 1.0)


def test_blind_time_is_the_largest_recent_age_of_the_readings(run) -> None:
    found = blind_times(run, every_nth(20), pull=PULL / 10.0, time=0.4)
    assert found[-200:].max() == pytest.approx(20.0)  # no doubt: the motion is slow
    assert found[-200:].min() == pytest.approx(
        20.0 * np.exp(-0.019 / Config().estimate.noise_window), rel=0.01
    )


def test_jump_adds_to_the_blind_time_which_then_decays(
    robot: RobotModel, border_data: BorderData
) -> None:
    good = ready(robot)
    loop, window = ControlLoop(robot, border_data), Config().estimate.noise_window
    loop.step(good._replace(q_m=np.zeros(7)))
    for k in range(1, 1000):
        step = loop.step(good).step
        assert step.blind_time == pytest.approx(max(0.001, 0.025 * np.exp(-k * 0.001 / window)))
    assert step.blind_time == 0.001


def test_long_gap_adds_at_most_0_1_s_to_the_blind_time(run) -> None:
    found = blind_times(run, blind(300, 700, "q_m"), time=0.9)
    assert 25.0 < found[700:].max() <= 124.0


def test_errors_are_those_of_the_velocities_used_at_the_time_of_the_reading(
    robot: RobotModel, border_data: BorderData
) -> None:
    delay, plant, used, expected = late(10), Kinematic(robot, dt=0.001), [], np.zeros(7)
    loop = ControlLoop(robot, border_data, Config().replace("estimate.delay", 0.010))
    plant.reset(np.zeros(3), np.array(robot.description.arm.ready_position))
    decay = np.exp(-0.001 / Config().estimate.noise_window)
    for k in range(200):
        command, step = loop.step(delay(k, plant.measure())), loop.controller.last
        if k > 30:
            expected = np.maximum(np.abs(step.x_read[1] - used[k - 10]), decay * expected)
            if k > 60:
                np.testing.assert_allclose(step.v_error, expected, rtol=1e-9)
        else:
            expected = step.v_error.copy()
        used.append(step.qd_m.copy())
        plant.step(command.u_a, np.asarray(command.base_velocity), PULL)
    assert expected.max() > 0.01


@pytest.mark.parametrize("noise", [3e-5, 1e-4])
def test_noise_does_not_delay_the_estimate_of_a_pull(run, noise: float) -> None:
    found = run(noisy(noise, lambda k, m: m), start=SIDE, pull=LATERAL, time=0.6)
    assert found.share < 1.02


def test_delay_that_begins_in_noise_is_reported_within_0_1_s(
    run,
) -> None:
    """The delay causes an oscillation: the joint speeds change sign, and double, every 25 ms."""
    found = run(noisy(8e-5, starting_at(late(12), 300)), time=0.5)
    assert set(found.faults) == {"lag"}
    assert 0.3 <= found.faults["lag"] < 0.4
    assert found.share < 1.05


@pytest.mark.parametrize(
    ("delay", "noise", "pull"), [(17, 1e-4, 40.0), (14, 6e-5, 30.0), (12, 1e-4, 40.0)]
)
def test_delay_that_noise_hides_at_rest_is_reported_within_0_11_s_of_a_pull(
    run, delay: int, noise: float, pull: float
) -> None:
    found = run(noisy(noise, late(delay)), start=SIDE, pull=np.array([0.0, -pull, 0.0]), time=0.8)
    assert found.faults["lag"] < 0.11
    assert found.share < 1.25


def test_base_velocity_in_another_unit_is_reported_without_contact(run) -> None:
    """Slow motions stay plausible in the wrong unit, so joints move faster than normally."""
    found = run(lambda k, m: m._replace(base_velocity=1000 * m.base_velocity))
    assert "velocity" in found.faults
    assert found.share < 1.5
    assert found.nearest > 0.02


@pytest.mark.parametrize(("amplitude", "lag"), [(0.5, 0), (50.0, 20)])
def test_only_changes_of_acceleration_that_no_person_causes_show_a_lag(
    robot: RobotModel, border_data: BorderData, amplitude: float, lag: int
) -> None:
    """All joints follow a sinusoidal acceleration 20 ms late, at 3 Hz.

    Args:
        robot: The robot.
        border_data: Its border data.
        amplitude: [rad/s²] amplitude of the acceleration.
        lag: Expected lag in control periods.
    """
    loop = ControlLoop(robot, border_data)
    w = loop.step(ready(robot)).step
    gains, q, speed = gains_struct(Config(), robot, "dbb", 0.001), w.q_m.copy(), 0.0
    for k in range(1000):
        w.periods[()], w.known[()] = k % HISTORY, min(k, HISTORY)
        w.history[k % HISTORY] = amplitude * np.sin(0.02 * k)
        speed += 0.001 * amplitude * np.sin(0.02 * (k - 20))
        q += 0.001 * speed
        _find_lag(loop.controller._robot, w.struct, q, 0, gains)
    assert w.lag == pytest.approx(lag, abs=3)


def test_rare_wrong_ratios_of_a_motion_do_not_add_up_to_a_wrong_period(
    robot: RobotModel, border_data: BorderData
) -> None:
    w = ControlLoop(robot, border_data).step(ready(robot)).step
    gains, q, qd = gains_struct(Config(), robot, "dbb", 0.001), w.q_m.copy(), np.full(7, 0.2)
    _measure_from(w.struct, q, qd)
    w.reading[1], w.known[()], w.ratio[()] = qd, 100.0, 1.0
    for k in range(20_000):
        q += 0.001 * qd * (1.12 if k % 1000 < 14 else 1.0)
        _find_period(w.struct, q, qd, 1, gains)
        w.reading[0] = q
        assert not w.faults[PERIOD], f"after {k} ms"


@pytest.mark.slow
@pytest.mark.parametrize("physics", ["planar", "kinematic", "mujoco-contact"])
def test_sudden_change_of_a_pull_is_not_reported_as_lag(
    robot: RobotModel, border_data: BorderData, physics: str
) -> None:
    """The person's target jumps by up to 0.35 m; the damping then follows the motion late."""
    rng, at = np.random.default_rng(5), Hold(3, np.zeros(3))
    for _ in range(5):
        session = Session(robot, border_data, Config(), physics=physics)
        origin = session.T_world_ee.translation.copy()
        for k in range(500):
            if k % 250 == 0:
                at = at._replace(target=origin + rng.uniform(-0.35, 0.35, 3))
            step = session.step(holds=[at])
            assert step.control.lag == 0.0
        session.close()


@pytest.mark.parametrize("factor", [0.0, 0.4, -1.0])
def test_base_that_does_not_follow_its_commands_is_reported_without_contact(
    run, factor: float
) -> None:
    """`factor` is the ratio of the driven to the commanded velocity: blocked, slow, backwards."""
    found = run(driven=lambda v: factor * v)
    assert set(found.faults) == {"base"}
    assert found.nearest > 0.02


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scenario", "controller"),
    [
        *((name, "dbb") for name in LINES),
        *(("guiding-fold", name) for name in CONTROLLERS if name != "dbb"),
    ],
)
def test_perfect_readings_have_no_fault(
    robot: RobotModel, border_data: BorderData, scenario: str, controller: str
) -> None:
    """Each motion with the controller dbb, and each other controller on one path."""
    line = LINES[scenario].changed(duration=3.0)
    found = run_scenario(
        robot, border_data, line, Config(), controller=controller, physics="kinematic"
    )
    assert found.figures["fault_s"] == {}


def test_motion_by_another_controller_is_not_reported_as_lag(
    robot: RobotModel, border_data: BorderData, starts
) -> None:
    """The motion does not result from the torques of the watching loop at any delay."""
    moving, watching = (
        ControlLoop(robot, border_data, Config().changed({"barrier.rate": rate}))
        for rate in (10.0, 40.0)
    )
    plant, faults = Kinematic(robot), set()
    plant.reset(np.zeros(3), starts[FRONT])
    for _ in range(1000):
        command = moving.step(plant.measure())
        faults |= set(watching.step(plant.measure()).faults)
        plant.step(command.u_a, command.base_velocity, PULL)
    assert faults == set()


@pytest.mark.parametrize(
    ("stated", "real"),
    [(0.002, 0.002), (0.004, 0.004), (0.008, 0.008), (0.001, 0.005), (0.004, 0.001)],
)
def test_period_hardly_changes_the_motion_and_a_wrong_one_is_reported(
    run, plain: Run, stated: float, real: float
) -> None:
    found = run(stated=stated, real=real)
    assert ("period" in found.faults) == (stated != real)
    assert found.share < 1.05
    np.testing.assert_allclose(found.base, plain.base, atol=0.01)  # the base moves at 0.5 m/s


def test_time_stamps_of_perfect_readings_change_nothing(run, plain: Run) -> None:
    found = run(stamped(lambda k, m: m))
    assert found.faults == {}
    np.testing.assert_array_equal(found.ee, plain.ee)


@pytest.mark.parametrize(
    ("make", "begin"),
    [
        (lambda: late(20), 0.0),
        (lambda: late(50), 0.0),
        (lambda: starting_at(late(24), 100), 0.1),
        (lambda: noisy(3e-4, late(20)), 0.0),
        (lambda: both(late(9), every_nth(27)), 0.0),
        (lambda: both(noisy(1e-4, late(15)), lossy(0.4)), 0.0),
    ],
)
def test_time_stamps_show_the_age_of_the_readings_at_once(
    run, plain: Run, make: Callable[[], Degradation], begin: float
) -> None:
    """Without time stamps, noise hides a delay for up to a second, and 50 ms remain unknown."""
    found = run(stamped(make()))
    assert set(found.faults) <= {"lag", "repeated"}
    assert found.faults["lag"] <= begin + 0.061
    assert found.share < 1.05
    assert found.nearest > 0.02
    np.testing.assert_allclose(found.base, plain.base, atol=0.15)  # the base moves 0.5 m


def test_readings_that_arrive_in_a_wrong_order_cause_no_jump(run, plain: Run) -> None:
    delays = np.random.default_rng(3).integers(0, 12, 2000)
    seen: list[Measurement] = []

    def shuffled(k: int, m: Measurement) -> Measurement:
        seen.append(m)
        return seen[max(0, k - delays[k])]

    found = run(stamped(shuffled))
    assert set(found.faults) <= {"lag", "repeated"}
    assert found.share < 1.05
    np.testing.assert_allclose(found.base, plain.base, atol=0.06)


@pytest.mark.parametrize(("stated", "real"), [(0.001, 0.005), (0.004, 0.001), (0.002, 0.0025)])
def test_a_clock_shows_a_wrong_period_at_rest(run, stated: float, real: float) -> None:
    found = run(stamped(lambda k, m: m, real), stated=stated, real=real, time=0.3, pull=np.zeros(3))
    assert found.faults["period"] < 0.2


def test_velocities_in_another_unit_are_no_wrong_period_if_a_clock_is_known(run) -> None:
    found = run(stamped(lambda k, m: m._replace(qd_m=2.0 * m.qd_m)))
    assert set(found.faults) == {"velocity"}


def stall(every: int, duration: int) -> Callable[[int], bool]:
    """Each `every`-th period, the next step comes `duration` periods later."""
    return lambda k: 0 < k % every < duration


@pytest.mark.parametrize(("every", "duration"), [(49, 30), (29, 10), (7, 3), (229, 30)])
@pytest.mark.parametrize("stamp", [True, False], ids=["time stamps", "only a clock"])
def test_stalls_of_the_loop_are_reported_and_change_the_motion_little(
    run, plain: Run, every: int, duration: int, stamp: bool
) -> None:
    """With the mean interval as the period, or with 1 ms in each step, the arm seems to jump."""
    loops: list[ControlLoop] = []
    found = run(
        stamped(lambda k, m: m if stamp else m._replace(time=np.nan)),
        stalls=stall(every, duration),
        created=loops.append,
    )
    assert set(found.faults) == {"stall"}
    assert loops[0].controller.dt == 0.001
    assert found.share < 1.05
    assert found.nearest > 0.02
    np.testing.assert_allclose(found.base, plain.base, atol=0.03)


@pytest.mark.parametrize("duration", [3, 5, 10])
def test_loop_that_catches_up_after_a_stall_keeps_its_period(
    robot: RobotModel, border_data: BorderData, duration: int
) -> None:
    """At random, a step comes some periods late; the next steps follow at once."""
    rng, plant = np.random.default_rng(0), Kinematic(robot, dt=0.0001)
    loop, faults, last = ControlLoop(robot, border_data), set[str](), 0
    command = loop.step(plant.measure()._replace(now=0.0, time=0.0))
    for k in range(1, 500):
        wakes = max(10 * (k + duration * (rng.random() < 0.05)), last + 1)
        for _ in range(wakes - last):
            plant.step(command.u_a, command.base_velocity, PULL)
        last, now = wakes, 1e-4 * wakes
        command = loop.step(plant.measure()._replace(now=now, time=now))
        faults |= set(command.faults)
    assert faults == {"stall"}
    assert loop.controller.dt == 0.001


def test_late_wake_ups_are_no_wrong_period(robot: RobotModel, border_data: BorderData) -> None:
    """The mean interval is 7 % longer than the period, because some steps miss their period."""
    wakes = 0.001 * np.arange(3000) + np.random.default_rng(2).exponential(0.0005, 3000)
    loop, m, last = ControlLoop(robot, border_data), ready(robot), -1.0
    for now in np.round(wakes, 4).tolist():
        if now > last:
            loop.step(m._replace(now=now, time=now))
            last = now
    assert loop.reported == {"stall"}
    assert loop.controller.dt == 0.001


@pytest.mark.parametrize("short", [0.0001, 0.0004])
def test_counted_periods_add_up_to_the_time_of_the_clock(short: float) -> None:
    """After each stall, the loop catches up with short intervals."""
    count = getattr(count_periods, "py_func", count_periods)
    rng, now, counted, off = np.random.default_rng(0), 0.0, 0.0, []
    w = SimpleNamespace(clock=np.zeros(()), clock_ahead=np.zeros(()), clock_rest=np.zeros(()))
    for k in range(1, 3000):
        now = max(0.001 * k + 0.02 * (rng.random() < 0.03), now + short)
        periods, ahead = count(w, now, 0.001)
        w.clock[()], w.clock_ahead[()], counted = now, ahead, counted + periods
        off.append(now / 0.001 - counted)
    assert np.abs(off).max() < 1.0


@pytest.mark.parametrize("short", [0.00015, 0.0004])
def test_loop_that_catches_up_commands_the_base_at_10_hz(
    robot: RobotModel, border_data: BorderData, short: float
) -> None:
    """Each missed period counted twice: at the stall, and at the step that follows at once.

    The stalls hardly coincide with a new command, which they delay.
    """
    loop, m, times, reports, now = ControlLoop(robot, border_data), ready(robot), [], [], 0.0
    for k in range(1, 1500):
        now = max(0.001 * k + 0.03 * (k % 137 == 70), now + short)
        command = loop.step(m._replace(now=now, time=now))
        times += [now] if command.step.command_due else []
        reports += [now] if "stall" in command.faults else []
    assert np.diff(times).min() > 0.095
    assert np.mean(np.diff(times)) == pytest.approx(0.1, rel=0.05)
    assert len(reports) == 11, "each stall is reported"
    assert loop.reported == {"stall"}


def test_jitter_of_the_loop_does_not_speed_up_the_interpolation(
    robot: RobotModel, border_data: BorderData
) -> None:
    """A planner's samples at 10 Hz: the interpolation ended 20 ms before the next sample."""
    m, state = ready(robot), RobotState(robot)
    state.update_kinematics(m)
    samples, speeds = sampled(10.0, 0.0), []
    for jitter in (0.0, 0.0004):
        loop, rng = ControlLoop(robot, border_data), np.random.default_rng(0)
        for k in range(1000):
            now = 0.001 * k + rng.uniform(-jitter, jitter)
            command = loop.step(m._replace(now=now, time=now), samples(now, state.T_world_ee))
        speeds.append(float(command.step.v_ref[1]))
    assert speeds[1] == pytest.approx(speeds[0], rel=0.05)


def test_reference_at_the_true_time_is_no_sample_of_a_planner_after_a_stall(run) -> None:
    """The end-effector was 85 mm behind the reference."""
    rest = {"start": SIDE, "pull": np.zeros(3), "time": 1.0, "reference": wobbling}
    exact = run(stamped(lambda k, m: m), **rest)
    found = run(stamped(lambda k, m: m), stalls=stall(229, 30), **rest)
    assert np.linalg.norm(found.ee - exact.ee, axis=1).max() < 0.005


@pytest.mark.parametrize(
    ("stated", "real", "delay"),
    [(0.001, 0.005, 2), (0.001, 0.008, 1), (0.005, 0.001, 50), (0.008, 0.001, 24)],
)
def test_late_readings_cause_no_jump_while_the_period_is_corrected(
    run, stated: float, real: float, delay: int
) -> None:
    options = {"start": SIDE, "pull": LATERAL / 2.0, "time": 0.5}
    found = run(stamped(late(delay), real), stated=stated, real=real, **options)
    assert "period" in found.faults
    assert "jump" not in found.faults


def test_pause_of_the_loop_is_no_wrong_period(run) -> None:
    def paused(k: int, m: Measurement) -> Measurement:
        later = 0.05 * (k // 100)  # [s] a pause of 50 ms each 0.1 s
        return m._replace(now=EPOCH + 0.001 * k + later, time=EPOCH + 0.001 * k + later)

    assert set(run(paused).faults) == {"stall"}


def with_age(age: Callable[[int], float]) -> Degradation:
    """Readings that are new, with time stamps that claim an age [s] in step k."""
    return stamped(lambda k, m: m._replace(time=m.time - age(k)))


@pytest.mark.parametrize(("age", "words"), [(-0.5, "0.5 s after"), (0.2, "0.2 s before")])
def test_clocks_that_differ_are_refused_first_and_reported_later(
    run, age: float, words: str
) -> None:
    with pytest.raises(MeasurementError, match=words):
        run(with_age(lambda k: age))
    found = run(with_age(lambda k: age if k > 100 else 0.0), time=0.25)
    assert set(found.faults) == {"stale", "lag" if age > 0.0 else "invalid"}


def odometry(delay: int, every: int, stamp: float | None = None) -> Degradation:
    """Late and repeated readings of the base with time stamps; the joints' readings are new.

    `stamp` [s] replaces the age of the base's readings.
    """
    behind = late_every_nth(every) if delay == every else both(late(delay), every_nth(every))

    def degrade(k: int, m: Measurement) -> Measurement:
        base, now = behind(k, m._replace(time=0.001 * k)), 0.001 * k
        measured = base.time if stamp is None else now - stamp
        velocity, times = base.base_velocity, {"now": now, "time": now, "base_time": measured}
        return m._replace(base_pose=base.base_pose, base_velocity=velocity, **times)

    return degrade


def inwards(t: float, origin: pin.SE3) -> Reference:
    """A motion by 0.3 m from the side towards the base, within 1.2 s."""
    w, far = np.pi / 1.2, np.array([0.0, -0.15, 0.0, 0.0, 0.0, 0.0])
    if t > 1.2:
        return Reference(
            pin.SE3(origin.rotation, origin.translation + 2.0 * far[:3]), 0 * far, 0 * far
        )
    pose = pin.SE3(origin.rotation, origin.translation + (1.0 - np.cos(w * t)) * far[:3])
    return Reference(pose, w * np.sin(w * t) * far, w**2 * np.cos(w * t) * far)


@pytest.mark.parametrize(("delay", "every"), [(20, 1), (50, 1), (0, 50), (50, 20)])
def test_time_stamp_of_the_odometry_compensates_its_age(run, delay: int, every: int) -> None:
    """Without it, the end-effector deviates by 5 to 11 mm."""
    options = {"start": SIDE, "pull": np.zeros(3), "reference": inwards}
    exact = run(**options)
    found = run(odometry(delay, every), **options)
    assert found.faults == {}
    assert np.linalg.norm(found.ee - exact.ee, axis=1).max() < 0.003


def test_rare_readings_of_the_joints_are_known_with_a_time_stamp_of_the_base_only(run) -> None:
    """The advanced pose of the base differs in each step; a joint reached 12 times its limit."""
    repeat = every_nth(20)

    def degrade(k: int, m: Measurement) -> Measurement:
        return repeat(k, m._replace(base_time=0.001 * k))._replace(now=0.001 * k)

    found = run(degrade, start=SIDE, pull=np.array([-3.0, -25.0, 0.0]))
    assert set(found.faults) == {"repeated"}
    assert found.share < 1.05


def joints(degrade: Degradation, which: Sequence[int] = range(7)) -> Degradation:
    """Change the readings of these joints only."""

    def degraded(k: int, m: Measurement) -> Measurement:
        other, own = degrade(k, m), np.isin(np.arange(7), which)
        return m._replace(
            q_m=np.where(own, other.q_m, m.q_m), qd_m=np.where(own, other.qd_m, m.qd_m)
        )

    return degraded


def base(degrade: Degradation) -> Degradation:
    """Change the readings of the base only."""

    def degraded(k: int, m: Measurement) -> Measurement:
        other = degrade(k, m)
        return m._replace(base_pose=other.base_pose, base_velocity=other.base_velocity)

    return degraded


def without_velocities(k: int, m: Measurement) -> Measurement:
    return m._replace(qd_m=NAN)


SOURCES = {
    "joints at 50 Hz": (lambda: joints(every_nth(20)), {"repeated"}),
    "joints at 30 Hz": (lambda: joints(every_nth(33)), {"repeated"}),
    "joints at 50 Hz without velocities": (
        lambda: both(joints(every_nth(20)), without_velocities),
        {"repeated", "velocity"},
    ),
    "odometry at 50 Hz": (lambda: base(every_nth(20)), set()),
    "odometry at 10 Hz": (lambda: base(every_nth(100)), set()),
    "joints at 50 Hz, odometry at 140 Hz": (
        lambda: both(base(every_nth(7)), joints(every_nth(20))),
        {"repeated"},
    ),
    "joints at 140 Hz, odometry at 50 Hz": (
        lambda: both(base(every_nth(20)), joints(every_nth(7))),
        {"repeated"},
    ),
    "one joint at 100 Hz": (lambda: joints(every_nth(10), [6]), {"repeated"}),
    "three joints at 100 Hz": (lambda: joints(every_nth(10), [4, 5, 6]), {"repeated"}),
    "three joints at 50 Hz": (lambda: joints(every_nth(20), [4, 5, 6]), {"repeated"}),
    "three joints at 100 Hz, the others at 250 Hz": (
        lambda: both(joints(every_nth(10), [4, 5, 6]), joints(every_nth(4), range(4))),
        {"repeated"},
    ),
    "three joints at 100 Hz without velocities": (
        lambda: both(joints(every_nth(10), [4, 5, 6]), without_velocities),
        {"repeated", "velocity"},
    ),
}
"""Readings of which each source has its own rate, and the faults that they cause."""
LATERALLY, BY_REFERENCE = {"start": SIDE, "pull": LATERAL}, {"start": SIDE, "pull": np.zeros(3)}


@pytest.fixture(scope="module")
def undisturbed(run) -> tuple[Run, Run]:
    """The runs LATERALLY and BY_REFERENCE with all readings in each step."""
    return run(**LATERALLY), run(**BY_REFERENCE, reference=wobbling)


@pytest.mark.parametrize("case", SOURCES)
def test_each_source_of_readings_has_its_own_rate(
    run, undisturbed: tuple[Run, Run], case: str
) -> None:
    """Joints reached 2 to 55 times their speed limits, and odometry shifted the base by 8 mm."""
    make, faults = SOURCES[case]
    (pulled, followed), found = undisturbed, run(make(), **LATERALLY)
    assert set(found.faults) == faults
    assert found.share < 1.05
    assert found.nearest > 0.02
    tracked = run(make(), **BY_REFERENCE, reference=wobbling)
    assert set(tracked.faults) == faults
    far = np.linalg.norm(tracked.ee - followed.ee, axis=1).max()
    assert far < (0.035 if "30" in case else 0.012)
    if not faults:
        np.testing.assert_allclose(found.base, pulled.base, atol=2e-3)


@pytest.mark.parametrize("step", [1e-5, 1e-4, 1e-3])
@pytest.mark.parametrize("measured", [True, False], ids=["velocity", "no velocity"])
@pytest.mark.parametrize("drives", [True, False], ids=["base moves", "base rests"])
def test_resting_joints_of_coarse_encoders_are_no_repetition(
    run, step: float, measured: bool, drives: bool
) -> None:
    """The encoders count in units of `step` [rad]; after 0.7 s, a person pulls."""
    before, now = list[Array](), [0]

    def coarse(k: int, m: Measurement) -> Measurement:
        q, now[:] = step * np.round(m.q_m / step), [k]
        before[:] = [*before, q][-2:]
        return m._replace(q_m=q, qd_m=(q - before[0]) / 0.001 if measured else NAN)

    def driven(v: Array) -> Array:
        return v + np.array([0.1, 0.0]) * (drives and now[0] < 600)

    found = run(coarse, pull=lambda k: PULL * (k > 700), driven=driven)
    assert set(found.faults) <= (set() if measured else {"velocity", "repeated"})
    assert found.share < 1.0


@pytest.mark.parametrize("field", ["time", "base_time", "now and time"])
@pytest.mark.parametrize("begin", [EPOCH, 1e5 + 0.123], ids=["UNIX time", "monotonic time"])
def test_time_in_single_precision_is_refused_or_reported_by_its_name(
    run, field: str, begin: float, caplog
) -> None:
    """A float32 resolves 128 s of a UNIX time: all readings seem to be repeated, then stale."""
    fields = field.split(" and ")

    def rounded(k: int, m: Measurement, kind: Callable[[Any], Any] = float) -> Measurement:
        times = dict.fromkeys(["now", "time", *fields], begin + 0.001 * k)
        return m._replace(**times | {each: kind(np.float32(times[each])) for each in fields})

    with pytest.raises(MeasurementError, match=f"{fields[0]} must be a float of 64 bits"):
        run(lambda k, m: rounded(k, m, np.float32), time=0.01)
    found = run(rounded, time=0.4)
    assert not found.faults or f"measurement.{fields[0]} seems to be a float32" in caplog.text
    assert found.faults or found.share < 1.05


@pytest.mark.parametrize(("now", "age"), [(5e9, 1e3), (5e9, 100.0), (7e6, 0.0), (7e7, np.nan)])
def test_clock_in_microseconds_is_no_time_in_single_precision(
    robot: RobotModel, now: float, age: float
) -> None:
    m = ready(robot)._replace(now=now, time=now - age)
    assert ("float32" in rounding(m, 5e-4)) == (age == 100.0)  # the only age that 512 s can explain


def garbage(field: str, value: float) -> Degradation:
    """One absurd entry in the step 300."""

    def degrade(k: int, m: Measurement) -> Measurement:
        at = np.arange(len(getattr(m, field))) == 0
        return m._replace(**{field: np.where(at & (k == 300), value, getattr(m, field))})

    return degrade


@pytest.mark.parametrize("value", [1e9, 1e16, -1.79e308])
@pytest.mark.parametrize(
    ("field", "fault"),
    [
        ("base_pose", "invalid"),
        ("base_velocity", "velocity"),
        ("q_m", "implausible"),
        ("qd_m", "velocity"),
    ],
)
@pytest.mark.parametrize("clock", [False, True], ids=["no clock", "stamps"])
def test_absurd_reading_is_named_and_not_used(
    run, field: str, fault: str, value: float, clock: bool
) -> None:
    """A base pose of 1e16 m gave torques of NaN in all later steps."""
    degrade = garbage(field, value)
    if clock:
        degrade = both(odometry(0, 1), degrade)
    found = run(degrade, time=0.4)
    assert set(found.faults) == {fault}
    assert np.isfinite(found.ee).all()
    assert found.share < 1.0


def test_absurd_first_pose_of_the_base_is_a_missing_pose(run) -> None:
    found = run(lambda k, m: m._replace(base_pose=m.base_pose + 1e16), time=0.2)
    assert set(found.faults) == {"invalid"}


def test_coarse_encoder_with_new_time_stamps_repeats_no_reading(run) -> None:
    """The encoders have 14 bits, and the velocities are means of 20 ms: joints often rest."""
    seen, step = list[Array](), 2.0 * np.pi / 2**14

    def coarse(k: int, m: Measurement) -> Measurement:
        seen[:] = [*seen, step * np.round(m.q_m / step)][-21:]
        velocity = (seen[-1] - seen[0]) / (0.001 * max(len(seen) - 1, 1))
        return m._replace(q_m=seen[-1], qd_m=velocity)

    pull = np.array([-20.0, 5.0, -5.0])
    found = run(stamped(coarse), pull=lambda k: pull * min(max(k / 100 - 3, 0), 1), time=0.7)
    assert found.faults == {}


def test_odometry_that_is_up_to_0_2_s_old_does_not_jump(run) -> None:
    pull = np.array([-20.0, 5.0, -5.0])
    found = run(odometry(100, 100), pull=lambda k: pull * min(max(k / 100 - 3, 0), 1), time=1.1)
    assert found.faults == {}


def test_velocity_of_a_car_with_the_wrong_sign_does_not_run_away(border_data: BorderData) -> None:
    """The model of the car's drive continued from the wrong reading: 8 m/s after 3 s."""
    model = robot_on("car-like")
    loop = ControlLoop(model, border_data)
    q_m = np.array(model.description.arm.ready_position)
    for k in range(900):
        t, v = 0.001 * k, min(0.001 * k, 0.5)
        pose = np.array([0.5 * v * v if v < 0.5 else 0.125 + 0.5 * (t - 0.5), 0.0, 0.0])
        step = loop.step(Measurement(pose, np.array([-v, 0.0]), q_m, 0.0 * q_m, now=t, time=t)).step
        step.v_cmd[:] = 0.5, 0.0
    assert "localisation" in loop.reported
    assert abs(step.base_velocity[0]) < 1.0


@pytest.mark.parametrize("factor", [100.0, np.array([1.0, 57.3])], ids=["cm/s", "deg/s"])
def test_base_velocity_that_contradicts_the_poses_is_not_used(run, factor: Any) -> None:
    """Joints reached 2.2 to 2.9 times their speed limits."""

    def inwards_by_0_3_m(t: float, origin: pin.SE3) -> Reference:
        way, v = min(t / 1.5, 1.0), np.array([0.0, -0.2, 0.0, 0.0, 0.0, 0.0]) * (t < 1.5)
        pose = pin.SE3(origin.rotation, origin.translation + np.array([0.0, -0.3 * way, 0.0]))
        return Reference(pose, v, np.zeros(6))

    found = run(
        lambda k, m: m._replace(base_velocity=factor * m.base_velocity),
        start=SIDE,
        pull=np.zeros(3),
        reference=inwards_by_0_3_m,
        time=1.5,
    )
    assert "localisation" in found.faults
    assert found.share < 1.1
    assert found.nearest > 0.02


@pytest.mark.parametrize("age", [0.3, -0.1])
def test_odometry_that_is_too_old_or_later_than_the_step_is_not_used(run, age: float) -> None:
    found = run(odometry(0, 1, age), time=0.5)
    assert set(found.faults) == {"invalid", "velocity"}
    assert found.share < 1.05


def test_time_in_nanoseconds_is_refused(robot: RobotModel, border_data: BorderData) -> None:
    with pytest.raises(MeasurementError, match="not nanoseconds"):
        ControlLoop(robot, border_data).step(ready(robot)._replace(now=1.7e18, time=1.7e18))


WRONG_VELOCITIES = {
    "zero": lambda qd: 0.0 * qd,
    "opposite": lambda qd: -qd,
    "degrees": lambda qd: 57.3 * qd,
    "rpm": lambda qd: 9.55 * qd,
    "twice": lambda qd: 2.0 * qd,
}


@pytest.mark.parametrize("case", WRONG_VELOCITIES)
def test_a_clock_does_not_hide_wrong_velocities_after_a_rest(run, case: str) -> None:
    change = WRONG_VELOCITIES[case]
    found = run(
        stamped(lambda k, m: m._replace(qd_m=change(m.qd_m))), pull=lambda k: PULL * (k > 150)
    )
    assert "velocity" in found.faults
    assert found.share < 1.05
    assert found.nearest > 0.02


@pytest.mark.parametrize("delay", [5, 10, 20])
def test_delay_before_the_time_stamp_is_estimated_too(run, delay: int) -> None:
    """A driver stamps on sending; without an estimate, a joint reaches 2 to 20 times its limit."""
    behind = late(delay)
    found = run(stamped(lambda k, m: behind(k, m)._replace(time=m.time)))
    assert "lag" in found.faults
    assert found.share < 1.25


def test_delay_before_the_time_stamp_can_be_stated(run) -> None:
    behind = late(15)
    config = Config().changed({"estimate.delay": 0.015})
    found = run(stamped(lambda k, m: behind(k, m)._replace(time=m.time)), config=config)
    assert "lag" not in found.faults
    assert found.share < 1.05


@pytest.mark.parametrize("jitter", [0.0002, 0.0008])
def test_jitter_of_the_clock_changes_nothing(run, jitter: float) -> None:
    """The age is about half a period, so that the rounded age would change in each step."""
    wake = np.random.default_rng(0).uniform(0.0, jitter, 2000)
    found = run(with_age(lambda k: -(0.0005 + wake[k])), pull=FRONTAL)
    early = run(with_age(lambda k: 0.0005 + wake[k] - 0.5 * jitter), pull=FRONTAL)
    assert max(found.share, early.share) < 1.05


@pytest.mark.parametrize("clock", [lambda t: 0.0, lambda t: 0.01 * np.floor(100.0 * t)])
def test_a_coarse_or_resting_clock_does_not_hide_a_wrong_period(run, clock: Any) -> None:
    found = run(lambda k, m: m._replace(now=float(clock(0.001 * k))), stated=0.004)
    assert found.faults["period"] < 0.5
    assert found.share < 1.05
    found = run(lambda k, m: m._replace(now=float(clock(0.001 * k))))
    assert found.faults == {}


def test_driver_that_ends_at_rest_is_reported_by_its_time_stamps(run) -> None:
    last: list[Measurement] = []

    def ended(k: int, m: Measurement) -> Measurement:
        last[:] = last or [m._replace(time=EPOCH)]
        return last[0]._replace(now=EPOCH + 0.001 * k)

    found = run(ended, time=0.3, pull=np.zeros(3))
    assert found.faults["stale"] == pytest.approx(0.1, abs=0.002)


@pytest.mark.parametrize(
    ("dt", "path", "value", "named"),
    [
        (1.0, "", 0.0, "dt must be a float from 0.0001 to 0.02 s"),
        (float("nan"), "", 0.0, "dt must be a float from"),
        (0.008, "task.ee_damping", 150.0, "task.ee_damping = 150"),
        (0.004, "limit.velocity_rate", 200.0, "limit.velocity_rate = 200"),
        (0.02, "", 0.0, "limit.velocity_rate = 70 .*at most 30, or the period at most 8.57 ms"),
        (0.0086, "", 0.0, "limit.velocity_rate = 70 .*at most 69.7, or the period at most 8.57"),
    ],
)
def test_invalid_period_or_too_large_a_gain_for_it_is_refused(
    robot: RobotModel, border_data: BorderData, dt: float, path: str, value: float, named: str
) -> None:
    config = Config().changed({path: value} if path else {})
    with pytest.raises(ConfigError, match=named):
        ControlLoop(robot, border_data, config, dt=dt)
    assert ControlLoop(robot, border_data, dt=0.00857).controller.dt == 0.00857


def test_controller_that_is_refused_is_not_in_use(robot: RobotModel, border_data: BorderData):
    """The measured period can be too long for a gain."""
    controller = ControlLoop(robot, border_data).controller
    controller.dt = 0.02
    with pytest.raises(ConfigError, match=r"limit\.velocity_rate"):
        controller.use("none")
    assert controller.name == "dbb"


@pytest.mark.parametrize("path", ["barrier.d_min", "barrier.rate", "limit.torque_rate"])
@pytest.mark.parametrize("bound", ["low", "high"])
def test_each_bound_of_a_parameter_can_be_set_during_a_pull(run, path: str, bound: str) -> None:
    """At 0.3 s, a pull of 20 N starts to move the arm into the buffer."""
    config, loops = Config().replace(path, getattr(parameter(path), bound)), list[ControlLoop]()

    def configured(k: int, m: Measurement) -> Measurement:
        if k == 300:
            loops[0].configure(config)
        return m

    growing = [min(k / 100, 1.0) * np.array([-20.0, 5.0, -5.0]) for k in range(1500)]
    found = run(configured, time=1.5, created=loops.append, pull=lambda k: growing[max(k - 100, 0)])
    assert (found.share < 1.05, found.nearest > 0.0, found.faults) == (True, True, {})


def test_refused_readings_do_not_use_up_the_reference(
    robot: RobotModel, border_data: BorderData
) -> None:
    loop, m = ControlLoop(robot, border_data), ready(robot)
    start = pin.SE3(pin.XYZQUATToSE3(np.array([0.9, 0.0, 0.8, 1.0, 0.0, 0.0, 0.0])))
    for k in range(4):
        pose = pin.SE3(start.rotation, start.translation + np.array([1e-4 * k, 0.0, 0.0]))
        reference = Reference(pose, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]), np.zeros(6))
        if k == 3:
            with pytest.raises(MeasurementError):
                loop.step(m._replace(q_m=np.zeros(6)), reference)
        loop.step(m, reference)
    assert loop.controller.last.v_ref[0] == pytest.approx(0.1)


def test_joint_states_are_sorted_by_name(robot: RobotModel) -> None:
    names = ["finger", *reversed(robot.description.arm.joints)]
    q, qd = JointOrder(robot, names)(np.arange(8.0), -np.arange(8.0))
    np.testing.assert_array_equal(q, np.arange(7.0, 0.0, -1.0))
    np.testing.assert_array_equal(qd, -q)
    for no_velocity in ((), None):
        assert np.isnan(JointOrder(robot, names)(np.arange(8.0), no_velocity)[1]).all()


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda names: names[1:], "does not name"),
        (lambda names: [*names, names[0]], "more than once"),
        (lambda names: [], "(none)"),
        (lambda names: ["robot1/" + each for each in names], "did you mean 'robot1/"),
        (lambda names: [each.encode() for each in names], "does not name"),
        (lambda names: names[0], "must be a list"),
    ],
)
def test_wrong_joint_names_are_refused_by_name(robot: RobotModel, change, named: str) -> None:
    names = list(robot.description.arm.joints)
    with pytest.raises(MeasurementError, match=names[0]) as error:
        JointOrder(robot, change(names))
    assert named in str(error.value)
    with pytest.raises(MeasurementError, match="must be a list"):
        JointOrder(robot, None)  # type: ignore[arg-type]
    with pytest.raises(MeasurementError, match="must be a list"):
        JointOrder(robot, set(names))  # type: ignore[arg-type]


def test_velocities_are_optional(robot: RobotModel, border_data: BorderData) -> None:
    m = ready(robot)
    for nothing in (None, (), np.empty(0)):
        command = ControlLoop(robot, border_data).step(
            m._replace(base_velocity=nothing, qd_m=nothing)
        )
        assert command.faults == ("velocity",)


def test_damping_of_a_light_joint_is_stable_at_each_period(
    robot: RobotModel, border_data: BorderData
) -> None:
    """A small force turns the last joint, which has an inertia of 4e-5 kg m²."""
    light = RobotModel(robot.description)
    light.pin.inertias[light.pin.njoints - 1] = pin.Inertia(
        0.3, np.array([0.0, 0.0, 0.05]), np.diag([1e-4, 1e-4, 4e-5])
    )
    for dt in (0.001, 0.008):
        loop, plant = ControlLoop(light, border_data, dt=dt), Kinematic(light, dt=dt)
        speeds = []
        for _ in range(40):
            command = loop.step(plant.measure())
            plant.step(command.u_a, command.base_velocity, np.array([0.0, 0.5, 0.0]))
            speeds.append(plant.measure().qd_m[6])
        steps = np.diff(speeds)
        assert (steps[1:] * steps[:-1] > -1e-6).all(), dt  # no alternation


@pytest.fixture(scope="module")
def turned(robot: RobotModel, border_data: BorderData) -> Callable[..., ControlStep]:
    """The last step of a loop whose last joint starts from rest with an acceleration [rad/s²]."""

    def turned(dt: float, acceleration: float, count: int) -> ControlStep:
        loop = ControlLoop(robot, border_data, dt=dt)
        m, turning = ready(robot), np.arange(7) == 6
        for k in range(count):
            t = dt * k
            q, qd = 0.5 * acceleration * t**2, acceleration * t
            loop.step(m._replace(q_m=m.q_m + turning * q, qd_m=turning * qd))
        return loop.controller.last

    return turned


def test_acceleration_from_rest_is_not_reported_as_a_wrong_period(turned) -> None:
    """For a joint that starts from rest, the sum of velocities exceeds the displacement."""
    for count in range(1, 21):
        assert turned(0.008, 4.0, count).ratio in (0.0, 1.0)  # unknown or right


def test_external_force_is_estimated_before_the_noise_is_known(turned) -> None:
    """The noise of the encoders is unknown before 8 readings."""
    assert turned(0.004, 40.0, 7).x_est[2, 6] > 20.0


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda m: None, "was NoneType"),
        (tuple, "was tuple"),
        (lambda m: m._asdict(), "was dict"),
        (lambda m: m._replace(q_m=[str(each) for each in m.q_m]), "q_m"),
        (lambda m: m._replace(q_m=m.q_m[:, None]), "q_m"),
        (lambda m: m._replace(qd_m=1j * m.qd_m), "qd_m"),
        (lambda m: m._replace(base_pose=np.zeros(7)), "base_pose must be 3"),
        (lambda m: m._replace(base_velocity=[[0.0], 0.0]), "base_velocity must be 2"),
        (lambda m: m._replace(drive=[None]), "drive"),
        (lambda m: m._replace(now="12:00"), "now must be seconds"),
        (lambda m: m._replace(time=1.0), "time needs measurement.now"),
        (lambda m: m._replace(base_time=1.0), "base_time needs measurement.now"),
    ],
)
def test_invalid_measurement_is_refused_by_field(
    robot: RobotModel, border_data: BorderData, change, named: str
) -> None:
    loop = ControlLoop(robot, border_data)
    with pytest.raises(MeasurementError, match=named):
        loop.step(change(ready(robot)))


@pytest.mark.parametrize(
    "change",
    [
        lambda a: a.tolist(),
        lambda a: a.astype(">f8"),
        lambda a: np.repeat(a, 2)[::2],
        lambda a: np.ma.masked_array(a, a == 1e20),
        lambda a: np.frombuffer(a.tobytes()),
    ],
)
def test_readings_may_be_any_array_of_numbers(
    robot: RobotModel, border_data: BorderData, change
) -> None:
    good = ready(robot)
    loop, other = ControlLoop(robot, border_data), ControlLoop(robot, border_data)
    command = loop.step(Measurement(*map(change, good[:4])))
    np.testing.assert_array_equal(command.u_a, other.step(good).u_a)
    assert command.faults == ()


@pytest.mark.parametrize("factor", [57.3, -57.3])
def test_positions_in_degrees_are_refused_first_and_reported_later(
    robot: RobotModel, border_data: BorderData, factor: float
) -> None:
    good = ready(robot)
    bad = good._replace(q_m=factor * good.q_m)
    loop = ControlLoop(robot, border_data)
    with pytest.raises(MeasurementError, match="radians"):
        loop.step(bad)
    loop.step(good)
    command = loop.step(bad)
    assert command.faults == ("implausible",)
    assert np.isfinite(command.u_a).all()


def test_positions_that_become_degrees_stay_implausible_and_lead_to_the_fallback(
    robot: RobotModel, border_data: BorderData
) -> None:
    """They lie many turns beyond the limits, so no full turns are subtracted from them."""
    good = ready(robot)
    loop = ControlLoop(robot, border_data)
    for k in range(300):
        creep = np.full(7, 1e-5 * max(k - 10, 0))
        read = good.q_m + creep if k < 10 else np.rad2deg(good.q_m + creep)
        faults = loop.step(good._replace(q_m=read)).faults
        assert ("implausible" in faults) == (k >= 10), k
        assert "jump" not in faults
    assert "stale" in faults


def reordered(order: Sequence[int], begin: int = 0) -> Degradation:
    return starting_at(lambda _, m: m._replace(q_m=m.q_m[order], qd_m=m.qd_m[order]), begin)


def wobbling(t: float, origin: pin.SE3, far: float = 0.1, rate: float = 2.0) -> Reference:
    """A sinusoidal motion of `far` [m] to each side, with the angular frequency `rate` [rad/s]."""
    pose, v, a, s = origin.copy(), np.zeros(6), np.zeros(6), far * np.sin(rate * t)
    pose.translation = origin.translation + np.array([0.0, s, 0.0])
    v[1], a[1] = far * rate * np.cos(rate * t), -(rate**2) * s
    return Reference(pose, v, a)


SIGNS = np.array([1.0, 1.0, -1.0, 1.0, 1.0, 1.0, 1.0])


@pytest.mark.parametrize(
    ("degrade", "latest"),
    [
        (reordered([2, 1, 0, 3, 4, 5, 6]), 0.3),
        (reordered([0, 1, 2, 3, 6, 5, 4], 500), 0.7),
        (reordered([6, 5, 4, 3, 2, 1, 0]), 0.3),
        (lambda _, m: m._replace(q_m=SIGNS * m.q_m, qd_m=SIGNS * m.qd_m), 0.6),
        (late(30), 0.4),
        (late(50), 0.3),
    ],
)
def test_readings_that_contradict_the_torques_lead_to_the_fallback_until_reset(
    run, degrade: Degradation, latest: float
) -> None:
    loops: list[ControlLoop] = []
    found = run(degrade, reference=wobbling, pull=np.zeros(3), created=loops.append)
    assert found.faults["contradictory"] < latest
    last = loops[0].controller.last
    assert not last.solved
    assert np.abs(last.qd[2:]).max() == 0.0  # no damping by wrong speeds
    for k in range(300):  # right readings of an arm at rest change nothing
        command = loops[0].step(found.sent._replace(qd_m=np.full(7, 1e-9 * k)))
        assert "contradictory" in command.faults
    loops[0].reset()
    command = loops[0].step(found.sent._replace(qd_m=np.zeros(7)))
    assert "contradictory" not in command.faults
    assert command.step.solved


def test_friction_does_not_contradict_the_torques(
    robot: RobotModel, border_data: BorderData, starts
) -> None:
    loop, plant = ControlLoop(robot, border_data, dt=0.008), WithFriction(robot)
    seen = RobotState(robot)
    plant.reset(np.zeros(3), starts[SIDE])
    seen.update_kinematics(plant.measure())
    origin = seen.T_world_ee.copy()
    for k in range(2000):
        if k % 8 == 0:
            reference = wobbling(0.001 * k, origin, 0.05, 2.0 * np.pi)
            command = loop.step(plant.measure(), reference)
            assert "contradictory" not in command.faults
        plant.step(command.u_a, np.zeros(2), np.zeros(3))


@pytest.mark.parametrize("stiffness", [3e3, 1e5])
def test_arm_that_a_contact_holds_does_not_contradict_the_torques(
    robot: RobotModel, border_data: BorderData, starts, stiffness: float
) -> None:
    """The reference moves away from a place where a stiff spring holds the end-effector."""
    loop, plant, seen = ControlLoop(robot, border_data), Kinematic(robot), RobotState(robot)
    plant.reset(np.zeros(3), starts[SIDE])
    seen.update_kinematics(plant.measure())
    origin, last, furthest = seen.T_world_ee.copy(), seen.p_ee.copy(), 0.0
    for k in range(1500):
        measured = plant.measure()
        seen.update_kinematics(measured)
        v, last = (seen.p_ee - last) / 0.001, seen.p_ee.copy()
        furthest = max(furthest, float(np.linalg.norm(seen.p_ee - origin.translation)))
        command = loop.step(measured, wobbling(0.001 * k, origin))
        assert "contradictory" not in command.faults
        force = stiffness * (origin.translation - seen.p_ee) - 2.0 * np.sqrt(stiffness) * v
        plant.step(command.u_a, np.zeros(2), force)
    assert furthest < 0.05


SHEARED = np.array([[1.0, 0.01, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


def turning(value: float) -> Array:
    return np.array([0.0, 0.0, 0.0, 0.0, 0.0, value])


@pytest.mark.parametrize(
    ("reference", "named"),
    [
        (np.eye(4), "Reference"),
        (Reference(np.eye(4), np.zeros(6), np.zeros(6)), "pose"),  # type: ignore[arg-type]
        (Reference(pin.SE3.Identity(), np.zeros(3), np.zeros(6)), "velocity"),
        (Reference(pin.SE3.Identity(), np.zeros(6), None), "acceleration"),  # type: ignore[arg-type]
        (Reference(pin.SE3.Identity(), np.full(6, np.nan), np.zeros(6)), "finite"),
        (Reference(pin.SE3(2 * np.eye(3), np.zeros(3)), np.zeros(6), np.zeros(6)), "rotation"),
        (Reference(pin.SE3(-np.eye(3), np.zeros(3)), np.zeros(6), np.zeros(6)), "rotation"),
        (Reference(pin.SE3(np.zeros((3, 3)), np.zeros(3)), np.zeros(6), np.zeros(6)), "rotation"),
        (Reference(pin.SE3(SHEARED, np.zeros(3)), np.zeros(6), np.zeros(6)), "rotation"),
        (Reference(pin.SE3.Identity(), np.full(6, 4.0), np.zeros(6)), r"velocity\[0\]: 4 .* mm/s"),
        (
            Reference(pin.SE3.Identity(), turning(-10.0), np.zeros(6)),
            r"velocity\[5\]: -10 .* deg/s",
        ),
        (Reference(pin.SE3.Identity(), np.zeros(6), turning(200.0)), r"on\[5\]: 200 .* deg/s²"),
        (Reference(pin.SE3.Identity(), ["0"] * 6, np.zeros(6)), "velocity"),  # type: ignore[arg-type]
    ],
)
def test_invalid_reference_is_refused_by_field(
    robot: RobotModel, border_data: BorderData, reference: Any, named: str
) -> None:
    loop = ControlLoop(robot, border_data)
    with pytest.raises(MeasurementError, match=named):
        loop.step(ready(robot), reference)


def sampled(rate: float, jitter: float) -> Callable[[float, pin.SE3], Reference]:
    """A reference at 0.1 m/s along -y, sampled at a rate [Hz] with a jitter [s]."""
    rng = np.random.default_rng(0)
    times = np.cumsum(1.0 / rate + rng.uniform(-jitter, jitter, 200))
    last: list[Any] = [-1, None]

    def reference(t: float, origin: pin.SE3) -> Reference:
        number = int(np.searchsorted(times, t + 1e-9, side="right"))
        if number != last[0]:
            pose = origin.copy()
            pose.translation = origin.translation + t * np.array([0.0, -0.1, 0.0])
            last[:] = number, Reference(pose, np.zeros(6), np.zeros(6))
        return last[1]

    return reference


def jerk(ee: Array) -> float:
    """[m/s³] largest jerk in the second half of a path at 1 kHz, smoothed over 5 ms."""
    a = np.apply_along_axis(lambda x: np.convolve(x, np.ones(5) / 5, "same"), 0, ee)
    late = np.diff(a, n=3, axis=0)[len(ee) // 2 : -10]
    return float(np.linalg.norm(late, axis=1).max()) / 1e-9


@pytest.mark.parametrize(("rate", "jitter"), [(30.0, 0.0), (10.0, 0.0), (10.0, 0.03)])
def test_interpolation_smooths_the_motion_to_sampled_references(
    run, rate: float, jitter: float
) -> None:
    options = {"start": SIDE, "pull": np.zeros(3), "time": 1.6}
    smooth = run(reference=sampled(rate, jitter), **options)
    raw = run(reference=sampled(rate, jitter), interpolate=False, **options)
    assert jerk(smooth.ee) < 0.15 * jerk(raw.ee)
    lag = (smooth.ee[-1] - smooth.ee[0])[1] + 0.1 * 1.6
    assert 0.0 < lag < 0.1 * 2.5 / rate + 0.01


IN_STEPS: dict[str, Callable[[float], tuple[float, ...]]] = {
    "leaps at 100 Hz": lambda t: (0.3 * (int(100 * t) % 2), 0.0),
    "an outlier each 0.2 s": lambda t: (0.3 * (round(1000 * t) % 200 == 100), 0.0),
    "noise": lambda t: (0.15 + 0.002 * np.sin(1e7 * t), 0.0),
    "a leap": lambda t: (0.3 * (t > 0.1), 0.0),
    "a motion at 2 m/s without a velocity": lambda t: (min(2.0 * t, 0.3), 0.0),
    "velocities against the motion": lambda t: (0.1 * t, -0.1),
    "a velocity without a motion": lambda t: (0.0, 3.0 * (t > 0.0)),
    "only the first reference has a velocity": lambda t: (0.02 * t, 3.0 * (t == 0.0)),
    "velocities in mm/s": lambda t: (0.003 * t, 3.0),
    "an acceleration without a change of velocity": lambda t: (0.1 * t, 0.1, 60.0),
    "poses without velocities": lambda t: (0.1 * t, 0.0),
    "poses without velocities, with noise": lambda t: (0.1 * t + 1e-4 * np.sin(1e7 * t), 0.0),
}


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.004])
@pytest.mark.parametrize("case", IN_STEPS)
def test_faulty_references_cause_no_fast_or_far_motion(
    robot: RobotModel, border_data: BorderData, case: str, dt: float
) -> None:
    """A case states position (0 to 0.3 m), velocity and perhaps acceleration along y."""
    loop, m = ControlLoop(robot, border_data, dt=dt), at_rest(robot, NAN)
    m = m._replace(q_m=np.array(robot.description.arm.ready_position))
    loop.step(m)
    start, ways = loop.controller.state.T_world_ee.copy(), []
    for k in range(round(0.6 / dt)):
        y, v, a = (*IN_STEPS[case](dt * k), 0.0)[:3]
        pose = pin.SE3(start.rotation, start.translation + np.array([0.0, y, 0.0]))
        loop.step(m, Reference(pose, np.eye(6)[1] * v, np.eye(6)[1] * a))
        w = loop.controller.last
        ways.append([w.x_ref[3, 1] - start.translation[1], w.v_ref[1], w.a_ref[1]])
    way, speed, acceleration = np.array(ways[1:]).T  # the first reference is used unchanged
    assert way.min() > -0.01
    assert way.max() < 0.31
    assert np.abs(speed).max() < 1.05 * Config().task.ee_speed
    assert np.abs(np.diff(way)).max() < 1.05 * dt * Config().task.ee_speed
    assert np.abs(acceleration).max() < 50.0


def still(t: float, origin: pin.SE3) -> Reference:
    return Reference(origin, np.zeros(6), np.zeros(6))


def blind(first: int, last: int, field: str) -> Degradation:
    def degrade(k: int, m: Measurement) -> Measurement:
        return m._replace(**{field: np.nan * getattr(m, field)}) if first <= k < last else m

    return degrade


def relocated(k: int, m: Measurement) -> Measurement:
    return m._replace(base_pose=m.base_pose + 0.1 * (k > 300))


EVENTS = {
    "no pose for 0.2 s": (blind(300, 500, "base_pose"), "invalid", 0.3),
    "no positions for 0.2 s": (blind(300, 500, "q_m"), "invalid", 0.3),
    "no base velocity for 0.2 s": (blind(300, 500, "base_velocity"), "velocity", 0.3),
    "localisation jumps": (relocated, "localisation", 0.8),  # the end-effector moves by 0.1 m
}


@pytest.mark.parametrize("case", EVENTS)
def test_event_is_reported_and_causes_no_jump(run, case: str) -> None:
    degrade, fault, most = EVENTS[case]
    found = run(degrade, start=SIDE, pull=np.zeros(3), reference=still)
    assert found.faults[fault] <= 0.5
    assert found.share < most
    assert np.linalg.norm(np.diff(found.ee, axis=0), axis=1).max() < 0.0006  # 0.6 m/s


@pytest.mark.parametrize("called", [True, False])
def test_arm_continues_after_a_protective_stop_without_a_jump(
    robot: RobotModel, border_data: BorderData, starts, called: bool
) -> None:
    """The readings freeze for 0.25 s, and the arm is moved before they continue."""
    loop, plant = ControlLoop(robot, border_data), Kinematic(robot)
    plant.reset(np.zeros(3), starts[SIDE])
    state = RobotState(robot)
    state.update_kinematics(plant.measure())
    stay = still(0.0, state.T_world_ee.copy())
    fastest = 0.0
    for k in range(1200):
        if k == 300:
            plant.reset(np.zeros(3), starts[SIDE] + 0.2)
            if called:
                loop.reset()
        frozen = at_rest(robot, starts[SIDE]) if 50 <= k < 300 else plant.measure()
        command = loop.step(frozen, stay)
        if not 50 <= k < 300:
            plant.step(command.u_a, command.base_velocity, np.zeros(3))
            fastest = max(fastest, float((np.abs(plant.measure().qd_m) / robot.qd_max).max()))
    assert fastest < 0.5


@pytest.mark.parametrize("turns", [-2.0 * np.pi, 2.0 * np.pi])
def test_wrapped_joint_angle_causes_no_jump(
    robot: RobotModel, border_data: BorderData, turns: float
) -> None:
    """The joint's limits exceed half a turn, and its driver wraps the angle."""
    wide = RobotModel(robot.description)
    wide.q_lower[6], wide.q_upper[6] = -9.0, 9.0
    wide.q_limits[:, 6] = -9.0, 9.0
    q, speed = np.array(robot.description.arm.ready_position), 0.5 * np.sign(turns)
    q[6] = np.pi * np.sign(turns) - 0.05 * np.sign(turns)
    loop = ControlLoop(wide, border_data)
    for k in range(300):
        angle = q[6] + 0.001 * k * speed
        wrapped = np.append(q[:6], np.angle(np.exp(1j * angle)))
        m = at_rest(wide, wrapped)._replace(qd_m=np.append(np.zeros(6), speed))
        command = loop.step(m)
        assert "jump" not in command.faults
    assert float(command.step.q_m[6]) == pytest.approx(angle, abs=1e-3)


def test_load_is_estimated_reported_and_compensated_if_configured(
    robot: RobotModel, border_data: BorderData
) -> None:
    mass, ready = 2.0, np.array(robot.description.arm.ready_position)
    fell = {}
    for stated in (False, True):
        loop, plant, seen = ControlLoop(robot, border_data), Kinematic(robot), RobotState(robot)
        if stated:
            loop.configure(Config().changed({"payload.mass": mass}))
        plant.reset(np.zeros(3), ready)
        faults, load = set(), []
        carried = PointLoad(robot, mass, np.zeros(3), plant.dt)
        for _ in range(300):
            seen.update_kinematics(plant.measure())
            command = loop.step(plant.measure())
            faults |= set(command.faults)
            load.append(command.load)
            push = carried.push(seen)
            plant.step(command.u_a, command.base_velocity, push.force)
        seen.update_kinematics(plant.measure())
        fell[stated] = float(seen.p_ee[2])
        assert ("load" in faults) != stated
        assert load[150] == pytest.approx(0.0 if stated else mass, abs=0.3)
    seen.update_kinematics(at_rest(robot, ready))
    assert seen.p_ee[2] - fell[True] < 0.005 < seen.p_ee[2] - fell[False]


def test_downward_pull_of_a_person_is_not_reported_as_a_load(
    robot: RobotModel, border_data: BorderData
) -> None:
    """A spring of at most 40 N whose lower end moves down at 0.3 m/s."""
    loop, plant, seen = ControlLoop(robot, border_data), Kinematic(robot), RobotState(robot)
    plant.reset(np.zeros(3), np.array(robot.description.arm.ready_position))
    seen.update_kinematics(plant.measure())
    origin, felt = float(seen.p_ee[2]), 0.0
    for k in range(600):
        seen.update_kinematics(plant.measure())
        pull = min(max(300.0 * (seen.p_ee[2] - origin + 0.0003 * k), 0.0), 40.0)
        command = loop.step(plant.measure())
        assert "load" not in command.faults
        felt = max(felt, command.load)
        plant.step(command.u_a, command.base_velocity, np.array([0.0, 0.0, -pull]))
    assert felt > 0.5


GRAVITY = np.array([0.0, 0.0, -9.81])
SINKS = np.array([1.0, 0.5, -4.0])  # [m/s²] acceleration of the end-effector


FORCES: dict[str, tuple[Callable[[float], tuple[float, float, float]], float]] = {
    "a load from one reading to the next": (lambda t: (0, 0, -20 * (t > 0.05)), 2.0),
    "a load that is set down within 10 ms": (lambda t: (0, 0, -2000 * min(t, 0.01)), 2.0),
    "a load while a person pulls": (lambda t: (20, 10 - 60 * t, 5 - 20 * (t > 0.1)), 2.0),
    "a stated load that is lost": (lambda t: (0, 0, 20 * (t > 0.05)), -2.0),
    "a load that accelerates": (lambda t: tuple(2 * (GRAVITY - SINKS) * (t > 0.05)), 2.0),
    "a spring up to 40 N": (lambda t: (0, 0, -min(200 * t, 40)), 0.0),
    "a pull that turns down": (lambda t: (max(20 - 60 * t, 2), 0, -20), 0.0),
    "a pull that grows within 0.1 s": (lambda t: (0, 0, -20 * min(max(10 * t - 1, 0), 1)), 0.0),
    "a pull that grows, then stays": (lambda t: (0, 0, -min(3 + 60 * t, 20)), 0.0),
    "a pull that was there before": (lambda t: (20 * (t < 0.1), 0, -20), 0.0),
    "a sudden sideways pull": (lambda t: (20 * (t > 0.05), 0, 0), 0.0),
    "a push upwards against friction": (lambda t: (0, 0, 10 * (t > 0.05) - 16 * (t > 0.25)), 0.0),
}


@pytest.mark.parametrize("case", FORCES)
def test_only_a_sudden_weight_is_a_load(case: str, monkeypatch: pytest.MonkeyPatch) -> None:
    force, mass = FORCES[case]
    sinks = SINKS if case == "a load that accelerates" else np.zeros(3)
    J = np.random.default_rng(0).normal(size=(3, 7))
    w = SimpleNamespace(g=np.zeros(9), q_m=np.zeros(7), M=np.eye(9), J_ee=np.zeros((6, 9)))
    w.J_ee[:3, 2:], w.x_est, w.v_ee, w.v_tip = J, np.zeros((3, 7)), np.zeros(6), np.zeros(3)
    w.load, w.loaded, w.torques_age = np.zeros(()), np.zeros(()), np.zeros(())
    w.samples, w.torques, w.P_est = np.array(100.0), np.zeros((8, 7)), np.zeros((7, 3, 3))
    w.lifts, w.blind_time, w.known = np.zeros((8, 7)), np.array(0.001), np.array(100.0)
    w.unstated = np.zeros(())
    gains = SimpleNamespace(dt=0.001, payload_mass=max(-mass, 0.0))
    w.corrected = w.lag = w.stated_lag = np.zeros(())
    judge = estimate._judge_load
    monkeypatch.setattr(estimate, "_judge_load", getattr(judge, "py_func", judge))
    take = getattr(estimate.estimate_load, "py_func", estimate.estimate_load)
    reported = []
    for k in range(400):
        w.x_est[2] = J.T @ force(0.001 * k)
        w.v_ee[:3] += 0.001 * sinks * (k > 50)
        take(gains, w, 0.001, False)
        reported.append(float(w.unstated))
    first = next((each for each in reported if each != 0.0), 0.0)
    assert first == pytest.approx(mass, rel=0.06)


def test_command_reports_its_gravity_torques(robot: RobotModel, border_data: BorderData) -> None:
    ready = np.array(robot.description.arm.ready_position)
    command = ControlLoop(robot, border_data).step(at_rest(robot, ready))
    np.testing.assert_allclose(command.u_a, command.gravity, atol=1e-6)


@pytest.mark.parametrize("copied", [copy.deepcopy, lambda each: pickle.loads(pickle.dumps(each))])
def test_copied_command_does_not_change(robot: RobotModel, border_data: BorderData, copied) -> None:
    loop, m = ControlLoop(robot, border_data), ready(robot)
    command = loop.step(m._replace(qd_m=NAN))
    record, gravity = copied(command), command.gravity
    loop.step(m._replace(q_m=m.q_m + 0.004))
    assert (record.faults, command.faults) == (("velocity",), ())
    np.testing.assert_array_equal(record.gravity, gravity)
    assert np.abs(command.gravity - gravity).max() > 0.01
    for step in (record.step, record.step.copy()):
        assert np.shares_memory(step.memory, step.q_m)
        np.testing.assert_array_equal(step.q_m, m.q_m)


def test_jump_of_the_positions_resets_the_posture(
    robot: RobotModel, border_data: BorderData
) -> None:
    """An example is a driver that sends zeros until it is ready."""
    good = ready(robot)
    loop = ControlLoop(robot, border_data)
    for _ in range(3):
        loop.step(good._replace(q_m=np.zeros(7)))
    assert loop.step(good).faults == ("jump",)
    np.testing.assert_array_equal(loop.controller.last.q_posture, good.q_m)


@pytest.mark.parametrize("steps", [105, 126, 140, 1000])
def test_jump_after_any_time_at_rest_resets_the_posture(
    robot: RobotModel, border_data: BorderData, steps: int
) -> None:
    good = ready(robot)
    loop = ControlLoop(robot, border_data)
    for _ in range(steps):
        loop.step(good)
    far = good._replace(q_m=good.q_m + 0.35)
    assert "jump" in loop.step(far).faults
    np.testing.assert_array_equal(loop.controller.last.q_posture, far.q_m)
    for _ in range(20):
        loop.step(far)
        assert np.abs(loop.controller.last.qd_m).max() < 0.05


def test_start_of_a_resting_arm_with_a_slow_driver_is_no_jump(
    robot: RobotModel, border_data: BorderData
) -> None:
    """The driver sends at 20 Hz; the last joint then accelerates by 22 rad/s²."""
    good = ready(robot)
    loop, last = ControlLoop(robot, border_data), np.eye(7)[6]
    for k in range(500):
        t = 1e-3 * max(k // 50 * 50 - 300, 0)
        moved = good.q_m + 11.0 * min(t, 0.1) ** 2 * last
        read = good._replace(q_m=moved, qd_m=22.0 * t * last if t <= 0.1 else good.qd_m)
        assert "jump" not in loop.step(read).faults, k


class Tensor:
    """A tensor whose conversion raises an exception of its own, as one that requires a gradient."""

    def __array__(self, *_: Any, **__: Any) -> Array:
        raise RuntimeError("can't call numpy()")

    def __repr__(self) -> str:
        raise RuntimeError("no text")


STAMP = SimpleNamespace(sec=5, nanosec=7)
TIMES = (np.timedelta64(1, "ms"), datetime(2026, 1, 1), STAMP, "0.001", [0.001], True, Tensor())
SECONDS = "must be seconds as a float, was"
WRONG_ARGUMENTS = [
    *(("dt", value, "dt must be a float from") for value in (*TIMES, None, 10**400)),
    *(("interpolate", value, "interpolate must be True or False") for value in ("no", None, 1)),
    *(("name", value, "unknown controller") for value in (None, 3, np.zeros(2), Tensor())),
    *(("use", value, "unknown controller") for value in (None, 3, ["dbb"])),
    *(("model", value, "model must be a RobotModel") for value in (None, "husky_panda")),
    *(("data", value, "data must be a BorderData") for value in (Config(), {})),
    *(("config", value, "config must be a Config") for value in ({"border.d_b": 0.1}, "my.toml")),
    *(("configure", value, "config must be a Config") for value in (None, {"border.d_b": 0.1})),
    *(("now", value, f"measurement.now {SECONDS}") for value in (*TIMES, 10**400)),
    ("time", STAMP, rf"measurement.time {SECONDS} namespace\(sec=5, nanosec=7\)"),
    ("now", 1.7e18, r"measurement.now must be seconds, not nanoseconds, was 1.7e\+18"),
    ("q_m", Tensor(), r"measurement.q_m must be 7 numbers, was a Tensor .*\(can't call numpy"),
    ("qd_m", list(range(9999)), r"measurement.qd_m must be 7 numbers, was \[0, 1, [0-9, ]*…"),
    ("velocity", Tensor(), "reference.velocity must be 6 numbers"),
    ("acceleration", np.full(6, np.inf), "reference.acceleration must be finite numbers"),
    ("base_acceleration", np.zeros(3), "base_acceleration must be 2 numbers, was"),
    ("base_acceleration", [np.nan, 0.0], r"base_acceleration must be finite numbers, was \[nan"),
    ("base_acceleration", Tensor(), "base_acceleration must be 2 numbers, was"),
    ("joint_order", np.array("joint"), "must be a list of the driver's joints"),
]


@pytest.mark.parametrize(
    ("argument", "value", "named"), WRONG_ARGUMENTS, ids=[f"{a}-{n}" for a, _, n in WRONG_ARGUMENTS]
)
def test_wrong_argument_has_one_error_that_names_it(
    robot: RobotModel, border_data: BorderData, argument: str, value: Any, named: str
) -> None:
    loop, given = ControlLoop(robot, border_data), {argument: value}
    m = ready(robot)._replace(now=1.0)
    rest = Reference(pin.SE3.Identity(), np.zeros(6), np.zeros(6))
    arguments = {"model": robot, "data": border_data} | given
    calls: tuple[Callable[[], Any], ...] = {
        "use": (lambda: loop.controller.use(value),),
        "configure": (lambda: loop.configure(value),),
        "joint_order": (lambda: loop.joint_order(value),),
        "base_acceleration": (lambda: loop.controller.step(m, **given),),
        **dict.fromkeys(Reference._fields, (lambda: loop.step(m, rest._replace(**given)),)),
        **dict.fromkeys(Measurement._fields, (lambda: loop.step(m._replace(**given)),)),
    }.get(argument, (lambda: ControlLoop(**arguments), lambda: Controller(**arguments)))
    for call in calls:
        with pytest.raises((ConfigError, MeasurementError, UnknownNameError), match=named) as error:
            call()
        assert len(str(error.value)) < 250


@pytest.mark.parametrize("copied", [copy.deepcopy, pickle.dumps])
def test_loop_refuses_to_be_copied(robot: RobotModel, border_data: BorderData, copied) -> None:
    with pytest.raises(ConfigError, match="create one in each process"):
        copied(ControlLoop(robot, border_data))


def test_load_is_set_atomically(robot: RobotModel) -> None:
    """A step in another thread never uses a partly set load."""
    masses = []

    class Watched(RobotState):
        def __setattr__(self, name: str, value: Any) -> None:
            if name == "pin":
                masses.append(sum(each.mass for each in value.inertias))
            super().__setattr__(name, value)

    state = Watched(robot)
    for mass in (2.0, 3.0):
        state.carry(mass, (0.0, 0.0, 0.1))
    np.testing.assert_allclose(np.diff(masses), (2.0, 1.0))


def test_a_fault_is_logged_once(robot: RobotModel, border_data: BorderData, caplog) -> None:
    loop = ControlLoop(robot, border_data)
    m = ready(robot)._replace(qd_m=NAN)
    for _ in range(5):
        loop.step(m)
    assert [r.levelname for r in caplog.records] == ["WARNING"]
    assert "velocity" in caplog.text


def test_wrong_predictions_do_not_throw_the_arm(run) -> None:
    """However wrong the predictions of the speeds were, the arm moves away slowly."""
    loops: list[ControlLoop] = []

    def distrust(k: int, m: Measurement) -> Measurement:
        loops[0].controller.last.v_error[:] = 10.0
        return m

    found = run(distrust, time=0.5, created=loops.append)
    assert found.share < 1.05


def test_stated_age_of_the_readings_can_change(robot: RobotModel, border_data: BorderData) -> None:
    at = ready(robot)
    loop = ControlLoop(robot, border_data)
    for delay in (0.0, 0.004, 0.002):
        loop.configure(Config.model_validate({"estimate": {"delay": delay}}))
        step = loop.step(at).step
        assert step.lag == round(delay / 0.001)
        assert not loop.reported


def reports_of_a_load(
    robot: RobotModel,
    data: BorderData,
    begins: int,
    ends: int,
    stated_at: int | None = None,
    noise: float = 0.0,
) -> list[float]:
    """The reported mass [kg] in each of 500 steps; 2 kg act from step `begins` to `ends`.

    `noise` [rad] is the standard deviation of the noise of the positions.
    """
    ready, state = np.array(robot.description.arm.ready_position), RobotState(robot)
    state.update_kinematics(at_rest(robot, ready))
    still = Reference(state.T_world_ee.copy(), np.zeros(6), np.zeros(6))
    loop, plant = ControlLoop(robot, data), Kinematic(robot)
    plant.reset(np.zeros(3), ready)
    carried, reported = PointLoad(robot, 2.0, np.zeros(3), plant.dt), []
    sensors = Disturbances(DisturbanceConfig(encoder_noise=noise), plant.dt, 0)
    for k in range(500):
        if k == stated_at:
            loop.configure(Config().changed({"payload.mass": 2.0}))
        state.update_kinematics(plant.measure())
        command = loop.step(sensors.sensed(plant.measure()), still)
        reported.append(command.load if "load" in command.faults else 0.0)
        force = carried.push(state).force if begins <= k < ends else np.zeros(3)
        plant.step(command.u_a, command.base_velocity, force)
    return reported


@pytest.mark.parametrize("begins", range(200, 220, 4))
def test_a_load_counts_once_whenever_it_begins(
    robot: RobotModel, border_data: BorderData, begins: int
) -> None:
    """The instant within an interval of the estimate does not matter; the end is no lost load."""
    reported = reports_of_a_load(robot, border_data, begins, 400)
    assert not np.any(reported[:begins])
    assert reported[begins + 100 : 400] == pytest.approx([2.0] * (300 - begins), rel=0.04)
    assert min(reported) == 0.0 == max(reported[490:]), "its end is no lost payload"


@pytest.mark.parametrize("noise", [1e-4, 2e-4])
def test_noise_does_not_hide_a_load(
    robot: RobotModel, border_data: BorderData, noise: float
) -> None:
    reported = reports_of_a_load(robot, border_data, 250, 500, noise=noise)
    assert not np.any(reported[:250])
    assert reported[350:] == pytest.approx([2.0] * 150, rel=0.25)


@pytest.mark.parametrize("stated_at", [150, 200, 230, 300])
def test_a_load_is_not_reported_if_it_is_stated(
    robot: RobotModel, border_data: BorderData, stated_at: int
) -> None:
    """The load begins at 0.2 s; the report has the difference of load and stated mass."""
    reported = reports_of_a_load(robot, border_data, 200, 500, stated_at)
    assert not np.any(reported[max(stated_at, 200) + 100 :])
    assert np.abs(reported).max() < 2.2


@pytest.mark.parametrize(
    ("noise", "every", "longest"),
    [(0.0, 1, 0.05), (0.01, 50, 0.25), (0.0005, 1, 0.005)],
    ids=["one jump", "noise at 20 Hz", "noise at 1 kHz"],
)
def test_jumps_of_the_base_pose_do_not_shake_the_arm(
    robot: RobotModel, run, noise: float, every: int, longest: float
) -> None:
    """One jump by 4 cm, or noise of the base's pose, gives steps of the error of T_2.

    Args:
        robot: The robot.
        run: Runs a loop.
        noise: [m] standard deviation of the noise of the base's pose; 0 for one jump.
        every: Number of control steps for which each random error of the pose lasts.
        longest: [m] upper bound of the end-effector's path.
    """
    rng, pose = np.random.default_rng(0), [np.zeros(3)]

    def degrade(k: int, m: Measurement) -> Measurement:
        if noise > 0.0 and k % every == 0:
            pose[0] = noise * rng.normal(size=3) * [1.0, 1.0, 0.3]
        elif noise == 0.0 and k == 500:
            pose[0] = np.array([0.04, 0.0, 0.0])
        return m._replace(base_pose=m.base_pose + pose[0])

    def still(t: float, origin: pin.SE3) -> Reference:
        return Reference(origin, np.zeros(6), np.zeros(6))

    ready = np.array(robot.description.arm.ready_position)
    found = run(degrade, start=ready, reference=still, pull=np.zeros(3))
    way = float(np.linalg.norm(np.diff(found.ee[500:], axis=0), axis=1).sum())
    assert way < longest
    assert found.share < 1.0


@pytest.mark.parametrize("odometry", [1, 200], ids=["1 kHz", "5 Hz"])
@pytest.mark.parametrize("gap", [400, 800])
@pytest.mark.parametrize("measured", [True, False], ids=["velocity", "no velocity"])
def test_motion_of_the_base_in_a_gap_is_no_jump_of_its_pose(
    robot: RobotModel, run, odometry: int, gap: int, measured: bool
) -> None:
    """While the end-effector moves forward by 0.5 m, there are no joint positions for a while."""
    repeat = odometry_every_nth(odometry)

    def degrade(k: int, m: Measurement) -> Measurement:
        m = repeat(k, m)
        m = m if measured else m._replace(base_velocity=NAN[:2])
        return m._replace(q_m=NAN) if 900 <= k < 900 + gap else m

    def forward(t: float, origin: pin.SE3) -> Reference:
        w, pose, v = 2.2, pin.SE3(origin), np.zeros(6)
        pose.translation = origin.translation + np.array([0.25 * (1 - np.cos(w * t)), 0.0, 0.0])
        v[0] = 0.25 * w * np.sin(w * t)
        return Reference(pose, v, np.zeros(6))

    ready = np.array(robot.description.arm.ready_position)
    found = run(degrade, start=ready, reference=forward, pull=np.zeros(3), time=2.2)
    assert set(found.faults) - {"velocity"} == {"invalid", "stale"}
    assert ("velocity" in found.faults) != measured


class WithFriction(Kinematic):
    """A plant whose joints have dry friction [N m], which its model does not contain."""

    friction = 2.95

    def step(self, u_a: Array, base_command: Array, *forces: Any) -> None:
        state, dt = RobotState(self._model), self.dt
        state.update(self.measure())
        inverse = np.linalg.inv(state.M[2:, 2:])
        free = self._qd + dt * inverse @ (u_a - state.h[2:])
        impulse, largest = np.zeros(7), dt * self.friction
        for _ in range(30):  # up to its limit, friction stops each joint
            for i in range(7):
                impulse[i] -= (free[i] + inverse[i] @ impulse) / inverse[i, i]
                impulse[i] = np.clip(impulse[i], -largest, largest)
        super().step(u_a + impulse / dt, base_command, *forces)


@pytest.mark.slow
def test_friction_of_a_joint_that_turns_back_is_not_reported_as_lag(
    robot: RobotModel, border_data: BorderData
) -> None:
    """The end-effector moves up and down by 11 cm at 1.55 Hz."""
    loop, plant = ControlLoop(robot, border_data), WithFriction(robot)
    plant.reset(np.zeros(3), np.array(robot.description.arm.ready_position))
    state, w = RobotState(robot), 2.0 * np.pi * 1.553
    state.update_kinematics(plant.measure())
    origin, evidence = state.T_world_ee.copy(), 0.0
    for k in range(1200):
        t = max(0.001 * k - 0.1, 0.0)
        z = 0.054 * np.array([np.cos(w * t) - 1, -w * np.sin(w * t), -(w**2) * np.cos(w * t)])
        pose, v, a = pin.SE3(origin), np.zeros(6), np.zeros(6)
        pose.translation = origin.translation + np.array([0.0, 0.0, z[0]])
        v[2], a[2] = z[1], z[2] * (t > 0.0)
        command = loop.step(plant.measure(), Reference(pose, v, a))
        assert "lag" not in command.faults
        evidence = max(evidence, float(command.step.evidence.max()))
        plant.step(command.u_a, command.base_velocity, np.zeros(3))
    assert evidence > 0.5, "the friction does not resemble a lag"


def test_a_clock_corrects_the_period_before_the_first_valid_reading(run) -> None:
    def lost_at_first(k: int, m: Measurement) -> Measurement:
        return m._replace(q_m=m.q_m if k >= 12 else NAN)

    loops: list[ControlLoop] = []
    run(stamped(lost_at_first, 0.005), stated=0.001, real=0.005, created=loops.append)
    assert loops[0].controller.dt == pytest.approx(0.005, rel=0.01)


def test_a_clock_that_ends_is_not_used_any_longer(run) -> None:
    def ended(k: int, m: Measurement) -> Measurement:
        return m._replace(now=EPOCH + 0.001 * k if k < 100 else np.nan, qd_m=2.0 * m.qd_m)

    assert "period" in run(ended).faults  # without a clock, the two causes are the same
