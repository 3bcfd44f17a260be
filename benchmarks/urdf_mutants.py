"""Changed copies of robots' files: `python -m benchmarks.urdf_mutants [--json]`.

Each mutant is the URDF of a real robot with one change that is typical of users' files: of names,
encodings, units, addresses, kinds of joints, limits, placeholders, namespaces, origins or formats.
The project must read a mutant like the original, with each link's hull within a millimetre of the
hull that pinocchio and trimesh give, or refuse it with one line. Everything else is a fault; then
the status is 1.
"""

from __future__ import annotations

import random
import re
import shutil
import sys
import tempfile
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple
from unicodedata import normalize
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin
import trimesh
import tyro

from app.cli.common import print_json
from app.cli.options import Json
from app.errors import DbbError
from app.onboarding.new_robot import parse
from app.onboarding.request import Request
from app.onboarding.write import rebased_urdf
from app.robot.assets import ASSETS, resolve_package_uri

Array = np.ndarray

ROBOTS = {
    "husky_panda": ("base_link", "panda_hand"),
    "frankie": ("panda_base_arm", "frankie_hand"),
    "husky_ur5": ("base_link", "tool0"),
}
"""Delivered robots with their links `base` and `tip`."""
AGREE = 1e-3
"""[m] largest accepted deviation of a link's hull."""
_POSTURES = 3
_DIRECTIONS = np.asarray(trimesh.creation.icosphere(subdivisions=1).vertices)


class Original(NamedTuple):
    """A robot in a separate folder with its meshes."""

    urdf: Path
    base: str
    tip: str


class Mutant(NamedTuple):
    """A changed copy of a robot's file."""

    kind: str
    urdf: Path
    base: str
    tip: str
    names: dict[str, str]
    """New names of renamed links, by the old names."""


def copied(name: str, folder: Path) -> Original:
    """Copy a delivered robot and its collision meshes into a folder."""
    base, tip = ROBOTS[name]
    robot = ElementTree.parse(ASSETS / name / "robot.urdf").getroot()
    for link in robot.findall("link"):
        for visual in link.findall("visual"):
            link.remove(visual)
    (folder / "meshes").mkdir(parents=True)
    for mesh in robot.iter("mesh"):
        source = resolve_package_uri(str(mesh.get("filename")))
        shutil.copy(source, folder / "meshes" / source.name)
        mesh.set("filename", f"meshes/{source.name}")
    path = folder / "robot.urdf"
    ElementTree.ElementTree(robot).write(path)
    return Original(path, base, tip)


def supports(urdf: Path, base: str, postures: int = _POSTURES) -> dict[str, Array]:
    """(postures, K) [m] extent of each link's hull along K directions, in the base's frame."""
    robot = ElementTree.parse(urdf).getroot()
    bare = ElementTree.fromstring(ElementTree.tostring(robot))
    for link in bare.findall("link"):
        for tag in ("visual", "collision"):
            for each in link.findall(tag):
                link.remove(each)
    model = pin.buildModelFromXML(ElementTree.tostring(bare, encoding="unicode"))
    data, found = model.createData(), {}
    clouds = {str(link.get("name")): _cloud(link, urdf.parent) for link in robot.findall("link")}
    for posture in range(postures):
        _place(model, data, posture)
        T_base = data.oMf[model.getFrameId(base, pin.BODY)]
        for name, points in clouds.items():
            if len(points):
                T = T_base.actInv(data.oMf[model.getFrameId(name, pin.BODY)])
                placed = points @ T.rotation.T + T.translation
                found.setdefault(name, []).append((placed @ _DIRECTIONS.T).max(axis=0))
    return {name: np.array(rows) for name, rows in found.items()}


def _place(model: pin.Model, data: pin.Data, posture: int) -> None:
    """Compute placements: in posture 0 all joints are at zero, else the arm has random angles.

    The random angle of a joint depends only on the joint's name and the number of the posture.
    """
    v = np.zeros(model.nv)
    for name, joint in zip(model.names, model.joints, strict=True):
        if posture and joint.nv == 1 and _is_arm(name):
            rng = random.Random(f"{name.removesuffix('_joint')}{posture}")
            v[joint.idx_v] = rng.uniform(-0.4, 0.4)
    pin.framesForwardKinematics(model, data, pin.integrate(model, pin.neutral(model), v))


def _is_arm(name: str) -> bool:
    return any(word in name for word in ("panda_joint", "shoulder", "elbow", "wrist"))


def _cloud(link: Element, folder: Path) -> Array:
    """(N, 3) [m] corners of a link's collision shapes, in its frame."""
    clouds = [np.zeros((0, 3))]
    for element in link.findall("collision"):
        shape = element.find("geometry/*")
        if shape is None:
            continue
        numbers = {
            k: [float(x) for x in v.split()] for k, v in shape.attrib.items() if k != "filename"
        }
        match shape.tag:
            case "box":
                mesh = trimesh.creation.box(extents=numbers["size"])
            case "sphere":
                mesh = trimesh.creation.icosphere(subdivisions=3, radius=numbers["radius"][0])
            case "cylinder":
                mesh = trimesh.creation.cylinder(numbers["radius"][0], numbers["length"][0])
            case _:
                mesh = _loaded(folder / str(shape.get("filename")))
                mesh.apply_scale(numbers.get("scale", [1.0] * 3))
        origin = element.find("origin")
        at = (
            {}
            if origin is None
            else {k: [float(x) for x in v.split()] for k, v in origin.attrib.items()}
        )
        R = pin.rpy.rpyToMatrix(*at.get("rpy", [0.0] * 3))
        clouds.append(np.asarray(mesh.vertices) @ R.T + at.get("xyz", [0.0] * 3))
    return np.vstack(clouds)


def _loaded(path: Path) -> trimesh.Trimesh:
    scene = trimesh.load_scene(path)
    if scene.units not in (None, "meters"):
        scene = scene.convert_units("meters")
    return scene.to_mesh()


Change = Callable[[Original, Path, random.Random], dict[str, str] | None]
"""Changes the copy of a robot in a folder; returns the new names of renamed links, or None."""


def _text(change: Callable[[str], str | bytes]) -> Change:
    """A change of the file's text."""

    def changed(original: Original, folder: Path, _: random.Random) -> None:
        path = folder / "robot.urdf"
        text = change(path.read_text(encoding="utf-8"))
        path.write_bytes(text if isinstance(text, bytes) else text.encode())

    return changed


def _tree(change: Callable[[Element, random.Random], dict[str, str] | None]) -> Change:
    """A change of the file's elements."""

    def changed(original: Original, folder: Path, rng: random.Random) -> dict[str, str] | None:
        path = folder / "robot.urdf"
        document = ElementTree.parse(path)
        names = change(document.getroot(), rng)
        document.write(path, encoding="utf-8", xml_declaration=True)
        return names

    return changed


def _mesh(change: Callable[[Path, Element], object]) -> Change:
    """A change of one mesh file, and of the element that names it."""

    def changed(original: Original, folder: Path, rng: random.Random) -> None:
        path = folder / "robot.urdf"
        document = ElementTree.parse(path)
        element = rng.choice(list(document.getroot().iter("mesh")))
        change(folder / str(element.get("filename")), element)
        document.write(path, encoding="utf-8", xml_declaration=True)

    return changed


def _renamed(new: str) -> Change:
    def change(robot: Element, rng: random.Random) -> dict[str, str]:
        old = str(rng.choice(robot.findall("joint")).find("child").get("link"))  # pyright: ignore[reportOptionalMemberAccess]
        for element in robot.iter():
            for key, value in element.attrib.items():
                if value == old and (element.tag == "link" or key == "link"):
                    element.set(key, new)
        return {old: new}

    return _tree(change)


def _encoded(code: str, declared: str | None = None) -> Change:
    """The file in another encoding, with a comment of characters that differ in this encoding."""
    word = {"gbk": "机器人", "shift_jis": "ロボット"}.get(code, "Grün")
    stated = code if declared is None else declared
    head = f'<?xml version="1.0" encoding="{stated}"?>' if stated else '<?xml version="1.0"?>'

    def change(text: str) -> bytes:
        body = re.sub(r"^<\?xml.*?\?>", "", text)
        return f"{head}<!-- {word} -->{body}".encode(code)

    return _text(change)


def _of_all(path: str, key: str, change: Callable[[str], str]) -> Change:
    """A change of the attribute `key` in all elements that the XML path `path` finds."""

    def changed(robot: Element, _: random.Random) -> None:
        for element in robot.iterfind(path):
            if key in element.attrib:
                element.set(key, change(element.attrib[key]))

    return _tree(changed)


def _times(factor: float) -> Callable[[str], str]:
    return lambda text: " ".join(repr(factor * float(word)) for word in text.split())


def _moments_in_mm(robot: Element, _: random.Random) -> None:
    for element in robot.iterfind("link/inertial/inertia"):
        for key, value in element.attrib.items():
            element.set(key, _times(1e6)(value))


def _above(kind: str) -> Change:
    """A new root link `odom`, connected to the original root link by a joint of a kind."""

    def change(robot: Element, _: random.Random) -> None:
        children = {str(j.get("link")) for j in robot.iterfind("joint/child")}
        root = next(
            str(k.get("name")) for k in robot.findall("link") if k.get("name") not in children
        )
        SubElement(robot, "link", name="odom")
        joint = SubElement(robot, "joint", name="odom_joint", type=kind)
        SubElement(joint, "parent", link="odom")
        SubElement(joint, "child", link=root)
        SubElement(joint, "axis", xyz="0 0 1")
        SubElement(joint, "limit", lower="-9", upper="9", effort="1", velocity="1")

    return _tree(change)


def _beside(kind: str, shape: str, inner: str = "") -> Change:
    """A further link with a shape, connected to a random link by a joint of a kind."""

    def change(robot: Element, rng: random.Random) -> None:
        parent = str(rng.choice(robot.findall("joint")).find("child").get("link"))  # pyright: ignore[reportOptionalMemberAccess]
        robot.append(ElementTree.fromstring(f'<link name="tag">{shape}</link>'))
        robot.append(
            ElementTree.fromstring(
                f'<joint name="tag_joint" type="{kind}"><parent link="{parent}"/>'
                f'<child link="tag"/>{inner}'
                '<limit lower="0" upper="0.02" effort="1" velocity="1"/></joint>'
            )
        )

    return _tree(change)


def _shape(text: str, tag: str = "collision") -> str:
    return f"<{tag}><geometry>{text}</geometry></{tag}>"


def _as(end: str, **options: Any) -> Change:
    """A mesh in another format, with the file name's ending `end`."""

    def change(path: Path, element: Element) -> None:
        mesh = _loaded(path)
        target = path.with_name(f"{path.stem}_as{end}")
        mesh.export(target, **options)
        element.set("filename", f"meshes/{target.name}")

    return _mesh(change)


def collada(mesh: trimesh.Trimesh, metre: float, up: str = "Z_UP") -> str:
    """A mesh as a COLLADA file whose unit is `metre` [m]; `up` names its upward axis."""
    p = " ".join(f"{c:.9g}" for c in (np.asarray(mesh.vertices) / metre).ravel())
    t, n = " ".join(map(str, np.asarray(mesh.faces).ravel())), len(mesh.vertices)
    return (
        '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
        f'<unit name="u" meter="{metre}"/><up_axis>{up}</up_axis></asset><library_geometries>'
        f'<geometry id="g"><mesh><source id="p"><float_array id="a" count="{3 * n}">{p}'
        f'</float_array><technique_common><accessor source="#a" count="{n}" stride="3">'
        '<param name="X" type="float"/><param name="Y" type="float"/><param name="Z" '
        'type="float"/></accessor></technique_common></source><vertices id="v"><input '
        'semantic="POSITION" source="#p"/></vertices><triangles count="'
        f'{len(mesh.faces)}"><input semantic="VERTEX" source="#v" offset="0"/><p>{t}</p>'
        "</triangles></mesh></geometry></library_geometries><library_visual_scenes>"
        '<visual_scene id="s"><node id="n"><instance_geometry url="#g"/></node></visual_scene>'
        '</library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


def _collada(metre: float, up: str = "Z_UP") -> Change:
    """Replace a mesh by a COLLADA file of the same size, whose unit is `metre` [m]."""

    def change(path: Path, element: Element) -> None:
        target = path.with_name(f"{path.stem}_unit.dae")
        target.write_text(collada(_loaded(path), metre, up), encoding="utf-8")
        element.set("filename", f"meshes/{target.name}")

    return _mesh(change)


def _replaced(content: bytes) -> Change:
    """Other content in place of a mesh."""
    return _mesh(lambda path, _: path.write_bytes(content))


def _address(change: Callable[[Path, str], str]) -> Change:
    return _mesh(lambda path, e: e.set("filename", change(path, str(e.get("filename")))))


def _moved_to(name: str, escape: bool = False) -> Change:
    """A mesh in a folder with the name `name`.

    With `escape`, blanks of its address are written as `%20`, and accents in the Unicode form NFC.
    """

    def change(path: Path, element: Element) -> None:
        target = path.parent.parent / name / path.name
        target.parent.mkdir(exist_ok=True)
        shutil.copy(path, target)
        written = normalize("NFC", name.replace(" ", "%20")) if escape else name
        element.set("filename", f"{written}/{path.name}")

    return _mesh(change)


def _scaled(factor: float, *, stated: bool) -> Change:
    """A mesh in another unit, with or without the corresponding scale in the URDF."""

    def change(path: Path, element: Element) -> None:
        mesh = _loaded(path)
        mesh.apply_scale(factor)
        target = path.with_name(f"{path.stem}_scaled.stl")
        mesh.export(target)
        element.set("filename", f"meshes/{target.name}")
        if stated:
            own = [float(word) for word in element.get("scale", "1 1 1").split()]
            element.set("scale", " ".join(repr(each / factor) for each in own))

    return _mesh(change)


POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 12345\n"
_NS = 'xmlns="http://www.ros.org/urdf" '
_XACRO = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" '
CHANGES: dict[str, dict[str, Change]] = {
    "names": {
        name: _renamed(name)
        for name in (
            "end_effector",
            "floor_point",
            "universe",
            "world",
            "Glied_Ä",
            "a link",
            "/l",
            "root_joint",
        )
    },
    "encodings": {
        "latin-1": _encoded("latin-1"),
        "cp1252": _encoded("cp1252"),
        "utf-16": _encoded("utf-16"),
        "utf-8-sig": _encoded("utf-8-sig"),
        "gbk": _encoded("gbk"),
        "shift_jis": _encoded("shift_jis"),
        "says utf-16": _encoded("utf-8", "utf-16"),
        "says nothing": _encoded("latin-1", ""),
        "another encoding than declared": _encoded("utf-8", "martian"),
        "blanks around": _text(lambda text: f"\n\n{text}\0\0"),
        "lines of Windows": _text(lambda text: text.replace("\n", "\r\n")),
        "pointer": _text(lambda _: POINTER),
        "page": _text(lambda _: b"<!DOCTYPE html><html><body>404</body></html>"),
    },
    "units": {
        "inches by COLLADA": _collada(0.0254),
        "millimetres by COLLADA": _collada(0.001),
        "centimetres by COLLADA, y up": _collada(0.01, "Y_UP"),
        "millimetres by scale": _scaled(1000.0, stated=True),
        "millimetres": _scaled(1000.0, stated=False),
        "joints in millimetres": _of_all("joint/origin", "xyz", _times(1000.0)),
        "joints in inches": _of_all("joint/origin", "xyz", _times(39.37)),
        "angles in degrees": _of_all("joint/origin", "rpy", _times(57.29578)),
        "limits in degrees": _of_all("joint/limit", "upper", _times(57.29578)),
        "centres of mass in millimetres": _of_all("link/inertial/origin", "xyz", _times(1000.0)),
        "moments of inertia in kg mm²": _tree(_moments_in_mm),
        "grams": _of_all("link/inertial/mass", "value", _times(1000.0)),
    },
    "addresses": {
        "file://": _address(lambda path, _: f"file://{path}"),
        "absolute": _address(lambda path, _: str(path)),
        "backslashes": _address(lambda _, name: ".\\" + name.replace("/", "\\")),
        "blanks around": _address(lambda _, name: f" {name} "),
        "dots": _address(lambda _, name: f"./meshes/../{name}"),
        "package": _address(lambda path, name: f"package://{path.parent.parent.name}/{name}"),
        "two slashes": _address(lambda path, name: f"package://{path.parent.parent.name}//{name}"),
        "no package": _address(lambda _, name: f"package://nobody_has_it/{name}"),
        "the web": _address(lambda _, name: f"https://a.b/{name}"),
        "Windows": _address(lambda _, name: f"C:\\robots\\{name}"),
        "missing": _address(lambda _, name: f"{name}.stl"),
        "a blank": _moved_to("my meshes"),
        "escaped": _moved_to("my meshes", escape=True),
        "unicode": _moved_to("网格"),
        "accents": _moved_to("A\u0308", escape=True),
        "per cent": _moved_to("100%"),
    },
    "joints": {
        **{f"{kind} above": _above(kind) for kind in ("floating", "planar", "fixed", "continuous")},
        **{
            f"{kind} beside": _beside(kind, "")
            for kind in ("floating", "planar", "fixed", "continuous", "prismatic", "screw")
        },
        "mimic beside": _beside("prismatic", "", '<mimic joint="tag_joint"/>'),
    },
    "limits": {
        "zeros": _of_all("joint/limit", "upper", lambda _: "0"),
        "inf": _of_all("joint/limit", "upper", lambda _: "inf"),
        "nan": _of_all("joint/limit", "lower", lambda _: "nan"),
        "huge": _of_all("joint/limit", "upper", lambda _: "1e9"),
        "words": _of_all("joint/limit", "upper", lambda _: "pi/2"),
        "effort of 0": _of_all("joint/limit", "effort", lambda _: "0"),
        "velocity of 0": _of_all("joint/limit", "velocity", lambda _: "0"),
    },
    "placeholders": {
        "box of 0": _beside("fixed", _shape('<box size="0 0 0"/>')),
        "sphere of 0": _beside("fixed", _shape('<sphere radius="0"/>')),
        "cylinder of 0": _beside("fixed", _shape('<cylinder radius="0" length="0"/>', "visual")),
        "empty mesh": _beside("fixed", _shape('<mesh filename=""/>')),
        "no geometry": _beside("fixed", "<collision/>"),
        "pointer": _replaced(POINTER),
        "page": _replaced(b"<html><body>Sign in</body></html>"),
        "empty": _replaced(b""),
        "archive": _replaced(b"\x1f\x8b\x08\x00"),
        "cut": _mesh(lambda path, _: path.write_bytes(path.read_bytes()[:500])),
        "usd": _beside("fixed", _shape('<mesh filename="a.usd"/>', "visual")),
    },
    "namespaces": {
        "default": _text(lambda text: text.replace("<robot ", f"<robot {_NS}", 1)),
        "xacro": _text(lambda text: text.replace("<robot ", _XACRO, 1)),
        "expression": _text(
            lambda text: text.replace("<robot ", _XACRO, 1).replace(
                "</robot>", '<xacro:if value="${1 > 2}"><link name="never"/></xacro:if></robot>'
            )
        ),
        "gazebo": _text(
            lambda text: text.replace("</robot>", "<gazebo><a:b xmlns:a='u'/></gazebo></robot>")
        ),
        "instruction": _text(
            lambda text: text.replace(
                "</robot>", "<?pi 1?><!-- -- --></robot>".replace(" -- ", " ")
            )
        ),
        "doctype": _text(lambda text: text.replace("<robot ", "<!DOCTYPE robot><robot ", 1)),
        "entity": _text(
            lambda text: text.replace("<robot ", '<!DOCTYPE r [<!ENTITY a "b">]><robot ', 1)
        ),
        "macro without prefix": _text(
            lambda text: text.replace("</robot>", '<macro name="a"/><a/></robot>')
        ),
        "macro": _text(
            lambda text: text.replace(
                "</robot>", "<x:arm xmlns:x='http://www.ros.org/wiki/xacro'/></robot>"
            )
        ),
    },
    "origins": {
        "whitespace": _of_all(
            "joint/origin", "xyz", lambda text: "\n\t" + text.replace(" ", "  \t") + " "
        ),
        "exponents": _of_all(
            "joint/origin", "xyz", lambda t: " ".join(f"{float(x):.12E}" for x in t.split())
        ),
        "commas": _of_all("joint/origin", "xyz", lambda text: text.replace(" ", ", ")),
        "five": _of_all("joint/origin", "xyz", lambda text: text + " 0 0"),
        "nan": _of_all("joint/origin", "rpy", lambda _: "nan 0 0"),
        "axis twice as long": _of_all("joint/axis", "xyz", _times(2.0)),
        "turned once round": _of_all(
            "joint/origin", "rpy", lambda t: " ".join(repr(float(x) + 2 * np.pi) for x in t.split())
        ),
    },
    "formats": {
        ".obj": _as(".obj"),
        ".ply": _as(".ply"),
        ".glb": _as(".glb"),
        ".off": _as(".off"),
        "STL as text": _as(".stl", file_type="stl_ascii"),
        "upper case": _as(".STL", file_type="stl"),
    },
}


def mutate(
    original: Original, kind: str, change: Change, folder: Path, rng: random.Random
) -> Mutant:
    """Make a changed copy of a robot in a folder."""
    shutil.copytree(original.urdf.parent, folder)
    names = change(original, folder, rng) or {}
    base, tip = (names.get(link, link) for link in (original.base, original.tip))
    return Mutant(kind, folder / "robot.urdf", base, tip, names)


def verdict(mutant: Mutant, expected: dict[str, Array], home: Path) -> str:
    """Read a mutant; return `same`, `refused: …` with the message, or `FAULT: …`."""
    home.mkdir()
    try:
        request = Request(str(mutant.urdf), mutant.base, mutant.tip, home, kind="holonomic")
        parsed = parse(request)
        text = rebased_urdf(parsed, name="mutant", header="", home=home)
    except DbbError as error:
        line = str(error)
        return f"refused: {line}" if line.strip() and "\n" not in line else f"FAULT: lines {line!r}"
    except Exception:
        return f"FAULT: {traceback.format_exc()}"
    (home / "robot.urdf").write_text(text, encoding="utf-8")
    return _compared(mutant, expected, home, parsed.arm.base)


def _compared(mutant: Mutant, expected: dict[str, Array], home: Path, base: str) -> str:
    made = supports(home / "robot.urdf", base)
    worst, where = 0.0, ""
    for old, rows in expected.items():
        new = mutant.names.get(old, old)
        found = made.get(new, made.get(f"{new}_link"))
        if found is None:
            return f"FAULT: the link {new} has no shape"
        off = float(np.abs(found - rows).max())
        worst, where = max((worst, where), (off, new))
    return "same" if worst <= AGREE else f"FAULT: {where} is {worst:.4f} m elsewhere"


OUTCOMES = ("same", "refused", "FAULT")
"""Outcomes of a mutant: read like the original, refused with one line, or anything else."""


def main(
    count: int = 200,
    first: int = 0,
    seed: int = 0,
    robots: Sequence[str] = tuple(ROBOTS),
    json: Json = False,
) -> None:
    """Read changed URDFs (mutants), and count the outcomes for each class of changes.

    Args:
        count: Number of mutants.
        first: Number of the first mutant; a mutant depends only on its number and the seed.
        seed: Seed of the choice of the changed link, joint or mesh.
        robots: Names of the robots.
        json: Print only one JSON object on standard output, and the mutants on standard error.
    """
    table = Counter[tuple[str, str]]()
    changes = [(kind, name, c) for kind, each in CHANGES.items() for name, c in each.items()]
    with tempfile.TemporaryDirectory() as folder:
        top = Path(folder)
        originals = [copied(name, top / name) for name in robots]
        expected = [supports(each.urdf, each.base) for each in originals]
        for k in range(first, first + count):
            which, (kind, name, change) = k % len(originals), changes[k % len(changes)]
            rng = random.Random(f"{seed} {k}")
            mutant = mutate(originals[which], kind, change, top / f"m{k}", rng)
            said = verdict(mutant, expected[which], top / f"made{k}")
            table[kind, said.partition(":")[0]] += 1
            line = f"{robots[which]:12} {kind}: {name}: {said.replace(folder, '')}"
            print(line, flush=True, file=sys.stderr if json else sys.stdout)
    rows = {kind: {each: table[kind, each] for each in OUTCOMES} for kind in CHANGES}
    if json:
        print_json(rows)
    for kind, row in () if json else rows.items():
        print(f"{kind:13} " + "  ".join(f"{key} {number:3}" for key, number in row.items()))
    if any(outcome == "FAULT" for _, outcome in table):
        sys.exit(1)


if __name__ == "__main__":
    tyro.cli(main)
