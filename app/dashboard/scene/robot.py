"""Meshes of a robot, which are loaded once for all viewers, and poses of its links."""

import logging
from collections.abc import Sequence
from functools import cached_property
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import trimesh

from app.dashboard.scene.colours import Rgb
from app.errors import AssetError, RobotFileError
from app.jobs.bounded import BudgetError, within_budget
from app.onboarding.read.links import read_mesh
from app.robot.assets import bare_urdf, is_own, resolved_urdf
from app.robot.description import RobotDescription
from app.robot.model import RobotModel, configured, kept_per_model
from app.robot.shapes import shape_mesh
from app.robot.urdf import colour, mesh_bytes, origin, urdf_mesh
from app.strict import Array

logger = logging.getLogger(__name__)
MAX_FACES = 2500  # [-] aim of the decimation; a link of the Panda has 12,000 to 22,000 faces
AGGRESSIONS = (3, 5, 7)
"""Settings of the decimation: the first one whose result has at most 4 times the aimed number of
faces is used, or the last one. Higher settings remove parts of meshes that consist of many parts,
such as UR5's tubes."""
LIGHT_FACES = 400  # [-] aim of the decimation for a page with low detail, for each joint and colour
CREASE = np.deg2rad(35.0)  # [rad] sharper edges are not smoothed
GREY: Rgb = (150, 150, 155)  # colour of a visual without a colour in the URDF
BODY: Rgb = (64, 156, 224)  # colour of convex bodies
_DARKEST = 110  # [-] smallest value of the brightest channel: black is invisible on a dark page
_BELOW = np.array([0.0, 0.0, 0.12])  # [m] from the top of the arm down to the label's point
_AROUND = np.array([0.15, 0.15, 0.0])  # [m] space for a border around the base


class Visual(NamedTuple):
    """A mesh, and its pose in the frame of the joint that moves it."""

    name: str
    joint: int  # index of pinocchio's joint; 0 for a mesh that is fixed to the root
    placement: pin.SE3  # T_joint_mesh
    mesh: trimesh.Trimesh
    colour: Rgb

    def corners(self, T: pin.SE3) -> Array:
        """Return the bounding box's corners (8, 3) [m] at the joint's pose T."""
        corners = trimesh.bounds.corners(self.mesh.bounds)
        return trimesh.transform_points(corners, (T * self.placement).homogeneous)


class LinkPoses:
    """Kinematics of the whole URDF, relative to its root; unlike in `RobotModel`, wheels turn."""

    def __init__(self, robot: RobotModel) -> None:
        self.model = pin.buildModelFromXML(bare_urdf(robot.description))
        self._data, self._robot = self.model.createData(), robot
        wheels = (name for wheel in robot.description.base.wheels for name in wheel.joints)
        self.wheels = {self.model.getJointId(name) for name in wheels}

    def update(self, q_m: Array, wheel_angles: Array) -> list[pin.SE3]:
        """Return T_root_joint of all joints at q_m (n_m,) [rad or m], wheel angles (n_w,) [rad]."""
        q = configured(self.model, self._robot.joint_positions(q_m, wheel_angles))
        pin.forwardKinematics(self.model, self._data, q)
        return [T.copy() for T in self._data.oMi]


class RobotParts:
    """Kinematics, visual meshes and convex bodies of a robot, loaded once for all viewers."""

    def __init__(self, robot: RobotModel, *, apart: bool = False) -> None:
        """Load all parts; raises `AssetError` if the URDF or the mesh of a convex body is missing.

        If `apart`, or for a user's own robot, a separate process reads large meshes. Its end frees
        the memory that the library for simplification does not free.
        """
        self.kinematics = LinkPoses(robot)  # not thread-safe, for the drawing thread
        self.bodies = _bodies(robot, self.kinematics.model)  # of the distance computation
        self.title = robot.description.title  # with a note if the bodies replace the visual meshes
        try:
            self.visuals = _visuals(robot, apart)
        except (AssetError, RobotFileError) as error:
            logger.warning("%s is drawn by its convex bodies: %s", robot.description.name, error)
            self.visuals = [
                body._replace(name=f"look_{body.name}", mesh=for_display(body.mesh), colour=GREY)
                for body in self.bodies
            ]
            self.title += " (convex bodies, because its meshes are missing or unusable)"
        self.extent = self._extent(robot.description)
        """(N, 3) [m] corners of the parts that a camera must show, in the base's frame: the links
        in the ready posture, and a part of the border around the base."""
        top = self.extent[:, 2] > self.extent[:, 2].max() - 0.01  # [m]
        self.crown = self.extent[top].mean(axis=0) - _BELOW
        """(3,) [m] position of the robot's label in the base's frame, slightly below the top."""

    @cached_property
    def light_visuals(self) -> list[Visual]:
        """Meshes with few faces for a page with low detail, one for each joint and colour."""
        groups: dict[tuple[int, Rgb], list[trimesh.Trimesh]] = {}
        for visual in self.visuals:
            mesh = visual.mesh.copy().apply_transform(visual.placement.homogeneous)
            groups.setdefault((visual.joint, visual.colour), []).append(mesh)
        lights = []
        for i, ((joint, shade), meshes) in enumerate(groups.items()):
            whole: Any = trimesh.util.concatenate(meshes)
            whole.merge_vertices(merge_norm=True)  # undoes the duplication of vertices
            light = for_display(whole, LIGHT_FACES, AGGRESSIONS[-1:])
            lights.append(Visual(f"light_{i}", joint, pin.SE3.Identity(), light, shade))
        return lights

    def _extent(self, robot: RobotDescription) -> Array:
        ready = np.array(robot.arm.ready_position)
        poses = self.kinematics.update(ready, np.zeros(len(robot.base.wheels)))
        base = self.bodies[: len(robot.bodies[0].shapes)]
        mobile = np.vstack([body.corners(poses[body.joint]) for body in base])
        around = np.array([mobile.min(axis=0) - _AROUND, mobile.max(axis=0) + _AROUND])
        links = [each.corners(poses[each.joint]) for each in self.visuals or self.bodies]
        return np.vstack([trimesh.bounds.corners(around), *links])


def _bodies(robot: RobotModel, model: pin.Model) -> list[Visual]:
    bodies = []
    for body in robot.description.bodies:
        frame = model.frames[model.getFrameId(body.frame)]
        for i, shape in enumerate(body.shapes):
            placement = frame.placement * shape.placement()
            name = f"body_{body.name}_{i}"
            bodies.append(Visual(name, frame.parentJoint, placement, shape_mesh(shape), BODY))
    return bodies


@kept_per_model(1)
def _visuals(robot: RobotModel, apart: bool) -> list[Visual]:
    tree = ElementTree.fromstring(resolved_urdf(robot.description))
    size = mesh_bytes(tree) if apart or is_own(robot.description.name) else 0
    try:
        return within_budget(load_visuals, robot.description, size=size)
    except BudgetError as error:
        raise RobotFileError(f"its meshes: {error}") from None


def load_visuals(description: RobotDescription) -> list[Visual]:
    """Load the URDF's visual meshes for display, in its colours; too dark ones are brightened.

    `joint` of each result is the index of a joint in `LinkPoses.model`. Raises `AssetError` if the
    URDF or a mesh is missing, and `RobotFileError` if a shape or a mesh is invalid.
    """
    urdf = resolved_urdf(description)
    tree, model = ElementTree.fromstring(urdf), pin.buildModelFromXML(urdf)
    materials = {each.get("name"): each for each in tree.iterfind("material")}
    ready: dict[bytes, trimesh.Trimesh] = {}  # several visuals may share a file
    visuals = []
    for link in tree.iterfind("link"):
        name = link.get("name", "")
        where, frame = f"link {name!r}", model.frames[model.getFrameId(name, pin.BODY)]
        for i, visual in enumerate(link.iterfind("visual")):
            if (shape := visual.find("geometry/*")) is None:
                continue
            key = ElementTree.tostring(shape)
            if key not in ready:
                mesh, _ = urdf_mesh(shape, where, read_mesh)
                # Vertices and faces only: all parts of a mesh would copy its textures.
                ready[key] = for_display(trimesh.Trimesh(mesh.vertices, mesh.faces))
            placement = frame.placement * origin(visual, where)
            rgba = colour(visual, materials)
            rgb = GREY if rgba is None else [round(255 * x) for x in rgba[:3]]
            r, g, b = (x + max(_DARKEST - max(rgb), 0) for x in rgb)
            look = Visual(f"{name}_{i}", frame.parentJoint, placement, ready[key], (r, g, b))
            visuals.append(look)
    return visuals


def for_display(
    mesh: trimesh.Trimesh, most: int = MAX_FACES, aggressions: Sequence[int] = AGGRESSIONS
) -> trimesh.Trimesh:
    """Return a mesh to draw: decimated if it has over `most` faces, and with sharp edges."""
    if len(mesh.faces) > most:
        whole = mesh.copy()
        whole.merge_vertices(merge_tex=True, merge_norm=True)  # else no triangles are connected
        for aggression in aggressions:
            mesh = whole.simplify_quadric_decimation(face_count=most, aggression=aggression)
            if len(mesh.faces) <= 4 * most:
                break
    # With common vertices, the edges of a box look round, because the browser averages normals.
    return trimesh.graph.smooth_shade(mesh, angle=CREASE)
