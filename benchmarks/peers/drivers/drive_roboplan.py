"""roboplan: weighted tasks under barriers; in each step the base starts at the origin."""

from __future__ import annotations

import math
from itertools import combinations
from xml.etree import ElementTree

import numpy as np
from loop import Array, Plan, main
from roboplan.core import CartesianConfiguration, Scene, loadUrdfSceneDescription
from roboplan.optimal_ik import (
    ConfigurationTask,
    FrameTask,
    FrameTaskOptions,
    Oink,
    PositionLimit,
    SelfCollisionBarrier,
    SelfCollisionBarrierOptions,
    VelocityLimit,
)


class Roboplan:
    """The loop of roboplan.

    The base's joints of the model, yaw and x, are zero at the start of each step, so that the base
    cannot move sideways. This class integrates the pose of the base in the world.
    """

    def __init__(self, plan: Plan, q: Array, base_cost: float) -> None:
        self._scene = Scene("peers", loadUrdfSceneDescription(plan["unicycle_urdf"]))
        self._keep_pairs(plan)
        joints = [*plan["unicycle_joints"], *plan["arm_joints"]]
        if self._scene.getJointNames() != joints:
            raise ValueError(f"joints in another order: {self._scene.getJointNames()}")
        self._pose, dt = q[:3].copy(), plan["dt_s"]
        self._q = np.concatenate([np.zeros(2), q[3:]])
        self._scene.setJointPositions(self._q)
        oink = self._oink = Oink(self._scene)
        ee = CartesianConfiguration("", plan["ee"], np.asfortranarray(np.eye(4)))
        weight = plan["ee_cost"] ** 2  # its cost is the square of the other libraries' costs
        self._ee = FrameTask(oink, self._scene, ee, FrameTaskOptions(weight, weight))
        weights = np.full(len(joints), plan["arm_cost"] ** 2)
        weights[:2] = base_cost**2
        self._damping = ConfigurationTask(oink, self._q, weights)
        v, w = plan["base_velocity"]
        limit = VelocityLimit(oink, dt, np.array([w, v, *plan["arm_velocity"]]))
        options = SelfCollisionBarrierOptions(
            n_collision_pairs=len(plan["pairs"]),
            gain=plan["rate_per_s"],
            safe_displacement_gain=0.0,
            d_min=plan["d_min_m"],
            d_max=plan["detection_m"],
        )
        self._constraints = [PositionLimit(oink), limit]
        self._barriers = [SelfCollisionBarrier(oink, self._scene, dt, options)]
        self._step = np.zeros(len(joints))

    def _keep_pairs(self, plan: Plan) -> None:
        """Monitor only the pairs of the plan."""
        robot = ElementTree.parse(plan["unicycle_urdf"])
        bodies = [link.get("name") for link in robot.iterfind("link[collision]")]
        for a, b in combinations(bodies, 2):
            kept = [a, b] in plan["pairs"] or [b, a] in plan["pairs"]
            self._scene.setCollisions(a, b, kept)

    def distances(self) -> list[float]:
        """See `Follower.distances`; roboplan does not report distances."""
        return []

    def step(self, target: Array) -> Array:
        """See `Follower.step`."""
        x, y, yaw = self._pose
        T_base_world = np.eye(4, order="F")
        c, s = math.cos(yaw), math.sin(yaw)
        T_base_world[:2, :2] = [[c, s], [-s, c]]
        T_base_world[:2, 3] = -(c * x + s * y), s * x - c * y
        self._ee.setTargetFrameTransform(np.asfortranarray(T_base_world @ target))
        self._damping.setTargetConfiguration(self._q)
        tasks = [self._ee, self._damping]
        self._oink.solveIk(self._q, tasks, self._constraints, self._barriers, self._step)
        turn, ahead = self._step[:2]
        middle = yaw + turn / 2  # direction of the chord of an arc
        self._pose = np.array(
            [x + ahead * math.cos(middle), y + ahead * math.sin(middle), yaw + turn]
        )
        self._q[2:] += self._step[2:]
        return np.concatenate([self._pose, self._q[2:]])


main(Roboplan, "roboplan-oink", "roboplan-core", "pin")
