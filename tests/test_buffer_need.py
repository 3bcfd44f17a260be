"""Required d_b: properties, an independent simulation, and the monitor of a running loop."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable

import numpy as np
import pytest

from app.avoidance.closest_points import DistanceMonitor
from app.border.cache import BorderData
from app.config import Config
from app.control.buffer_need import RESERVE, Approach, _bound, _ways, buffer_need
from app.control.buffer_watch import (
    BufferReading,
    BufferWatch,
    approach_speeds,
    buffer_warning,
    needed_text,
)
from app.control.tasks import activation
from app.robot.bases.kind import BaseKind
from app.robot.link_pairs import ClosestPoints
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.plants.interface import Drive
from app.strict import Array
from tests.admittance import RunningAdmittance

FRONT = np.array([1.0, 0.0, 0.0]), np.array([0.65, 0.0, 0.4])
SIDE = np.array([0.0, 1.0, 0.0]), np.array([0.33, 0.45, 0.4])
PLACES = [FRONT, SIDE, (np.array([0.6, -0.7, 0.39]), np.array([0.6, -0.5, 0.4]))]
DT = 0.001  # [s]


def least_distance(d_b: Array, approach: Approach, base: BaseKind, config: Config) -> Array:
    """(k,) [m] lower bound of the distance between arm and base, for each d_b (k,) [m] > d_full.

    The bound is −∞ if the base cannot reach the speed `approach.v` at any distance within d_b.
    """
    ways = list(_ways(approach, base, config))
    return np.array([max(_bound(each, *way) for way in ways) for each in d_b])


@pytest.fixture(scope="module")
def base(robot: RobotModel) -> BaseKind:
    return robot.description.base


def changed(**values: float) -> Config:
    config = Config()
    for path, value in values.items():
        config = config.replace(path.replace("__", "."), value)
    return config


@pytest.mark.parametrize("place", PLACES)
def test_required_buffer_grows_with_the_approach_speed(base, place):
    speeds = np.linspace(0.0, 1.0, 30)
    needs = [buffer_need(Approach(v, *place), base, Config()) for v in speeds]
    assert needs == sorted(needs)
    assert needs[0] == Config().activation.d_full
    assert needs[5] > needs[1]
    assert math.isinf(needs[-1])


@pytest.mark.parametrize("place", PLACES)
@pytest.mark.parametrize(
    ("path", "values"),
    [
        ("disturbance.base_delay", (0.0, 0.05, 0.1, 0.2, 0.5)),
        ("disturbance.slip", (0.0, 0.1, 0.3, 0.5)),
        ("admittance.period", (0.02, 0.1, 0.2, 0.5)),
        ("force.f_max", (600.0, 400.0, 300.0, 200.0, 100.0)),
    ],
)
def test_required_buffer_grows_with_limits_on_the_base_response(base, place, path, values):
    approach = Approach(0.09, *place)
    needs = [buffer_need(approach, base, Config().replace(path, value)) for value in values]
    assert needs == sorted(needs)
    assert needs[-1] > needs[0] * 1.05


@pytest.mark.parametrize("place", PLACES)
def test_required_buffer_decreases_with_base_acceleration(base, place):
    approach = Approach(0.1 if place is FRONT else 0.05, *place)
    needs = []
    for a in (0.4, 0.6, 1.0, 2.0, 6.0):  # [m/s²]; angular limit: twice the number
        limits = {"max_linear_acceleration_mps2": a, "max_angular_acceleration_radps2": 2 * a}
        needs.append(buffer_need(approach, base.model_copy(update=limits), Config()))
    assert needs == sorted(needs, reverse=True)
    assert needs[0] > needs[-1] * 1.1


def test_no_buffer_suffices_if_the_end_effector_is_faster_than_the_base(base):
    config = changed(admittance__v_max=0.2)
    assert math.isfinite(buffer_need(Approach(0.19, *FRONT), base, config))
    assert math.isinf(buffer_need(Approach(0.21, *FRONT), base, config))
    slipping = config.replace("disturbance.slip", 0.5)
    assert math.isfinite(buffer_need(Approach(0.09, *FRONT), base, slipping))
    assert math.isinf(buffer_need(Approach(0.11, *FRONT), base, slipping))


def test_required_buffer_is_equal_on_the_left_and_the_right(base):
    for v in (0.05, 0.1):
        n, p = np.array([0.3, 0.9, 0.3]), np.array([0.4, 0.45, 0.4])
        mirror = np.array([1.0, -1.0, 1.0])
        left = buffer_need(Approach(v, n, p), base, Config())
        assert buffer_need(Approach(v, mirror * n, mirror * p), base, Config()) == left


def test_required_buffer_is_the_d_b_whose_least_distance_is_the_reserve(base):
    for place in PLACES:
        approach = Approach(0.09, *place)
        need = buffer_need(approach, base, Config())
        near = least_distance(np.array([0.97 * need, need]), approach, base, Config())
        assert near[0] < RESERVE <= near[1] < RESERVE + 0.01


def test_only_the_horizontal_part_of_an_oblique_force_moves_the_base(base):
    """The horizontal share counts twice: for the force, and for the motion along the normal."""
    n, p = FRONT
    d_b, across = np.linspace(0.1, 0.4, 7), 0.8
    weak = [changed(force__f_max=f) for f in (40.0, 40.0 * across**2)]  # within the limits
    oblique = Approach(0.03, across * n + [0.0, 0.0, 0.6], p)
    found = least_distance(d_b, oblique, base, weak[0])
    assert found[-1] > 0.0
    level = least_distance(d_b, Approach(0.03, n, p), base, weak[1])
    np.testing.assert_allclose(found, level, atol=1e-12)


def simulated(v: float, d_b: float, base: BaseKind, config: Config) -> float:
    """[m] smallest distance of an end-effector that approaches from the front at v.

    Steps the product's admittance law and drive with a queue for the delay; only the avoidance
    force is written again here.
    """
    law, drive = RunningAdmittance(base, config.admittance), Drive(base, DT)
    steps = round(config.disturbance.base_delay / DT)
    queue = deque([np.zeros(2)] * steps)
    d, least = d_b + 0.01, d_b
    for _ in range(round(2.5 / DT + d / v / DT)):
        beta = activation(d, d_b, config.activation.d_full)
        f = beta * config.force.f_max * min(max(1 - d / d_b, 0.0), 1.0)
        c = (d_b - d) / math.hypot(d_b - d, config.force.alpha_min)
        queue.append(law.update(np.array([-f * c / base.mass_kg, 0.0]), DT).copy())
        moved = drive.step((1 - config.disturbance.slip) * queue.popleft())
        d += (-v - moved[0]) * DT
        least = min(least, d)
    return least


@pytest.mark.parametrize(
    ("v", "options"),
    [
        (0.05, {}),
        (0.2, {}),
        (0.4, {}),
        (0.2, {"disturbance__base_delay": 0.2}),
        (0.1, {"disturbance__base_delay": 0.5, "disturbance__slip": 0.3}),
        (0.3, {"admittance__damping": 0.0}),
        (0.15, {"admittance__mass": 10.0, "admittance__period": 0.3}),
        (0.25, {"force__f_max": 150.0, "admittance__damping": 60.0}),
    ],
)
def test_simulation_confirms_the_required_buffer(base, v, options):
    """With the required d_b the distance stays above the reserve, with 45 % of it not."""
    config = changed(**options)
    need = buffer_need(Approach(v, *FRONT), base, config)
    assert math.isfinite(need)
    assert simulated(v, need, base, config) >= RESERVE
    assert simulated(v, 0.45 * need, base, config) < RESERVE


# The monitor


class Seen(list[ClosestPoints]):
    """Closest points of pairs of arm and base, with the attributes of a control step."""

    def __init__(self, points: Iterable[ClosestPoints]) -> None:
        super().__init__(points)
        self.pairs = [point.pair for point in self]
        self.rows = [[i] for i in range(len(self))]
        self.d = np.array([point.d for point in self])
        self.normal = np.array([point.n for point in self])
        self.p_b = np.array([point.p_b for point in self])

    @property
    def n_mob(self) -> int:
        return len(self)


@pytest.fixture
def led(robot: RobotModel, border_data: BorderData):
    """A function that returns the state, and the pairs with the base, as the arm nears the base."""
    from app.simulation.scenarios.start import StartSolver

    q_m = StartSolver(robot, border_data.pairs, 0.15).solve((0.30, 0.72, 0.30))
    state = RobotState(robot)
    monitor = DistanceMonitor(state, border_data.pairs.mobile)

    def lead(v: float, base_velocity=(0.0, 0.0), late: float = 0.0):
        state.update(Measurement(np.zeros(3), np.zeros(2), q_m, np.zeros(7)))
        J = state.J_ee[:, 2:]
        qd = J.T @ np.linalg.solve(J @ J.T, [0.0, -v, 0.0, 0.0, 0.0, 0.0])
        at = Measurement(np.zeros(3), np.array(base_velocity), q_m + late * qd, qd)
        state.update(at)
        return state, Seen(monitor.find_closest_points())

    return lead


def test_approach_speed_is_the_closing_rate_for_a_base_at_rest(led):
    """The expected closing rate is the central difference of the distance."""
    h = 1e-5  # [s]
    before, after = led(0.1, late=-h)[1], led(0.1, late=h)[1]
    state, pairs = led(0.1)

    def joints(points: ClosestPoints) -> Array:
        return np.array([state.model.body_joints[body] for body in points.pair])

    for i, pair in enumerate(pairs):
        v, closing = approach_speeds(state.twists, joints(pair), pair.p_b, pair.n)
        assert v == closing
        assert closing == pytest.approx((before[i].d - after[i].d) / (2 * h), abs=1e-4)
    first = pairs[0]
    v, _ = approach_speeds(state.twists, joints(first), first.p_b, first.n)
    assert v == pytest.approx(0.1, rel=0.1)


def watched(watch: BufferWatch, led, speeds: list[float], *, gives_way=True) -> list[BufferReading]:
    readings = []
    for v in speeds:
        state, pairs = led(v)
        readings.append(watch.update(state, pairs, DT, gives_way=gives_way))
    return readings


def test_end_effector_at_rest_or_moving_away_needs_no_buffer(led):
    for v in (0.0, -0.2):
        reading = watched(BufferWatch(Config()), led, [v] * 60)[-1]
        assert reading == BufferReading(0.0, 0.0, 0.0, 0.0, too_small=False, too_small_ever=False)


def test_tremor_is_no_approach(led):
    """The same speed without reversals triggers the warning."""
    assert watched(BufferWatch(Config()), led, [0.3] * 60)[-1].too_small
    tremor = [0.3 * (-1) ** (k // 10) for k in range(60)]
    reading = watched(BufferWatch(Config()), led, [*[0.0] * 11, *tremor])[-1]
    assert not reading.too_small
    assert reading.approach_speed_max < 0.1


def test_warning_lasts_3_s_and_maxima_are_permanent(led):
    watch = BufferWatch(changed(border__d_b=0.16))
    quick = watched(watch, led, [0.15] * 60)[-1]
    assert quick.too_small
    assert quick.needed > 0.16
    state, pairs = led(0.0)
    rest = [watch.update(state, pairs, DT, gives_way=True) for _ in range(3200)]
    changes = [k for k in range(1, 3200) if rest[k].too_small != rest[k - 1].too_small]
    assert len(changes) == 1  # no flicker
    assert 2900 <= changes[0] <= 3100
    assert rest[-1].needed == 0.0
    assert rest[-1].too_small_ever
    assert rest[-1].needed_max == quick.needed_max
    assert rest[-1].approach_speed_max == pytest.approx(0.15, rel=0.1)


def test_warning_names_the_approach_that_requires_the_most(led):
    """A faster approach that requires less does not change speed or required d_b."""
    watch = BufferWatch(changed(border__d_b=0.16, disturbance__base_delay=0.3))
    worst = watched(watch, led, [0.12] * 60)[-1]
    watch.config = changed(border__d_b=0.16)
    faster = watched(BufferWatch(watch.config), led, [0.13] * 60)[-1]
    assert faster.approach_speed > worst.approach_speed
    assert 0.16 < faster.needed < worst.needed
    assert watched(watch, led, [0.13] * 60)[-1] == worst


def test_warning_ends_at_once_when_d_b_is_increased_as_recommended(led):
    watch = BufferWatch(changed(border__d_b=0.16))
    needed = watched(watch, led, [0.12] * 60)[-1].needed
    assert 0.16 < needed <= 0.30
    watch.config = watch.config.replace("border.d_b", math.ceil(needed * 100) / 100)
    assert not watched(watch, led, [0.0])[-1].too_small


def test_base_that_does_not_avoid_needs_no_buffer(led):
    watch = BufferWatch(changed(border__d_b=0.16))
    reading = watched(watch, led, [0.3] * 60, gives_way=False)[-1]
    assert not reading.too_small
    assert not reading.too_small_ever
    assert reading.approach_speed_max > 0.25


def test_approach_from_above_or_from_beyond_d_b_does_not_count(led):
    state, pairs = led(0.3)
    above = np.array([0.0, 0.3, math.sqrt(0.91)])
    for pair in (pairs[0]._replace(n=above), pairs[0]._replace(d=0.31)):
        watch = BufferWatch(changed(border__d_b=0.30))
        readings = [watch.update(state, Seen([pair]), DT, gives_way=True) for _ in range(101)]
        assert readings[-1].approach_speed_max == 0.0


def test_buffer_warning_names_the_speed_and_the_required_d_b():
    config = changed(disturbance__base_delay=0.2)
    fine = BufferReading(0.1, 0.1, 0.1, 0.1, too_small=False, too_small_ever=False)
    assert buffer_warning(fine, config) is None
    small = BufferReading(0.0, 0.0, 0.123, 0.2311, too_small=False, too_small_ever=True)
    text = buffer_warning(small, config) or ""
    assert "d_b = 0.15 m is too small" in text
    assert "0.12 m/s" in text
    assert text.endswith("late: d_b of 0.24 m needed")
    assert needed_text(0.30) == "d_b of 0.30 m needed"
    assert needed_text(0.381) == "d_b of 0.39 m needed, at most 0.30 m can be set"
    text = buffer_warning(small._replace(needed_max=0.381), config) or ""
    assert text.count("at most 0.30 m can be set") == 1
    hopeless = small._replace(needed_max=math.inf)
    assert "no d_b suffices" in (buffer_warning(hopeless, config) or "")
