"""The stack below self-collision avoidance: what hand, posture and base do by themselves."""

from functools import lru_cache
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.config import TaskConfig
from app.control import kernels
from app.control.qp import Objective
from app.robot.state import RobotState
from app.strict import Array


class Reference(NamedTuple):
    """Where the end-effector shall be, in the world."""

    pose: pin.SE3
    """T_world_ee."""
    velocity: Array
    """(6,) linear [m/s] over angular [rad/s]."""
    acceleration: Array
    """(6,) linear [m/s²] over angular [rad/s²]."""


class EqualityTask(NamedTuple):
    """J q̈ + w = b, to be met as closely as what comes before it allows."""

    J: Array
    """(k, n)."""
    b: Array
    """(k,) desired acceleration less J̇ q̇."""
    give: float
    """[m²] λ of `tracking_objective`."""
    drag: Array
    """(n,) [rad/s² or m/s²] k_v q̇."""


class EndEffectorError(NamedTuple):
    """How far the end-effector is from its reference."""

    pose: Array
    """(6,) x_d ⊖ x, linear [m] over angular [rad]."""
    velocity: Array
    """(6,) ẋ_d - ẋ."""
    acceleration: Array
    """(6,) ẍ_d - J̇_ee q̇, what J_ee q̈ is without any error."""


def end_effector_error(state: RobotState, reference: Reference) -> EndEffectorError:
    """The end-effector's, with rotations as rotation vectors in axes of the world."""
    at, (wanted, velocity, acceleration) = state.T_world_ee, reference
    turn = pin.log3(wanted.rotation @ at.rotation.T)
    pose = np.concatenate((wanted.translation - at.translation, turn))
    return EndEffectorError(pose, velocity - state.v_ee, acceleration - state.Jdqd_ee)


def end_effector_task(
    state: RobotState, error: EndEffectorError, config: TaskConfig
) -> EqualityTask:
    """T_ee ∈ ℝ⁶: J_ee q̈ + J̇_ee q̇ + w = ẍ_d + k_v (ẋ_d - ẋ) + k_p (x_d ⊖ x).

    The pull k_p (x_d ⊖ x) is at most k_v times the speed at which an error is taken back, of its
    linear and of its angular part: a target however far away asks for no more than that speed.

    Paper: Eq. (26), its task T_2.
    """
    k_p, k_v = config.ee_stiffness, config.ee_damping
    b, left = kernels.to_reference(*error, k_p, k_v, k_v * config.ee_speed)
    return EqualityTask(state.J_ee, b, left, k_v * state.qd)


def tracking_objective(posture: Objective, task: EqualityTask, weight: float) -> Objective:
    """T_ee above the posture: ½ w ‖J_ee q̈ - b‖² beside it, with a weight w [-] that decides.

    A strict level would ask for unbounded accelerations where a limit or another task makes it
    nearly dependent; this one gives in there, and is off by 1/w of what the posture pulls.

    An error that is left damps it, λ ‖q̈ + k_v q̇‖² in the posture's weights with λ its square
    (Levenberg and Marquardt, by Sugihara 2011): an arm at full stretch comes to rest.

    Paper: Eq. (26).
    """
    return Objective(*kernels.with_task(*posture, *task, weight))


def base_rest_acceleration(state: RobotState, config: TaskConfig) -> Array:
    """-k ν: what the base does while nothing moves it, (n_b,) [m/s² or rad/s²]."""
    return -config.base_damping * state.measurement.base_velocity


def posture_objective(state: RobotState, q_posture: Array, config: TaskConfig) -> Objective:
    """The arm towards a posture (n_m,), the base to rest, the base's acceleration far costlier.

    Without it (26) leaves the null space of T_2 open: nine accelerations, six rows. A joint at the
    share s of its way from the middle of its range to a limit is drawn back as if the way were s⁵:
    hardly at all near the middle, and enough at a limit that no wrist ends in a corner while the
    tasks above leave another way.
    """
    m, n_b = state.measurement, state.model.n_b
    c = np.empty(state.model.n)
    c[:n_b] = config.base_weight * config.base_damping * state.qd[:n_b]
    c[n_b:] = kernels.towards_posture(
        m.q_m,
        m.qd_m,
        q_posture,
        state.model.q_limits,
        config.posture_stiffness,
        config.posture_damping,
        config.centring,
    )
    return Objective(_posture_hessian(state.model.n, n_b, config.base_weight), c)


@lru_cache(maxsize=8)
def _posture_hessian(n: int, n_b: int, base_weight: float) -> Array:
    """(n, n), not to be written to."""
    return np.diag([base_weight] * n_b + [1.0] * (n - n_b))


def free_arm_torque(state: RobotState) -> Array:
    """u_0 = g_a - D q̇_a: gravity compensation and joint damping, (n_m,)."""
    return state.g[state.model.n_b :] - state.model.joint_damping * state.measurement.qd_m


def guided_objective(state: RobotState, u_0: Array) -> Objective:
    """Min (u_a - u_0)ᵀ M_aa⁻¹ (u_a - u_0): a guided arm gives only what avoidance asks of it.

    Here u_0 (n_m,) [N m or N] is what the arm does by itself. In q̈_a the Hessian is M_aa; with the
    base's acceleration given and no rows it returns u_a = u_0, and with rows u_a = u_0 + J_rᵀ λ.
    There is no posture: it would be felt.
    """
    n_b = state.model.n_b
    c = np.zeros(state.model.n)
    c[n_b:] = state.h[n_b:] - u_0
    return Objective(state.M, c)


def with_base_at_rest(state: RobotState, guided: Objective, config: TaskConfig) -> Objective:
    """The same over base and arm: the base comes to rest at the cost of its weight."""
    n_b, w = state.model.n_b, config.base_weight
    M_ab, c = state.M[n_b:, :n_b], guided.c.copy()
    share = np.linalg.solve(state.M[n_b:, n_b:], np.column_stack([M_ab, c[n_b:]]))
    H = state.M.copy()
    H[:n_b, :n_b] = w * np.eye(n_b) + M_ab.T @ share[:, :n_b]
    c[:n_b] = w * config.base_damping * state.qd[:n_b] + M_ab.T @ share[:, n_b]
    return Objective(H, c)


def carried(state: RobotState, speed: float) -> Array:
    """(3, n_b) R: what the hand's place moves by the base's axes, less what the arm makes up for.

    The method moves the base and leaves the hand to the arm. An arm that lacks a joint for that, or
    stands at full stretch, does not hold the hand: the base takes it along, the distance stays what
    it was, and the base would drive on with the hand before it. Our extension:
    R = (1 + (J Q² Jᵀ / v²)²)⁻¹ J_b with J and J_b the arm's and the base's part of the hand's
    Jacobian, Q the joints' largest speeds and v a speed [m/s]. Along a direction in which they move
    the hand at v, half of the base's motion is left, and along one of twice that a seventeenth.
    """
    model = state.model
    return kernels.carried(state.J_ee, model.qd_max, model.J_m_inv, speed)


def base_with_hand(
    state: RobotState, wanted: Array, held: Array, weight: float, taken: Array
) -> Array:
    """The base's acceleration nearest to the wanted one that does not take the hand along, (n_b,).

    The least of (a - a_wanted)ᵀ I (a - a_wanted) + w m ‖R K (a - a_held)‖²: as if a mass hung on
    the hand where the arm does not follow. Where it does, R = 0 and this is the wanted one.

    Args:
        state: The robot's state.
        wanted: (n_b,) [m/s² or rad/s²] of (29).
        held: (n_b,) with which the hand does what its own task asks.
        weight: [-] w, of the hand in masses of the base.
        taken: (3, n_b) R of `carried` times K, what the admittance law makes of an acceleration.
    """
    model = state.model
    mass = weight * model.description.base.mass_kg
    return kernels.with_hand(wanted, held, model.base_inertia, mass, taken)
