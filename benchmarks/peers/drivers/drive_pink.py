"""pink: weighted velocities with barriers; the wheels' row is a constraint."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from loop import Array, Plan, main
from pink import Configuration, solve_ik
from pink.barriers import SelfCollisionBarrier
from pink.tasks import DampingTask, FrameTask, Task


class NoSlip(Task):
    """The base has no velocity along the wheel axis."""

    def __init__(self) -> None:
        super().__init__(cost=1.0)

    def compute_error(self, configuration: Configuration) -> Array:
        """Zero: the constraint is on velocities."""
        return np.zeros(1)

    def compute_jacobian(self, configuration: Configuration) -> Array:
        """(1, n) Jacobian of the base's sideways velocity."""
        J = np.zeros((1, configuration.model.nv))
        yaw = configuration.q[2]
        J[0, :2] = -np.sin(yaw), np.cos(yaw)
        return J

    def __repr__(self) -> str:
        """A short name."""
        return "NoSlip()"


class Pink:
    """pink's loop."""

    def __init__(self, plan: Plan, q: Array, base_cost: float) -> None:
        model = pin.buildModelFromUrdf(plan["planar_urdf"])
        shapes = pin.buildGeomFromUrdf(model, plan["planar_urdf"], pin.COLLISION)
        for pair in plan["pairs"]:
            shapes.addCollisionPair(
                pin.CollisionPair(*(shapes.getGeometryId(f"{link}_0") for link in pair))
            )
        self._configuration = Configuration(
            model,
            model.createData(),
            q,
            collision_model=shapes,
            collision_data=pin.GeometryData(shapes),
        )
        cost = plan["ee_cost"]
        self._ee = FrameTask(plan["ee"], position_cost=cost, orientation_cost=cost)
        costs = np.full(model.nv, plan["arm_cost"])
        costs[:3] = base_cost
        self._tasks = [self._ee, DampingTask(cost=costs)]
        self._barriers = [
            SelfCollisionBarrier(
                len(plan["pairs"]),
                gain=plan["rate_per_s"],
                safe_displacement_gain=0.0,
                d_min=plan["d_min_m"],
            )
        ]
        self._constraints, self._dt = [NoSlip()], plan["dt_s"]

    def distances(self) -> list[float]:
        """See `Follower.distances`."""
        return [r.min_distance for r in self._configuration.collision_data.distanceResults]

    def step(self, target: Array) -> Array:
        """See `Follower.step`."""
        self._ee.set_target(pin.SE3(target))
        velocity = solve_ik(
            self._configuration,
            self._tasks,
            self._dt,
            solver="daqp",
            barriers=self._barriers,
            constraints=self._constraints,
            safety_break=False,
        )
        self._configuration.integrate_inplace(velocity, self._dt)
        return self._configuration.q


main(Pink, "pin-pink", "pin", "qpsolvers", "daqp")
