"""The rows of T_sca, each with its activation (§3.2, §3.3)."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.avoidance.closest_points import ClosestPoints
from app.config import RepulsionConfig
from app.robot.state import RobotState
from app.strict import Array


def activation(d: float, d_b: float, d_full: float) -> float:
    """β of a link pair: 0 outside the buffer, 1 at `d_full` and nearer, a cubic between.

    Paper: Figure 10; there d_b = 0.15 m and d_full = 0.05 m.

    Args:
        d: [m] signed distance of the pair.
        d_b: [m] buffer distance.
        d_full: [m] distance at which the task is in full force, below d_b.

    Returns:
        β in [0, 1], with a continuous derivative in d.
    """
    return cubic((d_b - d) / (d_b - d_full))


def cubic(s: float) -> float:
    """0 below 0, 1 above 1, a cubic with flat ends between."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def mobile_activation(betas: Sequence[float]) -> float:
    """β_m, the largest of the activations of the pairs of L_m.

    Paper: Eq. (28).
    """
    return max(betas, default=0.0)


class DistanceJacobian(NamedTuple):
    """How a pair's distance moves: ḋ = J q̇ and d̈ = J q̈ + J̇ q̇."""

    J: Array
    """(n,) Jacobian of the distance."""
    Jdqd: float
    """[m/s²] J̇ q̇, with the turning of l_a."""
    speed: float
    """[m/s] ḋ."""


def distance_jacobian(state: RobotState, closest: ClosestPoints) -> DistanceJacobian:
    """J = uᵀ(J_b - J_a) at the core of l_b, with u fixed to l_a.

    u is the collision library's signed normal: the printed (p_b - p_a)/‖p_b - p_a‖ flips in
    penetration. A face keeps its normal while the closest points of a round link slide along it,
    and the point of the link's core, its radius behind p_b, stays: there d̈ is exact. The curvature
    |v_⊥|²/d of the distance of two fixed points would be ten times as wrong as none.

    Paper: Eq. (21).
    """
    model, pair = state.model, closest.pair
    joint_a, joint_b = model.body_joints[pair.a], model.body_joints[pair.b]
    return DistanceJacobian(*state.pair_motion(joint_a, joint_b, closest.core, closest.n))


class TaskRows(NamedTuple):
    """Rows that enter the stack together under one activation parameter.

    They ask for J q̈ + J̇ q̇ = ẍ.
    """

    J: Array
    """(k, n) Jacobian."""
    Jdqd: Array
    """(k,) J̇ q̇."""
    xdd: Array
    """(k,) desired acceleration."""
    beta: float
    """[-] activation parameter in [0, 1]."""

    @property
    def b(self) -> Array:
        """(k,) right-hand side of J q̈ = ẍ - J̇ q̇."""
        return self.xdd - self.Jdqd


def mobile_rows(base_rows: Array, xdd_m: Array, beta_m: float) -> TaskRows:
    """The rows of the base, one an axis, [J_m O] q̈ = ẍ_m; J̇_m = 0.

    Paper: Eq. (16), (19).
    """
    return TaskRows(base_rows, np.zeros(len(base_rows)), xdd_m, beta_m)


def generate_rep_acc(
    state: RobotState, closest: ClosestPoints, config: RepulsionConfig, beta: float
) -> TaskRows:
    """One row that parts the links of a pair: ẍ_r = k_p - k_v uᵀ(ṗ_b - ṗ_a).

    Paper: Eq. (20).

    Args:
        state: The robot's state.
        closest: Closest points of the pair.
        config: Gains k_p and k_v.
        beta: [-] activation parameter of the pair.
    """
    J, Jdqd, speed = distance_jacobian(state, closest)
    xdd = config.k_p - config.k_v * speed
    return TaskRows(J[None, :], np.array([Jdqd]), np.array([xdd]), beta)


def generate_avoidance_task(rows: Sequence[TaskRows]) -> tuple[Array, Array, Array]:
    """Stack the rows of T_sca.

    Paper: Eq. (22), (23), (24), (25), (27).

    Returns:
        ẍ_sca - J̇_sca q̇ (n_b + k,), J_sca (n_b + k, n), and the diagonal of B (n_b + k,),
        in which the rows of the base share β_m.
    """
    B = np.array([r.beta for r in rows for _ in r.xdd])
    return np.concatenate([r.b for r in rows]), np.concatenate([r.J for r in rows]), B
