"""The robot in the scene: meshes sent once under frames that move."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import viser

from app.dashboard.colours import Rgb
from app.dashboard.visuals import Visual, load_visuals
from app.robot.meshes import shape_mesh
from app.robot.model import RobotModel
from app.robot.urdf import resolved_urdf
from app.simulation.snapshot import Snapshot

Array = np.ndarray

ROOT = "/robot"
"""Scene node that moves with the base: origin on the floor below the base's centre, x forward."""
BODY: Rgb = (64, 156, 224)
BODY_OPACITY = 0.28  # [-]


class LinkPoses:
    """Kinematics of the whole URDF, wheels included, relative to its root.

    The controller's model has the wheels locked and a planar root; for drawing they turn, and the
    root is the scene's node.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.model = pin.buildModelFromXML(resolved_urdf(robot.description))
        self._data = self.model.createData()
        self._q = pin.neutral(self.model)
        base, arm = robot.description.base, robot.description.arm
        self._arm = [self.model.joints[self.model.getJointId(name)] for name in arm.joints]
        self._right = [self.model.joints[self.model.getJointId(n)] for n in base.right_wheel_joints]
        self._left = [self.model.joints[self.model.getJointId(n)] for n in base.left_wheel_joints]

    def update(self, q_m: Array, wheel_angles: Array) -> list[pin.SE3]:
        """T_root_joint of every joint.

        Args:
            q_m: (n_m,) [rad or m] arm joints.
            wheel_angles: (2,) [rad] right and left.
        """
        for joint, position in zip(self._arm, q_m, strict=True):
            self._set(joint, position)
        for side, angle in zip((self._right, self._left), wheel_angles, strict=True):
            for joint in side:
                self._set(joint, angle)
        pin.forwardKinematics(self.model, self._data, self._q)
        return [T.copy() for T in self._data.oMi]

    def _set(self, joint: pin.JointModel, position: float) -> None:
        # pinocchio keeps a continuous joint, which a wheel often is, as a point on the circle.
        at = (np.cos(position), np.sin(position)) if joint.nq == 2 else (position,)
        self._q[joint.idx_q : joint.idx_q + joint.nq] = at


class RobotScene:
    """Visual meshes and, on demand, the convex bodies."""

    def __init__(self, server: viser.ViserServer, robot: RobotModel) -> None:
        self._kinematics = LinkPoses(robot)
        self._server = server
        model = self._kinematics.model
        self._root = server.scene.add_frame(ROOT, show_axes=False)
        visuals = load_visuals(robot.description, model)
        bodies = _bodies(robot, model)
        moving = sorted({visual.joint for visual in (*visuals, *bodies)})
        self._frames = {
            joint: server.scene.add_frame(_node(model, joint), show_axes=False) for joint in moving
        }
        self._visuals = [self._add(model, visual, None) for visual in visuals]
        self._bodies = [self._add(model, body, BODY_OPACITY) for body in bodies]
        self.show(meshes=True, bodies=False)

    def show(self, *, meshes: bool, bodies: bool) -> None:
        """Choose what is to be seen of the robot."""
        for handle in self._visuals:
            handle.visible = meshes
        for handle in self._bodies:
            handle.visible = bodies

    def update(self, snapshot: Snapshot) -> None:
        """Move the frames; viser sends only those that moved."""
        x, y, phi = snapshot.base_pose
        self._root.position = (x, y, 0.0)
        self._root.wxyz = (np.cos(phi / 2), 0.0, 0.0, np.sin(phi / 2))
        poses = self._kinematics.update(snapshot.q_m, snapshot.wheel_angles)
        for joint, frame in self._frames.items():
            frame.position, frame.wxyz = _pose(poses[joint])

    def _add(self, model: pin.Model, visual: Visual, opacity: float | None) -> viser.MeshHandle:
        position, wxyz = _pose(visual.placement)
        return self._server.scene.add_mesh_simple(
            f"{_node(model, visual.joint)}/{visual.name}",
            vertices=np.asarray(visual.mesh.vertices),
            faces=np.asarray(visual.mesh.faces),
            color=visual.colour, opacity=opacity, position=position, wxyz=wxyz,
            cast_shadow=opacity is None, receive_shadow=opacity is None,
        )  # fmt: skip


def _bodies(robot: RobotModel, model: pin.Model) -> list[Visual]:
    """The convex bodies of the description, in the frames of the joints that move them."""
    bodies = []
    for body in robot.description.bodies:
        frame = model.frames[model.getFrameId(body.frame)]
        for i, shape in enumerate(body.shapes):
            placement = frame.placement * shape.placement()
            name = f"body_{body.name}_{i}"
            bodies.append(Visual(name, frame.parentJoint, placement, shape_mesh(shape), BODY))
    return bodies


def _node(model: pin.Model, joint: int) -> str:
    return f"{ROOT}/{'fixed' if joint == 0 else model.names[joint]}"


def _pose(T: pin.SE3) -> tuple[Array, Array]:
    """Position (3,) [m] and quaternion wxyz (4,)."""
    xyzquat = np.array(pin.SE3ToXYZQUAT(T))
    return xyzquat[:3], xyzquat[[6, 3, 4, 5]]
