"""Laws of the person's hand."""

from __future__ import annotations

import numpy as np
import pytest

from app.config import HandConfig
from app.errors import DbbError, TargetError
from app.simulation.person import PersonHand, checked_target

DT = 0.001  # [s]
AT = np.array([0.5, 0.1, 0.8])  # [m] where the end-effector is taken


def settled_force(person: PersonHand, p_ee: np.ndarray, target: np.ndarray) -> np.ndarray:
    """The force on an end-effector that does not move, long after the target came."""
    for _ in range(3000):
        force = person.force(p_ee, np.zeros(3), target)
    return force


@pytest.mark.parametrize("stretch", [0.01, 0.05, 0.12])
def test_static_force_is_stiffness_times_stretch_below_the_limit(stretch):
    config = HandConfig()
    towards = np.array([2.0, -1.0, 0.5]) / np.linalg.norm([2.0, -1.0, 0.5])
    force = settled_force(PersonHand(config, DT), AT, AT + stretch * towards)
    np.testing.assert_allclose(force, config.stiffness * stretch * towards, rtol=1e-9)


def test_static_force_is_the_limit_above_it_and_points_to_the_target():
    config = HandConfig(f_max=40.0)
    force = settled_force(PersonHand(config, DT), AT, AT + np.array([0.3, 0.4, 0.0]))
    np.testing.assert_allclose(force, [24.0, 32.0, 0.0], rtol=1e-9)


def test_the_person_is_never_stronger_than_the_limit():
    rng = np.random.default_rng(0)
    person = PersonHand(HandConfig(f_max=17.0, stiffness=2000.0, damping=200.0), DT)
    strongest = 0.0
    for _ in range(5000):
        target = np.abs(rng.normal(0, 2, 3))
        force = person.force(rng.normal(0, 2, 3), rng.normal(0, 5, 3), target)
        strongest = max(strongest, float(np.linalg.norm(force)))
    assert 16.99 < strongest <= 17.0 * (1 + 1e-12)


def test_targets_at_20_hertz_give_no_steps_of_force_at_1_kilohertz():
    """The end-effector held still, the target dragged at 0.5 m/s in jumps of 25 mm."""
    config = HandConfig(f_max=150.0)
    person, forces = PersonHand(config, DT), []
    for k in range(600):
        target = AT + np.array([0.025 * (k // 50), 0.0, 0.0])
        forces.append(person.force(AT, np.zeros(3), target))
    steps = np.linalg.norm(np.diff(forces, axis=0), axis=1)
    assert np.linalg.norm(forces[0]) < 0.01 * config.stiffness * 0.025
    assert steps.max() < 0.3  # [N], where the raw target would give 7.5
    slope = np.diff(steps[1:])
    assert np.abs(slope).max() < 0.01  # [N] and no kinks either


def test_the_hand_moves_no_faster_than_a_person_and_does_not_overshoot():
    person = PersonHand(HandConfig(), DT)
    target, places = AT + np.array([1.0, 0.0, 0.0]), [AT]
    for _ in range(3000):
        person.force(AT, np.zeros(3), target)
        places.append(person.place)
    speed = np.linalg.norm(np.diff(places, axis=0), axis=1) / DT
    assert 1.4 < speed.max() <= 1.5 * (1 + 1e-9)
    assert np.max(places, axis=0)[0] <= target[0] + 1e-9
    np.testing.assert_allclose(places[-1], target, atol=1e-6)


def test_the_person_takes_hold_without_a_jerk_and_lets_go_at_once():
    person = PersonHand(HandConfig(), DT)
    far = AT + np.array([0.0, 0.5, 0.0])
    assert np.linalg.norm(person.force(AT, np.zeros(3), far)) < 0.1
    settled_force(person, AT, far)
    np.testing.assert_array_equal(person.force(AT, np.zeros(3), None), np.zeros(3))
    assert person.place is None
    elsewhere = AT + np.array([0.3, 0.0, 0.0])
    assert np.linalg.norm(person.force(elsewhere, np.zeros(3), elsewhere)) < 1e-9


@pytest.mark.parametrize("stretch", [0.05, 0.6])
def test_with_the_target_at_rest_the_person_only_takes_energy(stretch):
    """Kinetic energy plus that of the (limited) spring never grows, in three dimensions."""
    config, mass = HandConfig(), 3.0  # [kg]
    rng = np.random.default_rng(5)
    target = np.array([0.0, 0.0, 5.0])
    person = PersonHand(config, 1e-4)
    person.force(target, np.zeros(3), target)  # taken at rest at the target
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
    assert np.diff(energies).max() < 2e-5 * energies[0]  # what semi-implicit Euler itself adds
    assert energies[-1] < 0.01 * energies[0]


def test_a_target_below_the_floor_is_refused_with_its_height():
    person = PersonHand(HandConfig(), DT)
    with pytest.raises(TargetError, match=r"z = -0\.250 m, below the floor, which is z = 0"):
        person.force(AT, np.zeros(3), (0.5, 0.0, -0.25))
    np.testing.assert_array_equal(checked_target((0.5, 0.0, 0.0)), [0.5, 0.0, 0.0])
    assert issubclass(TargetError, DbbError)


@pytest.mark.parametrize("target", [(1.0, 2.0), (1.0, 2.0, float("nan")), (np.inf, 0.0, 1.0)])
def test_a_target_must_be_three_finite_numbers(target):
    with pytest.raises(TargetError, match="three finite numbers"):
        checked_target(target)


def test_other_parameters_act_at_once():
    person = PersonHand(HandConfig(), DT)
    target = AT + np.array([0.05, 0.0, 0.0])
    before = settled_force(person, AT, target)
    person.config = HandConfig(stiffness=600.0)
    np.testing.assert_allclose(person.force(AT, np.zeros(3), target), 2 * before, rtol=1e-6)
