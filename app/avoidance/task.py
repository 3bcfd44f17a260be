"""The rows of T_sca, each with its activation (§3.2, §3.3)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.avoidance.closest_points import ClosestPoints, Nearest
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


class Distances(NamedTuple):
    """Distances of some pairs and how they move: ḋ = J q̇ and d̈ = J q̈ + J̇ q̇."""

    d: Array
    """(k,) [m] signed distances, or what is left of them."""
    J: Array
    """(k, n) their Jacobians."""
    Jdqd: Array
    """(k,) [m/s²] J̇ q̇, with the turning of l_a."""
    speed: Array
    """(k,) [m/s] ḋ."""

    def of(self, rows: slice | Array) -> Distances:
        """Some of them."""
        return Distances(*[each[rows] for each in self])

    def beyond(self, kept: Array | float) -> Distances:
        """What is left of them beyond the distances that are kept, (k,) or one [m]."""
        return Distances(self.d - kept, *self[1:])


def distances_of(state: RobotState, nearest: Nearest) -> Distances:
    """J = uᵀ(J_b - J_a) at the core of l_b, with u fixed to l_a, of each row.

    u is the signed normal out of l_a: the printed (p_b - p_a)/‖p_b - p_a‖ flips in
    penetration. A face keeps its normal while the closest points of a round link slide along it,
    and the point of the link's core, its radius behind p_b, stays: there d̈ is exact. The curvature
    |v_⊥|²/d of the distance of two fixed points would be ten times as wrong as none.

    Paper: Eq. (21).
    """
    n, core = nearest.points[:, 2], nearest.points[:, 3]
    return Distances(nearest.d, *state.pair_motions(nearest.joints, core, n))


def distance_of(state: RobotState, closest: ClosestPoints) -> Distances:
    """The same of one pair by its closest points."""
    joints = np.array([[state.model.body_joints[body] for body in closest.pair]])
    points = np.array([[closest.p_a, closest.p_b, closest.n, closest.core]])
    d = np.array([closest.d])
    return distances_of(state, Nearest((closest.pair,), joints, ((0,),), d, points))


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


def generate_rep_acc(distance: Distances, config: RepulsionConfig, beta: float) -> TaskRows:
    """One row that parts the links of a pair: ẍ_r = k_p - k_v uᵀ(ṗ_b - ṗ_a).

    Paper: Eq. (20).

    Args:
        distance: That of the pair alone.
        config: Gains k_p and k_v.
        beta: [-] activation parameter of the pair.
    """
    _, J, Jdqd, speed = distance
    return TaskRows(J, Jdqd, config.k_p - config.k_v * speed, beta)


def generate_avoidance_task(rows: Sequence[TaskRows]) -> tuple[Array, Array, Array]:
    """Stack the rows of T_sca.

    Paper: Eq. (22), (23), (24), (25), (27).

    Returns:
        ẍ_sca - J̇_sca q̇ (n_b + k,), J_sca (n_b + k, n), and the diagonal of B (n_b + k,),
        in which the rows of the base share β_m.
    """
    B = np.array([r.beta for r in rows for _ in r.xdd])
    return np.concatenate([r.b for r in rows]), np.concatenate([r.J for r in rows]), B
