"""Links that touch by design, like a shoulder inside a torso, are not a contact pair.

An example is Baxter, whose shoulder overlaps its torso in 87 % of all postures and in the ready
posture.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
import trimesh
from trimesh.creation import box

from app.onboarding.check import arm_row, check_robot, nested_row
from app.onboarding.fit import grouping
from app.onboarding.fit.meetings import Meetings, nested_links, sample_meetings
from app.onboarding.fit.units import make_units
from app.onboarding.new_robot import parse
from app.onboarding.request import Request
from app.onboarding.write import compiled, description, in_pieces_urdf, rebased_urdf
from app.robot.description import RobotDescription
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.collision_shapes import link_contact_pairs
from app.simulation.plants.planar import Planar
from tests.onboarding import arm, cart, joint, link, robot, solid, write
from tests.robots import needs_pybullet

pytestmark = pytest.mark.slow

GROUPS = [[1, 2], [3, 4], [5], [6, 7]]  # (column, shoulder), (upper, fore), cuff, (wrist, hand)
UPPER = 3  # the unit that overlaps the torso


class Toy(NamedTuple):
    model: RobotModel
    bare: RobotModel
    meetings: Meetings


@pytest.fixture(scope="module")
def toy(tmp_path_factory: pytest.TempPathFactory) -> Toy:
    """A torso around the root of the arm; upper arm and forearm protrude from it."""
    return with_torso(tmp_path_factory.mktemp("torso"), '<box size="0.2 0.2 0.34"/>')


def with_torso(folder: Path, shape: str) -> Toy:
    """A robot with a torso, whose frame is at the root of the arm."""
    torso = [
        link("torso", solid(shape)),
        joint("spine", "fixed", "base", "torso", xyz="0.15 0 0.25"),
    ]
    return fitted(folder, [*torso, *arm()], GROUPS)


def fitted(folder: Path, parts: list[str], groups: list[list[int]]) -> Toy:
    """The robot of a cart and `parts`, with bodies around the `groups` of its units."""
    path = write(folder, robot([*cart(), *parts]))
    request = Request(urdf=str(path), base="base", tip="hand", out=folder / "toy")
    parsed = parse(request)
    urdf = rebased_urdf(parsed, name="toy", header="test")
    urdf, pieces = in_pieces_urdf(urdf, parsed.geometry, folder)
    path, parsed = write(folder, urdf), replace(parsed, geometry=pieces)
    bare = compiled(description(request, parsed), path)
    units = make_units(bare, parsed.arm, parsed.geometry)
    meetings = sample_meetings(bare, units, samples=1500, seed=1, d_b=0.15)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grouping, "_ranked", lambda *_: [(0.0, groups)])
        bodies = grouping.find_grouping(bare, meetings, d_b=0.15).bodies
    content = description(request, parsed, bodies)
    numbers = {"A_per_m2": 100.0, "B_m": 0.5, "C": 10.0}
    reach = {**numbers, "source": dict.fromkeys(numbers, "assumed")}
    content["reachability"] = {body.name: reach for body in bodies[2:]}
    return Toy(compiled(content, path), bare, meetings)


def test_only_links_that_touch_when_their_units_touch_are_nested(toy: Toy) -> None:
    """Neither other links that move with the torso nor links that only can collide are nested."""
    assert nested_links(toy.bare, toy.meetings, 0, UPPER) == [("torso", "upper")]
    assert nested_links(toy.bare, toy.meetings, 0, 2) == [("torso", "shoulder")]  # neighbours
    for far in (4, 5, 6, 7):
        assert (toy.meetings.random.distances[:, column(toy, far)] <= 0.0).any()
        assert nested_links(toy.bare, toy.meetings, 0, far) == []
    watched = replace(toy.meetings, close=frozenset())  # the pair leaves the buffer
    assert nested_links(toy.bare, watched, 0, UPPER) == []


def test_nested_links_are_stored_and_are_no_contact_pair(toy: Toy) -> None:
    assert {body.name: body.nested for body in toy.model.description.bodies if body.nested} == {
        "l2": {"upper": ("torso",)}
    }
    pairs = link_contact_pairs(toy.model.description)
    assert ("torso", "upper") not in pairs
    for pair in (("base", "upper"), ("torso", "fore"), ("torso", "hand"), ("base", "hand")):
        assert pairs[pair] == "arm_base"


@pytest.mark.parametrize(
    ("links", "outcome"), [(("torso",), "passed"), (("torso", "left_wheel"), "warned")]
)
def test_check_warns_of_nested_links_that_never_touch(
    toy: Toy, links: tuple[str, ...], outcome: str
) -> None:
    """Plants ignore contacts of nested links, so that a wrong name would hide contacts."""
    said = with_nested(toy.model, 2, {"upper": links}).description
    (row,) = (row for row in islice(check_robot(said), 6) if row.name == "nested links")
    assert row.outcome == outcome
    assert ("left_wheel and upper in 0%" in row.text) == (outcome == "warned")
    assert "torso" not in row.text


def test_check_has_no_row_for_a_robot_without_nested_links(toy: Toy) -> None:
    rows = islice(check_robot(toy.bare.description), 6)
    assert "nested links" not in [row.name for row in rows]


@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=needs_pybullet), "mujoco"])
def test_a_plant_reports_the_collisions_that_the_fit_finds(toy: Toy, engine: str) -> None:
    """The upper arm always overlaps the torso; a contact depends only on the other links."""
    built = toy.meetings.random.distances[:, column(toy, UPPER)]
    assert (built < -0.01).all()
    check_contacts(toy, engine, range(4, 8))


@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=needs_pybullet), "mujoco"])
def test_a_plant_uses_the_pieces_of_the_fit(tmp_path: Path, engine: str) -> None:
    """The hull of a torso between two plates contains the upper arm, but its pieces do not."""
    sides = [box(extents=(0.3, 0.02, 0.6)).apply_translation((0.0, y, 0.1)) for y in (-0.45, 0.45)]
    trimesh.util.concatenate(sides).export(tmp_path / "torso.stl")
    toy = with_torso(tmp_path, '<mesh filename="torso.stl"/>')
    assert not toy.model.description.nested
    check_contacts(toy, engine, range(UPPER, 8))


@pytest.mark.parametrize("engine", [pytest.param("pybullet", marks=needs_pybullet), "mujoco"])
@pytest.mark.parametrize(
    ("overlap", "named", "counts"), [(0.002, True, False), (0.002, False, True), (0.01, True, True)]
)
def test_check_and_plants_count_the_same_contacts_of_two_links(
    tmp_path: Path, engine: str, overlap: float, named: bool, counts: bool
) -> None:
    """Links that overlap by at most 3 mm are nested: neither counts their contacts. Both count the
    contacts of links that overlap more, and those of links that the description does not name.
    """
    toy = fitted(tmp_path, sweeping(overlap), [[1, 2], [3], [4, 5]])
    assert {body.name: body.nested for body in toy.model.description.bodies if body.nested} == (
        {} if overlap > 0.003 else {"lEE": {"sweep": ("post",)}}
    )
    model = toy.model if named else with_nested(toy.model, -1, {})
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grouping, "ENOUGH", 0)
        assert (arm_row(model).numbers["collisions"] > 0.0) is counts
    plant, state = Planar(engine, model), RobotState(model)
    plant.reset(np.zeros(3), np.zeros(4))  # the links overlap as much as they can
    state.update(plant.measure())
    plant.step(state.g[model.n_b :], np.zeros(model.n_b), np.zeros(3))
    assert plant.contacts().arm_arm is counts
    plant.close()
    if model.description.nested:
        assert nested_row(model).outcome == "passed"


def test_check_warns_of_nested_links_that_overlap_deeply_in_few_postures(tmp_path: Path) -> None:
    toy = fitted(tmp_path, sweeping(0.01), [[1, 2], [3], [4, 5]])
    row = nested_row(with_nested(toy.model, -1, {"sweep": ("post",)}))
    assert row.outcome == "warned"
    assert "post and sweep" in row.text


def sweeping(overlap: float) -> list[str]:
    """An arm whose link `sweep` overlaps the link `post` by at most `overlap` [m], in 5 % of the
    postures. Both turn about the same axis, and a third link is between them.
    """
    names = ("column", "post", "hub", "sweep", "hand")
    far = 0.4 - overlap
    shapes = [
        solid('<cylinder radius="0.03" length="0.2"/>', xyz="0 0 0.1"),
        solid('<sphere radius="0.05"/>', xyz="0.15 0 0"),
        solid('<cylinder radius="0.02" length="0.04"/>'),
        solid('<sphere radius="0.2"/>', xyz=f"{far} 0 0"),
        solid('<box size="0.08 0.12 0.08"/>', xyz="0 0 0.1"),
    ]
    parts = [link(name, shape) for name, shape in zip(names, shapes, strict=True)]
    parts.append(joint("mount", "fixed", "base", "column", xyz="0 0 0.1"))
    offsets, axes = ("0 0 0.7", "0 0 0", "0 0 0", f"{far} 0 0.3"), ("0 0 1",) * 3 + ("0 1 0",)
    for k, (xyz, axis) in enumerate(zip(offsets, axes, strict=True)):
        parts.append(joint(f"turn_{k}", "revolute", names[k], names[k + 1], xyz=xyz, axis=axis))
    return parts


def with_nested(model: RobotModel, k: int, nested: dict[str, tuple[str, ...]]) -> RobotModel:
    """The model, with `nested` in the description of body `k`."""
    bodies = [body.model_dump() for body in model.description.bodies]
    bodies[k]["nested"] = nested
    content = model.description.model_dump() | {"bodies": bodies}
    return RobotModel(RobotDescription.model_validate(content))


def check_contacts(toy: Toy, engine: str, others: range) -> None:
    """Compare the contacts of a plant with the fit's distances of the base and other units.

    A unit, as in `app.onboarding.fit.units`, is a group of links that moves as one rigid body.
    """
    gaps = toy.meetings.random.distances[:, [column(toy, k) for k in others]].min(axis=1)
    q_m = toy.meetings.random.q_m
    free, hit = q_m[gaps > 0.01][:40], q_m[gaps < -0.01][:40]
    assert len(free) == len(hit) == 40
    plant, state = Planar(engine, toy.model), RobotState(toy.model)
    for postures, expected in ((free, False), (hit, True)):
        for posture in postures:
            plant.reset(np.zeros(3), posture)
            state.update(plant.measure())
            plant.step(state.g[toy.model.n_b :], np.zeros(toy.model.n_b), np.zeros(3))
            assert plant.contacts().arm_base is expected
    plant.close()


def column(toy: Toy, unit: int) -> int:
    """Index of the pair of the base and a unit, the column of its distances."""
    return toy.meetings.pairs.index((0, unit))
