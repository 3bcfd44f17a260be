"""Robot: meshes sent once, under frames that move."""

from __future__ import annotations

import logging

import numpy as np
import pinocchio as pin
import trimesh
import viser

from app.dashboard.scene.colours import Rgb
from app.dashboard.scene.visuals import GREY, Visual, for_display, load_visuals
from app.errors import AssetError
from app.robot.description import RobotDescription
from app.robot.meshes import shape_mesh
from app.robot.model import RobotModel
from app.robot.urdf import bare_urdf

Array = np.ndarray


def to_viser(T: pin.SE3) -> tuple[Array, Array]:
    """Position (3,) [m] and quaternion wxyz (4,) of a pose."""
    xyzquat = np.array(pin.SE3ToXYZQUAT(T))
    return xyzquat[:3], xyzquat[[6, 3, 4, 5]]


def from_viser(position: Array, wxyz: Array) -> pin.SE3:
    """The pose of a position (3,) [m] and a quaternion wxyz (4,)."""
    return pin.XYZQUATToSE3(np.concatenate([position, wxyz[1:], wxyz[:1]]))


def moved(T: pin.SE3, points: np.ndarray) -> np.ndarray:
    """(N, 3) points of one frame in another."""
    return points @ T.rotation.T + T.translation


logger = logging.getLogger(__name__)

ROOT = "/robot"
"""Scene node that moves with the base: origin on the floor below the base's centre, x forward."""
BODY: Rgb = (64, 156, 224)
BODY_OPACITY = 0.28  # [-]
GHOST_OPACITY = 0.30  # [-]
_AROUND = np.array([0.15, 0.15, 0.0])  # [m] of a border around the base


class LinkPoses:
    """Kinematics of the whole URDF, wheels included, relative to its root.

    The controller's model has the wheels locked and a planar root; for drawing they turn, and the
    root is the scene's node.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.model = pin.buildModelFromXML(bare_urdf(robot.description))
        self._data = self.model.createData()
        self._q = pin.neutral(self.model)
        base, arm = robot.description.base, robot.description.arm
        self._arm = [self.model.joints[self.model.getJointId(name)] for name in arm.joints]
        self._wheels = [
            [self.model.joints[self.model.getJointId(name)] for name in wheels.joints]
            for wheels in base.wheels
        ]

    def update(self, q_m: Array, wheel_angles: Array) -> list[pin.SE3]:
        """T_root_joint of every joint.

        Args:
            q_m: (n_m,) [rad or m] arm joints.
            wheel_angles: (n_w,) [rad] of the base's wheels, right and left.
        """
        for joint, position in zip(self._arm, q_m, strict=True):
            self._set(joint, position)
        for wheels, angle in zip(self._wheels, wheel_angles, strict=True):
            for joint in wheels:
                self._set(joint, angle)
        pin.forwardKinematics(self.model, self._data, self._q)
        return [T.copy() for T in self._data.oMi]

    def _set(self, joint: pin.JointModel, position: float) -> None:
        # pinocchio keeps a continuous joint, which a wheel often is, as a point on the circle.
        at = (np.cos(position), np.sin(position)) if joint.nq == 2 else (position,)
        self._q[joint.idx_q : joint.idx_q + joint.nq] = at


class RobotParts:
    """Kinematics, visual meshes and convex bodies of a robot: read once, drawn for many viewers.

    Attributes:
        kinematics: Poses of what moves; used by the one thread that draws.
        visuals: What the robot looks like; its convex bodies where a mesh is not installed.
        bodies: The convex bodies that distances are measured to.
        title: What people read over the robot; it says so if its meshes are not here.
        extent: (N, 3) [m] corners of all that a camera has to show, in the base's frame: the links
            in the ready pose, and the borders' place around the base.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.kinematics = LinkPoses(robot)
        self.bodies = _bodies(robot, self.kinematics.model)
        self.title = robot.description.title
        try:
            self.visuals = load_visuals(robot.description, self.kinematics.model)
        except AssetError as error:
            logger.warning("%s is drawn by its convex bodies: %s", robot.description.name, error)
            self.visuals = [_as_look(body) for body in self.bodies]
            self.title += " (its meshes are not installed: convex bodies)"
        self.extent = self._extent(robot.description)

    def _extent(self, robot: RobotDescription) -> Array:
        ready = np.array(robot.arm.ready_position)
        poses = self.kinematics.update(ready, np.zeros(len(robot.base.wheels)))

        def corners(visual: Visual) -> Array:
            T = poses[visual.joint] * visual.placement
            return moved(T, trimesh.bounds.corners(visual.mesh.bounds))

        mobile = np.vstack([corners(body) for body in self.bodies[: len(robot.bodies[0].shapes)]])
        around = np.array([mobile.min(axis=0) - _AROUND, mobile.max(axis=0) + _AROUND])
        links = [corners(visual) for visual in self.visuals or self.bodies]
        return np.vstack([trimesh.bounds.corners(around), *links])

    def joint_name(self, joint: int) -> str:
        """Name of a joint of the model; empty for the root."""
        return "" if joint == 0 else self.kinematics.model.names[joint]


class RobotScene:
    """A robot in a scene: visual meshes and, on demand, the convex bodies."""

    def __init__(
        self,
        scene: viser.SceneApi,
        parts: RobotParts,
        root: str = ROOT,
        *,
        ghost: Rgb | None = None,
    ) -> None:
        """Send all meshes.

        Args:
            scene: Where to.
            parts: The robot.
            root: Scene node that moves with the base.
            ghost: Colour of a translucent robot without bodies; None for the real one.
        """
        self._parts, self._scene, self._ghost, self._path = parts, scene, ghost, root
        self._root = scene.add_frame(root, show_axes=False)
        bodies = parts.bodies if ghost is None else []
        moving = sorted({visual.joint for visual in (*parts.visuals, *bodies)})
        self._frames = {
            joint: scene.add_frame(self._node(joint), show_axes=False) for joint in moving
        }
        opacity = None if ghost is None else GHOST_OPACITY
        self.links = [(visual.joint, self._add(visual, opacity)) for visual in parts.visuals]
        """Joint that moves it, and handle, of each visual mesh."""
        self._bodies = [self._add(body, BODY_OPACITY) for body in bodies]
        self.show(meshes=True, bodies=False)

    def show(self, *, meshes: bool, bodies: bool) -> None:
        """Choose what is to be seen of the robot."""
        for _, handle in self.links:
            handle.visible = meshes
        for handle in self._bodies:
            handle.visible = bodies

    def update(self, base_pose: Array, q_m: Array, wheel_angles: Array) -> None:
        """Move the frames; viser sends only those that moved.

        Args:
            base_pose: (3,) x, y [m] and heading [rad] in the world.
            q_m: (n_m,) [rad or m] arm joints.
            wheel_angles: (n_w,) [rad] of the base's wheels, right and left.
        """
        x, y, phi = base_pose
        self._root.position = (x, y, 0.0)
        self._root.wxyz = (np.cos(phi / 2), 0.0, 0.0, np.sin(phi / 2))
        poses = self._parts.kinematics.update(q_m, wheel_angles)
        for joint, frame in self._frames.items():
            frame.position, frame.wxyz = to_viser(poses[joint])

    def world_pose(self, joint: int) -> pin.SE3:
        """T_world_joint of a joint, as it was drawn last."""
        frame = self._frames[joint]
        return from_viser(self._root.position, self._root.wxyz) * from_viser(
            frame.position, frame.wxyz
        )

    def remove(self) -> None:
        """Take it out of the scene."""
        self._root.remove()

    def _add(self, visual: Visual, opacity: float | None) -> viser.MeshHandle:
        position, wxyz = to_viser(visual.placement)
        return self._scene.add_mesh_simple(
            f"{self._node(visual.joint)}/{visual.name}",
            vertices=np.asarray(visual.mesh.vertices),
            faces=np.asarray(visual.mesh.faces),
            color=visual.colour if self._ghost is None else self._ghost,
            opacity=opacity,
            position=position,
            wxyz=wxyz,
            cast_shadow=opacity is None,
            receive_shadow=opacity is None,
        )

    def _node(self, joint: int) -> str:
        return f"{self._path}/{self._parts.joint_name(joint) or 'fixed'}"


def _as_look(body: Visual) -> Visual:
    """A convex body in place of the meshes that it covers."""
    return body._replace(name=f"look_{body.name}", mesh=for_display(body.mesh), colour=GREY)


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
