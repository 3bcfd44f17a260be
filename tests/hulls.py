"""Convex hulls of the links' meshes: the ground truth for the convex bodies."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from itertools import product
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh

from app.robot.assets import resolved_urdf
from app.robot.model import RobotModel
from tests.robots import husky_panda

pytest.importorskip("pybullet_data")  # it contains the meshes
URDF = ElementTree.fromstring(resolved_urdf(husky_panda().description))


@cache
def collision_points(link: str) -> np.ndarray:
    """(n, 3) [m] corners of the hulls of a link's collision meshes, in the link's frame."""
    points = [np.zeros((0, 3))]
    for collision in URDF.iterfind(f"link[@name='{link}']/collision"):
        origin, mesh = collision.find("origin"), collision.find("geometry/mesh")
        scale = [float(word) for word in mesh.get("scale", "1 1 1").split()]
        hull = trimesh.load(mesh.get("filename"), force="mesh").apply_scale(scale).convex_hull
        xyz, rpy = (np.array(origin.get(a).split(), float) for a in ("xyz", "rpy"))
        points.append(hull.vertices @ pin.rpy.rpyToMatrix(*rpy).T + xyz)
    return np.vstack(points)


@dataclass
class Collisions:
    """Pairs of shapes and their collisions."""

    geometry: pin.GeometryModel
    names: list[tuple[str, str]]
    """One pair of names for each collision pair of `geometry`."""
    body_of: dict[str, str]

    def __post_init__(self) -> None:
        self._results = pin.GeometryData(self.geometry)

    def colliding(self, data: pin.Data, q: np.ndarray) -> set[tuple[str, str]]:
        pin.computeCollisions(husky_panda().pin, data, self.geometry, self._results, q, False)
        results = self._results.collisionResults
        return {pair for pair, r in zip(self.names, results, strict=True) if r.isCollision()}

    def least_distance(self, data: pin.Data, q: np.ndarray) -> float:
        """[m] Smallest signed distance over all pairs."""
        pin.computeDistances(husky_panda().pin, data, self.geometry, self._results, q)
        return min(result.min_distance for result in self._results.distanceResults)


def candidate_pairs(model: RobotModel) -> list[tuple[str, str]]:
    """Pairs of bodies that are not neighbours."""
    names = model.body_names
    return [(a, b) for i, a in enumerate(names) for b in names[i + 2 :]]


def hull_pairs(model: RobotModel) -> Collisions:
    """Pairs of link hulls of bodies that are not neighbours."""
    geometry, ids, body_of = pin.GeometryModel(), {}, {}
    for body in model.description.bodies:
        for link in body.covers:
            points = coal.StdVec_Vec3s()
            for point in collision_points(link):
                points.append(point)
            if not len(points):
                continue
            frame_id = model.pin.getFrameId(link)
            frame = model.pin.frames[frame_id]
            hull = coal.Convex.convexHull(points, True, "Qt")
            ids[link] = geometry.addGeometryObject(
                pin.GeometryObject(link, frame.parentJoint, frame_id, frame.placement, hull)
            )
            body_of[link] = body.name
    pairs = [
        (x, y)
        for a, b in candidate_pairs(model)
        for x, y in product(model.description.body(a).covers, model.description.body(b).covers)
        if x in ids and y in ids
    ]
    for x, y in pairs:
        geometry.addCollisionPair(pin.CollisionPair(ids[x], ids[y]))
    return Collisions(geometry, pairs, body_of)


def body_pairs(model: RobotModel) -> Collisions:
    """Pairs of convex bodies that are not neighbours."""
    geometry, names = model.geometry.copy(), []
    for a, b in candidate_pairs(model):
        for x, y in product(model.shape_ids[a], model.shape_ids[b]):
            geometry.addCollisionPair(pin.CollisionPair(x, y))
            names.append((a, b))
    return Collisions(geometry, names, {name: name for name in model.body_names})
