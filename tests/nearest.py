"""Closest points by the collision library alone: the oracle of `SmoothPoints`."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from app.avoidance.closest_points import _core
from app.robot.link_pairs import Pair
from app.robot.shapes import Capsule, Sphere
from app.robot.state import RobotState

Array = np.ndarray


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
