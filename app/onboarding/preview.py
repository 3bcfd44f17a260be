"""Links that extend beyond their bodies, by design or by mistake, and a 3D view of both."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
import pinocchio as pin
import trimesh
from trimesh.viewer.notebook import scene_to_html

from app.onboarding.fit.units import moved
from app.onboarding.warn import outside
from app.robot.model import RobotModel
from app.robot.shapes import shape_mesh

if TYPE_CHECKING:
    from app.onboarding.record import NewRobot

Array = np.ndarray
Bare = Literal["design", "mistake"]

COLOURS: dict[Bare | None, str] = {None: "#9AA5B1", "design": "#E6C229", "mistake": "#D7263D"}
"""Colours of links: None for links inside of their bodies."""
_BARE = 0.005  # [m] distance beyond its body up to which a point of a link counts as enclosed
_BODY = "#0072B2"  # colour of bodies


def bare_links(robot: NewRobot, placed: Sequence[pin.SE3]) -> dict[str, Bare]:
    """Names of the links that extend beyond their body, and whether by design or by mistake.

    By design means that no link of a body that is not a neighbour can reach the part beyond the
    body. `placed` are the poses of the joints in the ready pose, by pinocchio's indices.
    """
    found: dict[str, Bare] = {}
    for k, body in enumerate(robot.bodies):
        others = [u for j, far in enumerate(robot.bodies) if abs(j - k) > 1 for u in far.units]
        joint = robot.model.body_joints[body.name]
        for unit in (robot.meetings.units[u] for u in body.units):
            points = moved(unit.surface, placed[joint].actInv(placed[unit.joint]))
            out = outside(robot.model, body.name, points) > _BARE
            met = out & robot.meetings.needed(unit.index, others)
            links = np.array(unit.links)[unit.owners]
            found |= dict.fromkeys(links[out].tolist(), "design")
            found |= dict.fromkeys(links[met].tolist(), "mistake")
    return found


def view_html(robot: NewRobot, placed: Sequence[pin.SE3], bare: Mapping[str, Bare]) -> str:
    """A page with a 3D view of the links, in the colours of `COLOURS`, and of the bodies."""
    scene = trimesh.Scene()
    for mesh, colour, alpha in _meshes(robot, placed, bare):
        r, g, b = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
        material = trimesh.visual.material.PBRMaterial(
            baseColorFactor=[r, g, b, int(255 * alpha)],
            alphaMode="BLEND" if alpha < 1 else "OPAQUE",
            doubleSided=True,
        )
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(mesh)
    return scene_to_html(scene)


def _meshes(
    robot: NewRobot, placed: Sequence[pin.SE3], bare: Mapping[str, Bare]
) -> Iterator[tuple[trimesh.Trimesh, str, float]]:
    """Mesh, colour and opacity of each hull of a link and each shape of a body."""
    for unit in robot.meetings.units:
        for part in unit.parts:
            hull = trimesh.convex.convex_hull(moved(part.corners, placed[unit.joint]))
            yield hull, COLOURS[bare.get(part.link)], 1.0
    for _, mesh in body_meshes(robot.model, placed):
        yield mesh, _BODY, 0.3


def body_meshes(
    model: RobotModel, placed: Sequence[pin.SE3]
) -> Iterator[tuple[str, trimesh.Trimesh]]:
    """Name of the body and mesh of each shape, with joints at the poses `placed`."""
    for body in model.description.bodies:
        for k, shape in zip(model.shape_ids[body.name], body.shapes, strict=True):
            item = model.geometry.geometryObjects[k]
            T = placed[item.parentJoint] * item.placement
            yield body.name, shape_mesh(shape).copy().apply_transform(T.homogeneous)
