"""Activation parameter β of the link pairs."""

from __future__ import annotations

from collections.abc import Sequence

from app.config import ActivationConfig

_ONSET = 0.8  # [-] |n_z| from which on the arm has a share


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
    return _cubic((d_b - d) / (d_b - d_full))


def share_from_above(n_z: float) -> float:
    """How much a pair of L_m meets from above, by the height of the pair's normal.

    0 up to 53 degrees above the horizon, where the base can give way; 1 straight above, where no
    motion of the base changes the distance; a cubic in |n_z| between.

    Args:
        n_z: [-] vertical component of the pair's unit normal.
    """
    return _cubic((abs(n_z) - _ONSET) / (1.0 - _ONSET))


def arm_activation(d: float, n_z: float, config: ActivationConfig) -> float:
    """β of the arm's own row against the base: 0 outside the arm's buffer, 1 in its inner half.

    Our extension. From above no horizontal force helps, so there the arm itself resists, within
    `d_above`. From the side it is the last resort only, within `d_last`: the base has not got away
    in time, or the pair began in penetration. Over the edge one buffer turns into the other. Its
    rows ask for a constant acceleration, far more than a tracking task does: a share of the paper's
    β that only faded out with n_z, such as n_z², would hold a hand up at the buffer's border from
    the side too.

    Args:
        d: [m] signed distance of a pair of L_m.
        n_z: [-] vertical component of the pair's unit normal.
        config: The buffers.

    Returns:
        β in [0, 1], with a continuous derivative in d and n_z.
    """
    buffer = config.d_last + share_from_above(n_z) * (config.d_above - config.d_last)
    return activation(d, buffer, 0.5 * buffer)


def _cubic(s: float) -> float:
    """0 below 0, 1 above 1, a cubic with flat ends between."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def mobile_activation(betas: Sequence[float]) -> float:
    """β_m, the largest of the activations of the pairs of L_m.

    Paper: Eq. (28).
    """
    return max(betas, default=0.0)
