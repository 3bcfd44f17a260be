"""Robot: what it looks like, read once for many viewers, and where its links are."""

import logging
from collections.abc import Sequence
from functools import cached_property
from typing import NamedTuple
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
from app.robot.model import RobotModel, kept_per_model
from app.robot.shapes import shape_mesh
from app.robot.urdf import colour, mesh_bytes, origin, urdf_mesh
from app.strict import Array

logger = logging.getLogger(__name__)
MAX_FACES = 2500  # faces a mesh may have on the page; the Panda's links come with 12,000 to 22,000
MOST_FACES = 4 * MAX_FACES
"""Faces that are borne where fewer would show; what cannot be decimated at all keeps more."""
AGGRESSIONS = (3, 5, 7)
"""Of the decimation, the first that gets below `MOST_FACES`. More of it takes corners off meshes of
many parts, such as UR5's tubes; with less such meshes stay too heavy."""
LIGHT_FACES = 400
"""Faces of all meshes of one colour that one joint moves, where a page draws in software."""
CREASE = np.deg2rad(35.0)  # [rad] sharper edges are drawn as edges, not shaded over
GREY: Rgb = (150, 150, 155)  # colour of a visual for which the URDF states none
BODY: Rgb = (64, 156, 224)
_BELOW = np.array([0.0, 0.0, 0.12])  # [m] of a label at the top, which stands above its place
_AT_TOP = 0.01  # [m] below the highest place
_AROUND = np.array([0.15, 0.15, 0.0])  # [m] of a border around the base


class Visual(NamedTuple):
    """One mesh in the frame of the joint that moves it."""

    name: str
    joint: int
    """Index of pinocchio's joint, 0 for what is fixed to the root."""
    placement: pin.SE3
    """T_joint_mesh."""
    mesh: trimesh.Trimesh
    colour: Rgb


class LinkPoses:
    """Kinematics of the whole URDF, wheels included, relative to its root.

    The controller's model has the wheels locked and a planar root; for drawing they turn, and the
    root is the scene's node.
    """

    def __init__(self, robot: RobotModel) -> None:
        self.model = pin.buildModelFromXML(bare_urdf(robot.description))
        self._data = self.model.createData()
        self._robot, self._arm = robot, self._places(robot.description.arm.joints)

    def update(self, q_m: Array, wheel_angles: Array) -> list[pin.SE3]:
        """T_root_joint of every joint.

        Of the arm's joints (n_m,) [rad or m], and the angles (n_w,) [rad] of the base's `wheels`.
        """
        turned = np.zeros(self.model.nv)
        turned[self._arm] = q_m
        wheels = self._robot.wheel_positions(wheel_angles)
        turned[self._places([*wheels])] = [*wheels.values()]
        # pinocchio keeps a continuous joint, which a wheel often is, as a point on the circle.
        q = pin.integrate(self.model, pin.neutral(self.model), turned)
        pin.forwardKinematics(self.model, self._data, q)
        return [T.copy() for T in self._data.oMi]

    def _places(self, joints: Sequence[str]) -> list[int]:
        return [self.model.joints[self.model.getJointId(name)].idx_v for name in joints]


class RobotParts:
    """Kinematics, visual meshes and convex bodies of a robot: read once, drawn for many viewers."""

    def __init__(self, robot: RobotModel) -> None:
        self.kinematics = LinkPoses(robot)
        """Poses of what moves; used by the one thread that draws."""
        self.bodies = _bodies(robot, self.kinematics.model)
        """The convex bodies that distances are measured to."""
        self.title = robot.description.title
        """What people read over the robot; it says so if its meshes are not here."""
        try:
            self.visuals = _visuals(robot)
            """What the robot looks like; its convex bodies where a mesh is not installed."""
        except (AssetError, RobotFileError) as error:
            logger.warning("%s is drawn by its convex bodies: %s", robot.description.name, error)
            self.visuals = [
                body._replace(name=f"look_{body.name}", mesh=for_display(body.mesh), colour=GREY)
                for body in self.bodies
            ]
            self.title += " (its meshes are not installed: convex bodies)"
        self.extent = self._extent(robot.description)
        """(N, 3) [m] corners of all that a camera has to show, in the base's frame: the links in
        the ready pose, and the borders' place around the base."""
        top = self.extent[:, 2] > self.extent[:, 2].max() - _AT_TOP
        self.crown = self.extent[top].mean(axis=0) - _BELOW
        """(3,) [m] the top of the arm in its ready pose, in the base's frame."""

    @cached_property
    def light_visuals(self) -> list[Visual]:
        """The visuals with few faces, one for each colour of what a joint moves."""
        groups: dict[tuple[int, Rgb], list[trimesh.Trimesh]] = {}
        for visual in self.visuals:
            mesh = visual.mesh.copy().apply_transform(visual.placement.homogeneous)
            groups.setdefault((visual.joint, visual.colour), []).append(mesh)
        return [
            Visual(f"light_{i}", joint, pin.SE3.Identity(), _light(meshes), colour)
            for i, ((joint, colour), meshes) in enumerate(groups.items())
        ]

    def _extent(self, robot: RobotDescription) -> Array:
        ready = np.array(robot.arm.ready_position)
        poses = self.kinematics.update(ready, np.zeros(len(robot.base.wheels)))

        def corners(visual: Visual) -> Array:
            T = poses[visual.joint] * visual.placement
            return trimesh.transform_points(trimesh.bounds.corners(visual.mesh.bounds), np.array(T))

        mobile = np.vstack([corners(body) for body in self.bodies[: len(robot.bodies[0].shapes)]])
        around = np.array([mobile.min(axis=0) - _AROUND, mobile.max(axis=0) + _AROUND])
        links = [corners(visual) for visual in self.visuals or self.bodies]
        return np.vstack([trimesh.bounds.corners(around), *links])


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


@kept_per_model(1)
def _visuals(robot: RobotModel) -> list[Visual]:
    tree = ElementTree.fromstring(resolved_urdf(robot.description))
    size = mesh_bytes(tree) if is_own(robot.description.name) else 0
    try:
        return within_budget(_visuals_of, robot.description, size=size)
    except BudgetError as error:
        raise RobotFileError(f"its meshes: {error}") from None


def _visuals_of(description: RobotDescription) -> list[Visual]:
    return load_visuals(description, LinkPoses(RobotModel(description)).model)


def load_visuals(description: RobotDescription, model: pin.Model) -> list[Visual]:
    """All visual meshes of the URDF, decimated, in the URDF's colours.

    `model` is pinocchio's of the whole URDF, whose joints the visuals refer to.

    Raises:
        AssetError: The URDF or a mesh is not there.
        RobotFileError: A shape of the URDF says nothing sensible, or a mesh cannot be read.
    """
    tree = ElementTree.fromstring(resolved_urdf(description))
    materials = {each.get("name"): each for each in tree.iterfind("material")}
    ready: dict[bytes, trimesh.Trimesh] = {}  # four wheels share one file
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
                # Of positions only: textures would be copied with every part of it.
                ready[key] = for_display(trimesh.Trimesh(mesh.vertices, mesh.faces))
            placement = frame.placement * origin(visual, where)
            rgba = colour(visual, materials, where)
            r, g, b = GREY if rgba is None else (round(255 * x) for x in rgba[:3])
            look = Visual(f"{name}_{i}", frame.parentJoint, placement, ready[key], (r, g, b))
            visuals.append(look)
    return visuals


def for_display(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """A mesh of about `MAX_FACES`, with the vertices of sharp edges doubled.

    The browser averages normals over shared vertices, so without the doubling every edge of a box
    would look like a pillow.
    """
    if len(mesh.faces) > MAX_FACES:
        mesh = _decimated(mesh)
    return trimesh.graph.smooth_shade(mesh, angle=CREASE)


def _decimated(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    mesh = mesh.copy()
    mesh.merge_vertices(merge_tex=True, merge_norm=True)  # loose triangles would shrink one by one
    for aggression in AGGRESSIONS:
        light = mesh.simplify_quadric_decimation(face_count=MAX_FACES, aggression=aggression)
        if len(light.faces) <= MOST_FACES:
            break
    return light


def _light(meshes: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    mesh = trimesh.util.concatenate(meshes)
    mesh.merge_vertices(merge_norm=True)  # those that were doubled for the sake of their normals
    if len(mesh.faces) > LIGHT_FACES:
        mesh = mesh.simplify_quadric_decimation(face_count=LIGHT_FACES, aggression=AGGRESSIONS[-1])
    return trimesh.graph.smooth_shade(mesh, angle=CREASE)
