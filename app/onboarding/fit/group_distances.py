"""Distances between groups of shapes at many poses of the arm."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel

Array = np.ndarray


def group_distances(
    model: RobotModel,
    geometry: pin.GeometryModel,
    groups: Sequence[Sequence[int]],
    pairs: Sequence[tuple[int, int]],
    q_m: Array,
) -> Array:
    """(N, pairs) [m] signed distances between groups of shapes at poses (N, n_m).

    Args:
        model: The robot, its base at the origin.
        geometry: The shapes, without collision pairs; those of the groups are added.
        groups: Indices of the shapes of each group; it is as near as its nearest shape.
        pairs: Of groups.
        q_m: (N, n_m) [rad or m] the arm's joints.
    """
    starts = []
    for a, b in pairs:
        starts.append(len(geometry.collisionPairs))
        for i in groups[a]:
            for j in groups[b]:
                geometry.addCollisionPair(pin.CollisionPair(i, j))
    placed, data = pin.GeometryData(geometry), model.pin.createData()
    results = [placed.distanceResults[k] for k in range(len(geometry.collisionPairs))]
    found = np.empty((len(q_m), len(pairs)))
    q = model.configuration((0.0, 0.0, 0.0), model.q_lower)
    for row, pose in zip(found, q_m, strict=True):
        if not len(pairs):
            break
        q[4:] = pose
        pin.updateGeometryPlacements(model.pin, data, geometry, placed, q)
        pin.computeDistances(geometry, placed)
        row[:] = np.minimum.reduceat([r.min_distance for r in results], starts)
    return found
