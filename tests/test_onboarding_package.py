"""A robot as a zip: the accepted content, and the limits of an untrusted zip."""

from __future__ import annotations

import re
import stat
import struct
import zipfile
from pathlib import Path

import pytest

from app.errors import DbbError, RobotFileError
from app.onboarding.new_robot import finish, parse
from app.onboarding.read import package as unpacking
from app.onboarding.read.package import FOLDER, open_package
from app.onboarding.request import Request
from tests.onboarding import arm, cart, cube, joint, robot, with_mesh, zipped

TOY = robot([*cart(), *arm()])
LAUGHS = (
    '<!DOCTYPE robot [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;&a;&a;">'
    '<!ENTITY c "&b;&b;&b;&b;&b;&b;&b;&b;&b;&b;">]>'
)
EXPRESSION = TOY.replace('radius="0.1"', """radius="${[].append('executed')}\"""")
XACRO = '<robot name="x" xmlns:xacro="http://www.ros.org/wiki/xacro">${open("/tmp/x", "w")}</robot>'


def special(kind: int) -> zipfile.ZipInfo:
    info = zipfile.ZipInfo("toy/meshes")
    info.external_attr = (kind | 0o777) << 16
    return info


def bad_zip(tmp_path: Path, case: str) -> Path:
    """A zip with one fault."""
    files: dict[str, str | bytes] = {"toy/toy.urdf": TOY}
    path = zipped(tmp_path, files)
    if case == "no zip":
        path.write_bytes(b"%PDF-1.7" * 100)
    elif case == "cut":
        path.write_bytes(path.read_bytes()[:-40])
    elif case == "broken":  # its directory is valid, its content is not
        content = bytearray(path.read_bytes())
        content[60:90] = bytes(30)
        path.write_bytes(content)
    elif case == "list":  # its header states more files than allowed
        content = bytearray(path.read_bytes())
        at = content.rfind(b"PK\x05\x06")
        struct.pack_into("<H", content, at + 10, 60_000)
        path.write_bytes(content)
    elif case in ("link", "device"):
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr(special(stat.S_IFLNK if case == "link" else stat.S_IFCHR), "/etc")
    elif case == "password":
        content = bytearray(path.read_bytes())
        content[content.rfind(b"PK\x01\x02") + 8] |= 1
        path.write_bytes(content)
    elif case == "lying bomb":  # megabytes of zeros, listed as one byte
        zipped(tmp_path, {"toy/toy.urdf": bytes(3_000_000)})
        content = bytearray(path.read_bytes())
        struct.pack_into("<I", content, content.rfind(b"PK\x01\x02") + 24, 1)
        path.write_bytes(content)
    elif case in ("bzip2", "lzma"):
        method = zipfile.ZIP_BZIP2 if case == "bzip2" else zipfile.ZIP_LZMA
        with zipfile.ZipFile(path, "a") as archive:
            archive.writestr("toy/m.stl", bytes(3_000_000), method)
    elif case == "zip64":  # its own record could name a longer list than the one that is read
        content = bytearray(path.read_bytes())
        at = content.rfind(b"PK\x05\x06")
        content[at:at] = struct.pack("<4sIQI", b"PK\x06\x07", 0, 0, 1)
        path.write_bytes(content)
    elif case == "name":  # marked as UTF-8, which it is not
        zipped(tmp_path, files | {"toy/\u00e4.stl": b""})
        path.write_bytes(path.read_bytes().replace("\u00e4".encode(), b"\xff\xff"))
    return path


WRONG_FILES: dict[str, tuple[dict[str, str | bytes], str]] = {
    "..": ({"../toy.urdf": TOY}, "leads out of the zip"),
    ".. inside": ({"toy/../../toy.urdf": TOY}, "leads out of the zip"),
    "absolute": ({"/tmp/toy.urdf": TOY}, "an absolute path"),
    "drive": ({"C:/toy.urdf": TOY}, "a path of Windows"),
    "backslash": ({"..\\toy.urdf": TOY}, "leads out of the zip"),
    "control": ({"toy/a\nb.urdf": TOY}, "is not a file name"),
    "long name": ({"a" * 300 + ".urdf": TOY}, "is not a file name"),
    "bomb": ({"toy.urdf": TOY, "m.stl": bytes(2_000_000)}, "expands to 2 MB; the limit is 1 MB"),
    "many": ({f"{i}.urdf": "" for i in range(30)}, "a list of 30 files"),
    "file and folder": ({"toy.urdf": TOY, "a.stl": b"", "a.stl/b.stl": b""}, "not a zip that can"),
    "nothing": ({"readme.txt": "hello"}, "no .urdf in it"),
    "two": ({"a.urdf": TOY, "b.urdf": TOY}, "name one by --file: a.urdf, b.urdf"),
    "hidden": ({"toy/.urdf": TOY, "__MACOSX/toy/a.urdf": TOY}, "no .urdf in it"),
    "xacro": ({"a.urdf.xacro": XACRO}, "a xacro can contain Python"),
    "xacro named .urdf": ({"a.urdf": EXPRESSION}, "is unexpanded xacro, which can contain Python"),
    "laughs": ({"toy.urdf": TOY.replace("<robot", LAUGHS + "<robot")}, "the XML entity 'a'"),
    "file entity": (
        {
            "toy.urdf": TOY.replace(
                "<robot", '<!DOCTYPE r [<!ENTITY p SYSTEM "file:///etc/passwd">]><robot'
            )
        },
        "the XML entity 'p'",
    ),
    "laughing mesh": (
        {"toy.urdf": with_mesh(TOY, "m.dae"), "m.dae": LAUGHS + "<COLLADA/>"},
        "m.dae: it declares",
    ),
    "mesh of another encoding": (
        {
            "toy.urdf": with_mesh(TOY, "m.dae"),
            "m.dae": '<?xml version="1.0" encoding="UTF-16"?>' + LAUGHS + "<COLLADA/>",
        },
        "m.dae: not well-formed",
    ),
    "mesh of no encoding": (
        {"toy.urdf": with_mesh(TOY, "m.dae"), "m.dae": '<?xml version="1.0" encoding="foo"?><C/>'},
        "m.dae: not well-formed",
    ),
    "mesh of many bytes": (
        {
            "toy.urdf": with_mesh(TOY, "m.dae"),
            "m.dae": '<?xml version="1.0" encoding="shift_jis"?><C/>',
        },
        "m.dae: not well-formed",
    ),
    "mesh outside": ({"u/toy.urdf": with_mesh(TOY, "../../m.stl")}, "outside of the package"),
    "mesh of the machine": ({"toy.urdf": with_mesh(TOY, "/etc/passwd")}, "outside of the package"),
    "mesh by file": ({"toy.urdf": with_mesh(TOY, "file:///etc/passwd")}, "outside of the package"),
    "mesh of a package": (
        {"toy.urdf": with_mesh(TOY, "package://pybullet_data/a.stl")},
        "no such file in the zip",
    ),
    "mesh of the net": ({"toy.urdf": with_mesh(TOY, "http://a.b/m.stl")}, "outside of the package"),
    "mesh missing": ({"toy.urdf": with_mesh(TOY, "meshes/m.stl")}, "no such file in the zip"),
    "mesh of another case": (
        {"toy.urdf": with_mesh(TOY, "Hand.STL"), "hand.stl": cube()},
        "(did you mean 'hand.stl'?)",
    ),
    "mesh in another folder": (
        {"toy.urdf": with_mesh(TOY, "package://robots/more/arm/hand.stl"), "arm/hand.stl": cube()},
        "(it has 'arm/hand.stl', but the paths differ)",
    ),
    "mesh of a NUL": ({"toy.urdf": with_mesh(TOY, "a%00.stl")}, "no such file in the zip"),
    "mesh no mesh": ({"toy.urdf": with_mesh(TOY, "m.stl"), "m.stl": b"solid"}, "m.stl"),
}


BAD_URDFS = {
    "no inertia": (re.sub(r"<inertial>.*?</inertial>", "", TOY), "--assume-inertia"),
    "mesh missing": (with_mesh(TOY, "meshes/none.stl"), "mesh meshes/none.stl: there is no"),
    "joint twice": (
        TOY.replace('<joint name="elbow"', '<joint name="lift"'),
        "2 joints have the name 'lift'",
    ),
    "square wheel": (
        robot([*cart(wheel='<box size="0.2 0.05 0.1"/>', wheel_rpy="0 0 0"), *arm()]),
        "left_axle is not a wheel",
    ),
    "millimetres": (TOY.replace('size="0.08 0.12 0.08"', 'size="80 120 80"'), "millimetres"),
    "millimetres between": (TOY.replace('xyz="0.15 0 0.1"', 'xyz="150 0 100"'), "millimetres"),
    "two parents": (
        robot([*cart(), *arm(), joint("rod", "revolute", "fore", "shoulder")]),
        "closed chain",
    ),
    "a ring": (robot([*cart(), *arm(), joint("ring", "fixed", "hand", "base")]), "closed chain"),
    "no number": (TOY.replace('xyz="0.15 0 0.1"', 'xyz="0.15 nan 0.1"'), "should be 3 numbers"),
    "not XML": (TOY[:-20], "not well-formed"),
    "another format": ("<sdf/>", "a URDF's is <robot>"),
    "laughs": (TOY.replace("<robot", LAUGHS + "<robot"), "the XML entity 'a'"),
    **{
        f"laughs in {encoding}": (
            TOY.replace('"1.0"?>', f'"1.0" encoding="{encoding}"?>' + LAUGHS),
            why,
        )
        for encoding, why in (
            ("UTF-16", "the XML entity 'a'"),
            ("foo", "unknown encoding: foo; save it as UTF-8"),
            ("shift_jis", "the XML entity 'a'"),
        )
    },
}


@pytest.mark.parametrize("case", BAD_URDFS)
def test_bad_urdf_is_refused_alike_as_a_file_and_in_a_zip(case: str, tmp_path: Path) -> None:
    text, why = BAD_URDFS[case]
    assert text != TOY
    path = zipped(tmp_path, {"toy.urdf": text})
    assert why in refused(tmp_path, path)
    path.unlink()
    (tmp_path / "toy.urdf").write_text(text, encoding="utf-8")
    with pytest.raises(DbbError) as caught:
        finish(Request(str(tmp_path / "toy.urdf"), base="base", tip="hand", out=tmp_path / "made"))
    assert why in str(caught.value)
    assert [p.name for p in tmp_path.iterdir()] == ["toy.urdf"]


def refused(tmp_path: Path, archive: Path) -> str:
    """The message with which a zip is refused; check that no other file remains."""
    with pytest.raises(DbbError) as caught:
        finish(Request(urdf=str(archive), base="base", tip="hand", out=tmp_path / "made"))
    assert [p.name for p in tmp_path.iterdir()] == ["toy.zip"]
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("case", WRONG_FILES)
def test_zip_with_wrong_files_is_refused_and_leaves_no_file(
    case: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files, why = WRONG_FILES[case]
    monkeypatch.setattr(unpacking, "LARGEST_CONTENT", 1_000_000)
    monkeypatch.setattr(unpacking, "MOST_FILES", 20)
    inner = tmp_path / "inner"  # a file outside of it would be in tmp_path
    inner.mkdir()
    assert why in refused(inner, zipped(inner, files))
    assert [p.name for p in tmp_path.iterdir()] == ["inner"]


@pytest.mark.parametrize(
    ("case", "why"),
    [
        ("no zip", "not a zip"),
        ("cut", "not a zip"),
        ("broken", "not a zip that can be read"),
        ("list", "a list of 60000 files"),
        ("link", "a link or a device"),
        ("device", "a link or a device"),
        ("password", "locked by a password"),
        ("lying bomb", "not a zip that can be read"),
        ("bzip2", "another method than deflate"),
        ("lzma", "another method than deflate"),
        ("zip64", "a ZIP64"),
        ("name", "not a zip that can be read"),
    ],
)
def test_invalid_or_manipulated_zip_is_refused(case: str, why: str, tmp_path: Path) -> None:
    assert why in refused(tmp_path, bad_zip(tmp_path, case))


def test_zip_that_is_too_large_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = zipped(tmp_path, {"toy.urdf": TOY})
    monkeypatch.setattr(unpacking, "LARGEST_ARCHIVE", path.stat().st_size - 1)
    assert "MB; the limit is" in refused(tmp_path, path)


@pytest.mark.parametrize(
    ("urdf", "mesh", "reference"),
    [
        ("toy.urdf", "meshes/m.stl", "meshes/m.stl"),
        ("toy/urdf/toy.urdf", "toy/meshes/m.stl", "../meshes/m.stl"),
        ("toy/urdf/toy.urdf", "toy/meshes/m.stl", "package://toy/meshes/m.stl"),
        ("ws/src/toy/toy.urdf", "ws/src/other/m.stl", "package://other/m.stl"),
        ("urdf/toy.urdf", "meshes/m.stl", "package://whatever/meshes/m.stl"),
        ("toy-main/urdf/toy.urdf", "toy-main/meshes/m.stl", "package://toy/meshes/m.stl"),
        ("toy\\urdf\\toy.urdf", "toy\\meshes\\m.stl", "package://toy/meshes/m.stl"),
    ],
)
def test_package_is_read_with_its_meshes_in_any_folder(
    urdf: str, mesh: str, reference: str, tmp_path: Path
) -> None:
    """A zip that was made inside the package's folder does not contain the package's name."""
    folders = {name: b"" for name in (urdf.removesuffix("toy.urdf"),) if name}
    files = {urdf: with_mesh(TOY, reference), mesh: cube(), "setup.py": "raise SystemExit"}
    path = zipped(tmp_path, folders | files)
    found = open_package(path, tmp_path / "made")
    parsed = parse(Request(urdf=str(found), base="base", tip="hand", out=tmp_path / "toy"))
    assert parsed.geometry["hand"].volume == pytest.approx(0.08 * 0.12 * 0.08, rel=1e-5)
    assert not list(tmp_path.rglob("setup.py"))


def test_files_that_macos_adds_to_a_zip_are_ignored(tmp_path: Path) -> None:
    path = zipped(
        tmp_path,
        {"toy/toy.urdf": TOY, "toy/._toy.urdf": b"\x00", "__MACOSX/toy/._toy.urdf": b"\x00"},
    )
    assert open_package(path, tmp_path / "made").name == "toy.urdf"


def test_requested_urdf_of_a_zip_is_used(tmp_path: Path) -> None:
    path = zipped(tmp_path, {"a.urdf": TOY, "b/b.urdf": TOY.replace('name="toy"', 'name="b"')})
    found = open_package(path, tmp_path / "made", "b/b.urdf")
    assert found.relative_to(tmp_path / "made" / FOLDER) == Path("b/b.urdf")
    with pytest.raises(
        RobotFileError, match=r"no URDF 'c\.urdf' in it; there are: a\.urdf, b/b\.urdf"
    ):
        open_package(path, tmp_path / "other", "c.urdf")
