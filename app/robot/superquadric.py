"""The surface of a superquadric (hyper-ellipsoid), and a convex polytope that stands for it.

f(p) = (|x/a|^(2/e₂) + |y/b|^(2/e₂))^(e₂/e₁) + |z/c|^(2/e₁) is 1 on the surface and less inside.
e₁ rounds the shape from top to bottom, e₂ in plan: 1 is an ellipsoid, towards 0 it becomes a box.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np

Array = np.ndarray

INTERVALS = 24
"""[-] along each edge of the cube whose grid is projected onto the surface."""


def implicit(p: Array, semi_axes: Sequence[float], e1: float, e2: float) -> Array:
    """The function f at points (…, 3) [m] in the superquadric's frame, (…); 1 on its surface.

    Args:
        p: (…, 3) [m] points.
        semi_axes: a, b, c [m].
        e1: e₁, from top to bottom.
        e2: e₂, in plan.
    """
    x, y, z = np.moveaxis(np.abs(p) / np.asarray(semi_axes), -1, 0)
    # By the largest of each sum: a power of 2/e of a number far from 1 would overflow.
    plan = _power_sum(x, y, e2 / 2)
    return _power_sum(plan, z, e1 / 2) ** (2 / e1)


def onto_surface(p: Array, semi_axes: Sequence[float], e1: float, e2: float) -> Array:
    """(…, 3) [m] where the rays from the centre through points (…, 3) meet the surface."""
    scaled = np.asarray(p) / np.abs(np.asarray(p) / np.asarray(semi_axes)).max(-1, keepdims=True)
    return scaled * implicit(scaled, semi_axes, e1, e2)[..., None] ** (-e1 / 2)


def around_box(size: Sequence[float], e1: float, e2: float) -> tuple[float, float, float]:
    """Semi-axes [m] of the superquadric on which all corners of a box lie.

    Args:
        size: (3,) [m] full side lengths of the box.
        e1: e₁, from top to bottom.
        e2: e₂, in plan.
    """
    growth = (2.0 ** (e2 / e1) + 1.0) ** (e1 / 2)
    a, b, c = (0.5 * side * growth for side in size)
    return a, b, c


@lru_cache(maxsize=16)
def polytope_vertices(
    semi_axes: tuple[float, float, float], e1: float, e2: float, intervals: int = INTERVALS
) -> Array:
    """Points of the surface whose convex hull stands for the superquadric, read-only.

    They are the points of a cube's grid, denser towards its edges, where a small exponent bends the
    surface most. The hull lies inside of the surface.

    Returns:
        (6 intervals² + 2, 3) [m] in the superquadric's frame.
    """
    s = np.sin(np.linspace(-0.5, 0.5, intervals + 1) * np.pi)
    u, v = (grid.ravel() for grid in np.meshgrid(s, s))
    ones = np.ones_like(u)
    faces = [
        np.roll(np.column_stack([sign * ones, u, v]), axis, axis=1)
        for axis in range(3)
        for sign in (-1.0, 1.0)
    ]
    cube = np.unique(np.round(np.vstack(faces), 12), axis=0)
    vertices = onto_surface(cube * np.asarray(semi_axes), semi_axes, e1, e2)
    vertices.setflags(write=False)
    return vertices


def _power_sum(a: Array, b: Array, e: float) -> Array:
    """(a^(1/e) + b^(1/e))^e for numbers of zero or more, without overflow."""
    high, low = np.maximum(a, b), np.minimum(a, b)
    ratio = np.divide(low, high, out=np.zeros_like(high), where=high > 0)
    return high * (1.0 + ratio ** (1.0 / e)) ** e
