"""Laws of the border as a surface: it is the exact offset, and nothing on it jumps."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.avoidance.mobile_acceleration import (
    ActingPointFinder,
    PairForce,
    avoidance_force,
    generate_mob_acc,
)
from app.border.cache import BorderData
from app.border.dbb import Border, construct_dbb
from app.border.mobile import MobileBody
from app.border.offset import RAYS, OffsetContours, ray_from
from app.border.score import ScoreField
from app.border.surface import (
    STEEPEST_GAP,
    BorderPoints,
    BorderSurface,
    Gap,
    find_reached,
    without_leaps,
)
from app.config import ForceConfig
from app.robot.model import RobotModel
from app.robot.shapes import Box

D_B = 0.15  # [m]
FORCE = ForceConfig()


@pytest.fixture(scope="module")
def offset(robot: RobotModel) -> OffsetContours:
    return OffsetContours(robot, D_B)


@pytest.fixture(scope="module")
def border(border_data: BorderData) -> Border:
    return construct_dbb(border_data.clouds["lm-lEE"], D_B, 0.01)


@pytest.fixture(scope="module")
def surface(border: Border, offset: OffsetContours) -> BorderSurface:
    return BorderSurface(border, offset)


def hand_path(seed: int, steps: int) -> np.ndarray:
    """(steps, 3) [m] a smooth path inside the buffer along the base's flank and front corner.

    The base is 0.99 m by 0.69 m by 0.248 m.
    """
    rng = np.random.default_rng(seed)
    s = np.linspace(0.0, 1.0, steps)
    phase, side = rng.uniform(0, 2 * np.pi, 3), rng.choice([-1.0, 1.0])
    x = -0.2 + 0.6 * s + 0.03 * np.sin(2 * np.pi * s + phase[0])
    y = side * (0.345 + 0.08 + 0.05 * np.sin(4 * np.pi * s + phase[1]))
    z = 0.2 + 0.04 * np.sin(2 * np.pi * s + phase[2])
    return np.column_stack([x, y, z])


def largest_step(values: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(values, axis=0), axis=1).max())


def acting_points(finder: ActingPointFinder, path: np.ndarray) -> np.ndarray:
    found = [finder.find_acting_point(p, abs(p[1]) - 0.345, FORCE) for p in path]
    return np.array([acting.p_act for acting in found if acting is not None])


def test_the_surface_is_within_two_millimetres_of_the_exact_offset(
    robot: RobotModel, surface: BorderSurface
) -> None:
    """Between heights and rays too, edges included."""
    rng = np.random.default_rng(0)
    body = MobileBody(robot)
    box = np.array([0.75, 0.6, 0.0]), np.array([0.0, 0.0, body.upper[2] + 0.99 * D_B])
    points = rng.uniform([-box[0][0], -box[0][1], 0.02], [*box[0][:2], box[1][2]], (2000, 3))
    feet = np.array([foot.p for p in points if (foot := surface.nearest(p)) is not None])
    assert len(feet) == len(points)
    assert np.abs(body.distance(feet) - D_B).max() < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_the_acting_point_is_continuous_on_the_surface_and_not_on_the_points(
    border: Border, offset: OffsetContours, robot: RobotModel, seed: int
) -> None:
    """On a path sampled ten times finer its largest step is at least eight times smaller."""
    field = ScoreField.of(robot, "lEE")
    coarse, fine = hand_path(seed, 4001), hand_path(seed, 40001)
    ratios = {}
    for shape in (BorderSurface, BorderPoints):
        finder = ActingPointFinder(shape(border, offset), field)
        ratios[shape] = largest_step(acting_points(finder, coarse)) / largest_step(
            acting_points(finder, fine[: 20001 if shape is BorderPoints else None])
        )
    assert ratios[BorderSurface] > 8.0
    assert ratios[BorderPoints] < 4.0


@pytest.mark.parametrize("seed", range(4))
def test_the_desired_acceleration_jumps_twenty_times_less_than_with_the_points(
    border: Border, offset: OffsetContours, robot: RobotModel, seed: int
) -> None:
    field, base = ScoreField.of(robot, "lEE"), robot.description.base
    largest = {}
    for shape in (BorderSurface, BorderPoints):
        finder = ActingPointFinder(shape(border, offset), field)
        accelerations = []
        for p_b in hand_path(seed, 4001):
            d = abs(p_b[1]) - 0.345
            acting = finder.find_acting_point(p_b, d, FORCE)
            assert acting is not None
            n = np.array([0.0, np.sign(p_b[1]), 0.0])
            f = avoidance_force(p_b, acting.p_act, d, n, FORCE.f_max, D_B)
            forces = [PairForce(f, acting.p_act)]
            accelerations.append(generate_mob_acc(forces, base))
        largest[shape] = largest_step(np.array(accelerations))
    assert largest[BorderSurface] * 20.0 < largest[BorderPoints]


@settings(max_examples=60, deadline=None)
@given(
    x=st.floats(-0.6, 0.6),
    y=st.floats(-0.5, 0.5),
    z=st.floats(0.0, 0.39),
    direction=st.floats(0.0, 2 * np.pi),
    climb=st.floats(-1.0, 1.0),
)
def test_near_points_outside_the_base_have_near_feet(
    surface: BorderSurface,
    robot: RobotModel,
    x: float,
    y: float,
    z: float,
    direction: float,
    climb: float,
) -> None:
    """Away from medial axes: inside the base, over its top, and in the middle of a gap."""
    step = 1e-5 * np.array([np.cos(direction), np.sin(direction), climb])
    p = np.array([x, y, z])
    (d,) = MobileBody(robot).distance(p[None])
    if not 0.01 < d < 0.14 or max(abs(x) - 0.495, abs(y) - 0.345) < 0.01 or x < -0.4:
        return
    before, after = surface.nearest(p), surface.nearest(p + step)
    assert before is not None
    assert after is not None
    assert np.linalg.norm(after.p - before.p) < 40 * np.linalg.norm(step)
    assert np.linalg.norm(after.t - before.t) < 200 * np.linalg.norm(step) + 1e-9


@pytest.mark.parametrize("depth", [0.03, 0.07, 0.12])
def test_the_foot_walks_around_an_edge_without_a_jump(surface: BorderSurface, depth: float) -> None:
    """Around the vertical edge the border is an arc of radius d_b; the foot is that much faster."""
    turn = np.linspace(-0.05, np.pi / 2 + 0.05, 20001)
    round_edge = (D_B - depth) * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    feet = np.array([surface.nearest(np.array([0.495, 0.345, 0.2]) + p).p for p in round_edge])
    ratio = largest_step(feet) / largest_step(round_edge)
    assert ratio < 1.3 * D_B / (D_B - depth)


def test_left_and_right_are_mirror_images_where_the_contour_is_closed(
    offset: OffsetContours,
) -> None:
    empty = Border("lm-door", D_B, 0.01, np.zeros((0, 3)), np.zeros(0))
    surface = BorderSurface(empty, offset)
    rng = np.random.default_rng(1)
    for p in rng.uniform([-0.6, 0.35, 0.0], [0.6, 0.49, 0.3], (50, 3)):
        left, right = surface.nearest(p), surface.nearest(p * [1, -1, 1])
        assert left is not None
        assert right is not None
        np.testing.assert_allclose(left.p * [1, -1, 1], right.p, atol=1e-6)
        np.testing.assert_allclose(left.t * [-1, 1, 1], right.t, atol=1e-4)


def test_the_contour_is_open_where_the_arm_never_is_and_nowhere_else(
    border: Border, offset: OffsetContours
) -> None:
    """Behind the base at low heights; each border point's own place is kept."""
    rings = offset.rings[0]
    k = int(np.searchsorted(rings.heights, 0.2))
    reached = find_reached(border, offset)[k]
    open_ = np.flatnonzero(reached[:-1] < 0.0)
    assert len(open_) > 90
    assert open_.mean() == pytest.approx(RAYS / 2, abs=10.0)
    points = border.same_height(float(rings.heights[k]), 0.004)[:, :2]
    rays = ray_from(points, rings.centres[k])
    assert (np.interp(rays, np.arange(RAYS + 1), reached) >= 0.0).all()


def test_the_gaps_of_a_single_shape_are_those_that_a_second_one_hidden_in_it_leaves(
    border: Border, offset: OffsetContours, robot: RobotModel
) -> None:
    """One convex shape is a union of one."""
    inner = Box(type="box", size_m=(0.3, 0.2, 0.1), xyz_m=(0.0, 0.0, 0.1))
    doubled = OffsetContours(RobotModel(robot.description.with_mobile_shapes(inner)), D_B)
    np.testing.assert_array_equal(find_reached(border, doubled), find_reached(border, offset))


def test_in_a_gap_the_foot_is_the_end_of_the_contour(surface: BorderSurface) -> None:
    left, right = (surface.nearest(np.array([-0.6, side * 0.1, 0.15])) for side in (1.0, -1.0))
    assert left is not None
    assert right is not None
    assert left.p[1] > 0.3
    assert right.p[1] < -0.3


def test_the_order_and_number_of_points_do_not_matter_where_all_is_reached(
    border: Border, offset: OffsetContours
) -> None:
    half = Border(border.pair, D_B, 0.01, border.points[::2], border.heights[::2])
    whole, thinned = BorderSurface(border, offset), BorderSurface(half, offset)
    for x in (0.0, 0.1, 0.3, 0.49):
        p = np.array([x, 0.43, 0.2])
        a, b = whole.nearest(p), thinned.nearest(p)
        assert a is not None
        assert b is not None
        np.testing.assert_array_equal(a.p, b.p)


def random_gaps(rng: np.random.Generator, heights: np.ndarray) -> list[list[Gap] | None]:
    """None or a gap at each height, some of them over the first ray, told from 1 m up to 2 m."""
    starts, widths = rng.uniform(0, RAYS, len(heights)), rng.uniform(1, 300, len(heights))
    return [
        None
        if not 1.0 <= z <= 2.0 or rng.random() < 0.2
        else []
        if rng.random() < 0.1
        else [Gap(a, a + w)]
        for z, a, w in zip(heights, starts, widths, strict=True)
    ]


def rays_of(gaps: list[Gap]) -> set[int]:
    return {int(ray) % RAYS for gap in gaps for ray in np.arange(np.ceil(gap.first), gap.last)}


@pytest.mark.parametrize("seed", range(20))
def test_gaps_only_get_narrower_and_no_end_leaps(seed: int) -> None:
    rng = np.random.default_rng(seed)
    heights = np.cumsum(rng.uniform(0.001, 0.06, 60))
    given = random_gaps(rng, heights)
    told = [k for k, gaps in enumerate(given) if gaps is not None]
    found = without_leaps(given, heights, RAYS)
    for k, (gaps, before) in enumerate(zip(found, given, strict=True)):
        assert before is None or rays_of(gaps) <= rays_of(before)
        assert told[0] <= k <= told[-1] or not gaps  # beyond what is told nothing is open
        for beside in (k - 1, k + 1):
            if gaps and 0 <= beside < len(found):
                further = STEEPEST_GAP * abs(heights[k] - heights[beside])
                (gap,) = gaps
                reach = max(
                    [
                        min(gap.last, o.last + t) - max(gap.first, o.first + t)
                        for o in found[beside]
                        for t in (-RAYS, 0, RAYS)
                    ],
                    default=0.0,
                )
                wide = gap.last - gap.first
                assert wide <= max(reach, 0.0) + 2 * further + 1e-9


def test_a_height_that_tells_nothing_between_two_others_does_not_close_the_gap() -> None:
    heights = np.linspace(0.1, 0.5, 9)
    wide = [Gap(100.0, 300.0)]
    found = without_leaps([wide] * 4 + [None] + [wide] * 4, heights, RAYS)
    assert found[4] == wide
    assert without_leaps([wide] * 4 + [[]] + [wide] * 4, heights, RAYS)[3] != wide
