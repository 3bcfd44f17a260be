"""Direct calls of the libraries in a plain implementation of the step, as a reference of duration.

They compute dynamics, placements and distances of the pairs, the Jacobians of the end-effector and
of each body of a pair, and the solution of one random QP, slightly smaller than the arm's: q̈_m is
unknown; limits of torques and joints, and distances to the base, are inequalities. ProxQP solves
this QP with a warm start; only its gradient changes between the calls. The control step itself
solves its QPs with its own compiled solver.
"""

from __future__ import annotations

from time import perf_counter

import numpy as np
import pinocchio as pin
from proxsuite import proxqp

from app.robot.link_pairs import LinkPairs, PairDistances
from app.robot.model import RobotModel
from benchmarks.step.paths import Moment

Array = np.ndarray


class Floor:
    """Measures the duration of the direct calls of the libraries.

    Attributes:
        size: Numbers of unknowns, equalities and inequalities of the QP.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, seed: int) -> None:
        """Prepare the data that all calls share."""
        self._model, self._data = model, model.pin.createData()
        self._distances = PairDistances(model, pairs.all)
        bodies = {body for pair in pairs.all for body in pair}
        self._joints = [model.body_joints[body] for body in sorted(bodies)]
        self._axes = pin.LOCAL_WORLD_ALIGNED
        self.size = model.n_m, 0, 2 * model.n_m + len(pairs.mobile)
        rng = np.random.default_rng(seed)
        self._qp = _make_qp(*self.size, rng)
        self._gradients = self._qp.model.g + 0.01 * rng.normal(size=(100, model.n_m))
        self._calls = 0

    def time(self, moment: Moment) -> float:
        """[µs] duration of the calls for the readings of one control step."""
        model, data, m = self._model, self._data, moment.measurement
        wheels = np.linalg.solve(model.J_m, m.base_velocity)
        q = model.configuration(m.base_pose, m.q_m)
        v = model.S @ np.concatenate([wheels, m.qd_m])
        gradient = self._gradients[self._calls % len(self._gradients)]
        self._calls += 1
        begin = perf_counter()
        pin.computeAllTerms(model.pin, data, q, v)
        pin.updateFramePlacement(model.pin, data, model.ee_frame)
        self._distances.update_from(data)
        pin.getFrameJacobian(model.pin, data, model.ee_frame, self._axes)
        for joint in self._joints:
            pin.getJointJacobian(model.pin, data, joint, self._axes)
        self._qp.update(g=gradient)
        self._qp.solve()
        return 1e6 * (perf_counter() - begin)


def _make_qp(
    n: int, equalities: int, inequalities: int, rng: np.random.Generator
) -> proxqp.dense.QP:
    """A feasible QP of n variables; some of its inequalities are active at its solution."""
    R, C = rng.normal(size=(n, n)), rng.normal(size=(inequalities, n))
    bound = rng.uniform(0.3, 3.0, inequalities)
    qp = proxqp.dense.QP(n, equalities, inequalities)
    qp.settings.eps_abs, qp.settings.eps_rel = 1e-8, 0.0
    qp.settings.initial_guess = proxqp.InitialGuess.WARM_START_WITH_PREVIOUS_RESULT
    qp.init(R @ R.T / n + np.eye(n), rng.normal(size=n), None, None, C, -bound, bound)
    qp.solve()
    return qp
