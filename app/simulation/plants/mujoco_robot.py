"""A robot over a floor as a specification of MuJoCo, to which a plant adds what it has besides.

Its bodies are pinocchio's, one a joint, and so their inertias; shapes that touch are the links'
own.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel
from app.robot.urdf import PLANAR_JOINTS
from app.simulation.plants.collision_shapes import CollisionShape, collision_shapes, vertices
from app.simulation.plants.mujoco_spec import FLOOR, IMPEDANCE, Spec

_GEOM = mujoco.mjtGeom
_JOINT = mujoco.mjtJoint
_PRIMITIVES = {
    coal.Box: (_GEOM.mjGEOM_BOX, lambda box: box.halfSide),
    coal.Sphere: (_GEOM.mjGEOM_SPHERE, lambda ball: [ball.radius]),
    coal.Cylinder: (_GEOM.mjGEOM_CYLINDER, lambda rod: [rod.radius, rod.halfLength]),
    coal.Capsule: (_GEOM.mjGEOM_CAPSULE, lambda rod: [rod.radius, rod.halfLength]),
}


class RobotSpec(Spec):
    """A robot's specification.

    Attributes:
        model: The robot.
        root: The root link's body.
        shapes: The robot's shapes.
        mobile: Names of l_m's links; of the body itself where bodies stand for links.
    """

    def __init__(
        self,
        model: RobotModel,
        dt: float,
        outer: Sequence[str] | None,
        *,
        free_root: pin.Inertia | None = None,
    ) -> None:
        """Specify the robot over the floor.

        Args:
            model: The robot.
            dt: [s] one step.
            outer: Names of the bodies of L_m on the arm; by default all that
                have a reachability.
            free_root: The inertia of a root link that is free, and that carries some of the
                robot's mass on joints which the plant adds; by default the root moves on motors
                along x, y and yaw.

        Raises:
            UnknownNameError: `outer` names a body that the arm does not have.
        """
        super().__init__(dt)
        self.model = model
        self.shapes, pairs, self.mobile = collision_shapes(model, outer)
        bodies = self._add_joints(free_root)
        self.root = bodies[1]
        self._geoms: dict[str, list[str]] = {}
        for i, shape in enumerate(self.shapes):
            name = f"{shape.part}/{i}"
            self._geoms.setdefault(shape.part, []).append(name)
            self._add_shape(bodies[shape.joint], name, shape)
        for group, named in (("arm_base", pairs.arm_base), ("arm_arm", pairs.arm_arm)):
            for a, b in sorted(named):
                self.allow(group, self.geoms(a), self.geoms(b))
        self.allow("arm_floor", [FLOOR], self.geoms(*sorted(pairs.arm_floor)))

    def geoms(self, *parts: str) -> list[str]:
        """Names of the geoms of links; of bodies where these stand for links."""
        return [geom for part in parts for geom in self._geoms.get(part, ())]

    def _add_joints(self, free_root: pin.Inertia | None) -> list[Any]:
        """The bodies by pinocchio's joints, on the world's."""
        source, bodies = self.model.pin, [self.spec.worldbody]
        base = self.model.description.base
        for i in range(1, source.njoints):
            inertia = source.inertias[i] if i > 1 or free_root is None else free_root
            parent = bodies[source.parents[i]]
            body = self.add_body(parent, source.names[i], source.jointPlacements[i], inertia)
            bodies.append(body)
            if i > 1:
                self._add_arm_joint(body, i)
            elif free_root is not None:
                body.add_freejoint(name="root")
            else:
                x, y, yaw = PLANAR_JOINTS
                self.add_motor(body, x, _JOINT.mjJNT_SLIDE, (1, 0, 0), base.traction_limit_n)
                self.add_motor(body, y, _JOINT.mjJNT_SLIDE, (0, 1, 0), base.traction_limit_n)
                self.add_motor(body, yaw, _JOINT.mjJNT_HINGE, (0, 0, 1), base.yaw_limit_nm)
        return bodies

    def _add_arm_joint(self, body: Any, i: int) -> None:
        model, source = self.model, self.model.pin
        J = pin.computeJointJacobian(source, source.createData(), pin.neutral(source), i)
        axis = J[:, source.joints[i].idx_v]  # in the joint's own frame
        slides = bool(np.any(axis[:3]))
        body.add_joint(
            name=source.names[i],
            axis=axis[:3] if slides else axis[3:],
            type=_JOINT.mjJNT_SLIDE if slides else _JOINT.mjJNT_HINGE,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=[model.q_lower[i - 2], model.q_upper[i - 2]],
            solref_limit=[2.0 * self._dt, 1.0],
            solimp_limit=IMPEDANCE,
        )

    def _add_shape(self, body: Any, name: str, shape: CollisionShape) -> None:
        points = vertices(shape.geometry)
        if points is None:
            kind, size_of = _PRIMITIVES[type(shape.geometry)]
            self.add_geom(body, name, kind, size_of(shape.geometry), shape.T)
        else:
            convex = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            self.spec.add_mesh(name=name, uservert=points.ravel(), inertia=convex)
            self.add_geom(body, name, _GEOM.mjGEOM_MESH, T=shape.T, mesh=name)
