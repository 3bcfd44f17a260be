"""A load that the end-effector carries in a plant."""

import numpy as np

from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.interface import Push
from app.strict import Array


class PointLoad:
    """A point mass fixed to the end-effector; its weight and inertia act on the arm as a force.

    A force m (g - a) with the last acceleration a would be unstable for a load heavier than the
    arm's effective mass. Therefore the computation includes the effect of the force on a.
    """

    def __init__(self, model: RobotModel, mass: float, centre: Array, dt: float) -> None:
        """A mass [kg] at `centre` (3,) [m] in the end-effector's frame; `dt` [s] is the step."""
        self._model, self._mass, self._centre, self._dt = model, mass, centre, dt
        self._joint = model.pin.njoints - 1
        self._at = model.pin.frames[model.ee_frame].placement.act(centre)
        self._data = model.pin.createData()
        self._effect, self._v = np.zeros(3), np.full(3, np.nan)

    def push(self, state: RobotState) -> Push:
        """The load's force on the arm in the next step, from the true state; call once a step."""
        model, n_b = self._model, self._model.n_b
        p = state.p_ee + state.R_ee @ self._centre
        q = model.configuration(state.base_pose, state.q_m)
        M = model.mass_matrix(q, self._data)[3:, 3:]
        J = state.point_jacobian(self._joint, p)[:, n_b:]
        mobility = J @ np.linalg.solve(M, J.T)  # [1/kg] of the arm without the load
        v = state.point_velocity(self._joint, p)
        a = (v - self._v) / self._dt if np.isfinite(self._v).all() else self._effect
        free = a - self._effect  # [m/s²] acceleration without the load
        gravity = model.pin.gravity.linear
        force = np.linalg.solve(np.eye(3) / self._mass + mobility, gravity - free)
        self._effect, self._v = mobility @ force, v
        return Push(model.pin.names[self._joint], self._at, force)
