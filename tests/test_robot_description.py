"""An invalid description is refused with file, field and the valid values."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from xml.etree import ElementTree

import pytest
import trimesh

from app.errors import AssetError, DescriptionError, RobotFileError, UnknownNameError
from app.robot import assets
from app.robot.assets import resolve_package_uri, resolved_urdf, robot_names, shown_urdf
from app.robot.bases import kind
from app.robot.description import load_description, load_robot
from app.robot.model import RobotModel
from app.simulation.plants.collision_shapes import collision_shapes
from app.strict import from_toml

ORIGINAL = from_toml((assets.ASSETS / "husky_panda/robot.toml").read_text(encoding="utf-8"))


def toml(value: object) -> str:
    """A value as inline TOML."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{k} = {toml(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    return json.dumps(value, ensure_ascii=False)


@pytest.fixture
def write(tmp_path):
    """Return a function that writes the paper's description with one change."""

    def write(change: Callable[[dict], object] = lambda data: None):
        data = copy.deepcopy(ORIGINAL)
        change(data)
        path = tmp_path / "robot.toml"
        path.write_text("".join(f"{k} = {toml(v)}\n" for k, v in data.items()), encoding="utf-8")
        return path

    return write


def test_rewritten_description_equals_the_original(write):
    assert load_description(write()) == load_robot("husky_panda")


def test_the_former_link_of_the_base_is_accepted_with_one_line(write, caplog):
    kind._tell_of_link.cache_clear()
    path = write(lambda d: d["base"].update(link="anything"))
    for _ in range(2):
        assert load_description(path) == load_robot("husky_panda")
    assert caplog.messages == ["base.link of robot.toml has no effect; remove this line"]


REFUSED = {
    "missing": (lambda d: d["base"].pop("mass_kg"), ["base.mass_kg: missing"]),
    "misspelt": (
        lambda d: d["base"].update(wheel_radus_m=d["base"].pop("wheel_radius_m")),
        ["base.wheel_radus_m", "did you mean 'wheel_radius_m'", "base.wheel_radius_m: missing"],
    ),
    "misspelt section": (
        lambda d: d.update(reachabilty=d.pop("reachability")),
        ["reachabilty", "did you mean 'reachability'"],
    ),
    "misspelt in a shape": (
        lambda d: d["bodies"][0]["shapes"][0].update(xyz=[0, 0, 0]),
        ["bodies[0].shapes[0]", "xyz", "did you mean 'xyz_m'"],
    ),
    "not positive": (
        lambda d: d["base"].update(mass_kg=-1.0),
        ["base.mass_kg", "greater than 0", "-1.0"],
    ),
    "wrong type": (
        lambda d: d["base"].update(mass_kg="heavy"),
        ["base.mass_kg", "number", "heavy"],
    ),
    "other base": (lambda d: d["base"].update(kind="car"), ["base.kind", "differential", "car"]),
    "too few limits": (
        lambda d: d["arm"].update(position_lower=[0.0]),
        ["arm", "position_lower", "needs 7 numbers", "has 1"],
    ),
    "too many damping values": (
        lambda d: d["arm"].update(joint_damping=[1.0] * 8),
        ["arm", "joint_damping", "needs 7 numbers", "has 8"],
    ),
    "joint named twice": (
        lambda d: d["arm"].update(joints=[d["arm"]["joints"][0]] * 7),
        ["arm", "joints", "twice"],
    ),
    "number without a source": (
        lambda d: d["base"]["source"].pop("mass_kg"),
        ["base", "source", "mass_kg"],
    ),
    "limits without a source": (
        lambda d: d["arm"]["source"].pop("max_effort"),
        ["arm", "source", "max_effort"],
    ),
    "source of nothing": (
        lambda d: d["base"]["source"].update(colour="red"),
        ["base", "source", "unknown fields: colour"],
    ),
    "body named twice": (lambda d: d["bodies"][2].update(name="l1"), ["bodies", "twice"]),
    "body with a bad name": (
        lambda d: d["bodies"][2].update(name="l-2"),
        ["bodies[2].name", "l-2"],
    ),
    "unknown shape": (
        lambda d: d["bodies"][1]["shapes"][0].update(type="cone"),
        ["bodies[1].shapes[0]", "cone", "capsule"],
    ),
    "parameter out of range": (
        lambda d: d.update(config={"border": {"d_b": 0.5}}),
        ["config.border.d_b: must be within 0.05 to 0.3 m (was 0.5)"],
    ),
    "no such parameter": (
        lambda d: d.update(config={"border": {"d_bb": 0.1}}),
        ["config.border.d_bb", "did you mean 'd_b'"],
    ),
    "no section of parameters": (
        lambda d: d.update(config={"border": 0.1}),
        ["config.border: must be a section of parameters (was 0.1)"],
    ),
    "reachability of nobody": (
        lambda d: d["reachability"].update(hand=d["reachability"]["l3"]),
        ["reachability", "hand", "lEE"],
    ),
    "nested with no link of another": (
        lambda d: d["bodies"][3].update(nested={"panda_link5": ["panda_link0", "elbow"]}),
        ["bodies.l3.nested: elbow", "that other bodies cover"],
    ),
    "nested link of another": (
        lambda d: d["bodies"][3].update(nested={"panda_link0": ["base_link"]}),
        ["bodies.l3.nested: panda_link0", "that this body covers"],
    ),
}


@pytest.mark.parametrize(("change", "expected"), REFUSED.values(), ids=REFUSED.keys())
def test_invalid_field_is_named_with_its_valid_values(write, change, expected):
    path = write(change)
    with pytest.raises(DescriptionError) as refusal:
        load_description(path)
    message = str(refusal.value)
    for part in (str(path), *expected):
        assert part in message
    assert "\n" not in message


@pytest.mark.parametrize("value", ["nan", "inf", "-inf"])
def test_a_number_must_be_finite(write, value):
    path = write()
    text = path.read_text(encoding="utf-8")
    path.write_text(text.replace("mass_kg = 60.0", f"mass_kg = {value}"), encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"base\.mass_kg"):
        load_description(path)


def test_a_missing_or_broken_file_is_named(tmp_path):
    with pytest.raises(DescriptionError, match=r"none\.toml: no such description"):
        load_description(tmp_path / "none.toml")
    (tmp_path / "bad.toml").write_text("name = [", encoding="utf-8")
    with pytest.raises(DescriptionError, match=r"bad\.toml: not a TOML file"):
        load_description(tmp_path / "bad.toml")
    (tmp_path / "binary.toml").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(DescriptionError, match=r"binary\.toml: not a TOML file"):
        load_description(tmp_path / "binary.toml")
    with pytest.raises(DescriptionError, match="cannot be read: Is a directory"):
        load_description(tmp_path)


def test_unknown_robot_is_refused_with_the_valid_names():
    with pytest.raises(UnknownNameError) as refusal:
        load_robot("husky_pand")
    assert "did you mean 'husky_panda'" in str(refusal.value)
    assert refusal.value.choices == robot_names()
    with pytest.raises(UnknownNameError):
        load_robot("../robot_assets/husky_panda")


UNFIT = {
    "joint": (
        lambda d: d["arm"]["joints"].__setitem__(3, "panda_joint9"),
        ["arm.joints", "'panda_joint9'", "panda_joint4"],
    ),
    "order of joints": (
        lambda d: d["arm"].update(joints=d["arm"]["joints"][::-1]),
        ["arm.joints", "order", "panda_joint1, panda_joint2"],
    ),
    "wheel": (
        lambda d: d["base"].update(left_wheel_joints=["left"]),
        ["base.left_wheel_joints", "'left'", "front_left_wheel"],
    ),
    "hand": (
        lambda d: d["arm"].update(end_effector_link="hand"),
        ["arm.end_effector_link", "'hand'", "panda_hand"],
    ),
    "mount": (lambda d: d["arm"].update(mount_link="m"), ["arm.mount_link", "'m'", "panda_link0"]),
    "frame of a body": (
        lambda d: d["bodies"][3].update(frame="elbow"),
        ["bodies.l3.frame", "'elbow'", "panda_link5"],
    ),
    "covered link": (
        lambda d: d["bodies"][3]["covers"].append("elbow"),
        ["bodies.l3.covers", "'elbow'", "panda_link5"],
    ),
    "crossed limits": (
        lambda d: d["arm"]["position_lower"].__setitem__(0, 2.9),
        ["panda_joint1", "2.9", "not below"],
    ),
    "ready outside of the limits": (
        lambda d: d["arm"]["ready_position"].__setitem__(3, 0.5),
        ["arm.ready_position", "panda_joint4", "0.5", "-0.0698"],
    ),
}


@pytest.mark.parametrize(("change", "expected"), UNFIT.values(), ids=UNFIT.keys())
def test_description_that_contradicts_the_urdf_is_refused(write, change, expected):
    description = load_description(write(change))
    with pytest.raises(DescriptionError) as refusal:
        RobotModel(description)
    for part in ("husky_panda/robot.toml", *expected):
        assert part in str(refusal.value)
    assert "\n" not in str(refusal.value)


@pytest.fixture
def with_urdf(tmp_path, monkeypatch):
    """Return a function that gives the paper's robot a changed URDF in a new asset folder."""

    def make(change: Callable[[str], str] | None):
        folder = tmp_path / "husky_panda"
        folder.mkdir()
        text = (assets.ASSETS / "husky_panda/robot.urdf").read_text(encoding="utf-8")
        if change is not None:
            (folder / "robot.urdf").write_text(change(text), encoding="utf-8")
        description = load_robot("husky_panda")
        monkeypatch.setattr(assets, "ASSETS", tmp_path)
        return description

    return make


def test_a_missing_urdf_is_named(with_urdf):
    with pytest.raises(AssetError, match=r"husky_panda: the URDF .*robot\.urdf does not exist"):
        RobotModel(with_urdf(None))


def test_a_missing_mesh_is_named(with_urdf):
    pytest.importorskip("pybullet_data")
    description = with_urdf(lambda text: text.replace("top_plate.stl", "roof.stl"))
    with pytest.raises(AssetError, match=r"roof\.stl: no such file in the installed package"):
        resolved_urdf(description)
    RobotModel(description)  # the model needs shapes, not meshes


ALL = slice(None)
POINTER = b"version https://git-lfs.github.com/spec/v1\noid sha256:00\nsize 1\n"


@pytest.mark.parametrize(
    ("kind", "part", "why"),
    [
        ("stl", ALL, ""),
        ("stl_ascii", ALL, ""),
        ("obj", ALL, ""),
        ("obj", lambda content: b"mtllib a.mtl\n" + content.replace(b"\n", b"\r\n"), ""),
        ("stl", slice(200), "is damaged"),
        ("stl", slice(-1), "is damaged"),
        ("stl", lambda content: bytes(len(content)), "is damaged"),
        ("stl_ascii", slice(200), "is damaged"),
        ("obj", slice(60), "is damaged"),
        ("obj", slice(-60), "is damaged"),
        ("obj", slice(0), "is an empty file"),
        ("obj", lambda _: POINTER, "is a Git LFS pointer"),
        ("obj", lambda content: content + b"f 1 2 99\n", "copy or export this mesh again"),
    ],
)
def test_a_damaged_mesh_is_refused_in_one_line(with_urdf, tmp_path, kind, part, why):
    """It is not replaced by the convex bodies, unlike a missing one, and logs leave it out."""
    pytest.importorskip("pybullet_data")
    address, name = "package://pybullet_data/husky/meshes/top_plate.stl", f"m.{kind[:3]}"
    boxes = trimesh.Scene([trimesh.creation.box((0.1, 0.1, z)) for z in (0.1, 0.2)])
    if kind == "obj":
        content = boxes.export(file_type=kind, header="dbb: 24 faces").encode()
    else:
        found = boxes.to_mesh().export(file_type=kind)
        content = found.encode() if isinstance(found, str) else found
    description = with_urdf(lambda text: text.replace(address, name))
    (tmp_path / "husky_panda" / name).write_bytes(
        content[part] if isinstance(part, slice) else part(content)
    )
    if not why:
        assert name in shown_urdf(description)
        assert len(collision_shapes(RobotModel(description)).shapes)
        return
    with pytest.raises(RobotFileError, match=f"{name}.*{why}") as caught:
        collision_shapes(RobotModel(description))
    assert "\n" not in str(caught.value)
    assert (name in shown_urdf(description)) == ("this mesh" in why)


def test_a_urdf_that_is_not_xml_is_named(with_urdf):
    with pytest.raises(DescriptionError, match=r"robot\.urdf: not well-formed"):
        RobotModel(with_urdf(lambda text: text[:-20]))


def test_a_urdf_without_links_is_refused(with_urdf):
    description = with_urdf(lambda text: '<robot name="nothing"/>')
    with pytest.raises(DescriptionError, match="pinocchio cannot read it"):
        RobotModel(description)


def test_continuous_arm_joint_is_refused_with_an_alternative(with_urdf):
    def change(text):
        head, tail = text.split('<joint name="panda_joint7" type="revolute">')
        return head + '<joint name="panda_joint7" type="continuous">' + tail

    with pytest.raises(DescriptionError, match="write a continuous joint as revolute"):
        RobotModel(with_urdf(change))


@pytest.mark.parametrize(
    "uri",
    [
        "package://pybullet_data/../pybullet_data/husky/husky.urdf/../../../os.py",
        "package://pybullet_data/../pydantic/__init__.py",
        "package://pybullet_data//etc/passwd",
        "package://pybullet_data/..",
        "package://../etc/passwd",
        "package:///etc/passwd",
        "package://pybullet_data",
        "package://no_such_package_at_all/x.stl",
        "package://sys/x.stl",
        "package://pybullet_data/husky",
        "file:///etc/passwd",
        "/etc/passwd",
        "",
    ],
)
def test_package_uri_cannot_leave_its_package(uri):
    with pytest.raises(AssetError):
        resolve_package_uri(uri)


def test_package_uri_finds_its_file():
    path = resolve_package_uri("package://pybullet_data/husky/meshes/top_plate.stl")
    assert path.is_file()
    assert path.parts[-3:] == ("husky", "meshes", "top_plate.stl")


def test_resolved_urdf_contains_no_package_uri():
    assert "package://" not in resolved_urdf(load_robot("husky_panda"))


def test_mesh_paths_are_resolved_with_any_quotes_and_escapes(tmp_path, monkeypatch):
    folder = tmp_path / "you & me"
    folder.mkdir()
    (folder / "a & b.stl").write_text("solid a\nendsolid a\n")
    (folder / "robot.urdf").write_text(
        "<robot name='r'><!-- <mesh filename=\"none.stl\"/> --><link name='a'><visual><geometry>"
        "<mesh filename='a &amp; b.stl'/></geometry></visual></link></robot>",
        encoding="utf-8",
    )
    monkeypatch.setattr(assets, "urdf_path", lambda description: folder / "robot.urdf")
    tree = ElementTree.fromstring(resolved_urdf(load_robot("husky_panda")))
    assert [mesh.get("filename") for mesh in tree.iter("mesh")] == [str(folder / "a & b.stl")]
    assert tree.find("link/inertial/mass") is not None
