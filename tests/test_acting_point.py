"""Properties of the acting point: Algorithm 3, (12) and (13)."""

from itertools import pairwise

import numpy as np
import pytest

from app.avoidance.acting_point import ActingPointFinder, step_size, tangential_step
from app.border.dbb import Border
from app.border.nearest import OffsetContours, border_struct
from app.border.offset import offset_contours
from app.border.score import ScoreField
from app.config import ForceConfig
from app.robot.model import RobotModel

D_B = 0.15  # [m]
FORCE = ForceConfig()


@pytest.fixture(scope="module")
def offset(robot: RobotModel) -> OffsetContours:
    return offset_contours(robot, D_B)


@pytest.fixture(scope="module")
def field(robot: RobotModel) -> ScoreField:
    return ScoreField.of(robot, "lEE")


def dense_border(offset: OffsetContours, step: float = 0.002) -> Border:
    """Points every 2 mm along the exact contours every 4 mm of height."""
    points = []
    for z in np.arange(0.02, 0.36, 0.004):
        (ring,) = offset.contours(float(z))
        for a, b in pairwise(ring):
            n = max(int(np.linalg.norm(b - a) / step), 1)
            points += [(*(a + (b - a) * k / n), z) for k in range(n)]
    array = np.array(points)
    return Border("lm-lEE", D_B, 0.01, array)


@pytest.fixture(scope="module", params=["points", "surface"])
def finder(
    request: pytest.FixtureRequest, offset: OffsetContours, field: ScoreField
) -> ActingPointFinder:
    borders = [dense_border(offset)] if request.param == "points" else []
    return ActingPointFinder(border_struct(offset, borders), field)


def alpha(d: float, score: float, force: ForceConfig) -> float:
    """[m] the step size (13) for the distance d [m] and a score, with the parameters `force`."""
    return step_size(d, score, force.alpha_gain, force.alpha_min, force.alpha_max)


def on_side(x: float, side: float, d: float, z: float = 0.2) -> np.ndarray:
    """(3,) [m] the point (x, y, z) at d [m] from the base's left (`side` 1) or right (−1) side."""
    return np.array([x, side * (0.345 + d), z])


@pytest.mark.parametrize("x", [-0.3, -0.05, 0.0, 0.05, 0.2])
@pytest.mark.parametrize("side", [-1.0, 1.0])
@pytest.mark.parametrize("d", [0.02, 0.08, 0.12])
def test_acting_point_is_on_the_border_at_equal_height_and_not_behind_p_n(
    finder: ActingPointFinder, x: float, side: float, d: float
) -> None:
    p_b = on_side(x, side, d)
    acting = finder.find_acting_point(p_b, d, FORCE)
    assert acting is not None
    for p in (acting.p_n, acting.p_act):
        assert p[2] == p_b[2]
        assert abs(p[1]) == pytest.approx(0.345 + D_B, abs=0.003)
    assert acting.p_n[0] == pytest.approx(x, abs=0.004)
    assert acting.p_act[0] >= acting.p_n[0]
    assert FORCE.alpha_min <= acting.alpha <= FORCE.alpha_max


@pytest.mark.parametrize("x", [-1e-3, -1e-9, 0.0, 1e-9, 1e-3])
def test_step_on_the_wheel_axis_is_twice_the_distance_forward(
    finder: ActingPointFinder, x: float
) -> None:
    acting = finder.find_acting_point(on_side(x, 1.0, 0.05), 0.05, FORCE)
    assert acting is not None
    assert acting.p_act[0] - acting.p_n[0] == pytest.approx(0.10, abs=0.01)


def test_acting_points_left_and_right_are_mirror_images(finder: ActingPointFinder) -> None:
    left = finder.find_acting_point(on_side(0.2, 1.0, 0.07), 0.07, FORCE)
    right = finder.find_acting_point(on_side(0.2, -1.0, 0.07), 0.07, FORCE)
    assert left is not None
    assert right is not None
    np.testing.assert_allclose(left.p_act * [1, -1, 1], right.p_act, atol=0.004)


def test_exact_offset_replaces_a_height_without_border_points(
    offset: OffsetContours, field: ScoreField
) -> None:
    empty = Border("lm-lEE", D_B, 0.01, np.zeros((0, 3)))
    finder = ActingPointFinder(border_struct(offset, [empty]), field)
    acting = finder.find_acting_point(on_side(0.1, 1.0, 0.05), 0.05, FORCE)
    assert acting is not None
    assert acting.p_n[1] == pytest.approx(0.345 + D_B, abs=1e-4)


@pytest.mark.parametrize("z", [-0.02, -1e-9, 0.0, 0.38, 0.531])
def test_every_height_inside_the_buffer_has_an_acting_point(
    finder: ActingPointFinder, z: float
) -> None:
    """Without an acting point, β would rise without a force, and the base would only brake."""
    acting = finder.find_acting_point(on_side(0.1, 1.0, 0.05, z), 0.05, FORCE)
    assert acting is not None
    assert acting.p_act[2] == z
    assert np.isfinite(acting.p_act).all()


@pytest.mark.parametrize("beyond", [0.0, 0.003, -0.003])
def test_tangent_at_a_point_on_the_border_is_along_the_contour(
    finder: ActingPointFinder, beyond: float
) -> None:
    d = D_B + beyond
    acting = finder.find_acting_point(on_side(0.2, 1.0, d), d, FORCE)
    assert acting is not None
    assert abs(acting.t[0]) == pytest.approx(1.0, abs=1e-3)


def test_tangent_is_a_horizontal_unit_vector_normal_to_p_n_minus_p_b(
    finder: ActingPointFinder,
) -> None:
    p_b = np.array([0.54, 0.38, 0.2])  # beside the front left corner
    acting = finder.find_acting_point(p_b, 0.06, FORCE)
    assert acting is not None
    assert np.linalg.norm(acting.t) == pytest.approx(1.0)
    assert acting.t[2] == 0.0
    along = (acting.p_n - p_b) / np.linalg.norm(acting.p_n - p_b)
    assert acting.t @ along == pytest.approx(0.0, abs=2e-3)


def test_step_size_is_proportional_to_d_over_score_within_its_bounds() -> None:
    force = ForceConfig(alpha_gain=0.001, alpha_min=0.0)
    assert alpha(0.1, 1.0, force) == pytest.approx(0.0001, rel=0.002)
    assert alpha(0.1, -1.0, force) == alpha(0.1, 1.0, force)
    assert alpha(0.05, 1.0, force) == pytest.approx(alpha(0.1, 1.0, force) / 2)
    assert alpha(0.1, 2.0, force) == pytest.approx(alpha(0.1, 1.0, force) / 2, rel=0.002)
    assert alpha(1.0, 0.0, force) == force.alpha_max
    for d, score in ((0.1, 1e9), (-0.1, 0.002)):
        assert alpha(d, score, FORCE) == FORCE.alpha_min


def test_step_size_changes_at_most_twice_as_fast_as_the_distance() -> None:
    """On the wheel axis d / |S| is 0/0, and the quotient alone would jump between its bounds."""
    d = np.linspace(-0.01, D_B, 161)
    for score in (0.0, 1e-6, 1e-4, 1e-3, 1e-2):
        steps = [alpha(each, score, FORCE) for each in d]
        assert np.abs(np.diff(steps)).max() <= 2.0 * (d[1] - d[0]) * (1 + 1e-9)
    assert alpha(0.1, 0.0, ForceConfig(alpha_gain=0.0)) == FORCE.alpha_min


def test_the_step_is_the_gradients_share_along_the_tangent() -> None:
    t = np.array([0.0, 1.0, 0.0])
    gradient = np.array([3.0, -4.0, 0.0])
    np.testing.assert_allclose(tangential_step(gradient, t, 0.1), [0.0, -0.08, 0.0])
    np.testing.assert_allclose(tangential_step(gradient, -t, 0.1), [0.0, -0.08, 0.0])
    forward = tangential_step(np.zeros(3), np.array([1.0, 0.0, 0.0]), 0.1)
    np.testing.assert_allclose(forward, [0.1, 0.0, 0.0])
