"""Units of a robot's links: neighbours that may touch, grouping to bodies, and distances."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import trimesh

from app.border.reach import ReachMap, fit_reachability, lattice
from app.errors import DescriptionError
from app.onboarding.fit import units
from app.onboarding.fit.bodies import ArmFitter
from app.onboarding.fit.convex import directions, hull
from app.onboarding.fit.grouping import _ranked
from app.onboarding.fit.meetings import Meetings, Postures, _grazing
from app.onboarding.fit.units import (
    Part,
    Unit,
    hulls,
    neighbours,
    shape_distances,
    units_of_links,
)
from app.onboarding.numbers import SHARES, best_fit
from app.onboarding.read.links import LinkGeometry, LinkShape
from app.onboarding.read.tree import Joint, Tree, extends
from app.robot.link_pairs import PairDistances, candidate_pairs, sample_joints
from tests.robots import husky_panda


class Chain:
    """The part of a robot model that its units need."""

    def __init__(self, model: pin.Model) -> None:
        self.pin = model


def chain(joints: list[Any]) -> Any:
    """A robot model with joints in series on a planar base."""
    model = pin.Model()
    parent = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    for k, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint_{k}")
    return Chain(model)


def unit(joint: int) -> Unit:
    return Unit(joint, "", (), joint, (), np.zeros((0, 3)), np.zeros(0, dtype=int))


X, Y, TURN = pin.JointModelPX, pin.JointModelPY, pin.JointModelRZ


@pytest.mark.parametrize(
    ("joints", "a", "b", "expected"),
    [
        ([X(), X(), X(), X()], 2, 5, True),  # the parts of a telescope
        ([X(), X(), X(), X()], 5, 2, True),
        ([X(), Y(), X()], 2, 4, False),  # a gantry
        ([TURN(), X(), X()], 1, 4, False),
        ([X(), X(), TURN()], 2, 4, False),
        ([TURN(), TURN()], 2, 3, True),
        ([TURN(), TURN(), TURN()], 2, 4, False),
    ],
)
def test_adjacent_units_and_units_of_a_telescope_are_neighbours(
    joints: list[Any], a: int, b: int, expected: bool
) -> None:
    assert neighbours(chain(joints), unit(a), unit(b)) is expected


@pytest.mark.parametrize(
    ("kind", "mimic", "expected"),
    [
        ("prismatic", None, True),
        ("fixed", None, True),
        ("revolute", None, False),
        ("prismatic", ("slide", 1.0, 0.0), True),
        ("revolute", ("slide", 1.0, 0.0), False),
    ],
)
def test_only_parallel_slides_extend_a_telescope(
    kind: str, mimic: tuple[str, float, float] | None, expected: bool
) -> None:
    """A joint that follows another one moves, too."""
    straight = pin.SE3.Identity()
    joints = (
        Joint("slide", "prismatic", "mast", "lift", straight),
        Joint("between", kind, "lift", "outer", straight, mimic=mimic),
        Joint("last", "prismatic", "outer", "inner", straight),
    )
    tree = Tree({}, {joint.name: joint for joint in joints})
    assert extends(tree, joints[0], joints[2]) is expected


def test_links_without_shapes_are_no_body_of_their_own() -> None:
    """An example is the mount of Baxter's arm, which has no shape."""
    part = Part("link", np.zeros((0, 3)), np.zeros(0))
    units = tuple(unit(k)._replace(parts=() if k == 1 else (part,)) for k in range(5))
    postures = Postures(np.zeros((3, 4)), np.zeros((3, 0)), np.ones(3, dtype=bool))
    meetings = Meetings(units, (), frozenset(), frozenset(), postures, postures)
    cuts = [groups for _, groups in _ranked((1, 2, 3, 4), (2, 3), meetings, (0,), frozenset())]
    assert cuts
    assert all([1] not in groups for groups in cuts)


@pytest.mark.parametrize(
    ("sizes", "name"),
    [({}, "frame"), ({"deck": 1.0}, "deck"), ({"camera": 0.1, "deck": 1.0, "wheel": 0.2}, "deck")],
)
def test_messages_name_a_unit_by_its_largest_link(sizes: dict[str, float], name: str) -> None:
    corners = np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]])
    parts = tuple(Part(link, size * corners, np.zeros(3)) for link, size in sizes.items())
    assert unit(0)._replace(links=("frame", *sizes), parts=parts).name == name


def test_links_fixed_to_the_base_are_never_grouped_with_a_slide() -> None:
    """A common body of a mast and its lift would wrongly move the mast up and down."""
    part = Part("link", np.zeros((0, 3)), np.zeros(0))
    units = tuple(unit(k)._replace(parts=(part,)) for k in range(5))
    postures = Postures(np.zeros((3, 4)), np.zeros((3, 0)), np.ones(3, dtype=bool))
    meetings = Meetings(units, (), frozenset(), frozenset(), postures, postures)
    cuts = [groups for _, groups in _ranked((1, 2, 3, 4), (2, 3), meetings, (0,), frozenset({3}))]
    assert cuts
    assert not any({1, 3} <= set(group) for groups in cuts for group in groups)


@pytest.mark.parametrize(("apart", "found"), [((2, 4), True), ((1, 2), False)])
def test_units_that_a_pair_must_monitor_are_not_in_neighbouring_groups(
    apart: tuple[int, int], found: bool
) -> None:
    """Units next to each other are in neighbouring groups at best, and keep all groupings."""
    part = Part("link", np.zeros((0, 3)), np.zeros(0))
    units = tuple(unit(k)._replace(parts=(part,)) for k in range(5))
    postures = Postures(np.zeros((3, 4)), np.zeros((3, 0)), np.ones(3, dtype=bool))
    meetings = Meetings(units, (), frozenset(), frozenset(), postures, postures)
    rows = [
        _ranked((1, 2, 3, 4), (2, 3, 4), meetings, (0,), frozenset(), each)
        for each in ((), [apart])
    ]
    cuts = [groups for _, groups in rows[1]]
    assert all([3] in groups for groups in cuts) == found
    assert (len(rows[1]) == len(rows[0])) != found


@pytest.mark.parametrize(
    ("depths", "a", "expected"),
    [
        (np.full(30, 0.002), 2, True),
        (np.full(29, 0.002), 2, False),  # too few postures to bound the depth
        (np.append(np.full(29, 0.002), 0.01), 2, False),
        (np.full(30, 0.002), 1, False),  # of the base
    ],
)
def test_arm_links_that_overlap_slightly_are_near_by_design(
    depths: np.ndarray, a: int, expected: bool
) -> None:
    """An example is Stretch's wrist, 2 mm inside the outer tube of the retracted telescope."""
    pair, gaps = (a, 4), np.append(-depths, np.full(70, 0.2))[:, None]
    found = _grazing([unit(k) for k in range(5)], [pair], gaps)
    assert found == (frozenset({pair}) if expected else frozenset())


def test_head_on_a_torso_is_no_neighbour_of_the_shoulder_beside_it() -> None:
    model = chain([TURN(), TURN(), TURN()])
    torso, head, shoulder = unit(2), unit(2)._replace(beside=True), unit(3)
    assert neighbours(model, torso, shoulder)
    assert not neighbours(model, head, shoulder)
    assert neighbours(model, head, torso)


@pytest.mark.parametrize("met", [0, 3, 8])
def test_body_with_too_few_reached_points_encloses_whole_links(met: int) -> None:
    corners = np.array(np.meshgrid([-0.1, 0.1], [-0.1, 0.1], [-0.1, 0.1])).reshape(3, -1).T
    units = tuple(
        Unit(k, f"link{k}", (f"link{k}",), k, (), corners, np.zeros(len(corners), dtype=int))
        for k in range(3)
    )
    empty = np.zeros((0, 3))
    reached = {(2, 0): np.arange(len(corners)) < met}
    postures = Postures(empty, empty, np.zeros(0, dtype=bool))
    meetings = Meetings(units, (), frozenset(), frozenset(), postures, postures, reached)
    body = ArmFitter(chain([TURN(), TURN()]), meetings).bodies([[1], [2]])[1]
    assert body.links == ("link2",)
    assert body.fits[0].volume == pytest.approx(0.2**3, rel=0.02)
    assert np.isfinite(body.fits[0].over_cover)


@pytest.mark.parametrize(("apart", "shapes"), [(0.3, 2), (0.02, 1)])
def test_distant_parts_of_one_link_have_separate_shapes(apart: float, shapes: int) -> None:
    """One shape around both would fill the space between them, where the link is bare."""
    cube = np.array(np.meshgrid([0.0, 0.04], [0.0, 0.04], [0.0, 0.04])).reshape(3, -1).T
    points = np.vstack([cube, cube + np.array([0.0, 0.0, 0.04 + apart])])
    units = tuple(
        Unit(k, f"link{k}", (f"link{k}",), k, (), points, np.zeros(len(points), dtype=int))
        for k in range(3)
    )
    empty = np.zeros((0, 3))
    postures = Postures(empty, empty, np.zeros(0, dtype=bool))
    reached = {(2, 0): np.ones(len(points), dtype=bool)}
    meetings = Meetings(units, (), frozenset(), frozenset(), postures, postures, reached)
    body = ArmFitter(chain([TURN(), TURN()]), meetings).bodies([[1], [2]])[1]
    assert len(body.fits) == shapes
    assert sum(fit.volume for fit in body.fits) < 3.0 * 2 * 0.04**3


def test_surface_points_of_a_gripper_include_its_fingertip() -> None:
    """Without them the body that encloses the surface points could leave out the fingertip."""
    palm, finger = trimesh.creation.icosphere(3, 0.05), trimesh.creation.box((0.01, 0.01, 0.1))
    finger.apply_translation((0.0, 0.0, 0.15))
    shapes = tuple(LinkShape(mesh, mesh, "mesh", None) for mesh in (palm, finger))
    model = husky_panda()
    covers = {
        link: LinkGeometry((), False) for each in model.description.bodies for link in each.covers
    }
    found = units_of_links(model, covers | {"panda_hand": LinkGeometry(shapes, False)})["lEE"]
    hand = found[-1]
    assert len(hand.surface) < len(LinkGeometry(shapes, False).surface)
    D = directions(2)
    corners = np.vstack([part.corners for part in hand.parts])
    beyond = (corners @ D.T).max(axis=0) - (hand.surface @ D.T).max(axis=0)
    assert beyond.max() < 1e-9


def test_shape_distances_agree_with_the_library_up_to_half_a_metre(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Larger distances are only certain to be at least 0.5 m."""
    monkeypatch.setattr(units, "_MANY", 0)
    model = husky_panda()
    names, every = model.body_names, candidate_pairs(model)
    shapes = [[model.geometry.geometryObjects[k] for k in model.shape_ids[name]] for name in names]
    groups = [[(s.parentJoint, s.placement, s.geometry) for s in group] for group in shapes]
    pairs = [(names.index(pair.a), names.index(pair.b)) for pair in every]
    q_m = sample_joints(model, 100, np.random.default_rng(0))
    ours = shape_distances(model, groups, pairs, q_m)
    theirs = PairDistances(model, every).sampled(q_m)
    near = theirs < 0.5
    assert near.any()
    assert not near.all()
    np.testing.assert_allclose(ours[near], theirs[near], atol=1e-5)
    assert (ours[~near] >= 0.5 - 1e-5).all()
    closer = shape_distances(model, groups, pairs, q_m, 0.1)
    near = theirs < 0.1
    np.testing.assert_allclose(closer[near], theirs[near], atol=1e-5)
    assert (closer[~near] >= 0.1 - 1e-5).all()


def test_hull_of_a_part_is_built_once() -> None:
    """The search for rare contacts needs the hulls of two units hundreds of times."""
    corners = np.random.default_rng(0).uniform(-0.1, 0.1, (30, 3))
    part = Part("link", corners, np.zeros(0))
    model = husky_panda()
    equal = (part, part._replace(corners=corners.copy()))
    (one,), (two,) = (hulls(model, unit(2)._replace(parts=(each,))) for each in equal)
    assert one[2] is two[2]
    assert one[2].computeVolume() == pytest.approx(hull(corners).volume)


def test_a_fit_that_is_worse_than_a_constant_uses_more_of_the_reachability() -> None:
    """A Racecar with an SO-101, whose few shells were almost equal, had an R² of -304."""
    points = 0.08 * lattice(0.6, 0.08)
    rho = np.linalg.norm(points, axis=1)

    def counted(best: float, width: float) -> ReachMap:
        reach = 100 * np.exp(-(((rho - best) / width) ** 2))
        return ReachMap("lEE", points, reach, 1, reach, np.zeros(3), 0.08, 0, ())

    narrow = counted(0.21, 0.045)
    assert fit_reachability(narrow, SHARES[0]).r_squared < 0.0
    fit, share = best_fit(narrow)
    assert share < SHARES[0]
    assert fit.r_squared > 0.9
    assert fit.B_m == pytest.approx(0.21, abs=0.01)
    assert best_fit(counted(0.3, 0.2))[1] == SHARES[0]
    with pytest.raises(DescriptionError):
        fit_reachability(counted(0.1, 0.07), SHARES[0])
    assert best_fit(counted(0.1, 0.07))[0].r_squared > 0.9
    with pytest.raises(DescriptionError, match="a constant fits the reachability map better"):
        best_fit(counted(0.5, 0.03))
