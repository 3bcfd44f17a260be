"""The adaptive controller at a simulated door: it finds the hinge with moderate forces.

The door is quasi-static: springs connect end-effector and handle, and the door turns as soon as
their moment about the hinge exceeds friction. The end-effector follows the reference with a lag.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from app.control.tasks import Reference
from app.simulation.plants.interface import Wrench
from app.simulation.scenarios.door_opening import (
    DoorOpening,
    DoorOpeningGains,
    curvature_update,
    radial_update,
    tangent,
)

Array = np.ndarray

DT = 0.002  # [s]; twice the period of a run
UP = np.array([0.0, 0.0, 1.0])
SEEDS = range(6)  # both sides with each kind of error of the assumed radial direction


def turned(angle: float) -> Array:
    """(3, 3) rotation about the vertical."""
    return pin.rpy.rpyToMatrix(0.0, 0.0, angle)


@dataclass
class Hinged:
    """A door and the end-effector that grasps it.

    `side` is +1 if the hinge is on the left, seen from the front of the door along `yaw`.
    """

    side: float = 1.0
    radius: float = 0.54  # [m] from the hinge to the handle
    yaw: float = 0.0  # [rad]
    inset: float = 0.1  # [rad] angle of the hinge behind the handle
    friction: float = 1.0  # [N m]
    stiffness: float = 4000.0  # [N/m] of the grasp
    twist: float = 100.0  # [N m/rad] of the grasp
    lag: float = 0.02  # [s] of the end-effector behind its reference

    def __post_init__(self) -> None:
        into, left = turned(self.yaw)[:, 0], turned(self.yaw)[:, 1]
        self.ee = pin.SE3(np.column_stack([UP, -left, into]), np.array([0.7, -0.2, 1.1]))
        to_hinge = math.cos(self.inset) * self.side * left + math.sin(self.inset) * into
        self.hinge = self.ee.translation + self.radius * to_hinge
        self.closed, self.angle, self.velocity = self.ee.copy(), 0.0, np.zeros(3)

    @property
    def radial(self) -> Array:
        """(3,) true direction from the end-effector to the hinge."""
        away = (self.hinge - self.ee.translation) * [1, 1, 0]
        return away / np.linalg.norm(away)

    def handle(self, angle: float) -> pin.SE3:
        """Pose of the handle at an opening angle [rad]."""
        R = turned(-self.side * angle)
        arm = self.closed.translation - self.hinge
        return pin.SE3(R @ self.closed.rotation, self.hinge + R @ arm)

    def wrench(self, angle: float) -> Wrench:
        """Force (3,) [N] and torque (3,) [N m] of the end-effector on the handle.

        The torque is about the end-effector's origin.
        """
        handle = self.handle(angle)
        force = self.stiffness * (self.ee.translation - handle.translation)
        torque = self.twist * pin.log3(self.ee.rotation @ handle.rotation.T)
        return Wrench(force, torque)

    def opening_moment(self, angle: float) -> float:
        """[N m] moment about the hinge; positive opens."""
        force, torque = self.wrench(angle)
        arm = self.ee.translation - self.hinge
        return -self.side * float(arm[0] * force[1] - arm[1] * force[0] + torque[2])

    def read(self) -> tuple[pin.SE3, Array, Wrench]:
        return self.ee.copy(), self.velocity, self.wrench(self.angle)

    def follow(self, reference: Reference) -> None:
        """Move the end-effector towards the reference, and the door as its friction permits."""
        share = -math.expm1(-DT / self.lag)
        step = share * (reference.pose.translation - self.ee.translation)
        self.velocity = step / DT
        spin = pin.log3(reference.pose.rotation @ self.ee.rotation.T)
        self.ee = pin.SE3(pin.exp3(share * spin) @ self.ee.rotation, self.ee.translation + step)
        moment = self.opening_moment(self.angle)
        if abs(moment) > self.friction:
            rest = math.copysign(self.friction, moment)
            for _ in range(2):  # Newton's method
                h = 1e-6  # [rad]
                slope = (self.opening_moment(self.angle + h) - moment) / h
                self.angle -= (moment - rest) / slope
                moment = self.opening_moment(self.angle)

    def move_hinge(self, radial: Array, radius: float) -> None:
        """Replace the door by one with another hinge, at the same end-effector pose."""
        self.hinge = self.ee.translation + radius * radial
        self.closed, self.angle, self.radius = self.ee.copy(), 0.0, radius


def random_door(seed: int) -> tuple[Hinged, float]:
    """A random door, and the error [rad] of the radial direction that is assumed at the start."""
    rng = np.random.default_rng(seed)
    door = Hinged(
        side=(-1.0) ** seed,
        radius=rng.uniform(0.35, 0.75),
        yaw=rng.uniform(-3, 3),
        inset=rng.uniform(-0.2, 0.2),
        friction=rng.uniform(0.0, 3.0),
        stiffness=rng.uniform(1500, 8000),
        twist=rng.uniform(40, 200),
    )
    return door, math.radians(30.0) * (1, -1, rng.uniform(-1, 1))[seed // 2 % 3]


class Sample(NamedTuple):
    """One control step."""

    t: float
    error: float  # [rad]
    force: float  # [N]
    angle: float  # [rad]
    speed: float  # [m/s] commanded
    along: float  # [m/s] the reference's velocity along the estimated tangent
    read: tuple[pin.SE3, Array, Wrench]
    reference: Reference


def opening_of(door: Hinged, wrong: float, gains: DoorOpeningGains | None = None) -> DoorOpening:
    guess = turned(wrong) @ door.radial
    return DoorOpening(door.ee.copy(), guess[:2], gains or DoorOpeningGains(), DT)


def step_at(t: float) -> int:
    """Number of the control step at a time [s]."""
    return round(t / DT)


def run(door: Hinged, opening: DoorOpening, seconds: float) -> list[Sample]:
    trace = []
    for k in range(step_at(seconds)):
        T_world_ee, velocity, wrench = door.read()
        estimate = opening.radial(T_world_ee)
        along = tangent(estimate, door.side)
        error = math.atan2(estimate @ tangent(door.radial, 1.0), estimate @ door.radial)
        reference = opening.step(T_world_ee, velocity, wrench)
        trace.append(
            Sample(
                k * DT,
                error,
                float(np.linalg.norm(wrench.force)),
                door.angle,
                opening.speed,
                float(reference.velocity[:3] @ along),
                (T_world_ee, velocity, wrench),
                reference,
            )
        )
        door.follow(reference)
    return trace


@pytest.fixture(scope="module", params=SEEDS)
def opened(request) -> tuple[Hinged, float, DoorOpening, list[Sample]]:
    """The first 8 s of opening a random door."""
    door, wrong = random_door(request.param)
    opening = opening_of(door, wrong)
    return door, wrong, opening, run(door, opening, 8.0)


@pytest.mark.slow
def test_radial_direction_estimate_converges_for_random_hinges(opened):
    """Initial errors up to 30° fall below 5° within 5 s, for both senses of opening."""
    _, wrong, _, trace = opened
    assert trace[0].error == pytest.approx(wrong)
    assert max(abs(s.error) for s in trace[step_at(5.0) :]) < math.radians(5)
    assert abs(trace[-1].error) < math.radians(1)


def test_force_of_the_end_effector_stays_moderate(opened):
    """Always below 50 N, and finally near the force of the hinge's friction."""
    door, _, _, trace = opened
    assert max(s.force for s in trace) < 50.0
    assert max(s.force for s in trace[step_at(6.0) :]) < 3.0 + door.friction / door.radius


@pytest.mark.slow
def test_radial_force_converges_to_the_desired_value():
    for wanted in (5.0, -5.0):
        door = Hinged(friction=0.5)
        trace = run(door, opening_of(door, 0.2, DoorOpeningGains(radial_force=wanted)), 12.0)
        assert trace[-1].read[2].force @ door.radial == pytest.approx(wanted, abs=0.5)


def test_curvature_estimate_converges(opened):
    """Its magnitude is 1/radius of the handle, its sign the sense of opening."""
    door, _, opening, _ = opened
    assert opening.curvature == pytest.approx(-door.side / door.radius, rel=0.05)


def test_reference_moves_along_the_estimated_tangent_at_commanded_speed(opened):
    door, _, _, trace = opened
    gains = DoorOpeningGains()
    for s in trace[::97]:
        assert s.along == pytest.approx(s.speed, abs=1e-9)
        assert s.speed <= gains.speed
    end = trace[-1]
    assert end.speed == pytest.approx(gains.speed)
    assert np.linalg.norm(end.reference.velocity[:3]) == pytest.approx(gains.speed, rel=0.02)
    # The end-effector follows: the door turns at v/r.
    assert (end.angle - trace[-1 - step_at(1.0)].angle) == pytest.approx(
        gains.speed / door.radius, rel=0.02
    )


def test_reference_pose_is_the_integral_of_its_velocity(opened):
    *_, trace = opened
    for before, after in zip(trace[1500::250], trace[1501::250], strict=True):
        moved = after.reference.pose.translation - before.reference.pose.translation
        np.testing.assert_allclose(moved / DT, after.reference.velocity[:3], atol=1e-9)
        spin = pin.log3(after.reference.pose.rotation @ before.reference.pose.rotation.T)
        np.testing.assert_allclose(spin / DT, after.reference.velocity[3:], atol=1e-9)


def test_reference_starts_at_the_end_effector_without_a_jerk(opened):
    door, *_, trace = opened
    first, gains = trace[0], DoorOpeningGains()
    np.testing.assert_allclose(first.reference.velocity, np.zeros(6), atol=1e-12)
    assert first.reference.pose.isApprox(door.closed, 1e-12)
    speeds = np.array([s.speed for s in trace[: step_at(2.0)]])
    assert speeds[0] == 0.0
    # Upper bounds of 3u² - 2u³: 1.5 for its slope, 6 for its curvature.
    assert np.diff(speeds).max() / DT < 1.6 * gains.speed / gains.ramp
    assert np.diff(speeds, 2)[:10].max() / DT**2 < 6.6 * gains.speed / gains.ramp**2
    moved = np.array([s.reference.pose.translation for s in trace])
    assert np.linalg.norm(np.diff(moved, axis=0), axis=1).max() < 0.2 * DT  # [m/s]


@pytest.mark.slow
def test_controller_adapts_to_a_changed_hinge_by_force_alone():
    """The door is replaced by one with another hinge and radius without notice."""
    door = Hinged(radius=0.45)
    opening = opening_of(door, 0.4)
    run(door, opening, 6.0)
    door.move_hinge(turned(math.radians(-25)) @ door.radial, 0.70)
    trace = run(door, opening, 8.0)
    assert abs(trace[0].error) > math.radians(20)
    assert abs(trace[step_at(5.0)].error) < math.radians(5)
    assert opening.curvature == pytest.approx(-1 / 0.70, rel=0.1)
    assert max(s.force for s in trace) < 50.0


def test_same_measurements_give_the_same_references():
    """A replay of the measurements without a door gives the same references."""
    door = Hinged(side=-1.0, radius=0.4)
    first = opening_of(door, -0.5)
    again = opening_of(Hinged(side=-1.0, radius=0.7, friction=3.0), -0.5)
    for s in run(door, first, 3.0):
        reference = again.step(*s.read)
        np.testing.assert_array_equal(reference.pose.homogeneous, s.reference.pose.homogeneous)
        np.testing.assert_array_equal(reference.velocity, s.reference.velocity)


def test_result_does_not_depend_on_the_world_frame():
    here, there = Hinged(yaw=0.0), Hinged(yaw=2.1)
    ends = [run(door, opening_of(door, 0.5), 4.0) for door in (here, there)]
    for a, b in zip(*(trace[::100] for trace in ends), strict=True):
        assert b.error == pytest.approx(a.error, abs=1e-6)
        v, w = a.reference.velocity[:3], a.reference.velocity[3:]
        np.testing.assert_allclose(b.reference.velocity[:3], turned(2.1) @ v, atol=1e-7)
        np.testing.assert_allclose(b.reference.velocity[3:], w, atol=1e-7)


@pytest.mark.slow
def test_mirrored_door_gives_mirrored_references():
    left, right = Hinged(side=1.0), Hinged(side=-1.0)
    ends = [run(d, opening_of(d, d.side * 0.5), 4.0) for d in (left, right)]
    for a, b in zip(*(trace[::100] for trace in ends), strict=True):
        assert b.error == pytest.approx(-a.error, abs=1e-6)
        mirrored = a.reference.velocity * [1, -1, 1, -1, 1, -1]
        np.testing.assert_allclose(b.reference.velocity, mirrored, atol=1e-7)


@pytest.mark.slow
def test_opening_stops_at_the_commanded_angle():
    """With a high speed to save time."""
    gains = DoorOpeningGains(speed=0.06)
    door = Hinged(radius=0.4)
    trace = run(door, opening_of(door, 0.3, gains), 20.0)
    assert math.radians(84) < trace[-1].angle < gains.turn + math.radians(1)
    assert trace[-1].speed < 0.05 * gains.speed
    assert max(s.force for s in trace) < 50.0


@pytest.mark.slow
def test_blocked_door_limits_the_force():
    """The speed falls to zero at the force `slow_until`."""
    gains = DoorOpeningGains()
    door = Hinged(friction=1e3)
    trace = run(door, opening_of(door, 0.1), 20.0)
    assert trace[-1].angle == 0.0
    assert max(s.force for s in trace) < 1.1 * gains.slow_until
    assert trace[-1].speed < 0.1 * gains.speed
    # Without motion there is no adaptation.
    assert abs(trace[-1].error - trace[0].error) < math.radians(3)


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_tangent_is_horizontal_unit_and_normal_to_the_radius(sense: float):
    for angle in np.linspace(-3, 3, 13):
        radial = np.array([math.cos(angle), math.sin(angle), 0.0])
        t = tangent(radial, sense)
        assert t @ radial == pytest.approx(0.0)
        np.testing.assert_allclose(np.cross(radial, t), sense * UP * (t @ t), atol=1e-12)
        assert np.linalg.norm(t) == pytest.approx(1.0)


@pytest.mark.parametrize("side", [1.0, -1.0])
@pytest.mark.parametrize("wrong", [-1.0, -0.5, 0.0, 0.5, 1.0])  # [rad]
def test_door_opens_towards_the_robot(side: float, wrong: float):
    door = Hinged(side=side)
    reference = run(door, opening_of(door, wrong), 0.5)[-1].reference
    assert reference.velocity[:3] @ -door.closed.rotation[:, 2] > 0


@pytest.mark.parametrize("sense", [1.0, -1.0])
def test_radial_update_is_the_gradient_step_of_its_docstring(sense: float):
    """At α_f R = -s v_d tan e and full speed, ė = -λ tan e; without progress, zero."""
    gains = DoorOpeningGains()
    for e in np.linspace(-1, 1, 9):
        force = -sense * gains.speed * math.tan(e) / gains.compliance
        rate = radial_update(force, 1.0, sense, gains)
        assert rate == pytest.approx(-gains.learning_rate * math.tan(e))
        assert radial_update(force, 0.5, sense, gains) == pytest.approx(rate / 2)
        assert radial_update(force, 0.0, sense, gains) == 0.0


def test_curvature_update_converges_to_zero_torque():
    """At α_τ τ = (κ̂ - κ) v_d and full speed, κ̂ converges to κ at the rate λ."""
    gains = DoorOpeningGains()
    for off in (-2.0, 0.0, 3.0):  # [1/m]
        torque = off * gains.speed / gains.angular_compliance
        assert curvature_update(torque, 1.0, gains) == pytest.approx(-gains.learning_rate * off)
        assert curvature_update(torque, 0.0, gains) == 0.0
