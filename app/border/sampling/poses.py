"""Poses of the arm and the point p_b that each brings near the mobile robot."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.robot.link_pairs import Pair, PairDistances
from app.robot.model import RobotModel

Array = np.ndarray


class Witnesses(NamedTuple):
    """What many poses bring about.

    Attributes:
        d: (N,) [m] signed distance of the pair.
        p_b: (N, 3) [m] closest point on the arm's body, in the base's frame.
        normal: (N, 3) unit vector from l_m to the body.
    """

    d: Array
    p_b: Array
    normal: Array


class PairReader:
    """Witness points of one pair of L_m, for many poses of the arm with the base at the origin."""

    def __init__(self, model: RobotModel, pair: Pair) -> None:
        self._model = model
        self._distances = PairDistances(model, [pair])
        self._joint = model.body_joint(pair.b)
        self._q = model.configuration((0.0, 0.0, 0.0), model.q_lower)

    def witnesses(self, q_m: Array) -> Witnesses:
        """The closest points at poses q_m (N, n_m) [rad or m]."""
        d = np.empty(len(q_m))
        p_b, normal = np.empty((len(q_m), 3)), np.empty((len(q_m), 3))
        q, reader = self._q, self._distances
        for i, pose in enumerate(q_m):
            q[4:] = pose
            reader.update(q)
            result = reader.nearest_result(0)
            d[i], p_b[i], normal[i] = result.min_distance, result.getNearestPoint2(), result.normal
        return Witnesses(d, p_b, normal)

    def jacobians(self, q_m: Array, p_b: Array) -> Array:
        """(N, 3, n_m) Jacobians of the material points that are at p_b (N, 3) [m] in poses q_m.

        The body slides under its closest point, so a step along them is only a good guess.
        """
        model, data, axes = self._model.pin, self._distances.data, pin.LOCAL_WORLD_ALIGNED
        J = np.empty((len(q_m), 6, model.nv))
        origin = np.empty((len(q_m), 3))
        for i, pose in enumerate(q_m):
            self._q[4:] = pose
            pin.computeJointJacobians(model, data, self._q)
            J[i] = pin.getJointJacobian(model, data, self._joint, axes)
            origin[i] = data.oMi[self._joint].translation
        J = J[:, :, 3:]
        lever = (p_b - origin)[:, :, None]
        return J[:, :3] + np.cross(J[:, 3:], lever, axis=1)
