"""The evaluation of all motions: results on the common model, with pinocchio and coal.

It does not use our own robot model, distances or controllers.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

Array = np.ndarray


class Evaluator:
    """Kinematics and distances of the common model.

    A configuration is (3 + n_m,): x, y [m], yaw [rad] and the arm's joints.
    """

    def __init__(self, urdf: str, pairs: Sequence[tuple[str, str]], ee: str) -> None:
        """Read a model.

        Args:
            urdf: Text of the URDF, with three joints for x, y and yaw of the base.
            pairs: The two links of each pair; each link has one shape.
            ee: The link of the end-effector.

        Raises:
            ValueError: A link does not exist, or a link of a pair has no shape.
        """
        self.model = pin.buildModelFromXML(urdf)
        self._data = self.model.createData()
        self._shapes = pin.GeometryModel()
        pin.buildGeomFromUrdfString(self.model, urdf, pin.COLLISION, self._shapes)
        for pair in pairs:
            names = [f"{link}_0" for link in pair]
            for name in names:
                if not self._shapes.existGeometryName(name):
                    raise ValueError(f"the common model has no shape {name}")
            self._shapes.addCollisionPair(
                pin.CollisionPair(*(self._shapes.getGeometryId(name) for name in names))
            )
        self._placed = pin.GeometryData(self._shapes)
        if not self.model.existFrame(ee):
            raise ValueError(f"the common model has no link {ee}")
        self._ee = self.model.getFrameId(ee)

    def distances(self, q: Array) -> Array:
        """(pairs,) [m] signed distances at a configuration."""
        pin.computeDistances(self.model, self._data, self._shapes, self._placed, q)
        return np.array([result.min_distance for result in self._placed.distanceResults])

    def ee(self, q: Array) -> pin.SE3:
        """T_world_ee at a configuration."""
        pin.framesForwardKinematics(self.model, self._data, q)
        return self._data.oMf[self._ee].copy()

    def figures(self, q: Array, p: Array, R: Array, dt: float) -> dict[str, float]:
        """The results of a motion; each key ends in its unit.

        Args:
            q: (N + 1, 3 + n_m) configurations every dt.
            p: (N + 1, 3) [m] reference positions of the end-effector at the same times.
            R: (3, 3) reference orientation.
            dt: [s]
        """
        least = np.min([self.distances(at) for at in q], axis=0)
        poses = [self.ee(at) for at in q]
        off = np.linalg.norm([T.translation for T in poses] - p, axis=1)
        turned = [float(np.linalg.norm(pin.log3(R.T @ T.rotation))) for T in poses]
        steps = np.diff(q, axis=0)
        velocity = np.vstack([np.zeros(q.shape[1]), steps / dt])
        change = np.abs(np.diff(velocity, axis=0)) / dt
        base = np.diff(along(q, velocity)) / dt
        return {
            "clearance_m": float(least.min()),
            "error_final_m": float(off[-1]),
            "error_max_m": float(off.max()),
            "turn_error_final_rad": turned[-1],
            "turn_error_max_rad": max(turned),
            "base_path_m": float(np.hypot(*steps[:, :2].T).sum()),
            "base_turned_rad": float(np.abs(steps[:, 2]).sum()),
            "slip_m": float(slips(q).sum()),
            "base_change_max_mps2": float(np.abs(base).max()),
            "base_turn_change_max_radps2": float(change[:, 2].max()),
            "arm_change_max_radps2": float(change[:, 3:].max()),
        }


def along(q: Array, velocity: Array) -> Array:
    """(N + 1,) [m/s] forward velocity of the base, before the first step and in each step.

    Args:
        q: (N + 1, 3 + n_m) configurations.
        velocity: (N + 1, 3 + n_m) velocity in each step, after a first row of zeros.
    """
    yaw = np.concatenate([q[:1, 2], (q[:-1, 2] + q[1:, 2]) / 2])
    return velocity[:, 0] * np.cos(yaw) + velocity[:, 1] * np.sin(yaw)


def slips(q: Array) -> Array:
    """(N,) [m] sideways motion of the base in each step.

    A step has no slip if its direction lies between the headings before and after the step. Thus
    the chord of an arc, and an Euler step along the initial heading, have no slip.

    Args:
        q: (N + 1, 3 + n_m) configurations.
    """
    step = np.diff(q[:, :2], axis=0)
    across = [-step[:, 0] * np.sin(yaw) + step[:, 1] * np.cos(yaw) for yaw in (q[:-1, 2], q[1:, 2])]
    between = across[0] * across[1] <= 0.0
    return np.where(between, 0.0, np.min(np.abs(across), axis=0))
