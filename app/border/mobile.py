"""DistanceToMobile of Algorithm 1: exact distance of points to the mobile robot's shapes."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin

from app.border.ray_ends import distances, measures
from app.robot.model import RobotModel

Array = np.ndarray


class ConvexPart:
    """One convex shape of l_m, fixed in the base's frame.

    Attributes:
        lower, upper: (3,) [m] corners of a box around it, along the base's axes.
        placement: T_base_shape.
        measures: Kind and sizes for `app.border.ray_ends`, or None for another shape.
    """

    def __init__(self, geometry: coal.CollisionGeometry, placement: pin.SE3) -> None:
        self.lower, self.upper = _bounds(geometry, placement)
        self.placement, self.measures = placement, measures(geometry)
        self._T_shape = coal.Transform3s(placement.rotation, placement.translation)
        self._T_point = coal.Transform3s()
        self._request, self._result = coal.DistanceRequest(), coal.DistanceResult()
        # The functor points to its two shapes without owning them: they must live as long as it.
        self._geometry, self._point = geometry, coal.Sphere(0.0)
        self._compute = coal.ComputeDistance(self._geometry, self._point)

    def distance(self, point: Array) -> float:
        """[m] signed distance of a point (3,) [m]."""
        self._T_point.setTranslation(point)
        self._result.clear()
        return self._compute(self._T_shape, self._T_point, self._request, self._result)

    def distance_and_normal(self, point: Array) -> tuple[float, Array]:
        """The same, and the unit vector (3,) from the shape to the point, until the next call."""
        return self.distance(point), self._result.normal

    def nearest(self, point: Array) -> Array:
        """(3,) [m] the point of the shape's surface nearest to a point (3,) [m]."""
        d, normal = self.distance_and_normal(point)
        return point - d * normal

    def distances(self, points: Array) -> Array:
        """(N,) [m] signed distances of points (N, 3) [m]."""
        if self.measures is None:
            return np.array([self.distance(p) for p in points])
        return distances(
            *self.measures, self.placement.rotation, self.placement.translation, points
        )


class MobileBody:
    """l_m: a union of convex parts.

    Attributes:
        parts: Its shapes.
        lower, upper: (3,) [m] corners of a box around it, along the base's axes.
    """

    def __init__(self, model: RobotModel) -> None:
        name = model.description.mobile_body.name
        objects = [model.geometry.geometryObjects[i] for i in model.shape_ids[name]]
        # The planar joint that carries l_m has its frame on the floor: the base's frame.
        self.parts = [ConvexPart(o.geometry, o.placement) for o in objects]
        self.lower = np.min([part.lower for part in self.parts], axis=0)
        self.upper = np.max([part.upper for part in self.parts], axis=0)

    def distance(self, points: Array) -> Array:
        """(N,) [m] signed distances of points (N, 3) [m] in the base's frame."""
        measures = [part.distance for part in self.parts]
        if len(measures) == 1:
            measure = measures[0]
            return np.array([measure(p) for p in points])
        return np.array([min(measure(p) for measure in measures) for p in points])


def _bounds(geometry: coal.CollisionGeometry, placement: pin.SE3) -> tuple[Array, Array]:
    geometry.computeLocalAABB()
    centre = placement.act(geometry.aabb_center)
    box = geometry.aabb_local
    half = np.abs(placement.rotation) @ np.array([box.width(), box.height(), box.depth()]) / 2
    return centre - half, centre + half
