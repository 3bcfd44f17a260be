"""Closest points by `SmoothPoints`, and by the collision library alone, as their oracle."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.avoidance.closest_points import (
    ClosestPoints,
    DistanceMonitor,
    SmoothPoints,
    _core,
    mean_nearest,
)
from app.border.dbb import Border
from app.border.nearest import OffsetContours, border_struct, nearest_border
from app.robot.link_pairs import Pair
from app.robot.shapes import Capsule, Sphere
from app.robot.state import RobotState

Array = np.ndarray


class Nearest(NamedTuple):
    """Closest points that move continuously, in the rows of `mean_nearest`."""

    pairs: Sequence[Pair]
    joints: Array
    """(k, 2) pinocchio's indices of the joints that move `a` and `b`."""
    rows: Sequence[Sequence[int]]
    d: Array
    """(k,) [m] signed distances."""
    points: Array
    """(k, 4, 3) [m] p_a, p_b, n and core of `ClosestPoints`, in the world."""

    def closest(self, i: int) -> ClosestPoints:
        """The closest points of the i-th pair, with its parts."""
        found = [ClosestPoints(self.pairs[i], self.d[k], *self.points[k]) for k in self.rows[i]]
        return found[0]._replace(parts=tuple(found[1:]))


class Foot(NamedTuple):
    """The border point nearest to a query point, among those at its height; in the base's frame."""

    p: Array
    """(3,) [m] the point of the border."""
    t: Array
    """(3,) horizontal unit tangent there; on the surface, l_m is on its left."""


class BorderSearch:
    """The search of a border for the point nearest to a query point."""

    def __init__(self, offset: OffsetContours, borders: Sequence[Border] = ()) -> None:
        self.struct = border_struct(offset, borders)

    def nearest(self, p: Array) -> Foot | None:
        """The border point of the first pair nearest to p (3,) [m]; None if l_m has no border."""
        foot = Foot(*nearest_border(self.struct, 0, np.ascontiguousarray(p, dtype=float)))
        return None if np.isnan(foot.p[0]) else foot


class SmoothMonitor(DistanceMonitor):
    """Distances of the collision library, and the closest points of `SmoothPoints`."""

    def find_nearest(self, blend: float) -> Nearest:
        """The closest points in the present state; `blend` [m] is the smoothing length."""
        self._distances.update_from(self._state.data)
        pairs = self._distances.pairs
        smooth = SmoothPoints(self._state.model, pairs)
        points = smooth_points(smooth, self._state, blend)
        d = np.empty(len(points))
        self._distances.write_distances(d)
        return Nearest(pairs, smooth.arrays["pair_joints"], smooth.rows, d, points)


def smooth_points(smooth: SmoothPoints, state: RobotState, blend: float) -> Array:
    """The points of `mean_nearest` in the present state."""
    fixed = smooth.arrays
    placed = [state.data.oMi[joint] for joint in fixed["body_joints"].tolist()]
    poses = np.concatenate([part for T in placed for part in (T.rotation, T.translation[None])])
    bodies = fixed["shapes"], fixed["triangles"], fixed["nodes"], fixed["firsts"]
    return mean_nearest(bodies, fixed["sought"], poses, blend)


class Placed:
    """A placed shape of coal that measures its distance from points."""

    def __init__(self, geometry: coal.CollisionGeometry, placement: pin.SE3) -> None:
        self._geometry, self._point, self._T = geometry, coal.Sphere(0.0), coal.Transform3s()
        self._placed = coal.Transform3s(placement.rotation, placement.translation)

    def distance(self, p: Array) -> tuple[float, Array]:
        """Signed distance [m] from a point (3,) [m] and the unit vector (3,) towards it."""
        self._T.setTranslation(p)
        result = coal.DistanceResult()
        args = self._geometry, self._placed, self._point, self._T
        d = coal.distance(*args, coal.DistanceRequest(), result)
        return d, result.normal.copy()


def library_nearest(state: RobotState, pair: Pair, blend: float, parts: slice) -> Array:
    """(4, 3) p_a [m], p_b [m], n [-] and core [m] in the world, for the shapes `parts` of `a`."""
    model, at = state.model, []
    for body in pair:
        objects = [model.geometry.geometryObjects[i] for i in model.shape_ids[body]]
        shapes = model.description.body(body).shapes
        placement = state.data.oMi[model.body_joints[body]]
        placed = [Placed(each.geometry, placement * each.placement) for each in objects]
        cores = [_core(*each) for each in zip(shapes, objects, strict=True)]
        nodes = [(placement.act(node), radius) for points, radius in cores for node in points]
        flat = [
            p for p, s in zip(placed, shapes, strict=True) if not isinstance(s, Capsule | Sphere)
        ]
        at.append((placed, nodes, flat))
    (a, corners, _), (_, nodes, flat) = at
    for face in flat:
        for corner, _ in corners:
            d, n = face.distance(corner)
            nodes.append((corner - d * n, 0.0))
    points, radii = np.array([p for p, _ in nodes]), np.array([r for _, r in nodes])
    d = np.array([min(part.distance(p)[0] for part in a[parts]) for p in points]) - radii
    weights = np.exp((d.min() - d) / blend)
    weights /= weights.sum()
    core, radius = weights @ points, float(weights @ radii)
    sides = [part.distance(core) for part in a[parts]]
    least = min(d for d, _ in sides)
    share = np.array([np.exp((least - d) / blend) for d, _ in sides])
    share /= share.sum()
    n = np.sum([w * normal for w, (_, normal) in zip(share, sides, strict=True)], axis=0)
    foot = np.sum([w * d * normal for w, (d, normal) in zip(share, sides, strict=True)], axis=0)
    return np.array([core - foot, core - radius * n, n, core])
