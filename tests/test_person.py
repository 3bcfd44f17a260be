"""Properties of the simulated person's hand."""

from __future__ import annotations

import numpy as np
import pytest

from app.config import PersonConfig
from app.errors import DbbError, TargetError
from app.simulation.people import PersonHand, checked_target

DT = 0.001  # [s]
AT = np.array([0.5, 0.1, 0.8])  # [m] where the person grasps the end-effector


def settled_force(person: PersonHand, p_ee: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The steady force on an end-effector at rest, 3 s after the target was set."""
    for _ in range(3000):
        force = person.force(p_ee, np.zeros(3), target)
    return force


@pytest.mark.parametrize("stretch", [0.01, 0.05, 0.12])
def test_static_force_is_stiffness_times_stretch_below_the_limit(stretch):
    config = PersonConfig()
    towards = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    force = settled_force(PersonHand(config, DT), AT, AT + stretch * towards)
    np.testing.assert_allclose(force, config.stiffness * stretch * towards, rtol=1e-9)


def test_static_force_saturates_at_the_limit_towards_the_target():
    config = PersonConfig(f_max=40.0)
    force = settled_force(PersonHand(config, DT), AT, AT + np.array([0.3, 0.4, 0.0]))
    np.testing.assert_allclose(force, [24.0, 32.0, 0.0], rtol=1e-9)


def test_force_of_a_hand_without_a_mass_never_exceeds_the_limit():
    rng = np.random.default_rng(0)
    person = PersonHand(PersonConfig(f_max=17.0, stiffness=2000.0, damping=200.0), DT)
    strongest = 0.0
    for _ in range(5000):
        target = np.abs(rng.normal(0, 2, 3))
        force = person.force(rng.normal(0, 2, 3), rng.normal(0, 5, 3), target)
        strongest = max(strongest, float(np.linalg.norm(force)))
    assert 16.99 < strongest <= 17.0 * (1 + 1e-12)


MASSES = [0.2, 1.0, 5.0]  # [kg]
STIFF = [300.0, 3000.0]  # [N/m]


def swing(
    config: PersonConfig,
    body: float,
    steps: int,
    at: np.ndarray = AT,
    target: np.ndarray = AT,
    speed: float = 0.0,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Positions, velocities and forces (steps, 3) of a free body [kg] grasped at `at`."""
    person, p, v = PersonHand(config, DT), at.astype(float), np.array([speed, 0.0, 0.0])
    places, speeds, forces = [], [], []
    for _ in range(steps):
        force = person.force(p, v, target)
        v = v + force / body * DT
        p = p + v * DT
        places.append(p)
        speeds.append(v)
        forces.append(force)
    return np.array(places), np.array(speeds), np.array(forces)


@pytest.mark.parametrize("mass", MASSES)
@pytest.mark.parametrize("stiffness", STIFF)
def test_mass_of_the_hand_does_not_change_the_static_force(mass, stiffness):
    config = PersonConfig(stiffness=stiffness, mass=mass, f_max=90.0)
    way = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    soft = settled_force(PersonHand(config, DT), AT, AT + 0.02 * way)
    np.testing.assert_allclose(soft, 0.02 * stiffness * way, rtol=1e-6)
    strong = settled_force(PersonHand(config, DT), AT, AT + 0.5 * way)
    np.testing.assert_allclose(strong, 90.0 * way, rtol=1e-6)


@pytest.mark.parametrize("mass", [0.0, 0.01, *MASSES])
@pytest.mark.parametrize("body", [0.8, 3.0])
@pytest.mark.parametrize("damping", [25.0, 200.0])
def test_stiffest_hand_brings_a_light_body_to_rest_at_its_target(mass, body, damping):
    config = PersonConfig(stiffness=3000.0, damping=damping, mass=mass, f_max=100.0)
    target = AT + np.array([0.2, 0.1, 0.0])
    places, speeds, _ = swing(config, body, 8000, target=target)
    assert np.linalg.norm(speeds, axis=1).max() < 3.0
    np.testing.assert_allclose(places[-1], target, atol=1e-4)
    np.testing.assert_allclose(speeds[-1], 0.0, atol=1e-3)


@pytest.mark.parametrize("stiffness", STIFF)
@pytest.mark.parametrize("mass", [0.0, *MASSES])
@pytest.mark.parametrize("speed", [0.3, 1.5])
def test_hand_with_a_resting_target_adds_no_energy_to_a_moving_body(stiffness, mass, speed):
    """The body moves when it is grasped, and the hand starts with its velocity."""
    config = PersonConfig(stiffness=stiffness, mass=mass, f_max=80.0)
    _, v, f = swing(config, 2.0, 4000, speed=speed)
    before = np.vstack([[speed, 0.0, 0.0], v[:-1]])
    work = np.cumsum(np.sum(f * (before + v) / 2, axis=1)) * DT
    assert work.max() <= 0.5 * mass * speed**2 + 1e-3 * speed**2
    energy = 0.5 * 2.0 * np.sum(v**2, axis=1)
    assert energy.max() < 1.02 * 0.5 * 2.0 * speed**2
    assert energy[-1] < 0.02 * energy[0]


def test_impact_force_grows_with_the_mass_of_the_hand():
    """A wall stops the end-effector after 0.2 m; the grip alone stops the hand's mass."""
    strongest = {}
    for mass in (0.0, 0.2, 2.0):
        person = PersonHand(PersonConfig(stiffness=2000.0, mass=mass, f_max=60.0), DT)
        x, hits = AT[0], []
        for _ in range(2000):
            v = 0.0 if not hits or x >= AT[0] + 0.2 else 1.2
            x = min(x + v * DT, AT[0] + 0.2)
            at = np.array([x, *AT[1:]])
            hits.append(person.force(at, np.array([v, 0, 0]), AT + np.array([0.4, 0, 0])))
        strongest[mass] = float(np.linalg.norm(hits, axis=1).max())
    assert strongest[0.0] <= 60.0 * (1 + 1e-12)
    assert strongest[0.0] < strongest[0.2] < strongest[2.0]
    assert 100.0 < strongest[2.0] < 60.0 + 1.2 * 1.2 * (2e4 * 2.0) ** 0.5  # v √(k m) more


def test_force_at_1_khz_is_smooth_for_targets_at_20_hz():
    """The end-effector is fixed; the target moves at 0.5 m/s in jumps of 25 mm."""
    config = PersonConfig(f_max=150.0)
    person, forces = PersonHand(config, DT), []
    for k in range(600):
        target = AT + np.array([0.025 * (k // 50), 0.0, 0.0])
        forces.append(person.force(AT, np.zeros(3), target))
    steps = np.linalg.norm(np.diff(forces, axis=0), axis=1)
    assert np.linalg.norm(forces[0]) < 0.01 * config.stiffness * 0.025
    assert steps.max() < 0.3  # [N], where the raw target would give 7.5
    slope = np.diff(steps[1:])
    assert np.abs(slope).max() < 0.01  # [N] change between two steps


def test_hand_moves_at_1_5_mps_at_most_and_does_not_overshoot():
    person = PersonHand(PersonConfig(), DT)
    target, places = AT + np.array([1.0, 0.0, 0.0]), [AT]
    for _ in range(3000):
        person.force(AT, np.zeros(3), target)
        places.append(person.motion[0].copy())
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / DT
    assert 1.4 < speed.max() <= 1.5 * (1 + 1e-9)
    assert np.max(places, axis=0)[0] <= target[0] + 1e-9
    np.testing.assert_allclose(places[-1], target, atol=1e-6)


@pytest.mark.parametrize("mass", [0.0, 2.0])
@pytest.mark.parametrize("speed", [0.0, 0.8])
def test_grasp_starts_with_the_force_of_the_damper_alone(mass, speed):
    person = PersonHand(PersonConfig(mass=mass, damping=25.0), DT)
    first = person.force(AT, np.array([speed, 0.0, 0.0]), AT + np.array([0.3, 0.0, 0.0]))
    assert np.linalg.norm(first) <= 25.0 * speed + 0.1


@pytest.mark.parametrize("stretch", [0.05, 0.6])
def test_hand_with_a_resting_target_only_dissipates_energy(stretch):
    """Kinetic energy plus that of the (limited) spring never grows, in three dimensions."""
    config, mass = PersonConfig(), 3.0  # [kg]
    rng = np.random.default_rng(5)
    target = np.array([0.0, 0.0, 5.0])
    person = PersonHand(config, 1e-4)
    person.force(target, np.zeros(3), target)  # grasped at rest at the target
    p, v = target + stretch * np.array([0.6, 0.8, 0.0]), rng.normal(0, 0.5, 3)

    def energy():
        x, knee = np.linalg.norm(p - target), config.f_max / config.stiffness
        spring = 0.5 * config.stiffness * x**2 if x < knee else config.f_max * (x - 0.5 * knee)
        return spring + 0.5 * mass * v @ v

    energies = [energy()]
    for _ in range(30000):
        v = v + person.force(p, v, target) / mass * 1e-4
        p = p + v * 1e-4
        energies.append(energy())
    assert np.diff(energies).max() < 2e-5 * energies[0]  # the error of semi-implicit Euler itself
    assert energies[-1] < 0.01 * energies[0]


def test_a_target_below_the_floor_is_refused_with_its_height():
    person = PersonHand(PersonConfig(), DT)
    with pytest.raises(TargetError, match=r"z = -0\.250 m, below the floor at z = 0"):
        person.force(AT, np.zeros(3), (0.5, 0.0, -0.25))
    np.testing.assert_array_equal(checked_target((0.5, 0.0, 0.0)), [0.5, 0.0, 0.0])
    assert issubclass(TargetError, DbbError)


@pytest.mark.parametrize("target", [(1.0, 2.0), (1.0, 2.0, float("nan")), (np.inf, 0.0, 1.0)])
def test_a_target_must_be_three_finite_numbers(target):
    with pytest.raises(TargetError, match="three finite numbers"):
        checked_target(target)


def test_changed_parameters_apply_at_once():
    person = PersonHand(PersonConfig(), DT)
    target = AT + np.array([0.05, 0.0, 0.0])
    before = settled_force(person, AT, target)
    person.configure(PersonConfig(stiffness=600.0))
    np.testing.assert_allclose(person.force(AT, np.zeros(3), target), 2 * before, rtol=1e-6)
