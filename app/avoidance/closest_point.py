"""A closest point that moves continuously, also along a link that turns parallel to a face."""

from __future__ import annotations

from itertools import product
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.border.mobile import ConvexPart
from app.compiled import compiled
from app.robot.link_pairs import Pair
from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, Cylinder, Shape, Sphere

Array = np.ndarray

_ALONG = 7  # nodes of a capsule
_SIGNS = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if any(v)])  # 26 directions


class Core(NamedTuple):
    """Where a shape is nearest to something flat: one of these points, or between them.

    Attributes:
        nodes: (K, 3) [m] of its core, in the frame of the joint that carries it.
        radius: [m] of the shape around its core.
    """

    nodes: Array
    radius: float


class SmoothPoint:
    """The mean over a link's core, each point by how little farther than the nearest it is.

    The library's closest point is one of many where a capsule lies along a face, and leaps from one
    end to the other as it turns. Weights exp((min d - d_k)/τ) over some nodes of the core make a
    motion of that, for every d_k is continuous. Where one point is clearly nearest it is that one.
    """

    def __init__(self, model: RobotModel, pair: Pair) -> None:
        """Prepare for the body `b` of a pair against its body `a`."""
        self._joint_a, self._joint_b = model.body_joint(pair.a), model.body_joint(pair.b)
        objects = model.geometry.geometryObjects
        placed = (objects[i] for i in model.shape_ids[pair.a])
        self._parts = [ConvexPart(each.geometry, each.placement) for each in placed]
        shapes = zip(model.description.body(pair.b).shapes, model.shape_ids[pair.b], strict=True)
        cores = [_core(shape, objects[i]) for shape, i in shapes]
        self._nodes = np.vstack([core.nodes for core in cores])
        self._radii = np.concatenate([np.full(len(c.nodes), c.radius) for c in cores])

    def find(self, data: pin.Data, blend: float) -> tuple[Array, Array, Array, Array]:
        """The closest points of the pair.

        Args:
            data: pinocchio's, with the joints' placements.
            blend: [m] τ.

        Returns:
            (3,) [m] each, in the world: on `a`, on `b`, and of the core of `b`; and (3,) the unit
            normal from `a` to `b`.
        """
        placed = data.oMi[self._joint_a]
        relative = placed.actInv(data.oMi[self._joint_b])
        nodes = self._nodes @ relative.rotation.T + relative.translation
        first, *others = self._parts
        d = first.distances(nodes)
        for part in others:
            d = np.minimum(d, part.distances(nodes))
        core, radius = _mean(nodes, self._radii, d, blend)
        d_core, n = first.distance_and_normal(core)
        for part in others:
            d_part, n_part = part.distance_and_normal(core)
            if d_part < d_core:
                d_core, n = d_part, n_part
        n = placed.rotation @ n
        core = placed.act(core)
        return core - d_core * n, core - radius * n, core, n


@compiled("Tuple((f8[::1], f8))(f8[:,:], f8[:], f8[:], f8)")
def _mean(nodes: Array, radii: Array, d: Array, blend: float) -> tuple[Array, float]:
    """The weighted mean (3,) of nodes and that of their radii, by the distances d - r."""
    least = (d - radii).min()
    weights = np.exp((least - d + radii) / blend)
    weights /= weights.sum()
    core = np.zeros(3)
    for k in range(len(d)):
        for i in range(3):
            core[i] += weights[k] * nodes[k, i]
    return core, float((weights * radii).sum())


def _core(shape: Shape, placed: pin.GeometryObject) -> Core:
    radius = 0.0
    if isinstance(shape, Capsule):
        nodes = np.zeros((_ALONG, 3))
        nodes[:, 2] = np.linspace(-0.5, 0.5, _ALONG) * shape.length_m
        radius = shape.radius_m
    elif isinstance(shape, Sphere):
        nodes, radius = np.zeros((1, 3)), shape.radius_m
    else:
        nodes = _farthest_out(_corners(shape, placed.geometry))
    return Core(np.array([placed.placement.act(node) for node in nodes]), radius)


def _corners(shape: Shape, geometry: coal.CollisionGeometry) -> Array:
    """(N, 3) [m] in the shape's frame."""
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
