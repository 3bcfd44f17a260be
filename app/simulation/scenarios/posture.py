"""What the searches for a posture of the arm share."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares

Array = np.ndarray

_MOST_EVALUATIONS = 60  # [-] of the residual


def best_posture(
    residual: Callable[[Array], Array],
    jacobian: Callable[[Array], Array],
    guess: Array,
    bounds: tuple[Array, Array],
) -> Array:
    """(n_m,) the joints with the least sum of squared residuals near a guess.

    Args:
        residual: (k,) of joints (n_m,).
        jacobian: (k, n_m) its derivative.
        guess: (n_m,) where the search begins, moved within the bounds.
        bounds: Lower and upper, (n_m,) each.
    """
    inside = np.clip(guess, bounds[0] + 1e-6, bounds[1] - 1e-6)
    return least_squares(
        residual,
        inside,
        jacobian,  # pyright: ignore[reportArgumentType] - read off a default, it may be a function
        bounds=bounds,
        max_nfev=_MOST_EVALUATIONS,
    ).x


def manipulability(J: Array) -> float:
    """√det(J Jᵀ) of a hand's Jacobian (6, n_m); 0 where a direction is lost."""
    return float(np.sqrt(max(np.linalg.det(J @ J.T), 0.0)))
