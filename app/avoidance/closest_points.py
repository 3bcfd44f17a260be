"""FindClosestPoints: signed distances, closest points and normals of all link pairs.

The normal points from `a` to `b`, also in penetration. The closest points of `SmoothPoints` move
continuously, also while a link turns parallel to a face.
"""

import math
from collections.abc import Sequence
from itertools import chain, pairwise, product

import coal
import numpy as np
import pinocchio as pin

from app.border.mobile import Shapes, act, is_round, nearest_of
from app.compiled import compiled
from app.robot.link_pairs import ClosestPoints, Pair, PairDistances
from app.robot.model import RobotModel
from app.robot.shapes import Box, Capsule, Cylinder, Shape, Sphere
from app.robot.state import RobotState
from app.strict import Array

_ALONG = 7  # nodes of a capsule
_SIGNS = np.array([v for v in product((-1.0, 0.0, 1.0), repeat=3) if any(v)])  # 26 directions


class DistanceMonitor:
    """Distances of a fixed set of link pairs at the robot's present state."""

    def __init__(self, state: RobotState, pairs: Sequence[Pair]) -> None:
        """Prepare `pairs`; the results have their order. Each method reads the present `state`."""
        self._state, self._distances = state, PairDistances(state.model, pairs)

    def find_closest_points(self) -> list[ClosestPoints]:
        """The closest points of every pair, from the collision library.

        A control step uses `mean_nearest` instead. The normal is that of the library. The direction
        of p_b − p_a would change its sign in penetration: repulsion would become attraction.
        """
        self._distances.update_from(self._state.data)
        return [self._distances.closest(i) for i in range(len(self._distances.pairs))]

    def distances(self) -> tuple[float, ...]:
        """[m] the signed distance of every pair, without the points."""
        self._distances.update_from(self._state.data)
        return self._distances.distances()


class SmoothPoints:
    """Closest points by a mean over the nodes of the core of `b`; nearer nodes weigh more.

    Nodes are points of the core, such as 7 on the axis of a capsule; "Closest points" in
    docs/method.md has the formulas. If a capsule is parallel to a face, the library's closest point
    is one of many, and jumps from one end to the other as the capsule turns. The mean moves
    continuously, because the distance of each node to `a` is continuous. If one node is much nearer
    than the others, only this node counts. If `a` has several convex parts, the normal is a mean of
    the parts' normals, and is shorter than 1 in a corner between two parts. The nearest point of a
    flat face can be any of its points. Therefore, on each shape of `b` with flat faces, the points
    that are nearest to the nodes of `a` are nodes too.

    Attributes:
        rows: For each pair: the index of its own row in the results of `mean_nearest`, then, if `a`
            has several convex parts, those of the rows of these parts.
        arrays: Fields of `app.control.inputs.ROBOT`: the constant arguments of `mean_nearest`, and
            the joints of the bodies and of the rows.
    """

    def __init__(self, model: RobotModel, pairs: Sequence[Pair]) -> None:
        names = list(dict.fromkeys(body for pair in pairs for body in pair))
        bodies = [_body(model, name) for name in names]
        sizes = [(len(shapes.rows), len(nodes)) for shapes, nodes in bodies]
        firsts = np.cumsum([(0, 0), *sizes], axis=0)
        at = [(names.index(pair.a), names.index(pair.b)) for pair in pairs]
        whole = [(a, b, *firsts[a : a + 2, 0]) for a, b in at]
        parts = [
            [(a, b, k, k + 1) for k in range(first, end) if end - first > 1]
            for a, b, first, end in whole
        ]
        sought = np.array([*whole, *chain(*parts)], dtype=int).reshape(-1, 4)
        ends = np.cumsum([len(pairs), *map(len, parts)]).tolist()
        self.rows = [[k, *range(*of_parts)] for k, of_parts in enumerate(pairwise(ends))]
        shapes = Shapes.together([shapes for shapes, _ in bodies])
        joints = np.array([model.body_joints[name] for name in names], dtype=int)
        self.arrays = {
            "shapes": shapes.rows,
            "triangles": shapes.triangles,
            "nodes": np.concatenate([np.empty((0, 4)), *(nodes for _, nodes in bodies)]),
            "firsts": firsts,
            "sought": sought,
            "body_joints": joints,
            "pair_joints": joints[sought[:, :2]],
        }


def _body(model: RobotModel, name: str) -> tuple[Shapes, Array]:
    """A body's shapes, and the points (K, 4) [m] of its core, each with the radius around the core.

    Both are in the frame of the joint that moves the body.
    """
    objects = [model.geometry.geometryObjects[i] for i in model.shape_ids[name]]
    cores = map(_core, model.description.body(name).shapes, objects)
    return (
        Shapes.together([Shapes.of(each.geometry, each.placement) for each in objects]),
        np.vstack([np.column_stack([at, np.full(len(at), radius)]) for at, radius in cores]),
    )


@compiled()
def _seen_by(T_a: Array, T_b: Array) -> tuple[Array, Array]:
    """Rotation (3, 3) and origin (3,) [m] of b in a's frame, from poses (4, 3) in the world."""
    R, p = np.empty((3, 3)), np.zeros(3)
    for i in range(3):
        for j in range(3):
            p[i] += T_a[j, i] * (T_b[3, j] - T_a[3, j])
            R[i, j] = T_a[0, i] * T_b[0, j] + T_a[1, i] * T_b[1, j] + T_a[2, i] * T_b[2, j]
    return R, p


@compiled()
def _mean_nearest(
    a: Array,
    corners: Array,
    T_a: Array,
    b: Array,
    nodes: Array,
    T_b: Array,
    triangles: Array,
    blend: float,
    work: Array,
    found: Array,
) -> None:
    """Write one row of `mean_nearest` into `found` (4, 3); `work` is scratch memory.

    `a` has the shapes of l_a, all or one, and `corners` its nodes; `b`, `nodes` are those of l_b.
    """
    R_a, p_a, none = T_a[:3], T_a[3], np.zeros(3)
    R, p = _seen_by(T_a, T_b)
    count = len(nodes)
    for k in range(count):
        x, y, z = act(R, p, nodes[k, 0], nodes[k, 1], nodes[k, 2])
        work[k, 0], work[k, 1], work[k, 2], work[k, 3] = x, y, z, nodes[k, 3]
    for f in range(len(b)):
        if is_round(b[f]):
            continue
        for c in range(len(corners)):
            x, y, z = corners[c, 0] - p[0], corners[c, 1] - p[1], corners[c, 2] - p[2]
            x, y, z = act(R.T, none, x, y, z)
            d_c, n_x, n_y, n_z = nearest_of(b[f : f + 1], triangles, x, y, z)
            x, y, z = act(R, p, x - d_c * n_x, y - d_c * n_y, z - d_c * n_z)
            work[count, 0], work[count, 1], work[count, 2], work[count, 3] = x, y, z, 0.0
            count += 1
    least = np.inf
    for k in range(count):
        d = nearest_of(a, triangles, work[k, 0], work[k, 1], work[k, 2])[0] - work[k, 3]
        work[k, 4] = d
        least = min(least, d)
    x = y = z = radius = total = 0.0
    for k in range(count):
        weight = math.exp((least - work[k, 4]) / blend)
        total += weight
        x, y, z = x + weight * work[k, 0], y + weight * work[k, 1], z + weight * work[k, 2]
        radius += weight * work[k, 3]
    x, y, z, radius = x / total, y / total, z / total, radius / total
    nearest, total = nearest_of(a, triangles, x, y, z), 0.0
    for i in range(3):
        found[0, i] = found[2, i] = 0.0
    for k in range(len(a)):
        side = nearest_of(a[k : k + 1], triangles, x, y, z) if len(a) > 1 else nearest
        weight = math.exp((nearest[0] - side[0]) / blend)
        total += weight
        n = act(R_a, none, side[1], side[2], side[3])
        for i in range(3):
            found[0, i] -= weight * side[0] * n[i]
            found[2, i] += weight * n[i]
    found[3, 0], found[3, 1], found[3, 2] = act(R_a, p_a, x, y, z)
    for i in range(3):
        found[2, i] /= total
        found[0, i] = found[3, i] + found[0, i] / total
        found[1, i] = found[3, i] - radius * found[2, i]


@compiled()
def mean_nearest(
    bodies: tuple[Array, Array, Array, Array], sought: Array, placed: Array, blend: float
) -> Array:
    """(k, 4, 3) [m] p_a, p_b, n and core of `ClosestPoints` in the world, as in `SmoothPoints`.

    There is a row for each pair, then one for each convex part of each `a` that has several.

    `bodies` are four arrays of all bodies, one body after the other: (P, 16) rows and (T, 4, 3)
    triangles of `Shapes`; (K, 4) [m] nodes, each with the radius around it; (bodies + 1, 2) index
    of the first shape and of the first node of each body. `sought` (k, 4) has the indices of `a`
    and `b`, then first and end index of the used shapes of `a`. `placed` (4 × bodies, 3) has the
    pose of each body in the world: three rows of R, then the origin [m]. `blend` [m] is the
    smoothing length τ.
    """
    rows, triangles, nodes, firsts = bodies
    found, most = np.empty((len(sought), 4, 3)), len(nodes) * (1 + len(rows))
    work = np.empty((most, 5))  # places, radii and distances of a pair's nodes
    for k in range(len(sought)):
        a, b = sought[k, 0], sought[k, 1]
        _mean_nearest(
            rows[sought[k, 2] : sought[k, 3]],
            nodes[firsts[a, 1] : firsts[a + 1, 1]],
            placed[4 * a : 4 * a + 4],
            rows[firsts[b, 0] : firsts[b + 1, 0]],
            nodes[firsts[b, 1] : firsts[b + 1, 1]],
            placed[4 * b : 4 * b + 4],
            triangles,
            blend,
            work,
            found[k],
        )
    return found


def _core(shape: Shape, placed: pin.GeometryObject) -> tuple[Array, float]:
    """Points (K, 3) [m] of a shape's core in its joint's frame, and the radius [m] around the core.

    A capsule has points along its axis, a sphere its centre. Any other shape has the corners that
    are farthest in one of the 26 directions of `_SIGNS`, and the radius 0. A cylinder counts as a
    shape with eight corners on each rim.
    """
    radius = 0.0
    if isinstance(shape, Capsule):
        nodes = np.zeros((_ALONG, 3))
        nodes[:, 2] = np.linspace(-0.5, 0.5, _ALONG) * shape.length_m
        radius = shape.radius_m
    elif isinstance(shape, Sphere):
        nodes, radius = np.zeros((1, 3)), shape.radius_m
    else:
        corners = _corners(shape, placed.geometry)
        nodes = corners[np.unique((corners @ _SIGNS.T).argmax(axis=0))]
    return np.array([placed.placement.act(node) for node in nodes]), radius


def _corners(shape: Shape, geometry: coal.CollisionGeometry) -> Array:
    if isinstance(shape, Box):
        return 0.5 * np.array(shape.size_m) * _SIGNS[np.abs(_SIGNS).sum(axis=1) == 3]
    if isinstance(shape, Cylinder):
        turns = np.linspace(0.0, 2 * np.pi, 8, endpoint=False)
        rim = shape.radius_m * np.column_stack([np.cos(turns), np.sin(turns)])
        heights = np.repeat([-0.5, 0.5], len(rim)) * shape.length_m
        return np.column_stack([np.vstack([rim, rim]), heights])
    return np.array(geometry.points())
