"""The offset of one convex shape of l_m as a stack of horizontal rings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.border.mobile import ConvexPart
from app.border.ray_ends import ray_ends

Array = np.ndarray

RAYS = 360
_STEP = 0.01  # [m] between heights, and along the arc above the top
_TOLERANCE = 1e-6  # [m] of the distance on a contour
_MAX_NEWTON = 30
_HIGH_BOTTOM = 0.8  # [-] of d_b: from there on the arc under a bottom needs heights of its own


class Rings(NamedTuple):
    """Closed polygons around one convex shape, one a height, each vertex at the distance d_b.

    Attributes:
        heights: (H,) [m], ascending.
        centres: (H, 2) [m] from which the rays of each height start, in the base's frame.
        vertices: (H, RAYS + 1, 2) [m] in the base's frame, counter-clockwise, the first repeated.
        tangents: (H, RAYS + 1) unit tangents at the vertices, as x + iy.
    """

    heights: Array
    centres: Array
    vertices: Array
    tangents: Array


def trace_rings(part: ConvexPart, d_b: float) -> Rings:
    """The offset of a convex shape above the floor; without any height if it has none there.

    Rays start from the middle of the shape. Where a slice of the offset does not contain it, as of
    a slanted shape, each height has the middle of its own slice.

    Args:
        part: The shape.
        d_b: [m] the offset.
    """
    tracer = _Tracer(part, d_b)
    heights = _levels(float(part.lower[2]), float(part.upper[2]), d_b)
    found = tracer.from_middle(heights) or tracer.from_slices(heights)
    kept = np.array([z for z, _, ends in found if ends is not None])
    centres = np.array([c for _, c, ends in found if ends is not None]).reshape(-1, 2)
    ends = np.array([e for _, _, e in found if e is not None]).reshape(-1, RAYS)
    rings = centres[:, None] + ends[:, :, None] * _DIRECTIONS
    vertices = np.concatenate([rings, rings[:, :1]], axis=1)
    tangents = _vertex_tangents(np.diff(vertices[..., 0] + 1j * vertices[..., 1], axis=1))
    return Rings(kept, centres, vertices, tangents)


_ANGLES = np.linspace(0.0, 2 * np.pi, RAYS, endpoint=False)
_DIRECTIONS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_Level = tuple[float, Array, "Array | None"]  # height, centre, how far each ray goes


class _Tracer:
    """Follows rays to the end of one shape's offset, height by height."""

    def __init__(self, part: ConvexPart, d_b: float) -> None:
        self._part, self._d_b = part, d_b
        self._middle = (part.lower[:2] + part.upper[:2]) / 2

    def from_middle(self, heights: Array) -> list[_Level] | None:
        """All heights from the shape's middle; None if a slice does not contain it."""
        found: list[_Level] = []
        ends: Array | None = None
        for z in heights:
            ends = self._ends(self._middle, float(z), ends)
            hits = np.isfinite(ends)
            if hits.any() and not hits.all():
                return None
            found.append((float(z), self._middle, ends if hits.all() else None))
        return found if any(ends is not None for _, _, ends in found) else None

    def from_slices(self, heights: Array) -> list[_Level]:
        """Each height from the middle of its own slice."""
        found: list[_Level] = []
        centre = self._middle
        for z in heights:
            inside = self._inside(centre, float(z))
            if inside is None:
                found.append((float(z), centre, None))
                continue
            ring = inside + self._ends(inside, float(z), None)[:, None] * _DIRECTIONS
            centre = (ring.min(axis=0) + ring.max(axis=0)) / 2
            ends = self._ends(centre, float(z), None)
            found.append((float(z), centre, ends if np.isfinite(ends).all() else None))
        return found

    def _inside(self, centre: Array, z: float) -> Array | None:
        """(2,) [m] a point inside of the slice at a height, or None if the slice is empty.

        The mean of the far ends that rays from outside find is inside: the slice is convex.
        """
        nearest = self._part.nearest(np.array([*centre, z]))[:2]
        for start in (centre, nearest, self._middle):
            ends = self._ends(start, z, None)
            hits = np.isfinite(ends)
            if hits.all():
                return start
            if hits.any():
                inside = (start + ends[hits, None] * _DIRECTIONS[hits]).mean(axis=0)
                if np.isfinite(self._ends(inside, z, None)).all():
                    return inside
        return None

    def _ends(self, centre: Array, z: float, start: Array | None) -> Array:
        return _ray_ends(self._part, centre, _DIRECTIONS, z, self._d_b, start)


def _vertex_tangents(edges: Array) -> Array:
    """Unit tangents at the vertices, as x + iy: between those of the two edges there.

    Args:
        edges: (H, RAYS).

    Returns:
        (H, RAYS + 1), the first one repeated.
    """
    directions = edges / np.abs(edges)
    tangents = directions + np.roll(directions, 1, axis=1)
    tangents /= np.abs(tangents)
    return np.concatenate([tangents, tangents[:, :1]], axis=1)


def _levels(bottom: float, top: float, d_b: float) -> Array:
    """(H,) [m] heights: every 10 mm beside a shape, then every 10 mm of arc over its upper edge.

    From the floor up; a shape high above it has such an arc under its lower edge too.
    """
    low = bottom if bottom > _HIGH_BOTTOM * d_b else min(0.0, top)
    arc = np.linspace(0.0, np.pi / 2, int(np.ceil(d_b * np.pi / 2 / _STEP)) + 1)[1:]
    # At the very end the contour lies on the flat of the offset, where rays graze: stop just short.
    arc[-1] -= 1e-3
    beside = np.linspace(low, top, max(2, int(np.ceil((top - low) / _STEP)) + 1))
    under = (low - d_b * np.sin(arc))[::-1] if low > 0.0 else np.empty(0)
    levels = np.concatenate([under, beside, top + d_b * np.sin(arc)])
    return levels if levels[0] >= 0.0 else np.concatenate([[0.0], levels[levels > 0.0]])


def _ray_ends(
    part: ConvexPart, centre: Array, rays: Array, z: float, d_b: float, start: Array | None
) -> Array:
    """(RAYS,) [m] how far along each ray the offset of one part ends; −inf where it misses it."""
    outside = float(np.abs(np.concatenate([part.lower, part.upper])[[0, 1, 3, 4]]).max())
    beyond = 2 * (outside + d_b + float(np.abs(centre).max()))
    first = np.full(len(rays), beyond)
    if start is not None:
        first = np.where(np.isfinite(start), start, beyond)
    origin = np.array([centre[0], centre[1], z])
    if part.measures is not None:
        at = part.placement
        return ray_ends(*part.measures, at.rotation, at.translation, rays, origin, first, d_b)
    pairs = zip(rays.tolist(), first.tolist(), strict=True)
    return np.array([_newton(part, origin, ray, s, d_b) for ray, s in pairs])


def _newton(part: ConvexPart, origin: Array, ray: Sequence[float], s: float, d_b: float) -> float:
    """`app.border.ray_ends.ray_ends` for one ray and any convex part."""
    point = origin.copy()
    for _ in range(_MAX_NEWTON):
        point[0], point[1] = origin[0] + s * ray[0], origin[1] + s * ray[1]
        d, normal = part.distance_and_normal(point)
        slope = normal[0] * ray[0] + normal[1] * ray[1]
        if abs(d - d_b) < _TOLERANCE:
            return s if slope >= 0.0 else -np.inf
        if slope <= 1e-9:
            return -np.inf
        s -= (d - d_b) / slope
    return s
