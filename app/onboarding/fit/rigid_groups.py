"""The links that move as one, with their hulls in the frame of the joint that moves them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import coal
import numpy as np
import pinocchio as pin

from app.onboarding.fit.convex import directions, hull_corners
from app.onboarding.read.arm import Arm
from app.onboarding.read.geometry import LinkGeometry
from app.onboarding.write.urdf_text import ROOT
from app.robot.model import RobotModel

Array = np.ndarray

_ALONG = 0.999  # [-] cosine between two lines that count as parallel
_THIN_OUT = 500  # [-] points on a unit's surface that are looked at


class Part(NamedTuple):
    """One hull of a unit.

    Attributes:
        link: The link it belongs to.
        corners: (N, 3) [m] of its hull, in the joint's frame.
        reach: (K,) [m] its support along `directions(2)`.
    """

    link: str
    corners: Array
    reach: Array


class Unit(NamedTuple):
    """Links that move as one.

    Attributes:
        index: 0 the base, 1 what is fixed to it below the arm, k + 1 what the arm's joint k moves.
        frame: The link whose frame is the joint's; the floor point for the first two.
        links: All of them.
        joint: pinocchio's joint that moves them.
        parts: Their hulls.
        surface: (N, 3) [m] points on the hulls, in the joint's frame.
    """

    index: int
    frame: str
    links: tuple[str, ...]
    joint: int
    parts: tuple[Part, ...]
    surface: Array


def make_units(model: RobotModel, arm: Arm, geometry: Mapping[str, LinkGeometry]) -> list[Unit]:
    """The base, the arm's fixed part, and one unit a joint of the arm."""
    frames = [ROOT, ROOT, *(joint.child for joint in arm.joints)]
    links = [arm.base_links, *arm.segments]
    return [
        _unit(model, k, frame, names, max(k, 1), geometry)
        for k, (frame, names) in enumerate(zip(frames, links, strict=True))
    ]


def units_of_links(
    model: RobotModel, geometry: Mapping[str, LinkGeometry]
) -> dict[str, list[Unit]]:
    """The links that each body of a description stands for, by joint, by the body's name.

    The units' indices are those of pinocchio's joints.
    """
    found = {}
    for body in model.description.bodies:
        by_joint: dict[int, list[str]] = {}
        for link in body.covers:
            joint = model.pin.frames[model.pin.getFrameId(link)].parentJoint
            by_joint.setdefault(joint, []).append(link)
        found[body.name] = [
            _unit(model, joint, body.frame, tuple(links), joint, geometry)
            for joint, links in by_joint.items()
        ]
    return found


def neighbours(model: RobotModel, a: Unit, b: Unit) -> bool:
    """Whether two units may touch by design.

    One joint or none lies between them, or only joints that slide along one line: the parts of a
    telescope stand in each other, and only its joints' limits can keep them apart.
    """
    first, last = sorted((a.joint, b.joint))
    return last - first <= 1 or _telescope(model, range(first + 1, last + 1))


def _telescope(model: RobotModel, joints: Sequence[int]) -> bool:
    """Whether joints all slide, along parallel lines."""
    data = model.pin.createData()
    pin.computeJointJacobians(model.pin, data, pin.neutral(model.pin))
    columns = data.J[:, [model.pin.joints[k].idx_v for k in joints]]
    return not columns[3:].any() and bool((np.abs(columns[:3].T @ columns[:3, 0]) > _ALONG).all())


def add_hulls(geometry: pin.GeometryModel, units: Sequence[Unit]) -> list[list[int]]:
    """Put the parts of units into pinocchio's geometry; gives their ids, unit by unit."""
    return [
        [
            geometry.addGeometryObject(
                pin.GeometryObject(
                    f"{part.link}_{i}", unit.joint, 0, pin.SE3.Identity(), _hull(part.corners)
                )
            )
            for i, part in enumerate(unit.parts)
        ]
        for unit in units
    ]


def _unit(
    model: RobotModel,
    index: int,
    frame: str,
    links: tuple[str, ...],
    joint: int,
    geometry: Mapping[str, LinkGeometry],
) -> Unit:
    parts, surface = [], [np.zeros((0, 3))]
    D = directions(2)
    for link in links:
        T = model.pin.frames[model.pin.getFrameId(link)].placement
        for shape in geometry[link].shapes:
            corners = hull_corners(_moved(T, np.asarray(shape.hull.vertices)))
            parts.append(Part(link, corners, (corners @ D.T).max(axis=0)))
        surface.append(_moved(T, geometry[link].surface))
    points = np.vstack(surface)
    if len(points) > _THIN_OUT:
        points = points[np.random.default_rng(0).permutation(len(points))[:_THIN_OUT]]
    return Unit(index, frame, links, joint, tuple(parts), points)


def _moved(T: pin.SE3, points: Array) -> Array:
    return points @ T.rotation.T + T.translation


def _hull(corners: Array) -> coal.CollisionGeometry:
    vertices = coal.StdVec_Vec3s()
    for corner in corners:
        vertices.append(corner)
    return coal.Convex.convexHull(vertices, True, "Qt")
