"""The files of a new robot: description, new URDF and list of sources."""

import re
import shutil
import zlib
from collections.abc import Mapping, Sequence
from copy import deepcopy
from itertools import chain
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin
import tomlkit
import trimesh
from tomlkit.items import Item

from app.config import Config
from app.errors import DescriptionError, named_part
from app.jobs.bounded import within_budget
from app.onboarding import ROOT
from app.onboarding.fit.bodies import FittedBody
from app.onboarding.fit.travel import held_at
from app.onboarding.numbers import Sourced, wheel_fields, with_source
from app.onboarding.read import links
from app.onboarding.read.links import Geometry, LinkGeometry, LinkInertia
from app.onboarding.read.package import FOLDER
from app.onboarding.read.tree import FREE, Joint
from app.onboarding.record import NewRobot, Parsed
from app.onboarding.request import Request
from app.robot.assets import followed
from app.robot.description import KINDS, RobotDescription, load_description
from app.robot.model import RobotModel
from app.robot.shapes import Shape
from app.robot.urdf import mesh_path
from app.strict import file_text
from app.system import temporary_folder, whole_folder, write_whole

MESH_FOLDER = "meshes"  # folder of the converted and cut meshes within a robot's folder
_ENDLESS = 1e6  # [rad] limit of a joint that turns without limits


def write_robot(robot: NewRobot, folder: Path) -> None:
    """Write and check the description, and write the list of sources; `folder` has the URDF."""
    title = f"{robot.content['title']}, from {robot.request.shown_source}"
    write_whole(folder / "robot.toml", description_text(robot.content, title))
    load_description(folder / "robot.toml")
    write_whole(folder / "SOURCES.md", _sources_text(robot))


def _sources_text(robot: NewRobot) -> str:
    """The text of `SOURCES.md`, which lists the files that the robot consists of."""
    request, copied = robot.request, "No mesh is copied: `robot.urdf` refers to the original files."
    urdfs = ("robot", request.shown_source), ("arm", request.arm_urdf)
    lines = [f"- URDF of the {what}: `{path}`" for what, path in urdfs if path is not None]
    urdf = ElementTree.fromstring(robot.urdf)
    meshes = sorted({str(mesh.get("filename")) for mesh in urdf.iter("mesh")})
    if packages := sorted({m.split("/")[2] for m in meshes if m.startswith("package://")}):
        lines.append(f"- Meshes of the installed packages: {', '.join(f'`{p}`' for p in packages)}")
    lines += [f"- Mesh by its path on this machine: `{mesh}`" for mesh in meshes if mesh[0] == "/"]
    folders = {mesh.partition("/")[0] for mesh in meshes}
    if FOLDER in folders:
        lines.append(f"- Meshes of the zip, in the folder `{FOLDER}` beside this file")
        copied = "Meshes of installed packages are not copied."
    if MESH_FOLDER in folders:
        why = "had another unit, up axis or format, or were larger than 4 MB"
        stl = f"those in `.stl` {why}, and are converted to metres"
        obj = "those in `.obj` are collision meshes, cut into nearly convex pieces"
        lines.append(f"- Meshes in the folder `{MESH_FOLDER}`: {stl}; {obj}")
        copied = "No other mesh is copied."
    unknown = "find the licences in the packages before you publish this folder."
    licence = request.licence or f"`--licence` was not set: {unknown}"
    warnings = "\n".join(f"- {warning}" for warning in robot.warnings) or "- none"
    return (
        f"# Sources of {robot.content['title']}\n\n" + "\n".join(lines) + f"\n\n{copied}\n\n"
        f"Licence: {licence}\n\n## Warnings of `dbb new-robot`\n\n{warnings}\n"
    )


class HandMade(NamedTuple):
    """Changes that a person makes to a robot."""

    shapes: dict[tuple[str, int], Shape]  # new ones, by the body's name and the shape's index
    unwatched: dict[str, str]  # all pairs without monitoring, with the reasons
    ready: tuple[float, ...] | None  # (n_m,) [rad or m] new ready posture


BY_HAND = "set by hand"  # source of a number that a person has changed


def save_by_hand(source: Path, out: Path, changes: HandMade) -> None:
    """Write a robot's folder with changes; all other content stays the same.

    `out` is the folder `source` itself, or a new folder for a copy with a new name and title.

    Raises:
        DescriptionError: The present description cannot be read, the change exceeds the time or
            memory that `within_budget` allows, or the result is not a valid description.
        OutputError: `out` is another folder that is not empty, or cannot be written.
    """
    file, in_place = source / "robot.toml", out.resolve() == source.resolve()
    name = None if in_place else out.name
    try:
        before = file_text(file)
    except (OSError, ValueError) as error:
        raise DescriptionError(f"{file}: cannot be read: {error}") from None
    try:
        text = within_budget(_changed_text, before, name, changes, size=len(before))
    except ValueError as error:  # also a BudgetError
        raise DescriptionError(f"{file}: cannot be changed: {error}") from None
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
    """The text of a description with changes, and with a new name if `name` is not None."""
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


def description_text(content: Mapping[str, Any], title: str) -> str:
    """The text of `robot.toml` without empty entries; comments have the sources of the numbers."""
    document = tomlkit.document()
    for line in (
        title,
        "Made by `dbb new-robot`. Lengths in metres, angles in radians, masses in kilograms.",
        "Each number is measured, from the URDF, from an option, chosen, fitted, counted or "
        "assumed; check the assumed numbers.",
    ):
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
    """Add the source of each number as a comment: the whole source if it has a semicolon and less
    than 80 characters, otherwise its part before the first colon.
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

    The root is a frame on the floor with x forward; below it are the base and all its descendants.
    A link without collision shapes gets its visual shapes as collision shapes. So that all
    libraries read the same robot, a continuous joint becomes revolute with wide limits, a planar or
    floating one fixed. `header` becomes a comment; `home` is the new URDF's folder (`mesh_name`).
    """
    tree, base = parsed.tree, parsed.arm.base
    robot = Element("robot", name=name, version="1.2")
    robot.append(ElementTree.Comment(f" {header.replace('--', '- -')} "))
    _add_inertial(SubElement(robot, "link", name=ROOT), pin.Inertia.Zero())
    root = Joint(f"{ROOT}_joint", "fixed", ROOT, base, parsed.wheels.T_base_floor.inverse())
    joints = {link: tree.joint_of[link] for link in tree.below(base)[1:]}
    rest = {joint.name: held_at(joint) for joint in joints.values()}
    rest |= {joint.name: 0.0 for joint in parsed.arm.joints}
    for link, joint in {base: root, **joints}.items():
        robot.append(_joint(joint, rest))
        shapes, inertia = parsed.geometry[link], parsed.inertias[link]
        robot.append(_link(link, tree.links[link], shapes, inertia, home))
    return _text(robot)


def _text(robot: Element) -> str:
    ElementTree.indent(robot)
    return '<?xml version="1.0"?>\n' + ElementTree.tostring(robot, encoding="unicode") + "\n"


def mesh_name(address: str, home: Path | None) -> str:
    """The address of a mesh in the new URDF, from its `address` in the old one.

    `home` is the folder of the new URDF; without it, the address does not change. A mesh in this
    folder gets a relative path, so that the folder can be moved. A mesh that `is_foreign` becomes
    an STL file in metres in `home`, with the errors of `load_mesh`. Others keep their address.
    """
    path = followed(mesh_path(address))
    if home is None:
        return address
    home = home.resolve()
    if links.is_foreign(path):
        target = _mesh_file(home, path.stem, str(path), ".stl")
        if not target.exists():
            links.load_mesh(path).export(target)
        path = target
    return path.relative_to(home).as_posix() if path.is_relative_to(home) else address


def _mesh_file(home: Path, name: str, key: str, end: str) -> Path:
    """The path of a mesh file in a robot's folder `home`, by a readable name and a unique key."""
    stem = re.sub(r"\W", "_", name, flags=re.ASCII)
    (home / MESH_FOLDER).mkdir(exist_ok=True)
    return home / MESH_FOLDER / f"{stem}_{zlib.crc32(key.encode()):08x}{end}"


def in_pieces_urdf(urdf: str, geometry: Geometry, home: Path) -> tuple[str, Geometry]:
    """The text of a new URDF, and the geometry of its links, both with the shapes `in_pieces`.

    A shape of several pieces is written to an OBJ file in `home`, the folder of the URDF, with an
    object for each piece. The URDF names this file, and the engines use the hull of each object.
    Files of `MESH_FOLDER` that the new text does not name are removed.
    """
    parser = ElementTree.XMLParser(target=ElementTree.TreeBuilder(insert_comments=True))
    tree, cut = ElementTree.fromstring(urdf, parser), dict(geometry)
    for link in tree.iterfind("link[collision]"):
        name = str(link.get("name"))
        found = [links.in_pieces(shape) for shape in geometry[name].shapes]
        cut[name] = geometry[name]._replace(shapes=tuple(chain(*found)))
        for k, (element, pieces) in enumerate(zip(link.findall("collision"), found, strict=True)):
            if len(pieces) > 1:
                path = _mesh_file(home, name, f"{name} {k}", ".obj")
                obj = trimesh.Scene([each.mesh for each in pieces])
                obj.export(path, include_normals=False, header=f"dbb: {len(obj.triangles)} faces")
                element[:] = [Element("geometry")]
                SubElement(element[0], "mesh", filename=path.relative_to(home).as_posix())
    named = {home / str(mesh.get("filename")) for mesh in tree.iter("mesh")}
    for unused in {*(home / MESH_FOLDER).glob("*")} - named:
        unused.unlink()
    return _text(tree), cut


def _link(
    name: str, old: Element, geometry: LinkGeometry, inertia: LinkInertia, home: Path | None
) -> Element:
    link = Element("link", name=name)
    if inertia.assumed:
        link.append(ElementTree.Comment(f" inertia assumed: {inertia.assumed} "))
    _add_inertial(link, inertia.inertia)
    for tag in ("visual", "collision"):
        source = "visual" if tag == "collision" and geometry.seen_only else tag
        for each in old.findall(source):
            part = SubElement(link, tag)
            names = ("origin", "geometry", "material")[: 3 if tag == "visual" else 2]
            found = (each.find(name) for name in names)
            part.extend(deepcopy(own) for own in found if own is not None)
            for mesh in part.iter("mesh"):
                with named_part(f"link {name!r}"):
                    mesh.set("filename", mesh_name(str(mesh.get("filename")), home))
    return link


def _joint(joint: Joint, rest: Mapping[str, float]) -> Element:
    """A joint of the new URDF. Its zero is its position in `rest` or, without one, its old zero.

    Libraries put an unmoved joint at zero, which can be outside of its limits: a finger would be
    inside of the gripper. The relation of a mimic joint to its leader stays the same; if the new
    URDF has no such leader, the joint becomes independent.
    """
    kind = "fixed" if joint.kind in FREE else joint.kind
    at = rest.get(joint.name, 0.0)
    T, endless = joint.motion(at), kind == "continuous"
    element = Element("joint", name=joint.name, type="revolute" if endless else kind)
    SubElement(element, "parent", link=joint.parent)
    SubElement(element, "child", link=joint.child)
    rpy = _words(*pin.rpy.matrixToRpy(T.rotation))
    SubElement(element, "origin", xyz=_words(*T.translation), rpy=rpy)
    if kind == "fixed":
        return element
    SubElement(element, "axis", xyz=_words(*joint.axis))
    leader, factor, offset = joint.mimic or ("", 0.0, 0.0)
    if leader in rest:
        offset += factor * rest[leader] - at
        SubElement(
            element, "mimic", joint=leader, multiplier=f"{factor:.12g}", offset=f"{offset:.12g}"
        )
    low, high = (-_ENDLESS, _ENDLESS) if endless else (joint.lower or 0.0, joint.upper or 0.0)
    numbers = low - at, high - at, joint.effort or 0.0, joint.velocity or 0.0
    keys = ("lower", "upper", "effort", "velocity")
    SubElement(element, "limit", {k: f"{x:.12g}" for k, x in zip(keys, numbers, strict=True)})
    return element


def _add_inertial(link: Element, inertia: pin.Inertia) -> None:
    element = SubElement(link, "inertial")
    SubElement(element, "origin", xyz=_words(*inertia.lever), rpy="0 0 0")
    SubElement(element, "mass", value=f"{inertia.mass:.9g}")
    names = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    values = inertia.inertia[np.triu_indices(3)]
    SubElement(element, "inertia", {n: f"{v:.9g}" for n, v in zip(names, values, strict=True)})


def _words(*numbers: float) -> str:
    return " ".join(f"{0.0 if abs(x) < 1e-12 else x:.12g}" for x in numbers)


def description(
    request: Request,
    parsed: Parsed,
    bodies: Sequence[FittedBody] = (),
    moving: tuple[Sourced, Sourced] | None = None,
    unwatched: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """The content of a description; it refers to the URDF by name.

    `moving` are numbers of the base and of the arm with their sources. Without them, the numbers of
    the base and missing efforts are 1, the damping is 0, and the ready posture is the middle of the
    joints' ranges. Without `bodies`, the bodies are small spheres. `unwatched` has the pairs that
    are not monitored, with the reasons.
    """
    arm, limits = parsed.arm, parsed.limits
    wheels = wheel_fields(request.kind, parsed.wheels)
    if moving is None:
        fields = KINDS[request.kind].model_fields.keys() - {"source", "kind", *wheels}
        middle = tuple((a + b) / 2 for a, b in zip(limits.lower, limits.upper, strict=True))
        limits = limits._replace(effort=tuple(e or 1.0 for e in limits.effort))
        free = (0.0,) * len(middle)
        of_arm = {"ready_position": (middle, "assumed"), "joint_damping": (free, "assumed")}
        moving = dict.fromkeys(sorted(fields), (1.0, "assumed")), of_arm
    given = any((*request.tip_xyz, *request.tip_rpy))
    tip = "from --tip-xyz, --tip-rpy" if given else "from the URDF: the origin of --tip"
    xyz, rpy = (request.tip_xyz, tip), (request.tip_rpy, tip)
    at = {"end_effector_xyz_m": xyz, "end_effector_rpy_rad": rpy}
    chain = {"mount_link": arm.mount, "joints": arm.names, "end_effector_link": arm.tip}
    dot = {"source": "none", "frame": ROOT, "covers": (ROOT,)}
    dot["shapes"] = [{"type": "sphere", "radius_m": 0.01}]
    return {
        "name": request.name,
        "title": request.title or request.name.replace("_", " "),
        "urdf": "robot.urdf",
        "licence": request.licence or "Of the files that the URDF refers to: see SOURCES.md.",
        "base": with_source({"kind": request.kind}, moving[0], wheels),
        "arm": with_source(chain, {**at, **limits.numbers, **moving[1]}),
        "bodies": [_body(body) for body in bodies] or [{"name": n, **dot} for n in ("lm", "l1")],
        "reachability": {},
        "config": Config().replace("border.d_b", request.buffer).model_dump(exclude_defaults=True),
        "unwatched": dict(unwatched),
    }


def _body(body: FittedBody) -> dict[str, Any]:
    over = ", ".join(f"{fit.over_cover:.2f}" for fit in body.fits)
    out = max(fit.protrusion for fit in body.fits)
    source = "fitted around the covered links, or their parts that other links can reach: "
    source += f"{over} times the volume of their hull, at most {out:.3f} m beyond it"
    nested = {"nested": dict(body.nested)} if body.nested else {}
    if nested:
        source += "; nested: links that touch in most random postures, or overlap by at most 3 mm"
    own = {"name": body.name, "source": source, "frame": body.frame, "covers": body.links}
    return own | nested | {"shapes": [shape_content(fit.shape) for fit in body.fits]}


def compiled(content: Mapping[str, Any], urdf: Path) -> RobotModel:
    """Model of a description and a URDF; raises a ValidationError or an error of `RobotModel`."""
    return RobotModel(RobotDescription.model_validate({**content, "urdf": str(urdf)}))
