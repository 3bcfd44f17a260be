"""What of a robot may touch: which pairs, and with which shapes.

The shapes are the links' own, or the description's bodies where a mesh is not installed.
"""

from __future__ import annotations

import logging
from itertools import combinations, product
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.errors import AssetError
from app.robot.assets import resolved_urdf
from app.robot.description import RobotDescription
from app.robot.model import RobotModel, kept_per_model

Array = np.ndarray


class ContactPairs(NamedTuple):
    """Pairs of names, each pair in one group only; names are those of bodies or of links."""

    arm_base: frozenset[tuple[str, str]]
    """A part of l_m, and a part of the arm that can come near it."""
    arm_arm: frozenset[tuple[str, str]]
    """Parts of arm bodies that are not neighbours in the chain."""
    arm_floor: frozenset[str]
    """Parts of the arm that can reach the floor."""


class CollisionShape(NamedTuple):
    """One convex shape.

    Attributes:
        part: Name of the link, or of the body, whose shape it is.
        joint: Pinocchio's joint that carries it.
        T: Its pose in that joint's frame.
        geometry: The shape; of a mesh, its convex hull is meant.
    """

    part: str
    joint: int
    T: pin.SE3
    geometry: coal.CollisionGeometry


class CollisionShapes(NamedTuple):
    """All shapes of a robot, which parts may touch, and the parts of l_m."""

    shapes: tuple[CollisionShape, ...]
    pairs: ContactPairs
    mobile: tuple[str, ...]


def body_contact_pairs(description: RobotDescription) -> ContactPairs:
    """Pairs of bodies that may touch; near l_m and the floor come those with a reachability."""
    mobile, *arm = [body.name for body in description.bodies]
    outer = [name for name in arm if name in description.reachability]
    apart = combinations(enumerate(arm), 2)
    return ContactPairs(
        arm_base=frozenset((mobile, name) for name in outer),
        arm_arm=frozenset(
            (a, b)
            for (i, a), (j, b) in apart
            if j - i > 1 and f"{a}-{b}" not in description.unwatched
        ),
        arm_floor=frozenset(outer),
    )


def link_contact_pairs(description: RobotDescription) -> ContactPairs:
    """The same pairs for the URDF's links that the bodies stand for."""
    bodies = body_contact_pairs(description)
    covers = {body.name: body.covers for body in description.bodies}

    def links(pairs: frozenset[tuple[str, str]]) -> frozenset[tuple[str, str]]:
        return frozenset(pair for a, b in pairs for pair in product(covers[a], covers[b]))

    return ContactPairs(
        arm_base=links(bodies.arm_base),
        arm_arm=links(bodies.arm_arm),
        arm_floor=frozenset(link for name in bodies.arm_floor for link in covers[name]),
    )


@kept_per_model(1)
def collision_shapes(model: RobotModel) -> CollisionShapes:
    """The collision shapes of the links, or the convex bodies where a mesh is not installed.

    The bodies are fatter than the links; the log says that they are taken. To read the meshes takes
    half the time of making a plant: they are kept per model.
    """
    description = model.description
    try:
        text = resolved_urdf(description)
    except AssetError as error:
        logging.getLogger(__name__).warning(
            "%s: what touches are its convex bodies, which are fatter than its links: %s",
            description.name,
            error,
        )
        objects = model.geometry.geometryObjects
        return CollisionShapes(
            tuple(_shape(name, objects[i]) for name, ids in model.shape_ids.items() for i in ids),
            body_contact_pairs(description),
            (description.mobile_body.name,),
        )
    loaded = pin.buildGeomFromUrdfString(model.pin, text, pin.GeometryType.COLLISION)
    return CollisionShapes(
        tuple(
            _shape(model.pin.frames[each.parentFrame].name, each) for each in loaded.geometryObjects
        ),
        link_contact_pairs(description),
        description.mobile_body.covers,
    )


def vertices(geometry: coal.CollisionGeometry) -> Array | None:
    """(n, 3) [m] of a mesh or a hull; None of another shape."""
    if isinstance(geometry, coal.BVHModelBase):
        return np.array(geometry.vertices())
    if isinstance(geometry, coal.ConvexBase):
        return np.array(geometry.points())
    return None


def _shape(part: str, placed: pin.GeometryObject) -> CollisionShape:
    return CollisionShape(part, placed.parentJoint, placed.placement, placed.geometry)
