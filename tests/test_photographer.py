"""Pictures of the robot: content, motion with base and arm, and projection of points."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import closing

import numpy as np
import pytest
import trimesh

from app.robot.model import RobotModel
from app.simulation.photographer import Camera, Photographer, Picture, Solid

YELLOW, RED = (1.0, 0.9, 0.0, 1.0), (0.9, 0.0, 0.0, 1.0)
CAMERA = Camera(np.array([0.1, 0.0, 0.4]), 6.0, 0.8, 0.4, 200, 180)
ORIGIN = (0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def photographer(robot: RobotModel) -> Iterator[Photographer]:
    with closing(Photographer(robot)) as photographer:
        yield photographer


@pytest.fixture
def ready(robot: RobotModel) -> np.ndarray:
    return np.array(robot.description.arm.ready_position)


def middle(mask: np.ndarray) -> np.ndarray:
    """Mean column and row of a mask."""
    return np.argwhere(mask).mean(axis=0)[::-1]


def red(picture: Picture) -> np.ndarray:
    r, g, b = np.moveaxis(picture.rgb.astype(int), -1, 0)
    return (r - g > 60) & (r - b > 60)


def test_the_picture_has_the_robot_on_a_white_floor(photographer, ready):
    picture = photographer.take(ORIGIN, ready, CAMERA)
    assert picture.rgb.shape == (180, 200, 3)
    share = np.mean(~picture.floor)
    assert 0.05 < share < 0.8
    assert picture.rgb[~picture.floor].std() > 30 > picture.rgb[picture.floor].std()
    assert np.median(picture.rgb[picture.floor]) == 255


def test_the_robot_moves_in_the_picture_by_the_projected_base_motion(photographer, ready):

    pictures = [photographer.take((x, 0.0, 0.0), ready, CAMERA) for x in (-0.2, 0.2)]
    moved = middle(~pictures[1].floor) - middle(~pictures[0].floor)
    ends = pictures[0].pixels(np.array([[-0.2, 0.0, 0.4], [0.2, 0.0, 0.4]]))
    np.testing.assert_allclose(moved, ends[1] - ends[0], atol=4.0)
    assert np.linalg.norm(moved) > 10.0


def test_the_arm_moves_in_the_picture(photographer, ready):
    turned = ready.copy()
    turned[0] += 1.0
    pictures = [photographer.take(ORIGIN, q_m, CAMERA).rgb.astype(int) for q_m in (ready, turned)]
    assert np.mean(np.abs(pictures[1] - pictures[0]).max(axis=-1) > 40) > 0.01


@pytest.mark.parametrize("place", [(0.9, 0.5, 0.3), (0.6, -0.7, 0.8), (1.0, 0.9, 0.1)])
def test_a_point_is_projected_to_its_drawn_pixel(photographer, ready, place):
    ball = trimesh.creation.icosphere(3, 0.05).apply_translation(place)
    picture = photographer.take(ORIGIN, ready, CAMERA, [Solid(ball, RED)], robot=False)
    np.testing.assert_allclose(picture.pixels(np.array(place))[0], middle(red(picture)), atol=1.0)


def test_solids_do_not_stay_for_the_next_picture(photographer, ready):
    box = trimesh.creation.box((0.4, 0.4, 0.4)).apply_translation([0.9, 0.4, 0.2])
    with_box = photographer.take(ORIGIN, ready, CAMERA, [Solid(box, RED)])
    assert red(with_box).sum() > 100
    with pytest.raises(AttributeError):
        photographer.take(ORIGIN, ready, CAMERA, [Solid(box, RED), Solid(None, RED)])
    assert red(photographer.take(ORIGIN, ready, CAMERA)).sum() == 0


def test_without_the_robot_the_picture_has_only_floor(photographer, ready):
    assert photographer.take(ORIGIN, ready, CAMERA, robot=False).floor.all()


def test_the_floor_is_hidden_under_the_base_and_visible_beside_it(photographer, ready):
    picture = photographer.take(ORIGIN, ready, CAMERA)
    points = np.array([[0.0, 0.0, 0.0], [0.9, 0.9, 0.0], [100.0, 0.0, 0.0]])
    assert picture.unhidden(points).tolist() == [False, True, False]


def test_framing_fills_the_picture_with_the_points(photographer):
    points = np.random.default_rng(0).uniform([-1, -1, 0], [2, 1, 1.2], (40, 3))
    camera = CAMERA.framing(points, margin=0.1)
    view, projection = camera.matrices()
    empty = np.ones((camera.height, camera.width), bool)
    at = Picture(np.zeros((*empty.shape, 3), np.uint8), empty, projection @ view).pixels(points)
    size = np.array([camera.width, camera.height])
    assert (at >= 0.07 * size).all()
    assert (at <= 0.93 * size).all()
    assert (np.ptp(at, axis=0) / size).max() == pytest.approx(0.8, abs=0.02)


def test_the_same_posture_gives_the_same_picture(photographer, ready):
    first, second = (photographer.take(ORIGIN, ready, CAMERA).rgb for _ in range(2))
    np.testing.assert_array_equal(first, second)


def test_a_second_close_raises_no_error(robot: RobotModel):
    photographer = Photographer(robot)
    photographer.close()
    photographer.close()
