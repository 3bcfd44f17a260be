"""FindClosestPoints: signed distances of all link pairs, with a normal that keeps its sign.

Inside a buffer the closest point of a pair moves continuously, also along a link that turns
parallel to a face.
"""

import math
from collections.abc import Sequence
from itertools import product

import coal
import numpy as np
import pinocchio as pin

from app.border.mobile import ConvexPart, mean_nearest
from app.robot.link_pairs import ClosestPoints, Pair, PairDistances, with_parts
from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, Cylinder, Shape, Sphere
from app.robot.state import RobotState
from app.strict import Array

_ALONG = 7  # nodes of a capsule
_SIGNS = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if any(v)])  # 26 directions


class DistanceMonitor:
    """Distances of a fixed set of link pairs at the robot's present state."""

    def __init__(self, state: RobotState, pairs: Sequence[Pair]) -> None:
        """Prepare the pairs, in the order of the results; `state` is read at each call."""
        self._state = state
        self._distances = PairDistances(state.model, pairs)
        self._smooth = [SmoothPoint(state, pair) for pair in pairs]

    def find_closest_points(
        self, *, within: float = -math.inf, blend: float = math.nan
    ) -> list[ClosestPoints]:
        """The closest points of every pair; within a distance such as move continuously.

        Paper: Algorithm 2, lines 4 and 9. The direction is the collision library's signed normal,
        not p_b - p_a, which flips in penetration and would turn repulsion into attraction.

        Args:
            within: [m] such as the buffer distance; by default all are the library's own.
            blend: [m] of `SmoothPoint`.
        """
        self._distances.update_from(self._state.data)
        found = []
        for i, smooth in enumerate(self._smooth):
            d = self._distances.distance_by_part(i)
            near = d[0] < within
            found.append(smooth.closest(d, blend) if near else self._distances.closest(i))
        return found

    def distances(self) -> tuple[float, ...]:
        """[m] the signed distance of every pair, without the points."""
        self._distances.update_from(self._state.data)
        return self._distances.distances()


class SmoothPoint:
    """The mean over a link's core, each point by how little farther than the nearest it is.

    The library's closest point is one of many where a capsule lies along a face, and leaps from one
    end to the other as it turns. Weights exp((min d - d_k)/τ) over some nodes of the core make a
    motion of that, for every d_k is continuous. Where one point is clearly nearest it is that one.

    Where `a` has several convex parts the normal is the mean of theirs at that point, by the same
    weights: the gradient of a smooth distance, which is shorter than 1 in a corner between two.

    A flat face may be nearest anywhere: there the points nearest to the corners of `a` are nodes.
    """

    def __init__(self, state: RobotState, pair: Pair) -> None:
        """Prepare for the body `b` of a pair against its body `a`; `state` is read each time."""
        self._pair = pair
        model, oMi = state.model, state.data.oMi
        self._at_a, self._at_b = oMi[model.body_joints[pair.a]], oMi[model.body_joints[pair.b]]
        a, b = _shapes(model, pair.a), _shapes(model, pair.b)
        self._parts = [ConvexPart(each.geometry, each.placement) for _, each in a]
        alone = [slice(k, k + 1) for k in range(len(a))]
        self._groups = [slice(len(a)), *(alone if len(a) > 1 else [])]
        self._corners = np.vstack([_core(*shape)[0] for shape in a])
        self._faces = [
            ConvexPart(each.geometry, each.placement)
            for shape, each in b
            if not isinstance(shape, Capsule | Sphere)
        ]
        cores = [_core(*shape) for shape in b]
        self._nodes = np.vstack(
            [np.column_stack([nodes, np.full(len(nodes), radius)]) for nodes, radius in cores]
        )
        placed = [part.placed for part in (*self._parts, *self._faces)]
        known = [each for each in placed if each is not None]
        self._shapes = np.vstack(known) if len(known) == len(placed) else None

    def closest(self, d: Sequence[float], blend: float) -> ClosestPoints:
        """The closest points at the signed distances d [m], of the pair and then of each part."""
        found = zip(d, self.find(blend), strict=True)
        return with_parts(*[ClosestPoints(self._pair, each, *points) for each, points in found])

    def find(self, blend: float) -> list[Array]:
        """The closest points of the pair, then of each part of `a` by itself if it has several.

        Args:
            blend: [m] τ.

        Returns:
            (4, 3) [m] of each, in the world: the points on `a` and on `b`, the normal from `a` to
            `b`, and the point of the core of `b`.
        """
        if self._shapes is None:
            return self.by_library(blend)
        a, b, split = self._at_a, self._at_b, len(self._parts)
        placed = a.rotation, a.translation, b.rotation, b.translation
        shapes, faces = self._shapes[:split], self._shapes[split:]
        return [
            mean_nearest(shapes[group], self._corners, self._nodes, faces, *placed, blend)
            for group in self._groups
        ]

    def by_library(self, blend: float) -> list[Array]:
        """The same of shapes that the kernel does not know, slower."""
        placed = self._at_a
        relative = placed.actInv(self._at_b)
        nodes, radii = self._nodes[:, :3], self._nodes[:, 3]
        if self._faces:
            corners = (self._corners - relative.translation) @ relative.rotation
            faced = [face.nearest(corner) for face in self._faces for corner in corners]
            nodes, radii = np.vstack([nodes, *faced]), np.append(radii, np.zeros(len(faced)))
        nodes = nodes @ relative.rotation.T + relative.translation
        distances = np.array([part.distances(nodes) for part in self._parts]) - radii
        found = []
        for group in self._groups:
            weights = _near(distances[group].min(axis=0), blend)
            core, radius = weights @ nodes, weights @ radii
            sides = [part.distance_and_normal(core) for part in self._parts[group]]
            d_core, normals = np.array([d for d, _ in sides]), np.array([n for _, n in sides])
            weights = _near(d_core, blend)
            foot, n = (placed.rotation @ (w @ normals) for w in (weights * d_core, weights))
            core = placed.act(core)
            found.append(np.array([core - foot, core - radius * n, n, core]))
        return found


def _near(d: Array, blend: float) -> Array:
    """(K,) [-] weights of distances d [m] whose sum is 1, by how little each is above the least."""
    weights = np.exp((d.min() - d) / blend)
    return weights / weights.sum()


def _shapes(model: RobotModel, body: str) -> list[tuple[Shape, pin.GeometryObject]]:
    objects = model.geometry.geometryObjects
    placed = (objects[i] for i in model.shape_ids[body])
    return list(zip(model.description.body(body).shapes, placed, strict=True))


def _core(shape: Shape, placed: pin.GeometryObject) -> tuple[Array, float]:
    """Where a shape is nearest to something flat: one of these points, or between them.

    Returns:
        (K, 3) [m] points of its core, in the frame of the joint that carries it; and [m] the radius
        of the shape around its core.
    """
    radius = 0.0
    if isinstance(shape, Capsule):
        nodes = np.zeros((_ALONG, 3))
        nodes[:, 2] = np.linspace(-0.5, 0.5, _ALONG) * shape.length_m
        radius = shape.radius_m
    elif isinstance(shape, Sphere):
        nodes, radius = np.zeros((1, 3)), shape.radius_m
    else:
        nodes = _farthest_out(_corners(shape, placed.geometry))
    return np.array([placed.placement.act(node) for node in nodes]), radius


def _corners(shape: Shape, geometry: coal.CollisionGeometry) -> Array:
    if isinstance(shape, Box):
        return 0.5 * np.array(shape.size_m) * _SIGNS[np.abs(_SIGNS).sum(axis=1) == 3]
    if isinstance(shape, Cylinder):
        turns = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        rim = shape.radius_m * np.column_stack([np.cos(turns), np.sin(turns)])
        heights = np.repeat([-0.5, 0.5], len(rim)) * shape.length_m
        return np.column_stack([np.vstack([rim, rim]), heights])
    return np.array([geometry.point(i) for i in range(geometry.num_points)])


def _farthest_out(corners: Array) -> Array:
    """(K, 3) [m] those of some corners that lie farthest in some direction."""
    return corners[np.unique((corners @ _SIGNS.T).argmax(axis=0))]
