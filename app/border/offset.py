"""The border as a surface in the base's frame: the exact offset {p : distance to l_m = d_b}."""

from __future__ import annotations

from typing import Any

import numpy as np

from app.border.dbb import Cloud, construct_dbb
from app.border.mobile import ConvexPart, MobileBody, Shapes
from app.border.nearest import BLOCK, OffsetContours, border_struct
from app.config import BorderConfig
from app.robot.model import RobotModel, kept_per_model
from app.strict import Array

RAYS = 360  # number of rays from the centre of a slice
_STEP = 0.01  # [m] largest distance between heights, or along the arcs at top and bottom
_HIGH_BOTTOM = 0.8  # [-] offsets have an arc below a shape whose bottom / d_b is above this
_ANGLES = np.linspace(0.0, 2 * np.pi, RAYS, endpoint=False)
_RAYS = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES), np.zeros(RAYS)])
_TOUCHING = 2e-6  # [m] tolerance with which flush shapes count as outside of each other
_ALONE = 1.0  # [m] upper bound of `_shown`, and its value if there are no other shapes
_MAX_NEWTON = 30  # [-] largest number of Newton steps along a ray
_AT_END = 1e-9  # [m] tolerance of the distance d_b at a ray's end

_Rings = tuple[Array, Array]
"""Counter-clockwise polygons around one convex shape, at the distance d_b from it: ascending
heights (H,) [m], and vertices (H, RAYS + 1) [m] as x + iy. The last vertex equals the first."""


@kept_per_model(4)
def offset_contours(model: RobotModel, d_b: float) -> OffsetContours:
    """The contours for d_b [m], with shapes by decreasing horizontal size; cached by model."""
    parts = MobileBody(model).parts
    parts.sort(key=lambda part: -float(np.prod((part.upper - part.lower)[:2])))
    traced = [(part, rings) for part in parts if len((rings := _trace_rings(part, d_b))[0])]
    kept = list(range(len(traced)))

    def shown(k: int) -> Array:
        return _shown(traced[k][1], [traced[j][0] for j in kept if j != k], d_b)

    for k in reversed(range(len(traced))):  # a hidden shape hides no other shape
        if (shown(k) <= 0.0).all():
            kept.remove(k)
    rings = [traced[k][1] for k in kept]
    none = np.empty((0, RAYS + 1))
    vertices = np.concatenate([none.astype(complex), *(each for _, each in rings)])
    directions = np.diff(vertices, axis=1)
    directions /= np.abs(directions)
    tangents = directions + np.roll(directions, 1, axis=1)
    tangents /= np.abs(tangents)
    blocks = np.arange(0, RAYS, BLOCK)[:, None] + np.arange(BLOCK + 1)
    middles = vertices[:, blocks[:, BLOCK // 2]]
    return OffsetContours(
        np.cumsum([0, *(len(heights) for heights, _ in rings)]),
        np.concatenate([none[:, 0], *(heights for heights, _ in rings)]),
        vertices,
        np.concatenate([tangents, tangents[:, :1]], axis=1),
        np.concatenate([none, *map(shown, kept)]),
        np.abs(vertices[:, blocks] - middles[:, :, None]).max(axis=2, initial=0.0),
    )


@kept_per_model(8)
def border_of(model: RobotModel, clouds: tuple[Cloud, ...], config: BorderConfig) -> Any:
    """The struct `BORDER` of the configured kind, for the pairs of the clouds; cached by model."""
    contours = offset_contours(model, config.d_b)
    if config.kind == "surface":
        return border_struct(contours)
    return border_struct(contours, [construct_dbb(each, config.d_b, config.eps) for each in clouds])


def _shown(rings: _Rings, others: list[ConvexPart], d_b: float) -> Array:
    """(H, RAYS + 1) [m] signed distance of each vertex from the other offsets, at most 1 m."""
    heights, vertices = rings
    z = np.broadcast_to(heights[:, None], vertices.shape)
    points = np.stack([vertices.real, vertices.imag, z], axis=-1).reshape(-1, 3)
    far = Shapes.together([each.shapes for each in others]).distances_and_normals(points)[:, 0]
    return np.minimum(d_b + _ALONE, far).reshape(vertices.shape) - d_b + _TOUCHING


def _trace_rings(part: ConvexPart, d_b: float) -> _Rings:
    """Trace the offset of a convex shape by d_b [m], above the floor. All rays start at the shape's
    centre. If any slice does not contain it, the rays of every slice start at their slice's centre.
    """
    tracer = _Tracer(part, d_b)
    heights = _levels(float(part.lower[2]), float(part.upper[2]), d_b).tolist()
    found = tracer.from_middle(heights) or tracer.from_slices(heights)
    centres = np.array([centre for _, centre, _ in found]).reshape(-1, 2)
    ends = np.array([ends for _, _, ends in found]).reshape(-1, RAYS)
    rings = centres[:, None] + ends[:, :, None] * _RAYS[:, :2]
    vertices = rings[..., 0] + 1j * rings[..., 1]
    return np.array([z for z, _, _ in found]), np.concatenate([vertices, vertices[:, :1]], axis=1)


class _Tracer:
    """Follows rays to the boundary of one shape's offset at some heights [m].

    For each height with a slice of the offset, the results of `from_middle` and `from_slices` have
    the height, the start (2,) [m] of the rays and their lengths (RAYS,) [m].
    """

    def __init__(self, part: ConvexPart, d_b: float) -> None:
        self._part, self._d_b = part, d_b
        self._middle = (part.lower[:2] + part.upper[:2]) / 2

    def from_middle(self, heights: list[float]) -> list[tuple[float, Array, Array]] | None:
        """Trace each height from the shape's centre; None if the centre is outside of a slice."""
        found, ends = [], np.full(RAYS, -np.inf)
        for z in heights:
            ends = self._ends(self._middle, z, ends)
            hits = np.isfinite(ends)
            if hits.all():
                found.append((z, self._middle, ends))
            elif hits.any():
                return None
        return found

    def from_slices(self, heights: list[float]) -> list[tuple[float, Array, Array]]:
        """Trace each height from the centre of the slice at this height."""
        found, centre = [], self._middle
        for z in heights:
            if (inside := self._inside(centre, z)) is None:
                continue
            ring = inside + self._ends(inside, z)[:, None] * _RAYS[:, :2]
            centre = (ring.min(axis=0) + ring.max(axis=0)) / 2
            ends = self._ends(centre, z)
            if np.isfinite(ends).all():
                found.append((z, centre, ends))
        return found

    def _inside(self, centre: Array, z: float) -> Array | None:
        """A point (2,) [m] inside the convex slice at height z [m]; None if the slice is empty."""
        d, n_x, n_y, _ = self._part.shapes.distances_and_normals(np.array([[*centre, z]]))[0]
        for start in (centre, centre - d * np.array([n_x, n_y]), self._middle):
            ends = self._ends(start, z)
            hits = np.isfinite(ends)
            if hits.all():
                return start
            if hits.any():  # the mean of the far side's ends
                inside = (start + ends[hits, None] * _RAYS[hits, :2]).mean(axis=0)
                if np.isfinite(self._ends(inside, z)).all():
                    return inside
        return None

    def _ends(self, centre: Array, z: float, start: Array | float = -np.inf) -> Array:
        """(RAYS,) [m] lengths of the rays from `centre` (2,) at height z to the far side of the
        offset; −inf without a hit. The finite numbers of `start` are the initial estimates.
        """
        part, origin, ends = self._part, np.array([*centre, z]), np.full(RAYS, -np.inf)
        outside = float(np.abs([part.lower[:2], part.upper[:2]]).max())
        beyond = 2 * (outside + self._d_b + float(np.abs(centre).max()))
        s, left = np.where(np.isfinite(start), start, np.full(RAYS, beyond)), np.arange(RAYS)
        # The distance to a convex shape is convex along a ray: where it increases, the first step
        # ends at the outer root or beyond, and the next steps approach the root from outside.
        for _ in range(_MAX_NEWTON):
            found = part.shapes.distances_and_normals(origin + s[left, None] * _RAYS[left])
            off, slope = found[:, 0] - self._d_b, (found[:, 1:] * _RAYS[left]).sum(axis=1)
            there, rising = np.abs(off) < _AT_END, slope > 1e-9
            on_border = left[there & (slope >= 0.0)]
            ends[on_border] = s[on_border]
            further = ~there & rising
            left = left[further]
            if not len(left):
                return ends
            s[left] -= off[further] / slope[further]
        ends[left] = s[left]
        return ends


def _levels(bottom: float, top: float, d_b: float) -> Array:
    """(H,) [m] heights of the traced slices of an offset, at most 10 mm apart: from the floor, or
    from the lowest point of the offset if this is above the floor, to the top of the offset.
    """
    low = bottom if bottom > _HIGH_BOTTOM * d_b else min(0.0, top)
    arc = np.linspace(0.0, np.pi / 2, int(np.ceil(d_b * np.pi / 2 / _STEP)) + 1)[1:]
    # At the end of the arc the offset is flat, and rays are tangent to it: stop just before.
    arc[-1] -= 1e-3
    beside = np.linspace(low, top, max(2, int(np.ceil((top - low) / _STEP)) + 1))
    under = (low - d_b * np.sin(arc))[::-1] if low > 0.0 else np.empty(0)
    levels = np.concatenate([under, beside, top + d_b * np.sin(arc)])
    return levels if levels[0] >= 0.0 else np.concatenate([[0.0], levels[levels > 0.0]])
