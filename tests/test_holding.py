"""The arm's hold of its end-effector while the base moves, and the commanded base motion then."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from app.config import EeHoldConfig
from app.control.transition import limit_ee_drag, uncompensated_base_jacobian
from app.robot.assets import package_roots
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest
from tests.robots import husky_panda, random_state

Array = np.ndarray

SPEED, WEIGHT = EeHoldConfig().min_speed, EeHoldConfig().weight


@cache
def stretch() -> RobotModel:
    if not package_roots("stretch_urdf"):
        pytest.skip("pip install '.[robots]'")
    return RobotModel(load_robot("stretch_se3"))


def ready(model: RobotModel) -> RobotState:
    state = RobotState(model)
    state.update(at_rest(model, np.array(model.description.arm.ready_position)))
    return state


def carried(state: RobotState, speed: float) -> Array:
    """(3, n_b) how the base's axes move the hand where the arm does not compensate."""
    model = state.model
    return uncompensated_base_jacobian(state.J_ee, model.qd_max, model.J_m_inv, speed)


def base_with_hand(
    state: RobotState, wanted: Array, held: Array, weight: float, drag: Array
) -> Array:
    """(n_b,) the base acceleration that does not drag the hand along.

    `weight` is the hand's in base masses.
    """
    mass = weight * state.model.description.base.mass_kg
    return limit_ee_drag(wanted, held, inertia_of(state), mass, drag)


def inertia_of(state: RobotState) -> Array:
    base = state.model.description.base
    return np.array([base.inertia_kgm2 if axis.angular else base.mass_kg for axis in base.axes])


@pytest.mark.parametrize("seed", range(10))
def test_what_is_carried_is_what_the_formula_says_direction_by_direction(seed: int) -> None:
    """Along each singular direction of the hand's speed 1 / (1 + (s/v)⁴) of the base's motion."""
    state = random_state(np.random.default_rng(seed))
    model = state.model
    U, s, _ = np.linalg.svd(state.J_ee[:3, model.n_b :] * model.qd_max)
    moved = state.J_ee[:3, : model.n_b] @ np.linalg.inv(model.J_m)
    expected = U @ ((U.T @ moved) / (1.0 + (s / SPEED) ** 4)[:, None])
    np.testing.assert_allclose(carried(state, SPEED), expected, atol=1e-9)


def test_the_papers_arm_holds_its_hand_in_its_ready_pose() -> None:
    state = ready(husky_panda())
    moved = state.J_ee[:3, :2] @ state.model.J_m_inv
    assert np.abs(carried(state, SPEED)).max() < 0.05 * np.abs(moved).max()


def test_stretch_holds_its_hand_along_its_telescope_and_not_along_its_wheels() -> None:
    """The base may not drag the end-effector: the commanded motion leaves it nearly in place."""
    state = ready(stretch())
    R = carried(state, SPEED)
    assert np.linalg.norm(R[:, 0]) > 0.2
    wanted = np.array([-1.0, 0.0])
    asked = base_with_hand(state, wanted, np.zeros(2), WEIGHT, R)
    assert np.linalg.norm(R @ asked) < 0.05 * np.linalg.norm(R @ wanted)


@pytest.mark.parametrize("seed", range(20))
def test_the_base_is_asked_for_the_least_of_its_cost(seed: int) -> None:
    """(a - a_w)ᵀ I (a - a_w) + w m |R K (a - a_h)|²: its gradient vanishes there."""
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held, taken = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(3, 2))
    weight = float(10.0 ** rng.uniform(-2, 3))
    asked = base_with_hand(state, wanted, held, weight, taken)
    mass = weight * state.model.description.base.mass_kg
    pull = inertia_of(state) * (asked - wanted)
    held_back = mass * taken.T @ taken @ (asked - held)
    np.testing.assert_allclose(pull + held_back, 0.0, atol=1e-9 * (1.0 + mass))


@pytest.mark.parametrize("seed", range(20))
def test_without_weight_or_where_the_arm_follows_the_base_does_what_is_wanted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held, taken = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(3, 2))
    for weight, R in ((0.0, taken), (WEIGHT, np.zeros((3, 2)))):
        asked = base_with_hand(state, wanted, held, weight, R)
        np.testing.assert_allclose(asked, wanted, atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_what_is_left_of_a_push_never_works_against_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held, taken = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(3, 2))
    asked = base_with_hand(state, wanted, held, float(10.0 ** rng.uniform(-2, 4)), taken)
    push = inertia_of(state) * (wanted - held)
    assert push @ (asked - held) >= 0.0
    assert inertia_of(state) @ np.square(asked - held) <= push @ (wanted - held) + 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_the_heavier_the_hand_the_less_it_is_taken_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held = rng.normal(size=2), rng.normal(size=2)
    taken = np.outer(rng.normal(size=3), rng.normal(size=2))  # one direction only
    moved = [
        np.linalg.norm(taken @ (base_with_hand(state, wanted, held, w, taken) - held))
        for w in (0.0, 0.1, 1.0, 10.0, 1e3, 1e6)
    ]
    assert (np.diff(moved) < 0).all()
    assert moved[-1] < 1e-4 * moved[0]
