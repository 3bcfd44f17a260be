"""The rows of T_sca, each with its activation (§3.2, §3.3)."""

from __future__ import annotations

from app.compiled import compiled
from app.strict import Array
from app.structs import put


@compiled()
def cubic(s: float) -> float:
    """A smooth step: 0 for s < 0, 1 for s > 1, between them a cubic with slope 0 at both ends."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


@compiled()
def activation(d: float, d_b: float, d_full: float) -> float:
    """β of a link pair: 0 outside the buffer, 1 for d ≤ `d_full`, a cubic between.

    Paper: Figure 10; there d_b = 0.15 m and d_full = 0.05 m.

    Args:
        d: [m] signed distance of the pair.
        d_b: [m] buffer distance.
        d_full: [m] distance at which the task is fully active, below d_b.

    Returns:
        β in [0, 1], with a continuous derivative in d.
    """
    return cubic((d_b - d) / (d_b - d_full))


@compiled()
def mobile_activation(beta: Array) -> float:
    """β_m, the largest of the activations (n_mob,) of the pairs of L_m.

    Paper: Eq. (28).
    """
    largest = 0.0
    for each in beta:
        largest = max(largest, each)
    return largest


@compiled()
def generate_rep_acc(d_dot: float, k_p: float, k_v: float) -> float:
    """ẍ_r = k_p − k_v ḋ [m/s²]: separates the links of a pair.

    Paper: Eq. (20), where ḋ [m/s] is nᵀ(ṗ_b − ṗ_a). k_p is in m/s², k_v in 1/s.
    """
    return k_p - k_v * d_dot


@compiled()
def generate_rep_force_acc(n: Array, velocity: Array, k_p: float, k_v: float) -> Array:
    """ẍ_rep = k_p n − k_v ṗ (3,) [m/s²]: pushes the arm's closest point away from the base.

    This is the compared method `repulsive`, realised by the arm alone. §4.2.1 names the method; its
    force on the closest point and its damping are Dietrich's (2011, 2012).

    Args:
        n: (3,) unit normal from the base to the arm.
        velocity: (3,) [m/s] ṗ, velocity of the closest point relative to the base.
        k_p: [m/s²] gain of the repulsion.
        k_v: [1/s] gain of the damping.
    """
    return k_p * n - k_v * velocity


@compiled()
def generate_avoidance_task(
    base_rows: Array,
    xdd_m: Array,
    beta_m: float,
    J_r: Array,
    b_r: Array,
    beta_r: Array,
    J_sca: Array,
    b_sca: Array,
    B: Array,
) -> None:
    """Write the rows of T_sca: those of the base, then those between links.

    The base's rows are [J_m O] q̈ = ẍ_m with J̇_m = 0; all have the activation β_m.

    Paper: Eq. (16), (19), (22), (23), (24), (25), (27).

    Args:
        base_rows: (n_b, n) [J_m O].
        xdd_m: (n_b,) [m/s² or rad/s²] ẍ_m of (16).
        beta_m: [-] β_m of (28).
        J_r: (k, n) Jacobians of the distances of L_m^c, (21).
        b_r: (k,) [m/s²] ẍ_r − J̇_r q̇ of these pairs.
        beta_r: (k,) [-] activations of these pairs.
        J_sca: (≥ n_b + k, n) output.
        b_sca: (≥ n_b + k,) ẍ_sca − J̇_sca q̇, output.
        B: (≥ n_b + k,) the diagonal of B, output.
    """
    n_b = len(xdd_m)
    for i in range(n_b):
        put(J_sca[i], base_rows[i])
        b_sca[i], B[i] = xdd_m[i], beta_m
    for i in range(len(b_r)):
        put(J_sca[n_b + i], J_r[i])
        b_sca[n_b + i], B[n_b + i] = b_r[i], beta_r[i]
