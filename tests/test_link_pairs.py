"""The pairs of bodies that can collide (§2.1)."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from app.robot.link_pairs import Pair, PairDistances, candidate_pairs, find_link_pairs
from app.robot.model import RobotModel
from app.robot.shapes import Shape, Sphere
from tests.robots import husky_panda


@pytest.fixture(scope="module")
def model() -> RobotModel:
    return husky_panda()


@pytest.mark.parametrize("seed", range(10))
def test_every_seed_finds_exactly_the_pairs_of_the_paper(model, seed):
    found = find_link_pairs(model, samples=20_000, seed=seed)
    assert [pair.name for pair in found.mobile] == ["lm-lEE", "lm-l3"]
    assert [pair.name for pair in found.manipulator] == ["l1-lEE", "l1-l3", "l2-lEE"]
    assert [pair.name for pair in found.never] == ["lm-l2"]
    assert [pair.name for pair in found.all] == [p.name for p in found.mobile + found.manipulator]


def test_default_sampling_reproduces_the_rates_and_the_clearance_of_l2(model):
    found = find_link_pairs(model)
    expected = {"lm-lEE": 0.072, "lm-l3": 0.032, "l1-lEE": 0.073, "l1-l3": 0.042, "l2-lEE": 0.016}
    for name, rate in expected.items():
        assert found.rates[name] == pytest.approx(rate, abs=0.003)
    assert found.rates["lm-l2"] == 0.0
    assert found.least_distance_m["lm-l2"] == pytest.approx(0.237, abs=0.001)


def test_same_seed_finds_the_same_pairs(model):
    assert find_link_pairs(model, samples=300, seed=4) == find_link_pairs(
        model, samples=300, seed=4
    )


def test_neighbours_are_no_candidates_and_outer_bodies_come_first(model):
    names = [pair.name for pair in candidate_pairs(model)]
    assert names == ["lm-lEE", "lm-l3", "lm-l2", "l1-lEE", "l1-l3", "l2-lEE"]


def test_distances_agree_with_the_capsules_segment_and_the_box(model):
    """The reference: the smallest distance of 20,001 points of the axis from the box, minus r."""
    reader = PairDistances(model, [Pair("lm", "lEE")])
    data = model.pin.createData()
    last = model.description.body("lEE")
    capsule, frame = last.shapes[0], model.pin.getFrameId(last.frame)
    axis = np.linspace(capsule.start_m, capsule.end_m, 20_001)
    rng = np.random.default_rng(1)
    for q_m in rng.uniform(model.q_lower, model.q_upper, (50, 7)):
        q = model.configuration((0, 0, 0), q_m)
        pin.framesForwardKinematics(model.pin, data, q)
        T = data.oMf[frame]
        points = axis @ T.rotation.T + T.translation
        outside = np.maximum(np.abs(points - [0, 0, 0.1902]) - [0.495, 0.345, 0.19015], 0)
        expected = np.linalg.norm(outside, axis=1).min() - capsule.radius_m
        reader.update(q)
        if expected > -capsule.radius_m + 1e-3:  # the axis itself is outside of the box
            assert reader.distances()[0] == pytest.approx(expected, abs=1e-5)


def test_the_distance_is_between_the_closest_points_along_the_normal(model):
    reader = PairDistances(model, candidate_pairs(model))
    rng = np.random.default_rng(2)
    for q_m in rng.uniform(model.q_lower, model.q_upper, (200, 7)):
        reader.update(model.configuration(rng.uniform(-3, 3, 3), q_m))
        for i in range(len(reader.pairs)):
            near = reader.closest(i)
            assert near.d == reader.distances()[i]
            np.testing.assert_allclose(near.p_b - near.p_a, near.d * near.n, atol=2e-6)


def test_closest_points_are_not_changed_by_a_later_update(model):
    reader = PairDistances(model, [Pair("lm", "lEE")])
    reader.update(model.configuration((0, 0, 0), np.array(model.description.arm.ready_position)))
    first = reader.closest(0)
    kept = first.p_b.copy()
    reader.update(model.configuration((1, 2, 0.5), model.q_lower))
    np.testing.assert_array_equal(first.p_b, kept)
    assert not np.allclose(reader.closest(0).p_b, kept)


def with_mobile_shapes(model: RobotModel, shapes: tuple[Shape, ...]) -> RobotModel:
    first, *others = model.description.bodies
    bodies = (first.model_copy(update={"shapes": shapes}), *others)
    return RobotModel(model.description.model_copy(update={"bodies": bodies}))


def test_distances_do_not_depend_on_earlier_queries(model):
    """They agree bit for bit, so any process can compute any case of a study."""
    distances = PairDistances(model, candidate_pairs(model))

    def found(q_m: np.ndarray) -> np.ndarray:
        distances.update(model.configuration((0.0, 0.0, 0.0), q_m))
        each = map(distances.closest, range(len(distances.pairs)))
        return np.concatenate([np.hstack(closest) for closest in each])

    postures = np.random.default_rng(0).uniform(model.q_lower, model.q_upper, (50, model.n_m))
    there, back = [found(q) for q in postures], [found(q) for q in postures[::-1]]
    np.testing.assert_array_equal(there, back[::-1])


def test_distance_of_a_body_is_that_of_its_nearest_shape():
    one = husky_panda()
    lm = one.description.mobile_body
    ball = Sphere(type="sphere", radius_m=0.02, xyz_m=(0.0, 0.0, 0.9))  # [m] floats over the base
    two, other = (with_mobile_shapes(one, shapes) for shapes in ((*lm.shapes, ball), (ball,)))
    pair = [Pair("lm", "lEE")]
    readers = [PairDistances(m, pair) for m in (two, one, other)]
    rng = np.random.default_rng(3)
    for q_m in rng.uniform(one.q_lower, one.q_upper, (200, 7)):
        for reader in readers:
            reader.update(one.configuration((0, 0, 0), q_m))
        d, *parts = (reader.distances()[0] for reader in readers)
        assert d == pytest.approx(min(parts), abs=1e-12)
        assert readers[0].closest(0).d == d
