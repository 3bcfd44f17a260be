"""The shapes with which a robot touches: its links' own, or the description's bodies for them."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.errors import AssetError
from app.robot.model import RobotModel
from app.robot.urdf import resolved_urdf
from app.simulation.plants.contact_pairs import ContactPairs, body_contact_pairs, link_contact_pairs

Array = np.ndarray


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
    """All shapes of a robot.

    Attributes:
        shapes: The shapes.
        pairs: Which parts may touch.
        mobile: Parts of l_m.
    """

    shapes: list[CollisionShape]
    pairs: ContactPairs
    mobile: tuple[str, ...]


def collision_shapes(model: RobotModel, outer: Sequence[str] | None = None) -> CollisionShapes:
    """The collision shapes of the links, or the convex bodies where a mesh is not installed.

    The bodies are fatter than the links; the log says that they are taken.

    Args:
        model: The robot.
        outer: Names of the bodies of L_m on the arm; by default all that
            have a reachability.

    Raises:
        UnknownNameError: `outer` names a body that the arm does not have.
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
        return _bodies(model, outer)
    loaded = pin.buildGeomFromUrdfString(model.pin, text, pin.GeometryType.COLLISION)
    return CollisionShapes(
        [_shape(model.pin.frames[each.parentFrame].name, each) for each in loaded.geometryObjects],
        link_contact_pairs(description, outer),
        description.mobile_body.covers,
    )


def vertices(geometry: coal.CollisionGeometry) -> Array | None:
    """(n, 3) [m] of a mesh or a hull; None of another shape."""
    if isinstance(geometry, coal.BVHModelBase):
        return np.array(geometry.vertices())
    if isinstance(geometry, coal.ConvexBase):
        return np.array(geometry.points())
    return None


def _bodies(model: RobotModel, outer: Sequence[str] | None) -> CollisionShapes:
    description, objects = model.description, model.geometry.geometryObjects
    return CollisionShapes(
        [_shape(name, objects[i]) for name, ids in model.shape_ids.items() for i in ids],
        body_contact_pairs(description, outer),
        (description.mobile_body.name,),
    )


def _shape(part: str, placed: pin.GeometryObject) -> CollisionShape:
    return CollisionShape(part, placed.parentJoint, placed.placement, placed.geometry)
