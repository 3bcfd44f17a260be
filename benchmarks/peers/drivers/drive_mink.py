"""mink: weighted velocities on MuJoCo with limits; the wheels' row is a constraint."""

from __future__ import annotations

from pathlib import Path

import mink
import mujoco
import numpy as np
from loop import Array, Plan, main

_COMPILER = '<mujoco><compiler fusestatic="false" discardvisual="true"/></mujoco>'


class NoSlip(mink.Task):
    """The base has no velocity along the wheel axis."""

    def __init__(self) -> None:
        super().__init__(cost=np.ones(1))

    def compute_error(self, configuration: mink.Configuration) -> Array:
        """Zero: the constraint is on velocities."""
        return np.zeros(1)

    def compute_jacobian(self, configuration: mink.Configuration) -> Array:
        """(1, n) Jacobian of the base's sideways velocity."""
        J = np.zeros((1, configuration.nv))
        yaw = configuration.q[2]
        J[0, :2] = -np.sin(yaw), np.cos(yaw)
        return J


class Mink:
    """mink's loop."""

    def __init__(self, plan: Plan, q: Array, base_cost: float) -> None:
        text = Path(plan["planar_urdf"]).read_text(encoding="utf-8")
        model = mujoco.MjModel.from_xml_string(text.replace("</robot>", _COMPILER + "</robot>"))
        self._model, self._dt = model, plan["dt_s"]
        self._configuration = mink.Configuration(model, q)
        cost = plan["ee_cost"]
        self._ee = mink.FrameTask(plan["ee"], "body", position_cost=cost, orientation_cost=cost)
        costs = np.full(model.nv, plan["arm_cost"])
        costs[:3] = base_cost
        self._tasks = [self._ee, mink.DampingTask(model, cost=costs)]
        self._pairs = [tuple(self._geom(link) for link in pair) for pair in plan["pairs"]]
        v, w = plan["base_velocity"]
        names = [*plan["planar_joints"], *plan["arm_joints"]]
        velocities = dict(zip(names, [v, v, w, *plan["arm_velocity"]], strict=True))
        self._limits = [
            mink.ConfigurationLimit(model),
            mink.VelocityLimit(model, velocities),
            mink.CollisionAvoidanceLimit(
                model,
                [([a], [b]) for a, b in self._pairs],
                gain=plan["rate_per_s"] * plan["dt_s"],
                minimum_distance_from_collisions=plan["d_min_m"],
                collision_detection_distance=plan["detection_m"],
            ),
        ]
        self._constraints = [NoSlip()]

    def _geom(self, link: str) -> int:
        """The number of a link's shape."""
        return int(self._model.body_geomadr[self._model.body(link).id])

    def distances(self) -> list[float]:
        """See `Follower.distances`."""
        data = self._configuration.data
        return [mujoco.mj_geomDistance(self._model, data, a, b, 10.0, None) for a, b in self._pairs]

    def step(self, target: Array) -> Array:
        """See `Follower.step`."""
        self._ee.set_target(mink.SE3.from_matrix(target))
        velocity = mink.solve_ik(
            self._configuration,
            self._tasks,
            self._dt,
            "daqp",
            limits=self._limits,
            constraints=self._constraints,
        )
        self._configuration.integrate_inplace(velocity, self._dt)
        return self._configuration.q


main(Mink, "mink", "mujoco", "qpsolvers", "daqp")
