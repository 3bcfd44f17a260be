"""Links that extend beyond their bodies, by design or by mistake, and a page that shows them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Literal

import numpy as np
import pinocchio as pin
import trimesh
from trimesh.viewer.notebook import scene_to_html

from app.onboarding.fit.units import moved
from app.onboarding.warn import outside
from app.robot.model import body_meshes

if TYPE_CHECKING:
    from app.onboarding.record import NewRobot

Array = np.ndarray
Bare = Literal["design", "mistake"]

COLOURS: dict[Bare | None, str] = {None: "#9AA5B1", "design": "#E6C229", "mistake": "#D7263D"}
"""Colours of links: inside of their bodies, or beyond them by design or by mistake."""
_BARE = 0.005  # [m] largest overhang of a link over its body
_BODY = "#0072B2"


def bare_links(robot: NewRobot, placed: Sequence[pin.SE3]) -> dict[str, Bare]:
    """Links that extend beyond their body, and whether by design or by mistake.

    It is by design if no monitored body can reach the part of the link that extends. `placed` are
    the poses of the joints in the ready pose.
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
    """A page that shows the coloured links and the bodies over them in three dimensions."""
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
    """The mesh, colour and opacity of each link and body."""
    for unit in robot.meetings.units:
        for part in unit.parts:
            hull = trimesh.convex.convex_hull(moved(part.corners, placed[unit.joint]))
            yield hull, COLOURS[bare.get(part.link)], 1.0
    for _, mesh in body_meshes(robot.model, (0.0, 0.0, 0.0), robot.ready.q_m):
        yield mesh, _BODY, 0.3
