"""The files of a new robot: description, URDF with the root on the floor, list of sources."""

from __future__ import annotations

import re
import shutil
import zlib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from pathlib import Path
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin
import tomlkit
from tomlkit.items import Item

from app.config import Config
from app.errors import DescriptionError
from app.jobs.bounded import BudgetError, within_budget
from app.onboarding import ROOT
from app.onboarding.fit.travel import held_at
from app.onboarding.numbers import Sourced, wheel_fields, with_source
from app.onboarding.read.links import LinkGeometry, LinkInertia, is_foreign, load_mesh
from app.onboarding.read.package import FOLDER
from app.onboarding.read.tree import FREE, MOVING, Joint, Tree
from app.robot.assets import followed
from app.robot.description import KINDS, RobotDescription, load_description
from app.robot.model import RobotModel
from app.robot.shapes import Shape
from app.robot.urdf import mesh_path, rgba
from app.strict import file_text
from app.system import temporary_folder, whole_folder, write_whole

if TYPE_CHECKING:
    from app.onboarding.fit.bodies import FittedBody
    from app.onboarding.record import NewRobot, Parsed
    from app.onboarding.request import Request

MESH_FOLDER = "meshes"
"""Folder of the converted meshes within a robot's folder."""
_ENDLESS = "1e6"  # [rad] limit of a joint that turns without limits


def write_robot(robot: NewRobot, folder: Path) -> None:
    """Write the description, the URDF and the list of sources into a folder."""
    write_whole(folder / "robot.urdf", robot.urdf)
    title = f"{robot.content['title']}, from {robot.request.told}"
    text = description_text(robot.content, title)
    write_whole(folder / "robot.toml", text)
    load_description(folder / "robot.toml")
    write_whole(folder / "SOURCES.md", _sources_text(robot))


def _sources_text(robot: NewRobot) -> str:
    """The text of `SOURCES.md`, which lists the files that the robot consists of."""
    request, lines = robot.request, []
    copied = "No mesh is copied: `robot.urdf` refers to the files of the installed packages."
    for what, path in (("robot", request.told), ("arm", request.arm_urdf)):
        if path is not None:
            lines.append(f"- URDF of the {what}: `{path}`")
    urdf = ElementTree.fromstring(robot.urdf)
    meshes = sorted({str(mesh.get("filename")) for mesh in urdf.iter("mesh")})
    installed = [mesh for mesh in meshes if mesh.startswith("package://")]
    if installed:
        packages = sorted({mesh.split("/")[2] for mesh in installed})
        lines.append(f"- Meshes of the installed packages: {', '.join(f'`{p}`' for p in packages)}")
    lines += [f"- Mesh by its path on this machine: `{mesh}`" for mesh in meshes if mesh[0] == "/"]
    folders = {mesh.partition("/")[0] for mesh in meshes if mesh not in installed}
    if FOLDER in folders:
        lines.append(f"- Meshes of that package, in the folder `{FOLDER}` beside this file")
        copied = "Meshes of installed packages are not copied."
    if MESH_FOLDER in folders:
        lines.append(
            f"- Meshes in the folder `{MESH_FOLDER}`: they had another unit or format, or too many "
            "triangles, and are converted to STL in metres"
        )
        copied = "No other mesh is copied."
    licence = request.licence or (
        "`--licence` was not set: find the licences in the packages before you publish this folder."
    )
    warnings = "\n".join(f"- {warning}" for warning in robot.warnings) or "- none"
    return (
        f"# Sources of {robot.content['title']}\n\n" + "\n".join(lines) + f"\n\n{copied}\n\n"
        f"Licence: {licence}\n\n## Warnings of `dbb new-robot`\n\n{warnings}\n"
    )


class HandMade(NamedTuple):
    """Changes that a person makes to a robot."""

    shapes: dict[tuple[str, int], Shape]
    """New shapes, by the name of the body and the index of the shape."""
    unwatched: dict[str, str]
    """All pairs that are not monitored: the reasons by the name of the pair."""
    ready: tuple[float, ...] | None
    """(n_m,) [rad or m] the new ready pose, or None for no change."""


BY_HAND = "set by hand"
"""Source of a number that a person has changed."""


def save_by_hand(source: Path, out: Path, changes: HandMade) -> None:
    """Write a robot's folder with changes; all other content stays the same.

    If `out` is the folder `source`, the changes are made in place; otherwise `out` is a copy.

    Raises:
        DescriptionError: The result is not a valid description, or reading the present description
            exceeds its budget.
        OutputError: `out` is another robot's folder, or cannot be written.
    """
    before = file_text(source / "robot.toml")
    in_place = out.resolve() == source.resolve()
    name = None if in_place else out.name
    try:
        text = within_budget(_changed_text, before, name, changes, size=len(before))
    except BudgetError as error:
        raise DescriptionError(f"{source / 'robot.toml'}: {error}") from None
    with temporary_folder() as tried:  # an invalid description must not replace a valid one
        write_whole(tried / "robot.toml", text)
        load_description(tried / "robot.toml")
    if in_place:
        write_whole(out / "robot.toml", text)
        return
    with whole_folder(out) as folder:
        shutil.copytree(source, folder, symlinks=True, dirs_exist_ok=True)
        write_whole(folder / "robot.toml", text)


def _changed_text(text: str, name: str | None, changes: HandMade) -> str:
    """The text of a description with changes, and with a new name unless `name` is None."""
    document: Any = tomlkit.parse(text)
    if name is not None:
        document["name"], document["title"] = name, f"{document['title']} ({BY_HAND})"
    for (body_name, i), shape in changes.shapes.items():
        body = next(each for each in document["bodies"] if each["name"] == body_name)
        body["source"] = BY_HAND
        body["shapes"][i] = tomlkit.item(shape_content(shape))
    if not changes.unwatched:
        document.pop("unwatched", None)
    elif changes.unwatched != document.get("unwatched"):
        document["unwatched"] = changes.unwatched
    if changes.ready is not None:
        document["arm"]["ready_position"] = list(changes.ready)
        document["arm"]["ready_position"].comment(BY_HAND)
        document["arm"]["source"]["ready_position"] = BY_HAND
    return tomlkit.dumps(document)


def shape_content(shape: Shape) -> dict[str, Any]:
    """A shape in the form of a description, without a rotation of zero."""
    return {k: v for k, v in shape.model_dump().items() if k != "rpy_rad" or any(v)}


_HEADER = (
    "Made by `dbb new-robot`. Lengths in metres, angles in radians, masses in kilograms.",
    "Each number is measured, from the URDF, given, chosen, counted or assumed; check the "
    "assumed numbers.",
)


def description_text(content: Mapping[str, Any], title: str) -> str:
    """The text of `robot.toml`, with comments: the title, and the kind of each number's source.

    Empty tables are left out, such as `lines` of a robot without lines.
    """
    document = tomlkit.document()
    for line in (title, *_HEADER):
        document.add(tomlkit.comment(line))
    document.add(tomlkit.nl())
    filled = [each for each in content.items() if each[1]]
    for key, value in sorted(filled, key=lambda each: isinstance(each[1], Mapping | list)):
        item = tomlkit.item(value)
        if isinstance(value, Mapping):
            _comment(item, value)
        document.add(key, item)
    return tomlkit.dumps(document)


def _comment(item: Any, content: Mapping[str, Any]) -> None:
    """Add comments with the source of each number, up to its first colon.

    A short source with several parts is a comment in full.
    """
    for key, value in content.items():
        if isinstance(value, Mapping):
            _comment(item[key], value)
    for key, source in content.get("source", {}).items():
        number: Item = item[key]
        whole = ";" in source and len(source) < 80
        number.comment(source if whole else source.partition(":")[0])


def rebased_urdf(parsed: Parsed, *, name: str, header: str, home: Path | None = None) -> str:
    """The text of the new URDF.

    Its root is on the floor with x forward; the base and all links below the base follow. If a link
    has only a visual shape, this is its collision shape too. So that all libraries read the same
    robot, a joint without limits becomes a revolute joint with wide limits, and a joint that is
    free in space becomes fixed.

    Meshes keep their files. Those in `home`, the folder of the new URDF, have relative paths.
    """
    tree, base = parsed.tree, parsed.arm.base
    robot = Element("robot", name=name, version="1.2")
    robot.append(ElementTree.Comment(f" {header.replace('--', '- -')} "))
    for material in tree.robot.findall("material"):
        if rgba(material) is not None:
            robot.append(_colour_only(material))
    _add_inertial(SubElement(robot, "link", name=ROOT), pin.Inertia.Zero())
    joint = SubElement(robot, "joint", name=f"{ROOT}_joint", type="fixed")
    SubElement(joint, "parent", link=ROOT)
    SubElement(joint, "child", link=base)
    T = parsed.wheels.T_base_floor.inverse()
    rpy = _words(pin.rpy.matrixToRpy(T.rotation))
    SubElement(joint, "origin", xyz=_words(T.translation), rpy=rpy)
    joints = {joint.get("name"): joint for joint in tree.robot.findall("joint")}
    driven = {joint.name for joint in parsed.arm.joints}
    for link in tree.below(base):
        if link != base:
            above = tree.joint_of[link]
            robot.append(_joint(joints[above.name]))
            if above.kind in MOVING and above.name not in driven:
                _hold_within_limits(robot[-1], above)
            _follow_from_rest(robot[-1], above, tree, driven)
        robot.append(_link(tree.links[link], parsed.geometry[link], parsed.inertias[link], home))
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def mesh_name(address: str, home: Path | None, where: str = "a link") -> str:
    """The name of a mesh in the new URDF.

    It is a relative path for a mesh in `home`, because that folder may move; this has precedence
    over `package://`. Otherwise it is `address`, an address of `mesh_address`. A mesh that
    libraries read differently is first converted to STL in metres, in `home`.
    """
    path = followed(mesh_path(address))
    if home is None:
        return address
    home = home.resolve()
    if is_foreign(path):
        stem = re.sub(r"\W", "_", path.stem, flags=re.ASCII)
        target = home / MESH_FOLDER / f"{stem}_{zlib.crc32(str(path).encode()):08x}.stl"
        if not target.exists():
            target.parent.mkdir(exist_ok=True)
            load_mesh(path, where).export(target)
        path = target
    return path.relative_to(home).as_posix() if path.is_relative_to(home) else address


def _link(old: Element, geometry: LinkGeometry, inertia: LinkInertia, home: Path | None) -> Element:
    link, where = Element("link", name=str(old.get("name"))), f"link {old.get('name')!r}"
    if inertia.assumed:
        link.append(ElementTree.Comment(f" inertia assumed: {inertia.assumed} "))
    _add_inertial(link, inertia.inertia)
    for tag in ("visual", "collision"):
        source = "visual" if tag == "collision" and geometry.seen_only else tag
        for each in old.findall(source):
            part = SubElement(link, tag)
            part.extend(_copies(each, "origin", "geometry"))
            for mesh in part.iter("mesh"):
                mesh.set("filename", mesh_name(str(mesh.get("filename")), home, where))
            if tag == "visual" and (material := each.find("material")) is not None:
                part.append(_colour_only(material))
    return link


def _copies(element: Element, *tags: str) -> list[Element]:
    return [deepcopy(found) for tag in tags if (found := element.find(tag)) is not None]


def _colour_only(material: Element) -> Element:
    """A material without its texture, because textures are never drawn."""
    kept = Element("material", name=material.get("name") or "unnamed")
    if (colour := rgba(material)) is not None:
        SubElement(kept, "color", rgba=_words(np.array(colour)))
    return kept


def _joint(old: Element) -> Element:
    kind = str(old.get("type"))
    joint = Element("joint", name=str(old.get("name")), type="fixed" if kind in FREE else kind)
    joint.extend(_copies(old, "parent", "child", "origin", "axis", "mimic"))
    if joint.get("type") == "fixed":
        return joint
    limit = old.find("limit")
    kept = dict(limit.attrib) if limit is not None else {}
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
        kept |= {"lower": f"-{_ENDLESS}", "upper": _ENDLESS}
    SubElement(joint, "limit", {"effort": "0", "velocity": "0", "lower": "0", "upper": "0"} | kept)
    return joint


def _hold_within_limits(element: Element, joint: Joint) -> None:
    """Shift the zero of a joint beside the arm to the limit nearest to zero, if zero is outside.

    Libraries place a joint that does not move at zero; otherwise a finger could be inside of the
    gripper.
    """
    low, high = joint.lower or 0.0, joint.upper or 0.0
    if (at := held_at(joint)) == 0.0:
        return
    T = joint.motion(at)
    found = element.find("origin")
    origin = SubElement(element, "origin") if found is None else found
    origin.set("xyz", _words(T.translation))
    origin.set("rpy", _words(pin.rpy.matrixToRpy(T.rotation)))
    limit = element.find("limit")
    assert limit is not None
    limit.attrib |= {"lower": f"{low - at:.9g}", "upper": f"{high - at:.9g}"}


def _follow_from_rest(element: Element, joint: Joint, tree: Tree, driven: set[str]) -> None:
    """Adapt a mimic joint to the shifted zeros; remove the mimic if its leader does not exist."""
    if (mimic := element.find("mimic")) is None or joint.mimic is None:
        return
    leader, multiplier, offset = joint.mimic
    if leader not in tree.joints:
        element.remove(mimic)
        return
    shift = 0.0 if leader in driven else held_at(tree.joints[leader])
    offset += multiplier * shift - held_at(joint)
    mimic.attrib |= {"multiplier": f"{multiplier:.9g}", "offset": f"{offset:.9g}"}


def _add_inertial(link: Element, inertia: pin.Inertia) -> None:
    element = SubElement(link, "inertial")
    SubElement(element, "origin", xyz=_words(inertia.lever), rpy="0 0 0")
    SubElement(element, "mass", value=f"{inertia.mass:.9g}")
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = inertia.inertia[np.triu_indices(3)]
    SubElement(element, "inertia", {n: f"{v:.9g}" for n, v in zip(names, values, strict=True)})


def _words(numbers: np.ndarray) -> str:
    return " ".join(f"{value + 0.0:.9g}" for value in np.where(np.abs(numbers) < 1e-12, 0, numbers))


def description(
    request: Request,
    parsed: Parsed,
    bodies: Sequence[FittedBody] = (),
    moving: tuple[Sourced, Sourced] | None = None,
    unwatched: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """The content of a description; it refers to the URDF by name.

    Without `bodies` and `moving` it is sufficient for kinematics and dynamics: the bodies are small
    spheres, the numbers of the base are 1, and the ready pose is the middle of the joints' ranges.

    Args:
        request: The input.
        parsed: The content of the URDF.
        bodies: The fitted bodies.
        moving: Numbers of the base and of the arm with their sources.
        unwatched: Why a pair of bodies is not monitored, by the name of the pair.
    """
    arm, limits = parsed.arm, parsed.limits
    wheels = wheel_fields(request.kind, parsed.wheels, parsed.steering)
    if moving is None:
        fields = KINDS[request.kind].model_fields.keys() - {"source", "kind", "link", *wheels}
        middle = tuple((a + b) / 2 for a, b in zip(limits.lower, limits.upper, strict=True))
        limits = limits._replace(effort=tuple(e or 1.0 for e in limits.effort))
        moving = (
            dict.fromkeys(sorted(fields), (1.0, "assumed")),
            {
                "ready_position": (middle, "assumed"),
                "joint_damping": ((0.0,) * len(middle), "assumed"),
            },
        )
    given = any((*request.tip_xyz, *request.tip_rpy))
    tip = "given: --tip-xyz, --tip-rpy" if given else "from the URDF: the origin of --tip"
    hand = {
        "end_effector_xyz_m": (request.tip_xyz, tip),
        "end_effector_rpy_rad": (request.tip_rpy, tip),
    }
    chain = {
        "mount_link": arm.mount,
        "joints": tuple(joint.name for joint in arm.joints),
        "end_effector_link": arm.tip,
    }
    dot = {"source": "none", "frame": ROOT, "covers": (ROOT,)}
    dot["shapes"] = [{"type": "sphere", "radius_m": 0.01}]
    return {
        "name": request.name,
        "title": request.title or request.name.replace("_", " "),
        "urdf": "robot.urdf",
        "licence": request.licence or "Of the files that the URDF refers to: see SOURCES.md.",
        "base": with_source({"kind": request.kind, "link": ROOT}, moving[0], wheels),
        "arm": with_source(chain, {**hand, **limits.numbers, **moving[1]}),
        "bodies": [_body(body) for body in bodies] or [{"name": n, **dot} for n in ("lm", "l1")],
        "reachability": {},
        "config": Config().replace("border.d_b", request.d_b).model_dump(exclude_defaults=True),
        "unwatched": dict(unwatched),
    }


def _body(body: FittedBody) -> dict[str, Any]:
    over = ", ".join(f"{fit.over_cover:.2f}" for fit in body.fits)
    out = max(fit.protrusion for fit in body.fits)
    nested = "; nested: links that touch in most of the random poses" if body.nested else ""
    return {
        "name": body.name,
        "source": f"fitted around the parts of the covered links that can meet other links: {over} "
        f"times their volume, at most {out:.3f} m outside of their hulls{nested}",
        "frame": body.frame,
        "covers": body.links,
        **({"nested": dict(body.nested)} if body.nested else {}),
        "shapes": [shape_content(fit.shape) for fit in body.fits],
    }


def compiled(content: Mapping[str, Any], urdf: Path) -> RobotModel:
    """The model of a description and a URDF.

    Raises:
        DescriptionError: The description is not valid.
    """
    return RobotModel(RobotDescription.model_validate({**content, "urdf": str(urdf)}))
