"""The compiled model agrees with its description, its URDF and its meshes."""

from __future__ import annotations

import gc
import weakref

import coal
import numpy as np
import pinocchio as pin
import pytest

from app.border.offset import offset_contours
from app.robot.model import RobotModel, kept_per_model
from app.simulation.plants.collision_shapes import collision_shapes
from tests.hulls import URDF, body_pairs, collision_points, hull_pairs
from tests.robots import husky_panda

COVER = 0.005  # [m] how far a mesh may extend beyond its body
SHELTERED = {"panda_link3", "panda_link4"}
"""The elbow extends beyond its two bodies by up to 0.18 m. No pair misses a collision because
of that: these links meet only bodies of neighbours (tested below).
"""


@pytest.mark.parametrize(
    ("stated", "attribute"),
    [
        ("position_lower", "lower"),
        ("position_upper", "upper"),
        ("max_velocity", "velocity"),
        ("max_effort", "effort"),
    ],
)
def test_description_limits_equal_the_urdf_limits(stated, attribute):
    arm = husky_panda().description.arm
    for joint, value in zip(arm.joints, getattr(arm, stated), strict=True):
        limit = URDF.find(f"joint[@name='{joint}']/limit")
        assert float(limit.get(attribute)) == value, joint


def test_wheels_stand_on_the_floor_with_the_described_radius():
    description = husky_panda().description
    base = description.base
    height = float(URDF.find("joint[@name='base_joint']/origin").get("xyz").split()[2])
    for name in (*base.left_wheel_joints, *base.right_wheel_joints):
        joint = URDF.find(f"joint[@name='{name}']")
        axle = height + float(joint.find("origin").get("xyz").split()[2])
        assert axle == pytest.approx(base.wheel_radius_m, abs=0.001), name
        hull = collision_points(joint.find("child").get("link"))
        assert np.abs(hull[:, 2]).max() == pytest.approx(base.wheel_radius_m, abs=0.001), name


def test_every_link_states_its_inertia():
    """Libraries differ for a link without inertia: pybullet assumes 1 kg, pinocchio 0."""
    for link in URDF.iterfind("link"):
        assert link.find("inertial/mass") is not None, link.get("name")
        assert link.find("inertial/inertia") is not None, link.get("name")


def test_model_mass_is_the_sum_of_the_links_and_near_the_described_mass():
    model = husky_panda()
    total = sum(float(mass.get("value")) for mass in URDF.iterfind("link/inertial/mass"))
    assert pin.computeTotalMass(model.pin) == pytest.approx(total, rel=1e-12)
    assert total == pytest.approx(model.description.base.mass_kg, rel=0.05)


def test_mount_has_the_papers_position():
    np.testing.assert_allclose(husky_panda().p_base(), [0.30, 0.0, 0.3883], atol=1e-9)


def test_every_link_with_a_collision_shape_belongs_to_one_body():
    owners = [link for body in husky_panda().description.bodies for link in body.covers]
    assert len(owners) == len(set(owners))
    colliding = {link.get("name") for link in URDF.iterfind("link") if link.find("collision")}
    assert colliding <= set(owners)


def least_signed_distance(p: np.ndarray, shapes: list, placements: list) -> float:
    """[m] distance of p (3,) [m] to the union of the placed shapes; negative inside."""
    probe, at, request = coal.Sphere(1e-9), coal.Transform3s(np.eye(3), p), coal.DistanceRequest()
    return min(
        coal.distance(
            probe,
            at,
            shape,
            coal.Transform3s(T.rotation, T.translation),
            request,
            coal.DistanceResult(),
        )
        for shape, T in zip(shapes, placements, strict=True)
    )


@pytest.mark.parametrize("name", husky_panda().body_names)
def test_body_covers_the_meshes_of_its_links_in_every_posture(name):
    """Links of one body may move relative to each other, so joint positions are random."""
    model, rng = husky_panda(), np.random.default_rng(0)
    body = model.description.body(name)
    meshes = {link: collision_points(link) for link in body.covers if link not in SHELTERED}
    assert sum(map(len, meshes.values())) > 50
    shapes = [shape.coal_geometry() for shape in body.shapes]
    data, worst = model.pin.createData(), -np.inf
    for _ in range(12 if name != "lm" else 1):  # l_m is rigid
        q = model.configuration(np.zeros(3), rng.uniform(model.q_lower, model.q_upper))
        pin.framesForwardKinematics(model.pin, data, q)
        frame = data.oMf[model.pin.getFrameId(body.frame)]
        placements = [frame * shape.placement() for shape in body.shapes]
        for link, points in meshes.items():
            T = data.oMf[model.pin.getFrameId(link)]
            for p in points @ T.rotation.T + T.translation:
                worst = max(worst, least_signed_distance(p, shapes, placements))
    assert worst <= COVER


def test_bodies_overlap_where_link_hulls_collide():
    """Sheltered links never collide, so the bodies miss no collision of the hulls."""
    model, rng = husky_panda(), np.random.default_rng(1)
    hulls, bodies = hull_pairs(model), body_pairs(model)
    data, hits = model.pin.createData(), 0
    for _ in range(4000):
        q = model.configuration(np.zeros(3), rng.uniform(model.q_lower, model.q_upper))
        touching = hulls.colliding(data, q)
        hits += len(touching)
        overlapping = bodies.colliding(data, q) if touching else set()
        for a, b in touching:
            assert (hulls.body_of[a], hulls.body_of[b]) in overlapping, (a, b, q)
            assert not {a, b} & SHELTERED, (a, b, q)
    assert hits > 500


def test_values_stored_per_model_are_bounded_and_freed_with_the_model() -> None:
    made = []

    @kept_per_model(2)
    def bodies(model: RobotModel, scale: float = 1.0) -> list[float]:
        made.append(scale)
        return [scale] * len(model.body_names)

    model = RobotModel(husky_panda().description)
    assert bodies(model, 2.0) is bodies(model, 2.0)
    assert bodies(husky_panda(), 2.0) is not bodies(model, 2.0)
    for scale in (3.0, 4.0, 3.0, 2.0):  # 4.0 evicts 2.0
        bodies(model, scale=scale)
    assert made == [2.0, 2.0, 3.0, 4.0, 2.0]

    @kept_per_model(2)
    def doubled(_: RobotModel, points: np.ndarray) -> np.ndarray:
        return 2.0 * points

    points = np.ones((2, 3))
    there, stored = doubled(model, points), weakref.ref(points)
    assert doubled(model, points.copy()) is there
    assert doubled(model, points.reshape(3, 2)).shape == (3, 2)
    assert doubled(model, points=points).shape == (2, 3)
    assert doubled(model, 0.0 * points).sum() == 0.0
    assert doubled(model, points.view(np.int64)).max() > 1.0, "the same bytes of another type"
    del points
    assert stored() is None, "the cache keeps only a digest"
    collision_shapes(model)
    offset_contours(model, 0.1)
    ref = weakref.ref(model)
    gc.disable()
    try:
        del model
        assert ref() is None
    finally:
        gc.enable()
