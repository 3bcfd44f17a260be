"""The border as a surface: it is the exact offset, and the acting point moves without jumps."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.avoidance.acting_point import ActingPointFinder, avoidance_force, resultant_force
from app.border.cache import BorderData
from app.border.dbb import Border, construct_dbb
from app.border.mobile import MobileBody
from app.border.nearest import OffsetContours
from app.border.offset import offset_contours
from app.border.score import ScoreField
from app.config import ForceConfig
from app.robot.model import RobotModel
from tests.nearest import BorderSearch

D_B = 0.15  # [m]
FORCE = ForceConfig()


@pytest.fixture(scope="module")
def offset(robot: RobotModel) -> OffsetContours:
    return offset_contours(robot, D_B)


@pytest.fixture(scope="module")
def surface(offset: OffsetContours) -> BorderSearch:
    return BorderSearch(offset)


@pytest.fixture(scope="module")
def border(border_data: BorderData) -> Border:
    return construct_dbb(border_data.clouds["lm-lEE"], D_B, 0.01)


@pytest.fixture(scope="module")
def points(border: Border, offset: OffsetContours) -> BorderSearch:
    return BorderSearch(offset, [border])


def random_path(seed: int, steps: int) -> np.ndarray:
    """(steps, 3) [m] smooth path inside the buffer along the base's side towards a front corner.

    The base is 0.99 m long, 0.69 m wide, and its top is 0.38 m above the floor.
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


def test_surface_deviates_less_than_two_millimetres_from_exact_offset(
    robot: RobotModel, surface: BorderSearch
) -> None:
    """Random points include those between heights and rays, and near edges."""
    rng = np.random.default_rng(0)
    body = MobileBody(robot)
    box = np.array([0.75, 0.6, 0.0]), np.array([0.0, 0.0, body.upper[2] + 0.99 * D_B])
    points = rng.uniform([-box[0][0], -box[0][1], 0.02], [*box[0][:2], box[1][2]], (2000, 3))
    feet = np.array([foot.p for p in points if (foot := surface.nearest(p)) is not None])
    assert len(feet) == len(points)
    assert np.abs(body.distance(feet) - D_B).max() < 0.002


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_acting_point_is_continuous_on_the_surface_but_not_on_points(
    points: BorderSearch, surface: BorderSearch, robot: RobotModel, seed: int
) -> None:
    """Ten times finer sampling divides the largest step by > 8 (surface) and < 4 (points)."""
    field = ScoreField.of(robot, "lEE")
    coarse, fine = random_path(seed, 4001), random_path(seed, 40001)
    ratios = {}
    for border, last in ((surface, None), (points, 20001)):
        finder = ActingPointFinder(border.struct, field)
        ratios[border] = largest_step(acting_points(finder, coarse)) / largest_step(
            acting_points(finder, fine[:last])
        )
    assert ratios[surface] > 8.0
    assert ratios[points] < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_desired_acceleration_jumps_20_times_less_with_surface_than_points(
    points: BorderSearch, surface: BorderSearch, robot: RobotModel, seed: int
) -> None:
    field, base = ScoreField.of(robot, "lEE"), robot.description.base
    largest = {}
    for border in (surface, points):
        finder = ActingPointFinder(border.struct, field)
        accelerations = []
        for p_b in random_path(seed, 4001):
            d = abs(p_b[1]) - 0.345
            acting = finder.find_acting_point(p_b, d, FORCE)
            assert acting is not None
            n = np.array([0.0, np.sign(p_b[1]), 0.0])
            f = avoidance_force(p_b, acting.p_act, d, n, FORCE.f_max, D_B)
            accelerations.append(base.A_b @ resultant_force(f[None], acting.p_act[None]))
        largest[border] = largest_step(np.array(accelerations))
    assert largest[surface] * 20.0 < largest[points]


@given(
    x=st.floats(-0.6, 0.6),
    y=st.floats(-0.5, 0.5),
    z=st.floats(0.0, 0.39),
    direction=st.floats(0.0, 2 * np.pi),
    climb=st.floats(-1.0, 1.0),
)
def test_nearest_point_of_the_surface_changes_continuously(
    surface: BorderSearch,
    robot: RobotModel,
    x: float,
    y: float,
    z: float,
    direction: float,
    climb: float,
) -> None:
    """The medial axes are excluded: inside the base and above its top.

    Around an edge at distance d, the nearest point moves by the factor d_b/d, and its tangent turns
    by 1/d [rad/m].
    """
    step = 1e-5 * np.array([np.cos(direction), np.sin(direction), climb])
    p = np.array([x, y, z])
    (d,) = MobileBody(robot).distance(p[None])
    if not 0.01 < d < 0.14 or max(abs(x) - 0.495, abs(y) - 0.345) < 0.01:
        return
    before, after = surface.nearest(p), surface.nearest(p + step)
    assert before is not None
    assert after is not None
    assert np.linalg.norm(after.p - before.p) < D_B / 0.01 * np.linalg.norm(step)
    assert np.linalg.norm(after.t - before.t) < 1 / 0.01 * np.linalg.norm(step) + 1e-9


@pytest.mark.parametrize("depth", [0.03, 0.07, 0.12])
def test_nearest_point_moves_around_an_edge_without_a_jump(
    surface: BorderSearch, depth: float
) -> None:
    """Around a vertical edge the border is an arc of radius d_b."""
    turn = np.linspace(-0.05, np.pi / 2 + 0.05, 20001)
    round_edge = (D_B - depth) * np.column_stack([np.cos(turn), np.sin(turn), 0 * turn])
    feet = np.array([surface.nearest(np.array([0.495, 0.345, 0.2]) + p).p for p in round_edge])
    ratio = largest_step(feet) / largest_step(round_edge)
    assert ratio < 1.3 * D_B / (D_B - depth)


def test_surface_is_symmetric_about_the_midplane_of_the_base(surface: BorderSearch) -> None:
    rng = np.random.default_rng(1)
    for p in rng.uniform([-0.6, 0.35, 0.0], [0.6, 0.49, 0.3], (50, 3)):
        left, right = surface.nearest(p), surface.nearest(p * [1, -1, 1])
        assert left is not None
        assert right is not None
        np.testing.assert_allclose(left.p * [1, -1, 1], right.p, atol=1e-6)
        np.testing.assert_allclose(left.t * [-1, 1, 1], right.t, atol=1e-4)
