"""Masses of a URDF's links: those it states, and those assumed from the links' volumes."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
import trimesh

from app.errors import RobotFileError
from app.onboarding.read.arm import Arm
from app.onboarding.read.geometry import LinkGeometry
from app.onboarding.read.tree import Tree, numbers, origin

ARM_DENSITY = 1200.0
"""[kg/m³] of an arm's link, in the volume of its hull; a Panda's links have 1,000 to 1,500."""
BASE_DENSITY = 450.0
"""[kg/m³] of a base's link, in the volume of its hull; a Husky has 400, an Omron LD-60 480."""

Array = np.ndarray

_ROUNDING = 1e-5  # [-] by which two moments of inertia have to be more than the third
_TINY = 1e-9  # [kg] or [kg m²] of nothing


class LinkInertia(NamedTuple):
    """What a link weighs.

    Attributes:
        inertia: In the link's frame.
        assumed: Why it is not the URDF's, or an empty string.
    """

    inertia: pin.Inertia
    assumed: str


def read_inertias(
    tree: Tree, arm: Arm, geometry: Mapping[str, LinkGeometry], *, assume: bool
) -> dict[str, LinkInertia]:
    """The inertia of every link below the base, by its name.

    Args:
        tree: The robot.
        arm: Its arm.
        geometry: Of its links.
        assume: Whether an arm without any mass may get assumed ones.

    Raises:
        RobotFileError: No link of the arm has a mass, or one is no possible one.
    """
    stated = {link: _stated(tree.links[link]) for link in tree.below(arm.base)}
    moving = [link for segment in arm.segments[1:] for link in segment]
    if not assume and not any((found := stated[link]) and found.mass > _TINY for link in moving):
        raise RobotFileError(
            "no link of the arm has an <inertial>: torques cannot be computed; add them, or give "
            f"--assume-inertia to take {ARM_DENSITY:g} kg/m³ in the hulls of its links"
        )
    found = {
        link: _chosen(inertia, geometry[link], _density(arm, link))
        for link, inertia in stated.items()
    }
    for links in arm.segments[1:]:  # a joint has to move something
        if sum(found[link].inertia.mass for link in links) <= _TINY:
            found |= {link: _chosen(None, geometry[link], _density(arm, link)) for link in links}
    return found


def _density(arm: Arm, link: str) -> float:
    return BASE_DENSITY if link in arm.base_links else ARM_DENSITY


def _chosen(stated: pin.Inertia | None, geometry: LinkGeometry, density: float) -> LinkInertia:
    if not geometry.shapes:
        return LinkInertia(stated or pin.Inertia.Zero(), "")
    if stated is None:
        why = f"{density:g} kg/m³ in its hull"
        return LinkInertia(_of_volume(geometry, density), why)
    if stated.mass <= _TINY or np.abs(stated.inertia).max() > _TINY:
        return LinkInertia(stated, "")
    shape = _of_volume(geometry, 1.0)
    spread = shape.inertia * (stated.mass / shape.mass)
    return LinkInertia(
        pin.Inertia(stated.mass, stated.lever, spread), "its mass spread over its hull"
    )


def _of_volume(geometry: LinkGeometry, density: float) -> pin.Inertia:
    """Of hulls filled evenly; where they overlap, of the hull around all of them if it is less."""
    hulls = [shape.hull for shape in geometry.shapes]
    around = trimesh.convex.convex_hull(geometry.corners)
    if around.volume < sum(hull.volume for hull in hulls):
        hulls = [around]
    total = pin.Inertia.Zero()
    for hull in hulls:
        solid = hull.copy()
        solid.density = density
        centre = np.asarray(solid.center_mass, dtype=float)
        total += pin.Inertia(
            float(solid.mass), centre, np.asarray(solid.moment_inertia, dtype=float)
        )
    return total


def _stated(link: Element) -> pin.Inertia | None:
    """The URDF's, or None where it states none.

    Raises:
        RobotFileError: It is no possible one.
    """
    element, where = link.find("inertial"), f"link {link.get('name')!r}"
    if element is None:
        return None
    mass = float(numbers(element.find("mass"), "value", (0.0,), where)[0])
    keys = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    I = element.find("inertia")
    xx, xy, xz, yy, yz, zz = (float(numbers(I, key, (0.0,), where)[0]) for key in keys)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    if mass < 0 or np.linalg.eigvalsh(tensor).min() < -1e-6 * max(1.0, np.abs(tensor).max()):
        raise RobotFileError(
            f"{where}: a mass of {mass:g} kg with moments of inertia of "
            f"{', '.join(f'{value:.3g}' for value in np.linalg.eigvalsh(tensor))} kg m² cannot be: "
            "none may be below zero"
        )
    T = origin(element, where)
    return T.act(pin.Inertia(mass, np.zeros(3), _possible(tensor)))


def _possible(tensor: Array) -> Array:
    """The same moments where two of a body's are more than the third; else the least change to it.

    No mass has others, and pybullet takes those that miss it by rounding for zero.
    """
    moments, axes = np.linalg.eigh(tensor)
    moments = np.maximum(moments, 0.0)
    short = moments[2] * (1 + _ROUNDING) - moments[0] - moments[1]
    if short <= 0:
        return tensor
    moments[:2] += short / 2
    return axes @ np.diag(moments) @ axes.T
