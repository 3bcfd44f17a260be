"""Activation parameter β of the link pairs."""

from __future__ import annotations

from collections.abc import Sequence


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
