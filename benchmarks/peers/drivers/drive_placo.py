"""placo: weighted tasks under hard constraints; the wheels' row is two half-spaces."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path

import numpy as np
import placo
from capsules import without_capsules
from loop import Array, Plan, main


class Placo:
    """The loop of placo. The URDF has joints of the base, so placo's floating base is fixed."""

    def __init__(self, plan: Plan, q: Array, base_cost: float) -> None:
        self._joints = [*plan["planar_joints"], *plan["arm_joints"]]
        source = Path(plan["planar_urdf"])
        self._robot = placo.RobotWrapper(
            str(source.parent),
            placo.Flags.ignore_collisions,
            without_capsules(source.read_text(encoding="utf-8")),
        )
        with tempfile.TemporaryDirectory() as folder:
            pairs = Path(folder) / "collisions.json"
            pairs.write_text(json.dumps(plan["pairs"]), encoding="utf-8")
            self._robot.load_collision_pairs(str(pairs))
        for name, value in zip(self._joints, q, strict=True):
            self._robot.set_joint(name, value)
        self._robot.update_kinematics()
        solver = self._solver = self._robot.make_solver()
        solver.mask_fbase(True)
        solver.dt = plan["dt_s"]
        solver.enable_velocity_limits(True)
        self._ee = solver.add_frame_task(plan["ee"], np.eye(4))
        weight = plan["ee_cost"] ** 2
        self._ee.configure("ee", "soft", weight, weight)
        damping = solver.add_regularization_task(plan["arm_cost"] ** 2)
        for name in plan["planar_joints"]:
            damping.set_joint_weight(name, base_cost**2)
        avoidance = solver.add_avoid_self_collisions_constraint()
        avoidance.self_collisions_margin = plan["d_min_m"]
        avoidance.self_collisions_trigger = plan["detection_m"]
        avoidance.configure("avoidance", "hard", 1.0)
        self._at = [self._robot.get_joint_offset(name) for name in self._joints]
        self._A = np.zeros((2, len(self._robot.state.q)))
        self._no_slip = solver.add_joint_space_half_spaces_constraint(self._A, np.zeros(2))
        self._no_slip.configure("no slip", "hard", 1.0)

    def distances(self) -> list[float]:
        """See `Follower.distances`."""
        return [found.min_distance for found in self._robot.distances()]

    def step(self, target: Array) -> Array:
        """See `Follower.step`."""
        q = self._robot.state.q
        yaw = q[self._at[2]]
        row = np.array([-np.sin(yaw), np.cos(yaw)])
        self._A[0, self._at[:2]], self._A[1, self._at[:2]] = row, -row
        self._no_slip.A, self._no_slip.b = self._A, self._A @ q
        self._ee.T_world_frame = target
        self._solver.solve(True)
        self._robot.update_kinematics()
        return self._robot.state.q[self._at]


main(Placo, "placo", "pin")
