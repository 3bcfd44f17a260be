"""Parsing of a URDF; each error gives one clear message before a file is written."""

from __future__ import annotations

import errno
import os
import re
import time
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from app.errors import DbbError, RobotFileError
from app.onboarding import new_robot
from app.onboarding.fit.travel import filled
from app.onboarding.new_robot import finish, parse
from app.onboarding.numbers import assumed_mass
from app.onboarding.read.links import read_geometry, read_mesh
from app.onboarding.read.tree import make_tree
from app.onboarding.request import Request
from app.onboarding.warn import held_still, wheels_carried
from app.onboarding.whole import whole_robot
from app.onboarding.write import compiled, description, rebased_urdf
from app.robot.model import RobotModel
from app.simulation.plants.collision_shapes import collision_shapes
from app.simulation.plants.planar import SAME_PICTURE, compare_engines
from tests.onboarding import (
    ARM_JOINTS,
    BOX,
    INERTIAL,
    WHEEL,
    arm,
    cart,
    cube,
    joint,
    link,
    robot,
    solid,
    with_mesh,
    write,
)

TOY = robot([*cart(), *arm()])


def request(tmp_path: Path, text: str, **changes: object) -> Request:
    path = write(tmp_path, text)
    given = {"urdf": str(path), "base": "base", "tip": "hand", "out": tmp_path / "made"}
    return Request(**(given | changes))


def refused(tmp_path: Path, text: str, **changes: object) -> str:
    """The one-line message of a refused robot; no file may remain."""
    with pytest.raises(DbbError) as caught:
        finish(request(tmp_path, text, **changes))
    assert sorted(p.name for p in tmp_path.iterdir()) == ["toy.urdf"]
    assert "\n" not in str(caught.value)
    return str(caught.value)


def test_wheel_radius_track_and_floor_point_are_read_from_the_urdf(tmp_path: Path) -> None:
    parsed = parse(request(tmp_path, TOY))
    wheels = parsed.wheels
    assert (wheels.left, wheels.right) == (("left_axle",), ("right_axle",))
    assert wheels.r == pytest.approx(0.1)
    assert wheels.b == pytest.approx(0.2)
    np.testing.assert_allclose(wheels.T_base_floor.translation, [0.05, 0.0, -0.15], atol=1e-9)
    np.testing.assert_allclose(wheels.T_base_floor.rotation, np.eye(3), atol=1e-9)


def test_a_base_with_its_axle_along_x_gets_a_frame_that_faces_forward(tmp_path: Path) -> None:
    """The same robot with its base link turned by 90°; the wheels define the forward direction."""
    turned = TOY.replace('xyz="0.05 0.2 -0.05"', 'xyz="-0.2 0.05 -0.05"')
    turned = turned.replace('xyz="0.05 -0.2 -0.05"', 'xyz="0.2 0.05 -0.05"')
    turned = turned.replace(
        '<axis xyz="0 1 0"/><limit effort="20"', '<axis xyz="1 0 0"/><limit effort="20"'
    )
    turned = turned.replace('rpy="1.5708 0 0"', 'rpy="0 1.5708 0"')
    wheels = parse(request(tmp_path, turned)).wheels
    np.testing.assert_allclose(wheels.T_base_floor.rotation @ [1, 0, 0], [0, 1, 0], atol=1e-9)
    assert wheels.left == ("left_axle",)


def test_the_arm_has_the_moving_joints_between_base_and_tip(tmp_path: Path) -> None:
    found = parse(request(tmp_path, TOY)).arm
    assert tuple(j.name for j in found.joints) == ARM_JOINTS
    assert found.mount == "column"
    assert found.segments[0] == ("column",)
    assert set(found.base_links) == {"base", "left_wheel", "right_wheel"}


def test_links_between_the_base_frame_and_the_first_joint_are_the_base(tmp_path: Path) -> None:
    """`--base` is a footprint without geometry, the parent of the base itself."""
    footprint = [link("footprint"), joint("stands", "fixed", "footprint", "base", xyz="0 0 0.15")]
    first = 'name="pan" type="revolute"><parent link="column"/>'
    assert first in TOY
    urdf = TOY.replace(first, first.replace("column", "base"))
    urdf = urdf.replace("</robot>", "".join(footprint) + "</robot>")
    found = parse(request(tmp_path, urdf, base="footprint")).arm
    assert {"base", "left_wheel", "right_wheel", "column"} <= set(found.base_links)
    assert found.mount == "shoulder"
    assert not found.segments[0]


def test_fingers_beside_the_chain_belong_to_their_parent_link(tmp_path: Path) -> None:
    finger = [
        link("finger", solid('<box size="0.01 0.01 0.05"/>', mass=0.05)),
        joint("grip", "prismatic", "wrist_link", "finger", xyz="0 0.02 0.1"),
    ]
    found = parse(request(tmp_path, robot([*cart(), *arm(), *finger]))).arm
    assert tuple(j.name for j in found.joints) == ARM_JOINTS
    assert "finger" in found.segments[5]


def suspended(*, travel: float) -> str:
    """The toy with each wheel on a slide of `travel` [m]."""
    limit = f'lower="{-travel / 2}" upper="{travel / 2}" effort="100" velocity="1"'
    parts = []
    for part in cart():
        if "_axle" in part:
            side = "left" if "left" in part else "right"
            parts += [link(f"{side}_slide")]
            parts += [joint(f"{side}_spring", "prismatic", "base", f"{side}_slide", limit=limit)]
            part = part.replace('<parent link="base"/>', f'<parent link="{side}_slide"/>')
        parts.append(part)
    return robot([*parts, *arm()])


def test_wheels_on_suspensions_are_found_like_rigid_wheels(tmp_path: Path) -> None:
    plain, slides = (parse(request(tmp_path, text)) for text in (TOY, suspended(travel=0.01)))
    assert slides.wheels[:4] == plain.wheels[:4]
    assert {"left_slide", "right_slide"} < set(slides.arm.rigid_links)
    given = request(tmp_path, suspended(travel=0.01), wheels=("left_axle", "right_axle"))
    assert parse(given).wheels[:4] == plain.wheels[:4]


def test_joints_treated_as_rigid_are_reported_except_above_the_base(
    tmp_path: Path,
) -> None:
    slide = joint("slide", "prismatic", "world", "base", limit='lower="-1e6" upper="1e6"')
    floating = robot([*cart(), *arm(), link("world"), slide])
    legged = robot([*cart(), *arm(), link("leg"), joint("knee", "revolute", "base", "leg")])
    texts = (suspended(travel=0.01), floating, legged)
    reported = [list(held_still(parse(request(tmp_path, text)))) for text in texts]
    assert reported[0][0].endswith("count as rigid on a level floor: left_spring, right_spring")
    assert len(reported[0]) == 1
    assert reported[1] == []
    assert [each.rpartition(": ")[2] for each in reported[2]] == ["knee"]


def rocking(*, xs: tuple[float, ...], axis: str) -> str:
    """The robot with a rocking beam on each side, with wheels at `xs` [m]; `axis` is the beam's."""
    parts = [link("base", solid('<box size="0.6 0.4 0.2"/>', mass=30))]
    for side, y in (("left", 0.2), ("right", -0.2)):
        parts += [link(f"{side}_beam", solid('<box size="0.3 0.02 0.02"/>'))]
        turn = {"xyz": f"0 {y} -0.05", "axis": axis, "limit": 'lower="-0.4" upper="0.4"'}
        parts += [joint(f"{side}_rocker", "revolute", "base", f"{side}_beam", **turn)]
        for k, x in enumerate(xs):
            name = f"{side}_wheel_{k}"
            parts += [link(name, solid(WHEEL, rpy="1.5708 0 0"))]
            place = {"xyz": f"{x} 0 0", "axis": "0 1 0", "limit": 'effort="20" velocity="12"'}
            parts += [joint(f"{name}_axle", "continuous", f"{side}_beam", name, **place)]
    return robot([*parts, *arm()])


@pytest.mark.parametrize(
    ("xs", "axis", "found"),
    [
        ((-0.15, 0.15), "0 1 0", True),
        ((0.15, 0.25), "0 1 0", False),  # a swing arm, which the robot's weight turns
        ((-0.15, 0.15), "0 0 1", False),  # a steered truck
    ],
)
def test_wheels_on_rockers_are_found_like_rigid_wheels(
    xs: tuple[float, ...], axis: str, found: bool, tmp_path: Path
) -> None:
    text = rocking(xs=xs, axis=axis)
    led = '<child link="right_beam"/>'
    text = text.replace(led, f'{led}<mimic joint="left_rocker" multiplier="-1"/>')
    if found:
        parsed = parse(request(tmp_path, text))
        assert parsed.wheels.left == ("left_wheel_0_axle", "left_wheel_1_axle")
        assert (parsed.wheels.r, parsed.wheels.b) == pytest.approx((0.1, 0.2))
        assert "left_rocker, right_rocker" in next(held_still(parsed))
    else:
        assert "no pair of wheels" in refused(tmp_path, text)


def test_a_slide_as_long_as_a_wheel_is_no_suspension(tmp_path: Path) -> None:
    reported = refused(tmp_path, suspended(travel=0.06))
    assert "no pair of wheels" in reported
    assert "left_axle hangs on left_spring, which moves by 0.06 m: too far for a spring" in reported
    assert "--kind holonomic" in reported  # for a base with one fork for each wheel


def test_joints_of_the_arm_are_no_reason_for_missing_wheels(tmp_path: Path) -> None:
    text = TOY.replace('type="continuous"', 'type="fixed"').replace('"revolute"', '"continuous"')
    assert "(no joint turns without limits)" in refused(tmp_path, text)


def test_the_option_for_wheels_requires_wheels_of_the_base(tmp_path: Path) -> None:
    for given, why in (
        (("lift", "right_axle"), "not on the base"),
        (("nothing", "right_axle"), "no joint or link 'nothing'"),
        (("left_axle", "left_axle"), "not two equal wheels on one axle"),
        (("turn_table", "right_axle"), "'turn_table' is not on the base"),
    ):
        above = [link("map"), joint("turn_table", "continuous", "map", "base")]
        assert why in refused(tmp_path, robot([*above, *cart(), *arm()]), wheels=given)


def test_a_wheel_that_is_not_round_is_refused(tmp_path: Path) -> None:
    square = robot([*cart(wheel='<box size="0.2 0.05 0.1"/>', wheel_rpy="0 0 0"), *arm()])
    reported = refused(tmp_path, square, wheels=("left_axle", "right_axle"))
    assert "left_axle is not a wheel" in reported
    assert "not round" in reported
    assert "--wheels LEFT RIGHT" in refused(tmp_path, square)


TYRE = '<mesh filename="tyre.stl"/>'
HUB = '<cylinder radius="0.03" length="0.06"/>'


@pytest.mark.parametrize(
    ("shapes", "rpy", "r"),
    [
        ([WHEEL], "1.5708 0 0", 0.1),
        ([TYRE, HUB], "1.5708 0 0", 0.1),
        ([HUB, TYRE], "1.5708 0 0", 0.1),
        (['<sphere radius="0.1"/>', HUB], "0 0 0", 0.1),
        ([WHEEL], "1.7 0 0", 0.1),  # a camber
        ([WHEEL], "0 0 0", None),  # its axis is not the joint's
        (['<box size="0.2 0.2 0.04"/>', '<sphere radius="0.01"/>'], "1.5708 0 0", None),
    ],
)
@pytest.mark.parametrize("fixed", [False, True])
def test_the_radius_of_a_wheel_is_the_largest_about_its_axis(
    shapes: list[str], rpy: str, r: float | None, fixed: bool, tmp_path: Path
) -> None:
    """The shapes may be on links that are fixed to the wheel and have other frames."""
    tyre = trimesh.creation.cylinder(radius=0.1, height=0.04, sections=64)
    tyre.export(tmp_path / "tyre.stl")
    parts = cart()
    for side in ("left", "right"):
        at = "0 0 0" if fixed else rpy
        content = "".join(
            solid(shape, rpy=at, mass=float(k == 0)) for k, shape in enumerate(shapes)
        )
        k = next(k for k, part in enumerate(parts) if f'<link name="{side}_wheel"' in part)
        parts[k] = link(f"{side}_wheel", "" if fixed else content)
        if fixed:
            parts.append(link(f"{side}_tyre", content))
            parts.append(joint(f"{side}_rim", "fixed", f"{side}_wheel", f"{side}_tyre", rpy=rpy))
    text = robot([*parts, *arm()])
    if r is None:
        with pytest.raises(RobotFileError, match="is not round about its axis"):
            parse(request(tmp_path, text))
        return
    wheels = parse(request(tmp_path, text)).wheels
    assert wheels.r == pytest.approx(r)
    assert wheels.T_base_floor.translation[2] == pytest.approx(-0.05 - r)


def car(front: str = WHEEL, height: float = -0.05) -> list[str]:
    """A base with two driven and two steered wheels; `front` is the shape of the steered ones."""
    parts = [part.replace('xyz="0.05 ', 'xyz="-0.2 ') for part in cart()]
    for side, y in (("left", 0.2), ("right", -0.2)):
        parts += [link(f"{side}_knuckle"), link(f"{side}_front", solid(front, rpy="1.5708 0 0"))]
        steer = {"xyz": f"0.2 {y} {height}", "limit": 'lower="-0.5" upper="0.5" effort="5"'}
        roll = {"axis": "0 1 0", "limit": 'effort="20" velocity="12"'}
        parts += [joint(f"{side}_steer", "revolute", "base", f"{side}_knuckle", **steer)]
        parts += [joint(f"{side}_roll", "continuous", f"{side}_knuckle", f"{side}_front", **roll)]
    return parts


@pytest.mark.parametrize(
    ("place", "shape"),
    [
        (None, ""),
        ("-0.1 0 0.3", BOX),  # a camera
        ("0.2 0 0.3", BOX),
        ("0 0 0.3", '<cylinder radius="0.04" length="0.1"/>'),  # a round shoulder
        ("0 0 -0.11", BOX),  # near the floor, but not round
    ],
)
def test_only_wheels_on_the_floor_count_as_steered(
    place: str | None, shape: str, tmp_path: Path
) -> None:
    parts = car()
    if place:
        turned = solid(shape, rpy="1.5708 0 0")
        parts += [link("pan_link"), link("tilt_link", turned)]
        parts += [joint("look", "revolute", "base", "pan_link", xyz=place)]
        parts += [joint("tilt", "revolute", "pan_link", "tilt_link", axis="0 1 0")]
    made = parse(request(tmp_path, robot([*parts, *arm()]), kind="car-like"))
    steering = made.wheels.steering
    assert steering is not None
    assert steering.joints == ("left_steer", "right_steer")
    assert steering.rolling == ("left_roll", "right_roll")
    assert steering.numbers["wheelbase_m"][0] == pytest.approx(0.4)
    assert any("look" in each for each in held_still(made)) is (place is not None)


@pytest.mark.parametrize(
    ("front", "height"),
    [(BOX, -0.05), (WHEEL, -0.02), ('<cylinder radius="0.07" length="0.04"/>', -0.05)],
)
def test_steered_links_count_if_none_of_them_is_a_wheel_on_the_floor(
    front: str, height: float, tmp_path: Path
) -> None:
    made = parse(request(tmp_path, robot([*car(front, height), *arm()]), kind="car-like"))
    assert made.wheels.steering is not None
    assert made.wheels.steering.joints == ("left_steer", "right_steer")


def test_a_wheel_with_a_vertical_axle_is_refused(tmp_path: Path) -> None:
    upright = TOY.replace(
        '<axis xyz="0 1 0"/><limit effort="20"', '<axis xyz="0 0 1"/><limit effort="20"'
    )
    assert "not horizontal" in refused(tmp_path, upright, wheels=("left_axle", "right_axle"))


def test_wheel_pairs_of_two_sizes_require_the_option_for_wheels(tmp_path: Path) -> None:
    """A second, smaller pair on the same floor; the option selects the driven pair."""
    second = []
    for name, y in (("fl", 0.2), ("fr", -0.2)):
        second.append(
            link(name, solid('<cylinder radius="0.05" length="0.03"/>', rpy="1.5708 0 0"))
        )
        second.append(
            joint(
                f"{name}_axle",
                "continuous",
                "base",
                name,
                axis="0 1 0",
                xyz=f"0.25 {y} -0.1",
                limit='effort="1" velocity="1"',
            )
        )
    text = robot([*cart(), *second, *arm()])
    assert "pairs of different radius" in refused(tmp_path, text)
    wheels = parse(request(tmp_path, text, wheels=("left_axle", "right_axle"))).wheels
    assert wheels.left == ("left_axle",)


def test_a_duplicate_joint_name_is_refused(tmp_path: Path) -> None:
    twice = TOY.replace('<joint name="elbow"', '<joint name="lift"')
    assert "2 joints have the name 'lift'" in refused(tmp_path, twice)


def test_a_closed_chain_is_refused(tmp_path: Path) -> None:
    rod = joint("rod", "revolute", "fore", "shoulder")
    reported = refused(tmp_path, robot([*cart(), *arm(), rod]))
    assert "closed chain" in reported
    assert "'rod'" in reported
    ring = robot([*cart(), *arm(), joint("ring", "fixed", "hand", "base")])
    assert "closed chain" in refused(tmp_path, ring)


def test_a_chain_of_20_000_links_is_read_in_linear_time() -> None:
    count = 20_000
    rows = [f'<link name="l{i}"/>' for i in reversed(range(count))]
    rows += [joint(f"j{i}", "fixed", f"l{i}", f"l{i + 1}") for i in range(count - 1)]
    begin = time.process_time()
    tree = make_tree(ElementTree.fromstring(robot(rows)))
    assert time.process_time() - begin < 8.0
    assert len(tree.joint_of) == count - 1


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("</robot>", "<xacro:arm/></robot>", "unknown macro name: xacro:arm; correct it"),
        ('xyz="0.15 0 0.1"', 'xyz="${x} 0 0.1"', "name 'x' is not defined"),
        (BOX, '<mesh filename="$(find a)/m.stl"/>', "set --package a=FOLDER"),
        (BOX, '<mesh filename="m.glb"/>', "m.glb: there is no file"),
        (BOX, "<mesh/>", "link 'hand': a mesh has no filename; name its file, or remove"),
        (f"<geometry>{BOX}</geometry>", "", "'hand': a collision has no geometry; add a geometry"),
        (
            "</robot>",
            2 * '<link name="floor_point"/>' + "</robot>",
            "2 links have the name 'floor_point'",
        ),
        ('lower="-2.5"', 'lower="-inf"', "lower='-inf' should be a finite number; leave it out"),
        ('<axis xyz="0 1 0"', '<axis rpy="0 1 0"', "no attribute 'rpy' of <axis>; it has xyz"),
        ('xyz="0.15 0 0.1"', 'pos="0.15 0 0.1"', "'mount': a URDF has no attribute 'pos' of <or"),
        ('xyz="0.15 0 0.1"', 'XYZ="0.15 0 0.1"', "'XYZ' of <origin> (did you mean 'xyz'?)"),
        ('lower="-2.5" upper="2.5"', 'min="-2.5" max="2.5"', "'min' of <limit>; it has lower,"),
        (
            '<mass value="30"',
            '<mass kg="30"',
            "link 'base': a URDF has no attribute 'kg' of <mass>",
        ),
        ('xyz="0.15 0 0.1"', 'quat_xyzw="0 0 1 0"', "quat_xyzw is zero, or beside rpy"),
        (
            '<child link="fore"/>',
            '<child link="fore"/><mimic joint="lift"/>',
            "--tip: the joint 'elbow' of the arm follows another joint (<mimic>)",
        ),
        (
            'type="continuous"',
            'type="fixed"',
            "no joint turns without limits); set --wheel-radius and",
        ),
        ('0.05 -0.2 -0.05"', '0.3 -0.2 -0.05"', "left_axle, right_axle: no two are on one axle"),
    ],
)
def test_common_faults_of_a_urdf_are_refused_with_a_remedy(
    tmp_path: Path, old: str, new: str, why: str
) -> None:
    assert old in TOY
    text = TOY.replace('name="toy"', 'name="toy" xmlns:xacro="http://www.ros.org/wiki/xacro"')
    assert why in refused(tmp_path, text.replace(old, new))


@pytest.mark.parametrize("closed", ["toy.urdf", "in/m.stl"])
def test_a_file_that_the_user_may_not_read_is_named(
    closed: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (path := tmp_path / "toy.urdf").write_text(TOY.replace(BOX, '<mesh filename="in/m.stl"/>'))

    def denied(own: Path, *_: object, **__: object) -> object:
        if own == tmp_path / closed:
            raise PermissionError(errno.EACCES, "Permission denied", str(own))
        return os.stat(own)

    monkeypatch.setattr(Path, "stat", denied)  # root may read all files
    if closed == "toy.urdf":
        monkeypatch.setattr(Path, "open", denied)
    with pytest.raises(RobotFileError, match=f"{closed}: cannot be read: Permission denied"):
        whole_robot(Request(str(path), "base", "hand", tmp_path / "out"))


@pytest.mark.parametrize("error", [AttributeError, IndexError, KeyError, TypeError])
def test_an_error_in_the_code_of_a_mesh_reader_becomes_advice(
    error: type[Exception], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise error("nodes")

    monkeypatch.setattr("trimesh.load", fails)
    (path := tmp_path / "m.obj").write_text("v 0 0 0")
    with pytest.raises(RobotFileError, match="has no triangles; export it again"):
        read_mesh(path)


def test_a_mesh_name_is_suggested_and_a_mirrored_mesh_has_its_volume(tmp_path: Path) -> None:
    (tmp_path / "m.stl").write_bytes(cube())
    with pytest.raises(RobotFileError, match=re.escape("(did you mean 'm.stl'?)")):
        parse(request(tmp_path, with_mesh(TOY, "M.stl")))
    mirrored = parse(request(tmp_path, with_mesh(TOY, 'm.stl" scale="1 -1 1')))
    plain = parse(request(tmp_path, with_mesh(TOY, "m.stl")))
    sizes = [made.geometry["hand"].volume for made in (mirrored, plain)]
    assert sizes[0] == pytest.approx(sizes[1]) == pytest.approx(0.08 * 0.12 * 0.08)


def test_attributes_of_extensions_are_ignored(tmp_path: Path) -> None:
    """Robots of several makers have these."""
    text = TOY.replace('velocity="2"', 'velocity="2" stiffness="9"')
    text = text.replace('<axis xyz="0 1 0"', '<axis xyz="0 1 0" rpy="0 0 0"')
    text = text.replace('velocity="12"', 'acceleration="5"')  # a wheel without a speed limit
    assert parse(request(tmp_path, text)).limits == parse(request(tmp_path, TOY)).limits


@pytest.mark.parametrize("old", ['xyz="0.15 0 0.1"', 'xyz="0 0 0.08"'])  # of joint, of shape
def test_a_quaternion_is_read_as_the_same_rotation(old: str, tmp_path: Path) -> None:
    """It need not have the length 1; the new URDF has `rpy`, which all libraries read."""
    found = []
    for turn in ('rpy="0 0 0.9272952180016122"', 'quat_xyzw="0 0 4 8"'):
        text = TOY.replace(f'{old} rpy="0 0 0"', f"{old} {turn}")
        assert text != TOY
        parsed = parse(request(tmp_path, text))
        assert "quat" not in rebased_urdf(parsed, name="toy", header="")
        T = parsed.tree.pose("column", "base").homogeneous
        found.append((T, parsed.geometry["hand"].corners))
    for one, two in zip(*found, strict=True):
        np.testing.assert_allclose(two, one, atol=1e-9)


def test_wheels_with_limits_of_many_turns_are_wheels(tmp_path: Path) -> None:
    limits = r'\1revolute\2lower="-100" upper="100" '
    text = re.sub(r'(_axle" type=")continuous(".*?<limit )', limits, TOY)
    assert text.count('upper="100"') == 2
    assert parse(request(tmp_path, text)).wheels.left == ("left_axle",)


def test_many_comments_before_the_robot_take_no_time(tmp_path: Path) -> None:
    """A licence of 25 lines took minutes: the time of a regular expression was exponential."""
    comments = "<!-- Redistribution and use in source and binary forms -->\n" * 700
    text = TOY.replace("<robot", f"{comments}<robot", 1)
    assert parse(request(tmp_path, text)).arm.names == ARM_JOINTS


@pytest.mark.parametrize(
    ("kind", "limit", "why"),
    [
        ("prismatic", (0, 40), "joints finger (0 to 40) have limits of many metres"),
        ("prismatic", (0.04, 0), "joints finger (0.04 to 0) have a lower limit that is not below"),
        ("revolute", (0, 90), "joints finger (0 to 90) have limits of over two turns"),
        ("revolute", (0, 0), ""),
        ("prismatic", (0, 0), ""),
        ("prismatic", None, ""),
        ("prismatic", (-1e16, 1e16), ""),
    ],
)
@pytest.mark.parametrize("carrier", ["hand", "base"])
def test_wrong_limits_beside_the_arm_are_refused(
    tmp_path: Path, carrier: str, kind: str, limit: tuple[float, float] | None, why: str
) -> None:
    words = 'lower="{}" upper="{}"'.format(*limit) if limit else 'effort="1"'
    finger = joint("finger", kind, carrier, "tip", limit=words)
    text = TOY.replace("</robot>", link("tip") + finger + "</robot>")
    if why:
        assert why in refused(tmp_path, text)
    else:
        assert parse(request(tmp_path, text)).arm.names == ARM_JOINTS


def test_elements_beside_links_and_joints_are_ignored(tmp_path: Path) -> None:
    """The elements of Gazebo and ros2_control may contain anything."""
    beside = '<gazebo reference="hand"><visual><geometry><mesh/></geometry></visual></gazebo>'
    parsed = parse(request(tmp_path, TOY.replace("</robot>", f"{beside}</robot>")))
    assert tuple(j.name for j in parsed.arm.joints) == ARM_JOINTS


def test_joints_may_have_names_that_libraries_use(tmp_path: Path) -> None:
    """MuJoCo uses `world`, pinocchio `universe`, and the project's root joint `planar_x`."""
    text = TOY
    for old, new in (("pan", "world"), ("lift", "universe"), ("elbow", "planar_x")):
        text = text.replace(f'joint name="{old}"', f'joint name="{new}"')
    arm = robot_model(tmp_path, request(tmp_path, text)).description.arm
    assert arm.joints[:3] == ("world_joint", "universe_joint", "planar_x_joint")


def test_the_tip_must_be_a_link_of_the_arms_file(tmp_path: Path) -> None:
    alone = robot([part for part in arm() if 'name="mount"' not in part])
    options = Request(
        urdf=str(write(tmp_path, robot(cart()))),
        base="base",
        tip="left_wheel",
        out=tmp_path / "made",
        arm_urdf=str(write(tmp_path, alone, "arm.urdf")),
    )
    with pytest.raises(RobotFileError, match="--tip: the URDF has no link 'left_wheel'"):
        parse(options)


def test_a_missing_mesh_is_reported_with_its_address(tmp_path: Path) -> None:
    pytest.importorskip("pybullet_data")
    for file, why in (
        ("meshes/none.stl", "there is no file"),
        ("package://no_such_package/none.stl", "not installed"),
        ("package://pybullet_data/husky/none.stl", "no such file"),
    ):
        text = TOY.replace('<box size="0.08 0.12 0.08"/>', f'<mesh filename="{file}"/>')
        reported = refused(tmp_path, text)
        assert file in reported
        assert why in reported


def test_missing_inertia_is_refused_unless_it_may_be_assumed(tmp_path: Path) -> None:
    bare = re.sub(r"<inertial>.*?</inertial>", "", TOY)
    assert "--assume-inertia" in refused(tmp_path, bare)
    parsed = parse(request(tmp_path, bare, assume_inertia=True))
    hand = parsed.inertias["hand"]
    assert hand.assumed
    assert hand.inertia.mass == pytest.approx(1200.0 * 0.08 * 0.12 * 0.08, rel=1e-6)
    np.testing.assert_allclose(hand.inertia.lever, [0.0, 0.0, 0.08], atol=1e-9)


@pytest.mark.parametrize(("size", "mass"), [("0.6 0.4 0.2", 21.6), ("2.5 2.0 2.2", 1767.0)])
def test_assumed_mass_of_a_large_base_grows_with_its_surface(
    tmp_path: Path, size: str, mass: float
) -> None:
    """With the density of a small base, the large one would have 5 t."""
    base = INERTIAL.format(m=30, i=0.3)
    text = TOY.replace(base, "", 1).replace('size="0.6 0.4 0.2"', f'size="{size}"')
    inertias = parse(request(tmp_path, text)).inertias
    assert inertias["base"].inertia.mass == pytest.approx(mass, rel=0.02)
    assert inertias["base"].inertia.inertia[2, 2] < mass * 3.0**2
    density = mass / np.prod([float(x) for x in size.split()])
    assert inertias["base"].assumed.startswith(f"{density:.0f} kg/m³")
    assert assumed_mass(inertias, inertias) == pytest.approx(mass, rel=0.02)


def test_lengths_in_millimetres_are_refused(tmp_path: Path) -> None:
    far = TOY.replace('xyz="0.15 0 0.1"', 'xyz="150 0 100"')
    assert "millimetres" in refused(tmp_path, far)
    large = TOY.replace('size="0.08 0.12 0.08"', 'size="80 120 80"')
    assert "millimetres" in refused(tmp_path, large)


@pytest.mark.parametrize(
    ("changes", "why"),
    [
        ({"base": "bse"}, "--base: the URDF has no link 'bse' (did you mean 'base'?)"),
        ({"tip": "hnd"}, "--tip: the URDF has no link 'hnd' (did you mean 'hand'?)"),
        ({"base": "hand", "tip": "base"}, "--tip: 'base' is not a descendant of --base 'hand'"),
        ({"tip": "column"}, "--tip: no joint moves 'column'"),
        ({"mount": "upper"}, "--mount: 'upper' is not between"),
        ({"urdf": "none.urdf"}, "none.urdf: no such file"),
    ],
)
def test_wrong_links_and_files_are_reported_with_their_option(
    tmp_path: Path, changes: dict[str, object], why: str
) -> None:
    assert why in refused(tmp_path, TOY, **changes)


def test_a_file_that_is_no_urdf_is_refused(tmp_path: Path) -> None:
    assert "not well-formed" in refused(tmp_path, TOY[:-20])
    assert "a URDF's is <robot>" in refused(tmp_path, "<sdf/>")
    unknown = TOY.replace('<child link="hand"/>', '<child link="hnd"/>')
    assert "its child is 'hnd', which is not a link" in refused(tmp_path, unknown)


def test_an_existing_folder_is_not_changed(tmp_path: Path) -> None:
    made = tmp_path / "made"
    made.mkdir()
    (made / "mine.txt").write_text("mine")
    with pytest.raises(DbbError, match="exists; remove it"):
        finish(request(tmp_path, TOY))
    assert [p.name for p in made.iterdir()] == ["mine.txt"]


@pytest.mark.parametrize("ending", ["xacro", "XACRO", "urdf", "xml"])
@pytest.mark.parametrize("namespace", ["http://www.ros.org/wiki/xacro", "http://a.b/#interface"])
def test_a_xacro_is_expanded(tmp_path: Path, ending: str, namespace: str) -> None:
    """The content decides; formerly, a xacro had to have the ending `.xacro`.

    As in xacro itself, the namespace does not matter; that of KUKA's youBot is Gazebo's.
    """
    pytest.importorskip("xacrodoc")
    text = TOY.replace(
        '<robot name="toy">',
        f'<robot name="toy" xmlns:xacro="{namespace}"><xacro:property name="r" value="0.1"/>',
    )
    text = text.replace('radius="0.1"', 'radius="${r}"')
    path = write(tmp_path, text, f"toy.{ending}")
    parsed = parse(Request(urdf=str(path), base="base", tip="hand", out=tmp_path / "made"))
    assert parsed.wheels.r == pytest.approx(0.1)


MACRO = '<macro name="a"><link name="z"/></macro>'


@pytest.mark.parametrize(
    ("added", "why"),
    [
        (f"{MACRO}<xacro:a/>", "toy.urdf: <macro> is xacro without its prefix; write <xacro:macro"),
        (f"{MACRO}<a/>", "toy.urdf: <macro> is xacro without"),  # formerly, a robot without z
        ('<xacro:include filename="m.xacro"/><a/>', ": <macro> is xacro without"),
        ('<include filename="m.xacro"/>', "toy.urdf: <include> is xacro without"),
        ('<property name="r" value="1"/><xacro:if value="${r}"/>', "<property> is xacro without"),
        ('<xacro:include filename="n.xacro"/>', "/n.xacro (did you mean 'm.xacro'?); correct it"),
    ],
)
def test_a_fault_of_a_xacro_is_refused_in_a_line_with_each_path_once(
    tmp_path: Path, added: str, why: str
) -> None:
    """A `<macro>` without the prefix is ignored by present versions of xacro."""
    pytest.importorskip("xacrodoc")
    write(tmp_path, f"<robot>{MACRO}</robot>", "m.xacro")
    text = TOY.replace('name="toy"', 'name="toy" xmlns:xacro="http://www.ros.org/wiki/xacro"')
    path = write(tmp_path, text.replace("</robot>", f"{added}</robot>"))
    with pytest.raises(RobotFileError) as caught:
        parse(Request(str(path), "base", "hand", tmp_path / "made"))
    assert why in str(caught.value)
    assert str(caught.value).count(str(tmp_path)) == 1 + ("n.xacro" in added)


def test_an_undeclared_prefix_is_named_with_its_declaration(tmp_path: Path) -> None:
    said = refused(tmp_path, TOY.replace("</robot>", "<xacro:arm/></robot>"))
    assert 'declare it in <robot>, such as xmlns:xacro="http://www.ros.org/wiki/xacro"' in said


@pytest.mark.parametrize(
    ("radius", "helps"),
    [("$(arg r)", "set it by --xacro r=VALUE"), ("${r}", "correct it, and try: xacro FILE")],
)
def test_only_a_missing_xacro_argument_is_requested(
    radius: str, helps: str, tmp_path: Path
) -> None:
    pytest.importorskip("xacrodoc")
    text = TOY.replace('radius="0.1"', f'radius="{radius}"')
    text = text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    path = write(tmp_path, text, "toy.urdf.xacro")
    options = Request(urdf=str(path), base="base", tip="hand", out=tmp_path / "made")
    with pytest.raises(RobotFileError, match=f"; {helps}$"):
        parse(options)


@pytest.mark.budget
def test_a_xacro_that_expands_to_gigabytes_is_refused(tmp_path: Path) -> None:
    pytest.importorskip("xacrodoc")
    text = TOY.replace('radius="0.1"', """radius="${len('x' * 2 * 10**9)}\"""")
    text = text.replace("<robot ", '<robot xmlns:xacro="http://www.ros.org/wiki/xacro" ')
    path = write(tmp_path, text, "toy.urdf.xacro")
    with pytest.raises(RobotFileError, match="xacro cannot expand it"):
        parse(Request(urdf=str(path), base="base", tip="hand", out=tmp_path / "made"))


def test_an_unknown_package_of_a_xacro_is_requested_with_its_folder(
    tmp_path: Path,
) -> None:
    pytest.importorskip("xacrodoc")
    text = (
        '<robot name="toy" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find no_such_arm)/arm/arm.xacro"/></robot>'
    )
    path = write(tmp_path, text, "toy.urdf.xacro")
    options = Request(urdf=str(path), base="base", tip="hand", out=tmp_path / "made")
    with pytest.raises(RobotFileError, match=r"set --package no_such_arm=FOLDER$"):
        parse(options)
    (tmp_path / "arm").mkdir()
    write(tmp_path / "arm", robot([*cart(), *arm()]), "arm.xacro")
    with pytest.raises(RobotFileError, match=f"--package no_such_arm={tmp_path}, which contains"):
        parse(options)
    assert parse(replace(options, package=(f"no_such_arm={tmp_path}",))).arm.tip == "hand"


def test_a_xacro_of_macros_alone_is_refused_with_the_file_to_give(tmp_path: Path) -> None:
    """An example is the platform of a Clearpath robot."""
    pytest.importorskip("xacrodoc")
    text = '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:macro name="a"/></robot>'
    path = write(tmp_path, text, "a.urdf.xacro")
    with pytest.raises(RobotFileError, match=r"has no <link>; .* give the file that calls them"):
        parse(Request(str(path), "base", "hand", tmp_path / "made"))


@pytest.mark.parametrize("added", ["", '<xacro:if value="$(arg tall)"/>'])
@pytest.mark.parametrize("name", ["length", "width", "tall", "lenght"])
def test_an_argument_that_no_xacro_declares_is_refused(
    added: str, name: str, tmp_path: Path
) -> None:
    """The file declares `length`, its include `width`; `tall` is used without a declaration."""
    pytest.importorskip("xacrodoc")
    head = '<robot name="toy" xmlns:xacro="http://www.ros.org/wiki/xacro">'
    declared = '<xacro:arg name="{}" default="0.34"/>'
    write(tmp_path, f"{head}{declared.format('width')}</robot>", "a.xacro")
    text = TOY.replace('length="0.34"', 'length="$(arg length)"').replace(
        '<robot name="toy">',
        f'{head}{declared.format("length")}<xacro:include filename="a.xacro"/>{added}',
    )
    path = write(tmp_path, text, "toy.xacro")
    entries = (f"{name}:=1", *(["tall=1"] if added else []))
    options = Request(str(path), "base", "hand", tmp_path / "made", xacro=entries)
    if name == "lenght" or (name == "tall" and not added):
        near = r" \(did you mean 'length'\?\)" if name == "lenght" else ""
        with pytest.raises(DbbError, match=f"--xacro '{name}'{near}; choose from: length, "):
            parse(options)
        return
    extents = parse(options).geometry["upper"].shapes[0].hull.extents
    assert extents[2] == pytest.approx(1.0 if name == "length" else 0.34)


def test_an_argument_of_a_urdf_without_xacro_is_refused(tmp_path: Path) -> None:
    assert "argument of --xacro 'r'" in refused(tmp_path, TOY, xacro=("r=1",))


@pytest.mark.parametrize("folder", ["", "parts/", "$(dirname)/", "$(dirname)/parts/"])
def test_a_relative_include_is_in_the_folder_of_its_xacro(folder: str, tmp_path: Path) -> None:
    """As in ROS, and not in the working directory; `$(dirname)` is the folder of each file."""
    pytest.importorskip("xacrodoc")
    own = tmp_path / folder.replace("$(dirname)/", "")
    own.mkdir(exist_ok=True)
    head = '<robot name="toy" xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:include filename='
    write(own, robot([*cart(), *arm()]), "parts.xacro")
    write(own, f'{head}"$(dirname)/parts.xacro"/></robot>', "toy.xacro")
    text = f'{head}"{folder}toy.xacro"/></robot>'
    path = write(tmp_path, text, "toy.urdf.xacro")
    assert parse(Request(str(path), "base", "hand", tmp_path / "made")).arm.tip == "hand"


def test_a_xacro_finds_a_python_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """For example `$(find pybullet_data)`, which was reported as not installed."""
    pytest.importorskip("xacrodoc")
    package = tmp_path / "site" / "toy_arm_data"
    package.mkdir(parents=True)
    write(package, robot([*cart(), *arm()]))
    monkeypatch.syspath_prepend(tmp_path / "site")
    (tmp_path / "a" / "b").mkdir(parents=True)
    text = (
        '<robot name="toy" xmlns:xacro="http://www.ros.org/wiki/xacro">'
        '<xacro:include filename="$(find toy_arm_data)/toy.urdf"/></robot>'
    )
    path = write(tmp_path / "a" / "b", text, "toy.urdf.xacro")
    assert parse(Request(str(path), "base", "hand", tmp_path / "made")).arm.tip == "hand"


def test_an_arm_from_a_second_file_is_mounted_on_the_base(tmp_path: Path) -> None:
    """The arm's root has the same name as the base and is renamed."""
    alone = [part for part in arm() if 'name="mount"' not in part]
    arm_file = write(tmp_path, robot(alone).replace('"column"', '"base"'), "arm.urdf")
    base_file = write(tmp_path, robot(cart()), "cart.urdf")
    parsed = parse(
        Request(
            urdf=str(base_file),
            base="base",
            tip="hand",
            out=tmp_path / "made",
            arm_urdf=str(arm_file),
            mount_xyz=(0.15, 0.0, 0.1),
        )
    )
    assert parsed.arm.mount == "arm_base"
    one = parse(request(tmp_path, TOY))
    for made, whole in (("hand", "hand"), ("arm_base", "column")):
        np.testing.assert_allclose(
            parsed.tree.pose(made, "base").homogeneous,
            one.tree.pose(whole, "base").homogeneous,
            atol=1e-12,
        )


def test_materials_of_one_name_in_two_files_keep_their_colours(tmp_path: Path) -> None:
    """Both files have a material `grey`, and their links refer to it by name."""

    def painted(parts: list[str], link: str, rgba: str) -> str:
        visual = f'<visual><geometry>{BOX}</geometry><material name="grey"/></visual>'
        text = robot([*parts, f'<material name="grey"><color rgba="{rgba}"/></material>'])
        return text.replace(f'<link name="{link}">', f'<link name="{link}">{visual}')

    alone = [part for part in arm() if 'name="mount"' not in part]
    base = write(tmp_path, painted(cart(), "base", "0.2 0.2 0.2 1"), "cart.urdf")
    arm_urdf = str(write(tmp_path, painted(alone, "hand", "0.7 0.7 0.7 1"), "arm.urdf"))
    options = Request(str(base), "base", "hand", tmp_path / "made", arm_urdf=arm_urdf)
    written = ElementTree.fromstring(rebased_urdf(parse(options), name="toy", header=""))
    assert written.find("material") is None
    colours = {
        link.get("name"): colour.get("rgba")
        for link in written.iterfind("link")
        for colour in link.iterfind("visual/material/color")
    }
    assert colours == {"base": "0.2 0.2 0.2 1", "hand": "0.7 0.7 0.7 1"}
    names = [each.get("name") for each in written.iter("material")]
    assert len(set(names)) == 2


def test_names_of_an_arm_are_distinct_from_all_others(tmp_path: Path) -> None:
    """Here a name already has the prefix, and a joint has the name of the mounting joint."""
    plate = [link("plate"), joint("arm_on_base", "fixed", "base", "plate")]
    alone = [part for part in arm() if 'name="mount"' not in part]
    alone += [link("arm_base"), joint("more", "fixed", "hand", "arm_base")]
    arm_file = write(tmp_path, robot(alone).replace('"column"', '"base"'), "arm.urdf")
    base_file = str(write(tmp_path, robot([*cart(), *plate]), "cart.urdf"))
    options = Request(base_file, "base", "hand", tmp_path / "made", arm_urdf=str(arm_file))
    tree = parse(options).tree
    ends = {name: (tree.joints[name].parent, tree.joints[name].child) for name in tree.joints}
    assert ends["arm_on_base"] == ("base", "arm_base_")
    assert ends["arm_on_base_joint"] == ("base", "plate")
    assert ends["more"] == ("hand", "arm_base")


def test_wheels_reveal_a_complete_robot_in_place_of_an_arm(tmp_path: Path) -> None:
    names = {}
    base = str(write(tmp_path, robot(cart()), "cart.urdf"))
    for name, below in (("whole", cart()), ("alone", [link("base")])):
        arm_urdf = str(write(tmp_path, robot([*below, *arm()]), f"{name}.urdf"))
        options = Request(base, "base", "hand", tmp_path / name, arm_urdf=arm_urdf)
        names[name] = wheels_carried(parse(options))
    assert names == {"whole": ["arm_left_axle", "arm_right_axle"], "alone": []}


def test_an_impossible_inertia_is_refused(tmp_path: Path) -> None:
    bad = TOY.replace('<mass value="30"/><inertia ixx="0.3"', '<mass value="30"/><inertia ixx="-3"')
    assert bad != TOY
    with pytest.raises(RobotFileError, match="is impossible"):
        parse(request(tmp_path, bad))


def test_inertia_that_violates_the_triangle_by_rounding_is_repaired(tmp_path: Path) -> None:
    """For pybullet an inertia with ixx + iyy < izz counts as zero, even for a rounding error."""
    flat = TOY.replace('<mass value="30"/><inertia ixx="0.3"', '<mass value="30"/><inertia ixx="1"')
    flat = flat.replace('iyy="0.3" iyz="0" izz="0.3"', 'iyy="2" iyz="0" izz="3.00001"')
    made = parse(request(tmp_path, flat)).inertias["base"].inertia.inertia
    moments = np.linalg.eigvalsh(made)
    assert moments[0] + moments[1] > moments[2]
    np.testing.assert_allclose(moments, [1.0, 2.0, 3.00001], atol=1e-4)


def test_a_joint_may_have_the_name_of_a_link(tmp_path: Path) -> None:
    """Z1 and SO-100 have such names; pinocchio cannot distinguish their frames."""
    text = TOY.replace('<joint name="lift"', '<joint name="upper"')
    text = text.replace('<joint name="left_axle"', '<joint name="left_wheel"')
    follower = '<joint name="grip" type="revolute"><parent link="hand"/><child link="finger"/>'
    follower += '<axis xyz="1 0 0"/><mimic joint="upper"/></joint>'
    text = text.replace("</robot>", link("finger") + follower + "</robot>")
    parsed = parse(request(tmp_path, text))
    assert parsed.arm.joints[1].name == "upper_joint"
    assert parsed.wheels.left == ("left_wheel_joint",)
    assert parsed.tree.joints["grip"].mimic == ("upper_joint", 1.0, 0.0)
    made = robot_model(tmp_path, request(tmp_path, text))
    assert made.n_m == len(ARM_JOINTS)


def test_a_finger_whose_limits_exclude_zero_is_at_the_nearest_limit(tmp_path: Path) -> None:
    limit = 'lower="0.015" upper="0.037" effort="5" velocity="1"'
    finger = joint("slide", "prismatic", "hand", "finger", axis="0 1 0", limit=limit)
    text = TOY.replace("</robot>", link("finger") + finger + "</robot>")
    model = robot_model(tmp_path, request(tmp_path, text)).pin
    T = model.frames[model.getFrameId("hand")].placement.actInv(
        model.frames[model.getFrameId("finger")].placement
    )
    assert T.translation == pytest.approx([0.0, 0.015, 0.0])


@pytest.mark.parametrize(("leader", "offset"), [("lift", 0.0), ("slide", 0.2)])
def test_a_mimic_joint_preserves_its_relation_if_its_leader_is_shifted(
    tmp_path: Path, leader: str, offset: float
) -> None:
    """A joint of the arm keeps its zero; another joint gets a new zero at its nearest limit."""
    limit = 'lower="0.1" upper="1" effort="5" velocity="1"'
    text = re.sub(r'(name="lift".*?)<limit [^>]*>', rf"\1<limit {limit}/>", TOY)
    slide = joint("slide", "prismatic", "hand", "finger", axis="0 1 0", limit=limit)
    tip = joint("follower", "revolute", "finger", "tip")
    tip = tip.replace("</joint>", f'<mimic joint="{leader}" multiplier="2"/></joint>')
    text = text.replace("</robot>", link("finger") + link("tip") + slide + tip + "</robot>")
    urdf = rebased_urdf(parse(request(tmp_path, text)), name="toy", header="test")
    mimic = ElementTree.fromstring(urdf).find("joint[@name='follower']/mimic")
    assert float(mimic.get("offset")) == pytest.approx(offset)


def test_a_finger_with_very_wide_limits_covers_one_turn(tmp_path: Path) -> None:
    found = []
    for kind, limit in (("continuous", ""), ("revolute", 'lower="-1e6" upper="1e6" effort="1"')):
        turn = joint("spin", kind, "hand", "finger", limit=f'{limit} velocity="1"' if limit else "")
        part = link("finger", solid('<box size="0.02 0.04 0.1"/>'))
        tree = make_tree(ElementTree.fromstring(TOY.replace("</robot>", part + turn + "</robot>")))
        chain = [tree.joints[name] for name in ARM_JOINTS]
        found.append(filled(tree, read_geometry(tree), chain)["finger"].corners)
    np.testing.assert_allclose(found[1], found[0])


def test_a_finger_on_a_screw_of_many_turns_covers_its_whole_way(tmp_path: Path) -> None:
    limit = 'lower="0" upper="60" effort="1" velocity="1"'
    motor = joint("motor", "revolute", "hand", "screw", limit=limit)
    slide = joint("slide", "prismatic", "hand", "finger", axis="0 1 0", limit='lower="0" upper="1"')
    slide = slide.replace("</joint>", '<mimic joint="motor" multiplier="0.001"/></joint>')
    part = link("finger", solid('<box size="0.02 0.02 0.1"/>')) + link("screw")
    text = TOY.replace("</robot>", part + motor + slide + "</robot>")
    tree = make_tree(ElementTree.fromstring(text))
    chain = [tree.joints[name] for name in ARM_JOINTS]
    y = filled(tree, read_geometry(tree), chain)["finger"].corners[:, 1]
    assert [y.min(), y.max()] == pytest.approx([-0.01, 0.07], abs=1e-6)


LIFT = 'lower="-2.5" upper="2.5"'


@pytest.mark.parametrize(
    ("limits", "mimics", "low", "high"),
    [
        (LIFT, {"rides": ("lift", 0.1, 0.0)}, -0.25, 0.25),  # like a torso that follows a lift
        ('lower="0.5" upper="1.5"', {"rides": ("lift", 0.2, 0.1)}, 0.2, 0.4),  # never at zero
        (LIFT, {"rides": ("idles", -0.5, 0.1), "idles": ("lift", 0.2, 0.0)}, -0.15, 0.35),
        (LIFT, {"rides": ("nothing", 0.1, 0.0)}, 0.0, 0.0),
    ],
)
def test_links_that_follow_the_arm_cover_their_travel(
    tmp_path: Path,
    limits: str,
    mimics: dict[str, tuple[str, float, float]],
    low: float,
    high: float,
) -> None:
    """The written URDF, which a check reads, gives the same result."""
    text = re.sub(
        r'(name="lift".*?<limit )lower="-2.5" upper="2.5"', rf"\1{limits}", TOY, flags=re.S
    )
    for name, (leader, multiplier, offset) in mimics.items():
        slide = joint(name, "prismatic", "base", f"{name}_link", limit='lower="-1" upper="1"')
        follow = f'<mimic joint="{leader}" multiplier="{multiplier}" offset="{offset}"/></joint>'
        part = link(f"{name}_link", solid('<box size="0.1 0.1 0.1"/>'))
        text = text.replace("</robot>", part + slide.replace("</joint>", follow) + "</robot>")
    parsed = parse(request(tmp_path, text))
    again = make_tree(ElementTree.fromstring(rebased_urdf(parsed, name="toy", header="test")))
    for tree in (parsed.tree, again):
        chain = [tree.joints[name] for name in ARM_JOINTS]
        z = filled(tree, read_geometry(tree), chain)["rides_link"].corners[:, 2]
        assert [z.min(), z.max()] == pytest.approx([low - 0.05, high + 0.05], abs=1e-6)
    warned = " ".join(held_still(parsed))
    assert ("follow a joint of the arm (<mimic>)" in warned) is (low < high)


def robot_model(folder: Path, options: Request) -> RobotModel:
    """The model of a robot that is parsed and written, without the fitted bodies."""
    parsed = parse(options)
    urdf = rebased_urdf(parsed, name="toy", header="test")
    content = description(options, parsed)
    return compiled(content, write(folder, urdf, "robot.urdf"))


def test_an_error_of_a_library_becomes_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ValueError("Several frames\nmatch the filter")

    monkeypatch.setattr(new_robot, "make_units", broken)
    reported = refused(tmp_path, TOY)
    assert "random postures: a library cannot read this robot" in reported
    assert "ValueError: Several frames match the filter" in reported


@pytest.mark.parametrize(
    ("ready", "why"),
    [
        ((0.0, 0.1), "--ready: it has 2 numbers, but the arm has 6 joints: pan, lift, elbow"),
        ((0.0, 0.0, 9.0, 0.0, 0.0, 0.0), "--ready: elbow at 9 is outside of its limits"),
    ],
)
def test_an_invalid_ready_posture_is_refused_before_sampling(
    tmp_path: Path, ready: tuple[float, ...], why: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(new_robot, "sample_meetings", None)
    assert why in refused(tmp_path, TOY, ready=ready)


MESH = "package://hand_support/meshes/hand.stl"


@pytest.fixture
def meshed(tmp_path: Path) -> Path:
    """A URDF in a separate folder that refers to a mesh of a package."""
    folder = tmp_path / "robots" / "urdf"
    folder.mkdir(parents=True)
    return write(folder, with_mesh(TOY, MESH))


def mesh_in(folder: Path) -> Path:
    """The mesh in the folder of the package."""
    mesh = folder / "meshes" / "hand.stl"
    mesh.parent.mkdir(parents=True)
    mesh.write_bytes(cube())
    return mesh


def meshes(path: Path, **changes: object) -> list[str]:
    given = {"urdf": str(path), "base": "base", "tip": "hand", "out": path.parent / "made"}
    links = parse(Request(**given | changes)).tree.links.values()
    return [str(mesh.get("filename")) for link in links for mesh in link.iter("mesh")]


def test_a_package_folder_is_searched_by_option_parents_and_ros_paths(
    meshed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"/none:{tmp_path / 'ament'}")
    ament = mesh_in(tmp_path / "ament" / "share" / "hand_support")
    assert meshes(meshed) == [str(ament)]
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "ros"))
    ros = mesh_in(tmp_path / "ros" / "stack" / "hand_support")
    assert meshes(meshed) == [str(ros)]
    upwards = mesh_in(tmp_path / "hand_support")
    assert meshes(meshed) == [str(upwards)]
    given = mesh_in(tmp_path / "given")
    assert meshes(meshed, package=(f"hand_support={tmp_path / 'given'}",)) == [str(given)]


def test_a_misspelt_mesh_of_a_package_gets_a_suggestion(meshed: Path, tmp_path: Path) -> None:
    mesh = mesh_in(tmp_path / "hand_support")
    mesh.rename(mesh.with_name("hands.stl"))
    with pytest.raises(RobotFileError, match=r"did you mean 'meshes/hands\.stl'"):
        meshes(meshed)


def test_the_error_of_a_missing_package_names_paths_and_options_only(meshed: Path) -> None:
    with pytest.raises(RobotFileError) as caught:
        meshes(meshed)
    reported = str(caught.value)
    for words in (
        MESH,
        "ROS_PACKAGE_PATH",
        "AMENT_PREFIX_PATH",
        "--package hand_support=FOLDER",
    ):
        assert words in reported
    assert "pip" not in reported
    mesh_in(meshed.parent.parent)  # the package's own folder has another name
    with pytest.raises(RobotFileError, match=f"--package hand_support={meshed.parent.parent}"):
        meshes(meshed)


@pytest.mark.parametrize("given", ["hand_support", "=x", "hand_support=/none"])
def test_a_package_without_a_folder_is_refused(tmp_path: Path, given: str) -> None:
    assert "--package: " in refused(tmp_path, TOY, package=(given,))


def test_each_group_of_an_obj_has_a_separate_hull(tmp_path: Path) -> None:
    """Like in pybullet, the gap between two fingers of one mesh is free."""
    pytest.importorskip("pybullet")
    finger = trimesh.creation.box(extents=(0.02, 0.02, 0.1))
    lines = []
    for k, (y, begin) in enumerate(((-0.06, "o left"), (0.06, "g right"))):
        corners = np.round(np.add(finger.vertices, [0.0, y, 0.0]), 6)
        lines += [f"v {' '.join(map(str, each))}" for each in corners]
        first = -8 if k else 1  # the second group has indices relative to its end
        lines += [begin, *(f"f {' '.join(str(i + first) for i in face)}" for face in finger.faces)]
    write(tmp_path, "\n".join(lines), "m.obj")
    model = robot_model(tmp_path, request(tmp_path, with_mesh(TOY, "m.obj")))
    shapes = [shape for shape in collision_shapes(model).shapes if shape.part == "hand"]
    middles = sorted(float(shape.T.act(shape.geometry.min(axis=0))[1]) for shape in shapes)
    assert middles == pytest.approx([-0.07, 0.05])
    assert compare_engines(model, postures=3).picture < SAME_PICTURE
