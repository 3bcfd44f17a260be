"""How well the arm holds its end-effector while the base moves, and the limited base motion."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from app.config import EeHoldConfig
from app.control.tasks import limit_ee_drag, uncompensated_base_jacobian
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


def uncompensated(state: RobotState, speed: float) -> Array:
    """(3, n_b) [-, m/rad] part of the base motion that the arm does not compensate."""
    model = state.model
    return uncompensated_base_jacobian(state.J_ee, model.qd_max, model.J_m_inv, speed)


def limited_base_acceleration(
    state: RobotState, wanted: Array, held: Array, weight: float, drag: Array
) -> Array:
    """(n_b,) base acceleration with limited drag of the end-effector, by `limit_ee_drag`.

    `weight` is the end-effector's weight in base masses; the other arrays are its arguments.
    """
    mass = weight * state.model.description.base.mass_kg
    return limit_ee_drag(wanted, held, inertia_of(state), mass, drag)


def inertia_of(state: RobotState) -> Array:
    base = state.model.description.base
    return np.array([base.inertia_kgm2 if axis.angular else base.mass_kg for axis in base.axes])


@pytest.mark.parametrize("seed", range(10))
def test_base_motion_reaches_the_end_effector_by_the_singular_value_formula(seed: int) -> None:
    """The share along each singular direction is 1 / (1 + (s/v)⁴)."""
    state = random_state(np.random.default_rng(seed))
    model = state.model
    U, s, _ = np.linalg.svd(state.J_ee[:3, model.n_b :] * model.qd_max)
    moved = state.J_ee[:3, : model.n_b] @ np.linalg.inv(model.J_m)
    expected = U @ ((U.T @ moved) / (1.0 + (s / SPEED) ** 4)[:, None])
    np.testing.assert_allclose(uncompensated(state, SPEED), expected, atol=1e-9)


def test_paper_arm_compensates_base_motion_in_its_ready_posture() -> None:
    state = ready(husky_panda())
    moved = state.J_ee[:3, :2] @ state.model.J_m_inv
    assert np.abs(uncompensated(state, SPEED)).max() < 0.05 * np.abs(moved).max()


def test_stretch_base_stops_in_the_direction_that_its_arm_lacks() -> None:
    """The commanded motion leaves the end-effector nearly in place."""
    state = ready(stretch())
    R = uncompensated(state, SPEED)
    assert np.linalg.norm(R[:, 0]) > 0.2
    wanted = np.array([-1.0, 0.0])
    asked = limited_base_acceleration(state, wanted, np.zeros(2), WEIGHT, R)
    assert np.linalg.norm(R @ asked) < 0.05 * np.linalg.norm(R @ wanted)


@pytest.mark.parametrize("seed", range(20))
def test_base_acceleration_minimises_its_cost(seed: int) -> None:
    """The gradient of (a - a_w)ᵀ I (a - a_w) + w m |D (a - a_h)|² vanishes, with D = `taken`."""
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held, taken = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(3, 2))
    weight = float(10.0 ** rng.uniform(-2, 3))
    asked = limited_base_acceleration(state, wanted, held, weight, taken)
    mass = weight * state.model.description.base.mass_kg
    pull = inertia_of(state) * (asked - wanted)
    held_back = mass * taken.T @ taken @ (asked - held)
    np.testing.assert_allclose(pull + held_back, 0.0, atol=1e-9 * (1.0 + mass))


@pytest.mark.parametrize("seed", range(20))
def test_without_weight_or_drag_the_base_acceleration_is_the_desired_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held, taken = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(3, 2))
    for weight, R in ((0.0, taken), (WEIGHT, np.zeros((3, 2)))):
        asked = limited_base_acceleration(state, wanted, held, weight, R)
        np.testing.assert_allclose(asked, wanted, atol=1e-12)


@pytest.mark.parametrize("seed", range(20))
def test_limited_acceleration_never_opposes_the_desired_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held, taken = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(3, 2))
    asked = limited_base_acceleration(state, wanted, held, float(10.0 ** rng.uniform(-2, 4)), taken)
    push = inertia_of(state) * (wanted - held)
    assert push @ (asked - held) >= 0.0
    assert inertia_of(state) @ np.square(asked - held) <= push @ (wanted - held) + 1e-12


@pytest.mark.parametrize("seed", range(5))
def test_larger_weight_reduces_the_drag_of_the_end_effector(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state = random_state(rng)
    wanted, held = rng.normal(size=2), rng.normal(size=2)
    taken = np.outer(rng.normal(size=3), rng.normal(size=2))  # of rank one
    moved = [
        np.linalg.norm(taken @ (limited_base_acceleration(state, wanted, held, w, taken) - held))
        for w in (0.0, 0.1, 1.0, 10.0, 1e3, 1e6)
    ]
    assert (np.diff(moved) < 0).all()
    assert moved[-1] < 1e-4 * moved[0]
