"""Derivatives by central differences."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Array = np.ndarray

STEP = 1e-6  # balances truncation (1e-12) and rounding (1e-10) for quantities near 1


def derivative(f: Callable[[float], Array], h: float = STEP) -> Array:
    """Derivative at 0 of an array-valued function of a number, by central differences ±h."""
    return (np.asarray(f(h)) - np.asarray(f(-h))) / (2 * h)


def jacobian(f: Callable[[Array], Array], n: int, h: float = STEP) -> Array:
    """(m, n) Jacobian at 0 of f, by differences ±h; (n,) if f returns a single number."""
    columns = [derivative(lambda t, e=e: f(t * e), h) for e in np.eye(n)]
    return np.stack(columns, axis=-1)
