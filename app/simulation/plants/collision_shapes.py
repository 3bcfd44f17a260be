"""The pairs of parts between which a plant computes contacts, and the shapes of the parts."""

import logging
from itertools import product
from pathlib import Path
from typing import NamedTuple
from xml.etree import ElementTree

import coal
import numpy as np
import pinocchio as pin

from app.border.mobile import bounds
from app.errors import AssetError, RobotFileError
from app.jobs.bounded import BudgetError, within_budget
from app.robot.assets import is_own, resolved_urdf
from app.robot.description import RobotDescription
from app.robot.model import RobotModel, kept_per_model
from app.robot.shapes import convex_hull
from app.robot.urdf import mesh_bytes
from app.strict import Array

FLOOR = "/floor"  # name of the floor as a part; no body and no usual link has this name

ContactPairs = dict[tuple[str, str], str]
"""The field of `Contacts` for each pair of parts, by the names of bodies or links. In pairs of
`arm_base` the part of l_m is first, in pairs of `arm_floor` the floor."""


class CollisionShape(NamedTuple):
    part: str  # name of the shape's link or body
    joint: int  # Pinocchio's index of the joint that moves the shape
    T: pin.SE3  # pose of the shape in the joint's frame
    geometry: coal.CollisionGeometry | Array  # primitive, or (n, 3) [m] points of a hull

    @property
    def lowest(self) -> float:
        """[m] lowest z, in the joint's frame, of the bounding box along the shape's own axes."""
        geometry, T = self.geometry, self.T
        if isinstance(geometry, np.ndarray):
            low, high = geometry.min(axis=0), geometry.max(axis=0)
            geometry, T = coal.Box(*(high - low)), T * pin.SE3(np.eye(3), (low + high) / 2)
        return float(bounds(geometry, T)[0][2])


class CollisionShapes(NamedTuple):
    shapes: tuple[CollisionShape, ...]  # all shapes of a robot
    pairs: ContactPairs  # pairs of parts between which contacts are computed
    mobile: tuple[str, ...]  # names of the parts of l_m


def body_contact_pairs(description: RobotDescription) -> ContactPairs:
    """Pairs of bodies between which contacts are computed: l_m, and also the floor, with each body
    of the arm that the description's `reachability` contains; and any two bodies of the arm that
    are not neighbours in the chain and not a pair of the description's `unwatched`.
    """
    mobile, *arm = [body.name for body in description.bodies]
    outer = [name for name in arm if name in description.reachability]
    apart = [(a, b) for i, a in enumerate(arm) for b in arm[i + 2 :]]
    watched = [(a, b) for a, b in apart if f"{a}-{b}" not in description.unwatched]
    return {
        **{(mobile, name): "arm_base" for name in outer},
        **dict.fromkeys(watched, "arm_arm"),
        **{(FLOOR, name): "arm_floor" for name in outer},
    }


def link_contact_pairs(description: RobotDescription) -> ContactPairs:
    """Pairs of links whose bodies are a pair of `body_contact_pairs`, without those in `nested`.
    Pairs of l_m in `unwatched` are also included, because their bodies may overlap by design, but
    their links may not. The exception is the pair of l_m and the arm's first body.
    """
    covers = {body.name: body.covers for body in description.bodies} | {FLOOR: (FLOOR,)}
    nested, mobile = description.nested, description.mobile_body.name
    beyond = [body.name for body in description.bodies[2:]]
    near = [(mobile, name) for name in beyond if f"{mobile}-{name}" in description.unwatched]
    bodies = {**body_contact_pairs(description), **dict.fromkeys(near, "arm_base")}
    return {
        pair: group
        for (a, b), group in bodies.items()
        for pair in product(covers[a], covers[b])
        if frozenset(pair) not in nested
    }


def geometry_with_floor(
    model: RobotModel, floor: pin.GeometryObject, pairs: ContactPairs
) -> tuple[pin.GeometryModel, list[str]]:
    """The bodies and a floor, with the pairs of their shapes; each pair's field of `Contacts`."""
    geometry, fields = model.geometry.copy(), list[str]()
    ids = {**model.shape_ids, FLOOR: [geometry.addGeometryObject(floor)]}
    for (a, b), field in pairs.items():
        for shapes in product(ids[a], ids[b]):
            geometry.addCollisionPair(pin.CollisionPair(*shapes))
            fields.append(field)
    return geometry, fields


@kept_per_model(1)
def collision_shapes(model: RobotModel) -> CollisionShapes:
    """The collision shapes of a robot's links, or its convex bodies if a mesh is missing; the
    result is cached. A RobotFileError is raised if a mesh is damaged, or if the meshes of a user's
    own robot exceed the limits of `within_budget`.
    """
    description = model.description
    try:
        text = resolved_urdf(description)
    except AssetError as error:
        larger = "contacts are computed with the convex bodies, which are larger than the links"
        logging.getLogger(__name__).warning("%s: %s: %s", description.name, larger, error)
        objects = model.geometry.geometryObjects
        bodies = (
            _shape(name, objects[i], objects[i].geometry)
            for name, ids in model.shape_ids.items()
            for i in ids
        )
        mobile = (description.mobile_body.name,)
        return CollisionShapes(tuple(bodies), body_contact_pairs(description), mobile)
    size = mesh_bytes(ElementTree.fromstring(text)) if is_own(description.name) else 0
    try:
        shapes = within_budget(_link_shapes, model.pin, text, size=size)
    except BudgetError as error:
        raise RobotFileError(f"{description.name}: its meshes: {error}") from None
    return CollisionShapes(shapes, link_contact_pairs(description), description.mobile_body.covers)


def _link_shapes(model: pin.Model, urdf: str) -> tuple[CollisionShape, ...]:
    """The collision shapes of the links in a URDF's text; `model` has the joints that move them."""
    try:
        loaded = pin.buildGeomFromUrdfString(model, urdf, pin.GeometryType.COLLISION)
    except ValueError as error:  # assimp reports exhausted memory like a damaged file
        why = f"{str(error).rpartition('message: ')[2].strip()}; copy or export this mesh again"
        raise MemoryError if "bad_alloc" in why else RobotFileError(why) from None
    return tuple(
        _shape(model.frames[each.parentFrame].name, each, piece)
        for each in loaded.geometryObjects
        for piece in _pieces(each)
    )


def _pieces(placed: pin.GeometryObject) -> list[coal.CollisionGeometry]:
    """A hull for each object or group of an OBJ file, as in pybullet; otherwise the whole shape."""
    if not placed.meshPath.lower().endswith(".obj"):
        return [placed.geometry]
    points: list[list[float]] = []
    groups: list[set[int]] = [set()]
    for line in Path(placed.meshPath).read_text(encoding="utf-8", errors="replace").splitlines():
        word, *rest = line.split() or [""]
        if word == "v":
            points.append([float(each) for each in rest[:3]])
        elif word in ("o", "g") and rest:
            groups.append(set())
        elif word == "f":
            corners = (int(each.partition("/")[0]) for each in rest)
            groups[-1] |= {k - 1 if k > 0 else k + len(points) for k in corners}
    groups = [group for group in groups if group]
    if len(groups) < 2:
        return [placed.geometry]
    scaled = np.array(points) * placed.meshScale
    return [convex_hull(scaled[sorted(group)]) for group in groups]


def _shape(
    part: str, placed: pin.GeometryObject, geometry: coal.CollisionGeometry
) -> CollisionShape:
    """A shape of the link or body `part` at the pose of `placed`; a mesh becomes its points."""
    if isinstance(geometry, coal.BVHModelBase):
        geometry = np.array(geometry.vertices())
    elif isinstance(geometry, coal.ConvexBase):
        geometry = np.array(geometry.points())
    return CollisionShape(part, placed.parentJoint, placed.placement, geometry)
