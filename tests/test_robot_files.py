"""Robot files of other programs are read as intended or refused with the cause."""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from app.errors import RobotFileError
from app.onboarding.fit.travel import filled
from app.onboarding.new_robot import Parsed, parse
from app.onboarding.read import links
from app.onboarding.read.links import MOST_FACES, is_foreign, load_mesh, read_mesh
from app.onboarding.read.package import open_package
from app.onboarding.read.source import locate
from app.onboarding.read.tree import find_arm, make_tree
from app.onboarding.request import Request
from app.onboarding.write import in_pieces_urdf, rebased_urdf
from app.robot.assets import xml_text
from benchmarks.urdf_mutants import collada
from tests.onboarding import (
    BOX,
    INERTIAL,
    arm,
    cart,
    cube,
    joint,
    link,
    robot,
    solid,
    with_mesh,
    zipped,
)
from tests.robots import husky_panda

TOY = robot([*cart(), *arm()])
HAND = (0.08, 0.12, 0.08)
LIMIT = 'lower="-2.5" upper="2.5" effort="60" velocity="2"'
HEAD = '<?xml version="1.0"?>'
ABOVE = '<link name="map"/><joint name="root" type="{}"><parent link="map"/><child link="base"/>'
ABOVE += "</joint>"
POINTER = "version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n"


def parsed(folder: Path, text: str | bytes, **changes: str) -> Parsed:
    path = folder / "toy.urdf"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    options = {"base": "base", "tip": "hand"} | changes
    return parse(Request(urdf=str(path), out=folder / "made", **options))


def extents(made: Parsed, name: str = "hand") -> list[float]:
    return made.geometry[name].shapes[0].hull.extents.tolist()


@pytest.mark.parametrize(
    ("code", "stated"),
    [
        ("latin-1", "ISO-8859-1"),
        ("cp1252", "windows-1252"),
        ("utf-16", "UTF-16"),
        ("utf-16-le", "UTF-16"),
        ("utf-8-sig", "utf-8"),
        ("utf-8", "UTF-16"),
        ("gbk", "GBK"),
        ("shift_jis", "Shift_JIS"),
    ],
)
def test_a_urdf_is_read_in_the_encoding_that_it_declares(
    tmp_path: Path, code: str, stated: str
) -> None:
    word = {"gbk": "爪", "shift_jis": "ソ"}.get(code, "Grün")
    head = f'<?xml version="1.0" encoding="{stated}"?>'
    text = TOY.replace(HEAD, head).replace('"wrist_link"', f'"{word}"')
    assert word in parsed(tmp_path, text.encode(code)).tree.links


@pytest.mark.parametrize(
    ("content", "cause"),
    [
        (POINTER, "a Git LFS pointer; get the file by: git lfs pull"),
        ("<!DOCTYPE html><html></html>", "a web page"),
        ("<!-- saved --> <HTML><body/></HTML>", "a web page"),
        ("404: Not Found", "a server's error"),
        ('<?xml version="1.0"?>\n<Error><Code>AccessDenied</Code></Error>', "a server's error"),
        ("../other/toy.urdf", "the text of a symbolic link"),
        ("\x1f\x8b\x08", "an archive; unpack it"),
        ("", "an empty file"),
    ],
)
def test_the_error_names_the_content_in_place_of_a_file(
    tmp_path: Path, content: str, cause: str
) -> None:
    path = tmp_path / "m.stl"
    path.write_bytes(content.encode("latin-1"))
    for read in (lambda: read_mesh(path), lambda: xml_text(path)):
        with pytest.raises(RobotFileError) as caught:
            read()
        assert cause in str(caught.value)


@pytest.mark.parametrize(
    ("content", "kind"),
    [
        (b"#usda 1.0\n", "a USD file"),
        (b"PXR-USDC\0\0", "a USD file"),
        (b"%PDF-1.7\n", "a PDF"),
        (b"\x89PNG\r\n", "a picture"),
        (trimesh.creation.box().export(file_type="stl"), "an STL mesh (.stl)"),
        (trimesh.creation.box().export(file_type="stl_ascii").encode(), "an STL mesh (.stl)"),
    ],
)
def test_a_file_of_another_kind_is_named(tmp_path: Path, content: bytes, kind: str) -> None:
    path = tmp_path / "robot.urdf"
    path.write_bytes(content)
    with pytest.raises(RobotFileError, match=re.escape(f"it is {kind}, not a URDF")):
        xml_text(path)
    with pytest.raises(RobotFileError, match="it is a folder; name a URDF"):
        locate(str(tmp_path))


@pytest.mark.parametrize(("unit", "up"), [(0.0254, "Z_UP"), (0.001, "Z_UP"), (0.01, "Y_UP")])
def test_the_unit_of_a_mesh_applies_to_bodies_and_the_written_urdf(
    tmp_path: Path, unit: float, up: str
) -> None:
    pytest.importorskip("collada")
    (tmp_path / "m.dae").write_text(collada(trimesh.creation.box(HAND), unit, up))
    made, home = parsed(tmp_path, with_mesh(TOY, "m.dae")), tmp_path / "home"
    assert extents(made) == pytest.approx(HAND, abs=1e-6)
    home.mkdir()
    (home / "robot.urdf").write_text(rebased_urdf(made, name="toy", header="", home=home))
    model = pin.buildModelFromUrdf(str(home / "robot.urdf"))
    shapes = pin.buildGeomFromUrdf(
        model, str(home / "robot.urdf"), pin.GeometryType.COLLISION, package_dirs=[str(home)]
    )
    hand = next(each for each in shapes.geometryObjects if each.name.startswith("hand"))
    hand.geometry.computeLocalAABB()
    box = hand.geometry.aabb_local
    assert [box.width(), box.height(), box.depth()] == pytest.approx(HAND, abs=1e-6)


@pytest.mark.parametrize(
    "address",
    [
        "file://{}/my%20robot/m.stl",
        "{}/my robot/m.stl",
        ".\\my robot\\m.stl",
        " my%20robot/m.stl",
        "package://my%20robot//m.stl",
        "my robot/A\u0308.stl",
        "my robot/\u00c4.stl",
    ],
)
def test_common_forms_of_mesh_addresses_are_read(tmp_path: Path, address: str) -> None:
    (tmp_path / "my robot").mkdir()
    for name in ("m", "\u00c4" if "\u0308" in address else "A\u0308"):
        (tmp_path / "my robot" / f"{name}.stl").write_bytes(cube())
    assert extents(parsed(tmp_path, with_mesh(TOY, address.format(tmp_path)))) == pytest.approx(
        HAND
    )


@pytest.mark.parametrize(
    ("address", "cause"),
    [
        ("https://a.b/m.stl", "an address of the web or of another tool"),
        ("C:\\robots\\m.stl", "a path of another machine, of Windows"),
        ("file:///C:/robots/m.stl", "a path of another machine, of Windows"),
        ("m.STL", "there is no file"),
        ("hand.stl", "(did you mean 'Hand.STL'?)"),
        ("Meshes/m.stl", "(did you mean 'meshes/M.STL'?)"),
        (f"{300 * 'a'}/m.stl", "there is no file"),
        ("package://__main__/m.stl", "set --package __main__=FOLDER"),
        ("package://test/m.stl", "set --package test=FOLDER"),
    ],
)
def test_the_error_of_a_wrong_mesh_address_states_the_cause(
    tmp_path: Path, address: str, cause: str
) -> None:
    (tmp_path / "meshes").mkdir()
    for name in ("Hand.STL", "nan.stl", "meshes/M.STL"):
        (tmp_path / name).write_bytes(cube())
    with pytest.raises(RobotFileError) as caught:
        parsed(tmp_path, with_mesh(TOY, address))
    assert cause in str(caught.value)


@pytest.mark.parametrize("before", ["\n\n", " ", "\ufeff\n"])
@pytest.mark.parametrize("after", ["", "\n\0\0"])
def test_blanks_around_a_urdf_are_ignored(tmp_path: Path, before: str, after: str) -> None:
    assert "hand" in parsed(tmp_path, before + TOY + after).tree.links


@pytest.mark.parametrize(
    "end", ["", '<xacro:if value="0" xmlns:xacro="http://www.ros.org/wiki/xacro"/>']
)
def test_a_mesh_path_relative_to_the_package_is_found(tmp_path: Path, end: str) -> None:
    for name in ("urdf", "meshes"):
        (tmp_path / name).mkdir()
    (tmp_path / "meshes" / "m.stl").write_bytes(cube())
    text = with_mesh(TOY, "meshes/m.stl").replace("</robot>", f"{end}</robot>")
    made = parsed(tmp_path / "urdf", text)
    assert extents(made) == pytest.approx(HAND)


@pytest.mark.parametrize(
    ("code", "name"),
    [
        ("gbk", "爪"),
        ("shift_jis", "ソ"),
        ("euc-jp", "手"),
        ("cp866", "рука"),
        ("koi8-r", "рука"),
        ("cp1252", "Grün"),
    ],
)
def test_a_zip_may_have_file_names_in_another_code_page(
    tmp_path: Path, code: str, name: str
) -> None:
    import zipfile

    class Info(zipfile.ZipInfo):
        def _encodeFilenameFlags(self) -> tuple[bytes, int]:
            return self.filename.encode(code), self.flag_bits

    with zipfile.ZipFile(tmp_path / "toy.zip", "w") as archive:
        archive.writestr(Info("a/toy.urdf"), with_mesh(TOY, f"{name}.stl"))
        archive.writestr(Info(f"a/{name}.stl"), cube())
    path = open_package(tmp_path / "toy.zip", tmp_path / "made")
    made = parse(Request(str(path), "base", "hand", tmp_path / "made"))
    assert extents(made) == pytest.approx(HAND)


@pytest.mark.parametrize(
    ("old", "new", "causes"),
    [
        (
            LIMIT,
            'lower="-90" upper="90" effort="60" velocity="90"',
            ["pan (-90 to 90)", "roll", "degrees"],
        ),
        (
            LIMIT,
            'lower="0" upper="0"',
            ["pan (0 to 0)", "roll (0 to 0)", "write those of the real"],
        ),
        (LIMIT, 'lower="1" upper="-1"', ["pan", "roll", "not below"]),
        ('rpy="1.5708 0 0"', 'rpy="90 0 0"', ['rpy="90 0 0" looks like degrees']),
        ('xyz="0 0 0.34"', 'xyz="0 0 13.4"', ["inches or centimetres"]),
        ('xyz="0 0 0.34"', 'xyz="0 0 340"', ["millimetres"]),
        ('<mass value="2"/>', '<mass value="2000"/>', ["grams"]),
        ("<inertial>", '<inertial><origin xyz="0 0 100"/>', ["link 'base'", "millimetres"]),
    ],
)
def test_the_error_of_numbers_in_other_units_names_the_unit(
    tmp_path: Path, old: str, new: str, causes: list[str]
) -> None:
    assert old in TOY
    with pytest.raises(RobotFileError) as caught:
        parsed(tmp_path, TOY.replace(old, new))
    assert all(cause in str(caught.value) for cause in causes), caught.value


@pytest.mark.parametrize("factor", [1e6, 1e9])
def test_the_error_of_inertia_in_another_unit_names_the_unit(tmp_path: Path, factor: float) -> None:
    text = re.sub(r'(i[xyz]{2})="([\d.]+)"', lambda m: f'{m[1]}="{factor * float(m[2]):g}"', TOY)
    with pytest.raises(RobotFileError, match="looks like kg mm²"):
        parsed(tmp_path, text)


FORE = INERTIAL.format(m=1.5, i=0.015)


@pytest.mark.parametrize(
    ("inertial", "unit"),
    [
        (INERTIAL.format(m=1.5, i=20_000), "'fore': a moment .* looks like kg mm²"),
        (INERTIAL.format(m=1.5, i=150), "'fore': a moment .* looks like kg mm²"),  # kg cm²
        (FORE.replace("<mass", '<origin xyz="5 0 0"/><mass'), "'fore': a centre .* centimetres"),
        (FORE.replace("<mass", '<origin xyz="0 1.1 0"/><mass'), "'fore': a centre .* centimetres"),
        (INERTIAL.format(m=1500, i=15), "'fore': a mass of 1500 kg .* looks like grams"),
    ],
)
def test_the_inertia_of_one_link_in_another_unit_is_refused(
    tmp_path: Path, inertial: str, unit: str
) -> None:
    """The other links of the robot are in the right unit."""
    text = TOY.replace(FORE, inertial)
    assert text.count(inertial) == 1
    with pytest.raises(RobotFileError, match=unit):
        parsed(tmp_path, text)


@pytest.mark.parametrize(
    "inertial",
    [
        INERTIAL.format(m=1.5, i=1.0),
        INERTIAL.format(m=0.001, i=1.0),
        FORE.replace("<mass", '<origin xyz="0.2 0 0"/><mass'),
    ],
)
def test_a_rough_guess_of_one_inertia_is_accepted(tmp_path: Path, inertial: str) -> None:
    assert "fore" in parsed(tmp_path, TOY.replace(FORE, inertial)).inertias


@pytest.mark.parametrize("light", [(True, False), (False, True), (True, True)])
def test_masses_that_are_too_small_for_their_shapes_are_refused(
    tmp_path: Path, light: tuple[bool, bool]
) -> None:
    parts = [
        re.sub('mass value="([^"]*)"', lambda m: f'mass value="{float(m[1]) / 1e3}"', each)
        if small
        else each
        for each, small in zip(("".join(cart()), "".join(arm())), light, strict=True)
    ]
    with pytest.raises(RobotFileError, match=r"kg in .* in total looks like tonnes"):
        parsed(tmp_path, robot(parts))


@pytest.mark.parametrize("kind", ["revolute", "prismatic"])
@pytest.mark.parametrize(
    ("limit", "low", "high", "assumed"),
    [
        ('upper="1.5" effort="6" velocity="2"', 0.0, 1.5, ["lower"]),
        ('lower="-0.5"', -0.5, 0.0, ["upper"]),
        ('lower="0" upper="1e16"', 0.0, np.pi, ["upper"]),
        ('lower="-1e16" upper="-4"', -4 - np.pi, -4.0, ["lower"]),
        ('lower="-1e9" upper="1e9"', -np.pi, np.pi, ["lower", "upper"]),
        ('effort="6"', -np.pi, np.pi, ["lower", "upper"]),
    ],
)
def test_a_stated_limit_on_one_side_is_preserved(
    tmp_path: Path, limit: str, low: float, high: float, assumed: list[str], kind: str
) -> None:
    """In a URDF a missing limit is 0 if the other is stated; the source names the assumption."""
    lift = re.search('<joint name="lift".*\n', TOY)
    assert lift is not None
    text = TOY.replace(lift[0], lift[0].replace(LIMIT, limit).replace("revolute", kind))
    if kind == "prismatic" and ("e16" in limit or len(assumed) == 2):
        with pytest.raises(RobotFileError, match=r"joints lift.* without a limit on each side"):
            parsed(tmp_path, text)
        return
    limits = parsed(tmp_path, text).limits
    assert (limits.lower[1], limits.upper[1]) == pytest.approx((low, high))
    sources = {side: limits.numbers[f"position_{side}"][1] for side in ("lower", "upper")}
    assert [k for k, text in sources.items() if "assumed for lift: " in text] == assumed


def test_only_meshes_that_the_new_urdf_names_remain(tmp_path: Path) -> None:
    """A converted collision mesh is not needed if it is cut into pieces."""
    boxes = [trimesh.creation.box(HAND).apply_translation((x, 0.0, 0.0)) for x in (0.0, 0.5)]
    trimesh.util.concatenate(boxes).export(tmp_path / "m.ply")
    made, home = parsed(tmp_path, with_mesh(TOY, "m.ply")), tmp_path / "home"
    home.mkdir()
    text = rebased_urdf(made, name="toy", header="", home=home)
    assert [path.suffix for path in (home / "meshes").iterdir()] == [".stl"]
    text, _ = in_pieces_urdf(text, made.geometry, home)
    named = [mesh.get("filename") for mesh in ElementTree.fromstring(text).iter("mesh")]
    assert [f"meshes/{path.name}" for path in (home / "meshes").iterdir()] == named
    assert named[0].endswith(".obj")
    content = (home / named[0]).read_text()
    assert content.startswith(f"# dbb: {content.count(chr(10) + 'f ')} faces\n")


@pytest.mark.parametrize("unit", ["0", "-1", "0,001", "mm", ""])
def test_an_invalid_unit_of_a_mesh_is_refused(tmp_path: Path, unit: str) -> None:
    pytest.importorskip("collada")
    text = collada(trimesh.creation.box(HAND), 1.0).replace('meter="1.0"', f'meter="{unit}"')
    (tmp_path / "m.dae").write_text(text)
    with pytest.raises(RobotFileError, match="should be a number above zero"):
        parsed(tmp_path, with_mesh(TOY, "m.dae"))


@pytest.mark.parametrize("code", ["utf-8", "utf-8-sig", "utf-16", "utf-16-be", "latin-1"])
@pytest.mark.parametrize("before", ["", "<contributor><comments>{}</comments></contributor>"])
def test_the_unit_of_a_mesh_is_read_in_any_encoding_and_place(
    tmp_path: Path, code: str, before: str
) -> None:
    pytest.importorskip("collada")
    stated = {"utf-8-sig": "utf-8", "utf-16-be": "utf-16", "latin-1": "ISO-8859-1"}.get(code, code)
    text = re.sub(r"<\?xml.*?\?>", "", collada(trimesh.creation.box(HAND), 0.001))
    text = text.replace("<unit", before.format("ü" * 100_000) + "<unit")
    mark = "\ufeff" if code == "utf-16-be" else ""
    content = f'{mark}<?xml version="1.0" encoding="{stated}"?>{text}'.encode(code)
    (tmp_path / "m.dae").write_bytes(content)
    assert is_foreign(tmp_path / "m.dae")
    assert extents(parsed(tmp_path, with_mesh(TOY, "m.dae"))) == pytest.approx(HAND, abs=1e-6)


def gltf() -> dict[str, bytes]:
    """The files of the end-effector's box: `m.gltf` and the `.bin` files that it needs."""
    files = trimesh.exchange.gltf.export_gltf(trimesh.Scene(trimesh.creation.box(HAND)))
    return {name.replace("model.gltf", "m.gltf"): content for name, content in files.items()}


@pytest.mark.parametrize("lacking", [False, True])
@pytest.mark.parametrize("in_zip", [False, True])
def test_a_gltf_is_read_with_its_bin_files(tmp_path: Path, in_zip: bool, lacking: bool) -> None:
    files = {name: each for name, each in gltf().items() if name == "m.gltf" or not lacking}
    text, folder = with_mesh(TOY, "m.gltf"), tmp_path
    if in_zip:
        zipped(tmp_path, {"a/toy.urdf": text, **{f"a/{k}": each for k, each in files.items()}})
        path = open_package(tmp_path / "toy.zip", tmp_path / "made")
        text, folder = path.read_text(), path.parent
    else:
        for name, content in files.items():
            (folder / name).write_bytes(content)
    if lacking:
        with pytest.raises(RobotFileError, match=r"0\.bin is missing beside it: add this file"):
            parsed(folder, text)
    else:
        assert extents(parsed(folder, text)) == pytest.approx(HAND, abs=1e-6)


@pytest.mark.parametrize("kind", ["obj", "stl_ascii", "off"])
def test_a_byte_order_mark_before_a_mesh_is_ignored(tmp_path: Path, kind: str) -> None:
    text = trimesh.creation.box(HAND).export(file_type=kind)
    text = text.decode() if isinstance(text, bytes) else str(text)
    text = text[text.index("v ") :] if kind == "obj" else text
    path = tmp_path / f"m.{kind.partition('_')[0]}"
    path.write_text(text, encoding="utf-8-sig")
    assert read_mesh(path).extents == pytest.approx(HAND, abs=1e-6)
    assert is_foreign(path)


@pytest.mark.parametrize("scale", ["", ' scale="0.001 0.001 0.001"'])
def test_a_mesh_of_less_than_a_millimetre_is_refused_with_its_scale(
    tmp_path: Path, scale: str
) -> None:
    trimesh.creation.box(np.multiply(HAND, 1.0 if scale else 1e-3)).export(tmp_path / "m.stl")
    with pytest.raises(RobotFileError, match=r"'hand': its mesh is 0\.12 mm long") as caught:
        parsed(tmp_path, TOY.replace(BOX, f'<mesh filename="m.stl"{scale}/>'))
    assert ("scale='0.001 0.001 0.001'" in str(caught.value)) is bool(scale)


def test_a_mesh_of_several_links_is_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "m.stl").write_bytes(cube())
    (tmp_path / "n.stl").write_bytes(b"solid")
    first = load_mesh(tmp_path / "m.stl")
    monkeypatch.setattr(links.trimesh, "load", None)
    assert load_mesh(tmp_path / "m.stl") is first
    element = f"<collision><geometry><mesh filename='{tmp_path}/n.stl'/></geometry></collision>"
    with pytest.raises(RobotFileError, match=r"^link 'c': mesh "):
        links.link_geometry(ElementTree.fromstring(f"<link name='c'>{element}</link>"))


@pytest.mark.parametrize("kind", ["floating", "planar"])
def test_a_free_joint_above_the_base_is_removed(tmp_path: Path, kind: str) -> None:
    text = TOY.replace("</robot>", ABOVE.format(kind) + "</robot>")
    made = parsed(tmp_path, text)
    assert "map" not in rebased_urdf(made, name="toy", header="")
    with pytest.raises(RobotFileError, match="moves the whole base; set --base base"):
        parsed(tmp_path, text, base="map")


@pytest.mark.parametrize(
    "shape",
    [
        '<box size="0 0 0"/>',
        '<box size="0.1 0 0.1"/>',
        '<sphere radius="0"/>',
        '<cylinder radius="0.1" length="0"/>',
        '<mesh filename="m.stl" scale="1 1 0"/>',
    ],
)
def test_a_placeholder_of_size_0_is_removed_and_reported(tmp_path: Path, shape: str) -> None:
    tag = link("tag", f"<collision><geometry>{shape}</geometry></collision>")
    mount = joint("tag_joint", "fixed", "wrist_link", "tag")
    made = parsed(tmp_path, TOY.replace("</robot>", tag + mount + "</robot>"))
    assert "a collision of tag is left out" in made.changes[0]
    assert not made.geometry["tag"].shapes
    assert shape not in rebased_urdf(made, name="toy", header="").replace(" />", "/>")


@pytest.mark.parametrize(
    ("file", "cause"),
    [
        ("m.usd", "are read; convert it to one"),
        ("none.stl", "there is no file"),
        ("package://gone/m.dae", "set --package gone=FOLDER"),
        ("pointer.dae", "a Git LFS pointer"),
        ("", "has no filename"),
    ],
)
def test_an_unreadable_visual_mesh_is_removed_if_it_is_not_needed(
    tmp_path: Path, file: str, cause: str
) -> None:
    (tmp_path / "m.usd").write_bytes(b"PXR-USDC")
    (tmp_path / "pointer.dae").write_text(POINTER)
    visual = f'<visual><geometry><mesh filename="{file}"/></geometry></visual>'
    made = parsed(tmp_path, TOY.replace('<link name="hand">', f'<link name="hand">{visual}'))
    assert made.changes[0].startswith("a visual of hand is left out: ")
    assert cause in made.changes[0]
    alone = TOY.replace("collision>", "visual>").replace(BOX, f'<mesh filename="{file}"/>')
    with pytest.raises(RobotFileError, match=re.escape(cause)):
        parsed(tmp_path, alone)


@pytest.mark.parametrize(
    ("old", "new", "causes"),
    [
        ('xyz="0.15 0 0.1"', 'xyz="0,15 0 0,1"', ["3 numbers", "no commas"]),
        ('xyz="0.15 0 0.1"', 'xyz="0.15, 0, 0.1"', ["3 numbers", "no commas"]),
        ('xyz="0.15 0 0.1"', 'xyz="1_5 0 0.1"', ["3 numbers"]),
        ('<mass value="2"/>', '<mass value="nan"/>', ["value='nan' should be a number"]),
        ('effort="60"', 'effort="-60"', ["'pan'", "effort='-60'", "must not be negative"]),
        ('velocity="2"', 'velocity="2,5"', ["'pan'", "no commas"]),
        ('length="0.34"', 'height="0.34"', ["link 'upper'", "its cylinder has no length"]),
        ('type="revolute"', 'type="Revolute"', ["(did you mean 'revolute'?)"]),
        ('<child link="fore"/>', '<child link="Fore"/>', ["not a link (did you mean 'fore'?)"]),
        ("<link", "<Link", ["the URDF has no <link> (did you mean 'Link'?)"]),
    ],
)
def test_values_that_other_readers_reject_are_refused_with_a_remedy(
    tmp_path: Path, old: str, new: str, causes: list[str]
) -> None:
    assert old in TOY
    text = TOY.replace(old, new).replace(old.replace("<", "</"), new.replace("<", "</"))
    with pytest.raises(RobotFileError) as caught:
        parsed(tmp_path, text)
    assert all(cause in str(caught.value) for cause in causes), caught.value


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('<child link="hand"/>', '<child link="hand "/>'),
        ('type="revolute"', 'type=" revolute "'),
        ('<link name="fore">', '<link name=" fore">'),
    ],
)
def test_blanks_around_a_name_are_removed(tmp_path: Path, old: str, new: str) -> None:
    made = parsed(tmp_path, TOY.replace(old, new))
    assert [each.child for each in made.arm.joints][-4:] == ["fore", "cuff", "wrist_link", "hand"]
    assert new not in rebased_urdf(made, name="toy", header="")


@pytest.mark.parametrize(
    ("rgba", "written"),
    [
        ("1 0.5 0 0.5", "1 0.5 0 0.5"),
        ("255 0 51 1", "1 0 0.2 1"),
        ("1 0 0", "1 0 0 1"),
        ("1, 0, 0, 1", "1 0 0 1"),
        ("red", None),
    ],
)
def test_colours_are_written_in_the_common_form(
    tmp_path: Path, rgba: str, written: str | None
) -> None:
    visual = f'<visual><geometry>{BOX}</geometry><material name="m"><color rgba="{rgba}"/>'
    visual += "</material></visual>"
    made = parsed(tmp_path, TOY.replace('<link name="hand">', f'<link name="hand">{visual}'))
    found = re.findall('rgba="([^"]*)"', rebased_urdf(made, name="toy", header=""))
    assert found == ([] if written is None else [written])


ASCII = trimesh.creation.box(HAND).export(file_type="stl_ascii")
assert isinstance(ASCII, str)
OBJ = "v 0 0 0\nv 0.1 0 0\nv 0 0.1 0\nf 1 2 3\n"


@pytest.mark.parametrize(
    ("file", "content", "cause"),
    [
        ("m.stl", re.sub(r"(\d)\.(\d)", r"\1,\2", ASCII).encode(), "have decimal commas"),
        ("m.obj", OBJ.replace(".", ",").encode(), "have decimal commas"),
        ("m.stl", cube()[:-120], "states 12 triangles, which are 684 bytes, but it has 564"),
        ("m.obj", OBJ.replace("0.1 0 0", "nan 0 0").encode(), "not a finite number"),
        ("m.obj", b"# 8,000 vertices\nf 1 2 3\n", r"^((?!commas).)*$"),
        ("m.gltf", b'{"scenes": [0,1', "is damaged: export it again"),
        ("m.stl", cube()[:96] + b"\0\0\x80\x7f" + cube()[100:], "not a finite number"),
        ("m.stl", OBJ.encode(), r"triangles; it is an OBJ mesh \(.obj\): rename it"),
        ("m.stl", b"# made by hand\no part\n" + OBJ.encode(), "an OBJ mesh"),
        ("m.stl", b'<?xml version="1.0"?>\n<COLLADA/>', "a COLLADA mesh"),
        ("m.stl", b"ISO-10303-21;\nHEADER;\n", "a STEP file"),
        ("m.obj", cube(), "an STL mesh"),
    ],
)
def test_the_error_of_a_damaged_mesh_names_the_damage(
    tmp_path: Path, file: str, content: bytes, cause: str
) -> None:
    (tmp_path / file).write_bytes(content)
    with pytest.raises(RobotFileError, match=cause):
        read_mesh(tmp_path / file)


def test_a_flat_mesh_becomes_a_thin_body(tmp_path: Path) -> None:
    (tmp_path / "m.obj").write_text(OBJ)
    made = parsed(tmp_path, with_mesh(TOY, "m.obj"))
    assert extents(made) == pytest.approx([0.1, 0.1, 0.0], abs=2e-4)


@pytest.mark.parametrize("ending", ["", ".v1"])
def test_a_symbolic_link_has_the_file_type_of_its_own_name(tmp_path: Path, ending: str) -> None:
    """For example in download caches that name files by their content."""
    stored = tmp_path / f"0a{ending}"
    stored.write_text(str(trimesh.creation.box(HAND).export(file_type="off")))
    (tmp_path / "m.off").symlink_to(stored)
    assert extents(parsed(tmp_path, with_mesh(TOY, "m.off"))) == pytest.approx(HAND)


def test_a_package_has_the_name_in_its_package_xml(tmp_path: Path) -> None:
    """The folder of a downloaded repository may have another name, such as `toy-main`."""
    folder = tmp_path / "toy-main" / "urdf"
    folder.mkdir(parents=True)
    (folder.parent / "package.xml").write_text("<package><name>toy</name></package>")
    (folder.parent / "m.stl").write_bytes(cube())
    assert extents(parsed(folder, with_mesh(TOY, "package://toy/m.stl"))) == pytest.approx(HAND)


@pytest.mark.parametrize("form", ["file://{}", "~/toy.urdf"])
def test_a_urdf_may_be_a_file_address_or_below_the_home_folder(
    tmp_path: Path, form: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    (tmp_path / "toy.urdf").write_text(TOY)
    options = Request(form.format(tmp_path / "toy.urdf"), "base", "hand", tmp_path / "made")
    assert "hand" in parse(options).tree.links


@pytest.mark.parametrize("name", ["end_effector", "floor_point", "universe", "planar_x_link"])
def test_a_link_may_have_the_name_of_a_frame_of_the_project(tmp_path: Path, name: str) -> None:
    from app.onboarding.write import compiled, description

    made = parsed(tmp_path, TOY.replace('"fore"', f'"{name}"'))
    (tmp_path / "robot.urdf").write_text(rebased_urdf(made, name="made", header=""))
    options = Request(str(tmp_path / "toy.urdf"), "base", "hand", tmp_path / "made")
    model = compiled(description(options, made), tmp_path / "robot.urdf")
    assert model.pin.frames[model.ee_frame].parentFrame == model.pin.getFrameId("hand")


FINGERS = "".join(
    link(f"{s}_finger", solid('<box size="0.02 0.02 0.12"/>', mass=0.1, xyz="0 0 0.06"))
    + joint(
        f"{s}_slide",
        "prismatic",
        "hand",
        f"{s}_finger",
        xyz=f"0 {y} 0.12",
        axis=f"0 {a} 0",
        limit='lower="0" upper="0.1" effort="2" velocity="1"',
    )
    for s, y, a in (("left", 0.02, 1), ("right", -0.02, -1))
)


def test_bodies_cover_fingers_over_their_whole_travel(tmp_path: Path) -> None:
    made = parsed(tmp_path, TOY.replace("</robot>", FINGERS + "</robot>"))
    found = filled(made.tree, made.geometry, made.arm.joints)
    assert found["left_finger"].shapes[0].hull.extents.tolist() == pytest.approx([0.02, 0.12, 0.12])
    assert found["hand"].shapes[0] is made.geometry["hand"].shapes[0]


def test_a_telescope_of_coupled_slides_becomes_one_slide(tmp_path: Path) -> None:
    """Its end has the same reach, and its body covers all positions of the middle part."""
    tube = solid('<box size="0.04 0.04 0.2"/>', xyz="0 0 0.1")
    limit = 'lower="0" upper="0.1" effort="6" velocity="1"'
    first = joint("slide", "prismatic", "fore", "middle", limit=limit)
    second = joint("follower", "prismatic", "middle", "end", xyz="0 0 0.01", limit=limit)
    second = second.replace("</joint>", '<mimic joint="slide"/></joint>')
    text = TOY.replace(
        "</robot>", f"{link('middle', tube)}{link('end', tube)}{first}{second}</robot>"
    )
    text = text.replace('<parent link="fore"/>', '<parent link="end"/>', 1)
    made = parsed(tmp_path, text)
    slide = made.tree.joints["slide"]
    assert (slide.child, slide.upper, slide.effort, slide.velocity) == ("end", 0.2, 3.0, 2.0)
    assert slide.T_parent_child.translation.tolist() == pytest.approx([0.0, 0.0, 0.01])
    assert "become one joint" in made.changes[0]
    held = filled(made.tree, made.geometry, made.arm.joints)["middle"].shapes[0].hull
    assert held.extents[2] == pytest.approx(0.3)
    still = text.replace('joint="slide"/>', 'joint="slide" multiplier="-1"/>')
    with pytest.raises(RobotFileError, match="'follower' of the arm follows another joint"):
        parsed(tmp_path, still)  # its end never moves


@pytest.mark.parametrize(
    ("axis", "multiplier", "travel"),
    [
        ("0 0 1", 1.0, 0.2),
        ("0 0 -1", -1.0, 0.2),
        ("0 0 1", 0.5, 0.15),
        ("0 0 -1", 1.0, None),  # its end never moves
        ("0 1 0", 1.0, None),  # not along one line
    ],
)
def test_a_telescope_is_parallel_and_its_mimic_joints_are_rescaled(
    tmp_path: Path, axis: str, multiplier: float, travel: float | None
) -> None:
    limit = 'lower="0" upper="0.1" effort="6" velocity="1"'
    first = joint("slide", "prismatic", "fore", "middle", axis="0 0 1", limit=limit)
    second = joint("follower", "prismatic", "middle", "end", axis=axis, limit=limit)
    mimic = f'<mimic joint="slide" multiplier="{multiplier}"/></joint>'
    text = first + second.replace("</joint>", mimic)
    for name, leader in (("cover", "slide"), ("lid", "follower")):
        beside = joint(name, "prismatic", "base", f"{name}_link", limit=limit)
        mimic = f'<mimic joint="{leader}" multiplier="0.5" offset="0.01"/></joint>'
        text += link(f"{name}_link") + beside.replace("</joint>", mimic)
    text = TOY.replace("</robot>", link("middle") + link("end") + text + "</robot>")
    text = text.replace('<parent link="fore"/>', '<parent link="end"/>', 1)
    if travel is None:
        with pytest.raises(RobotFileError, match="'follower' of the arm follows another joint"):
            parsed(tmp_path, text)
        return
    joints = parsed(tmp_path, text).tree.joints
    assert joints["slide"].upper == pytest.approx(travel)
    for name, factor in (("cover", 0.05), ("lid", 0.05 * multiplier)):
        leader, each, offset = joints[name].mimic
        assert (leader, each * travel) == ("slide", pytest.approx(factor))
        assert offset == pytest.approx(0.01)


@pytest.mark.parametrize(("axis", "beside"), [("1 0 0", ()), ("0 0 1", ("side",))])
def test_a_slide_behind_a_fixed_joint_belongs_to_a_telescope_if_it_is_parallel(
    axis: str, beside: tuple[str, ...]
) -> None:
    limit = 'lower="0" upper="1" effort="1" velocity="1"'
    joints = [
        joint("lifts", "prismatic", "base", "lift", axis="0 0 1", limit=limit),
        joint("fixed", "fixed", "lift", "carriage", rpy="0 1.5707963 0"),
        joint("slides", "prismatic", "carriage", "side", axis=axis, limit=limit),
        joint("turns", "revolute", "lift", "hand", axis="0 0 1", limit=limit),
    ]
    links = "".join(map(link, ("base", "lift", "carriage", "side", "hand")))
    tree = make_tree(ElementTree.fromstring(f'<robot name="r">{links}{"".join(joints)}</robot>'))
    assert find_arm(tree, "base", "hand").beside[1] == beside


def test_a_very_large_mesh_is_reduced_with_the_same_hull(
    tmp_path: Path,
) -> None:
    rough = trimesh.creation.icosphere(subdivisions=7, radius=0.1)
    rough.export(tmp_path / "m.stl")
    assert len(rough.faces) > 2 * MOST_FACES
    light = read_mesh(tmp_path / "m.stl")
    assert len(light.faces) <= 1.1 * MOST_FACES
    D = np.asarray(trimesh.creation.icosphere(subdivisions=2).vertices)
    reach = [(np.asarray(m.vertices) @ D.T).max(axis=0) for m in (rough, light)]
    np.testing.assert_allclose(*reach, atol=1e-4)


@pytest.mark.parametrize(
    ("undetected", "excluded", "outcome"),
    [(0, 30, "passed"), (0, 287, "warned"), (1, 30, "failed"), (1, 287, "failed")],
)
def test_check_fails_on_an_unmonitored_collision_and_warns_of_many_exclusions(
    monkeypatch: pytest.MonkeyPatch, undetected: int, excluded: int, outcome: str
) -> None:
    from app.onboarding import check
    from app.onboarding.fit.grouping import Detection

    unseen = {("head", "arm"): 0.002, ("hand", "lift"): 0.001}
    found = Detection(
        4000, 638, undetected, 900, 0, 0.0, (), unseen, excluded, "link5 and hand (7.2%)"
    )
    monkeypatch.setattr(check, "detection_of", lambda *_: found)
    monkeypatch.setattr(check, "_geometry", lambda _: {})
    row = check.arm_row(husky_panda())
    assert row.outcome == outcome
    assert ("are of head and arm (0.20% of the postures)" in row.text) == bool(undetected)
    assert f"{excluded} other postures do not count" in row.text
    assert "link5 and hand (7.2%)" in row.text
