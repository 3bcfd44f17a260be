"""The superquadric: its distances agree with a minimisation of its own function."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
import pytest
from pydantic import ValidationError
from scipy.optimize import minimize
from scipy.spatial import ConvexHull
from scipy.special import beta

from app.robot.shapes import (
    INTERVALS,
    Superquadric,
    around_box,
    implicit,
    onto_surface,
    polytope_vertices,
    shape_mesh,
)
from app.strict import explain

Array = np.ndarray

DEVIATION = {1.0: 0.005, 2.0: 0.01}
"""[-] bound of the polytope's deviation per longest semi-axis, by the largest exponent."""
EXTREMES = [(e1, e2) for e1 in (0.1, 0.2, 1.0, 2.0) for e2 in (0.1, 0.2, 1.0, 2.0)]


def shape_of(axes, e1: float, e2: float, **placed) -> Superquadric:
    a, b, c = map(float, axes)
    return Superquadric(
        type="superquadric", semi_axes_m=(a, b, c), e1=float(e1), e2=float(e2), **placed
    )


def random_shape(rng: np.random.Generator, greatest: float) -> tuple[Superquadric, float]:
    """A placed shape, and the bound [m] of the error of its distances."""
    axes = rng.uniform(0.03, 1.0, 3)
    shape = shape_of(
        axes,
        *rng.uniform(0.1, greatest, 2),
        xyz_m=tuple(rng.uniform(-1, 1, 3)),
        rpy_rad=tuple(rng.uniform(-1.5, 1.5, 3)),
    )
    return shape, DEVIATION[greatest] * axes.max()


def random_pose(rng: np.random.Generator, reach: float) -> pin.SE3:
    R = pin.Quaternion(rng.normal(size=4)).normalized().matrix()
    direction = rng.normal(size=3)
    return pin.SE3(R, rng.uniform(0.1, 1.0) * reach * direction / np.linalg.norm(direction))


def gauge(p: Array, shape: Superquadric) -> Array:
    """Growth of the shape at which `p`, (3,) or (k, 3), is on its surface.

    It uses the sums of powers of the definition, independently of the module.
    """
    x, y, z = (np.abs(p) / np.array(shape.semi_axes_m)).T
    plan = (x ** (2 / shape.e2) + y ** (2 / shape.e2)) ** (shape.e2 / 2)
    return (plan ** (2 / shape.e1) + z ** (2 / shape.e1)) ** (shape.e1 / 2)


def coal_distance(shape: Superquadric, other: coal.CollisionGeometry, pose: pin.SE3) -> float:
    """[m] signed distance between the placed shape and the shape `other` at a pose."""
    at = shape.placement()
    return coal.distance(
        shape.coal_geometry(),
        coal.Transform3s(at.rotation, at.translation),
        other,
        coal.Transform3s(pose.rotation, pose.translation),
        coal.DistanceRequest(),
        coal.DistanceResult(),
    )


def distance_to_box(shape: Superquadric, half: Array, pose: pin.SE3) -> float:
    """[m] smallest distance of a point of the solid from a point of a box, by SLSQP; 0 inside."""
    T = shape.placement().actInv(pose)  # of the box in the shape's frame
    best = np.inf
    for start in (T.translation, T.act(half), T.act(-half), np.array(shape.semi_axes_m)):
        p = start / max(gauge(start, shape), 1.0) * 0.99
        y = np.clip(T.actInv(p), -half, half)
        found = minimize(
            lambda v: float(np.sum((v[:3] - T.act(v[3:])) ** 2)),
            np.concatenate([p, y]),
            method="SLSQP",
            bounds=[(None, None)] * 3 + list(zip(-half, half, strict=True)),
            constraints={"type": "ineq", "fun": lambda v: 1.0 - gauge(v[:3], shape)},
            options={"maxiter": 400, "ftol": 1e-13},
        )
        if gauge(found.x[:3], shape) < 1 + 1e-6:
            best = min(best, float(np.sqrt(max(found.fun, 0.0))))
    return best


def depth_of_point(shape: Superquadric, p: Array) -> float:
    """[m] smallest distance from a point inside, in the shape's frame, to the surface, by SLSQP."""
    around = np.random.default_rng(0).normal(size=(20_000, 3))
    around *= shape.semi_axes_m / np.linalg.norm(around, axis=1, keepdims=True)
    surface = around[:2_000] / gauge(around[:2_000], shape)[:, None]
    nearest = surface[np.argsort(np.linalg.norm(surface - p, axis=1))[:6]]
    best = float(np.linalg.norm(nearest[0] - p))
    for start in nearest:
        found = minimize(
            lambda s: float(np.sum((s - p) ** 2)),
            start,
            method="SLSQP",
            constraints={"type": "eq", "fun": lambda s: gauge(s, shape) - 1.0},
            options={"maxiter": 200, "ftol": 1e-13},
        )
        if abs(gauge(found.x, shape) - 1.0) < 1e-6:
            best = min(best, float(np.sqrt(found.fun)))
    return best


@pytest.mark.slow
@pytest.mark.parametrize("greatest", [1.0, 2.0])
@pytest.mark.parametrize("seed", range(10))
def test_distance_from_a_box_agrees_with_constrained_minimisation(seed: int, greatest: float):
    """The distance exceeds the exact one by at most the polytope's deviation."""
    rng = np.random.default_rng(seed)
    shape, most = random_shape(rng, greatest)
    half, apart = rng.uniform(0.05, 0.5, 3), 0.0
    while apart < 0.02:
        pose = shape.placement() * random_pose(rng, 3.0)
        apart = distance_to_box(shape, half, pose)
    found = coal_distance(shape, coal.Box(*(2 * half)), pose)
    assert apart - 1e-4 < found < apart + most + 1e-4


@pytest.mark.parametrize("greatest", [1.0, 2.0])
@pytest.mark.parametrize("seed", range(10))
def test_penetration_of_a_ball_agrees_with_constrained_minimisation(seed: int, greatest: float):
    """The signed distance of a ball whose centre is inside: -(centre to the surface + radius)."""
    rng = np.random.default_rng(100 + seed)
    shape, most = random_shape(rng, greatest)
    inside = rng.normal(size=3) * shape.semi_axes_m
    inside *= rng.uniform(0.2, 0.95) / gauge(inside, shape)
    radius = rng.uniform(0.02, 0.2)
    true = -depth_of_point(shape, inside) - radius
    at = pin.SE3(np.eye(3), shape.placement().act(inside))
    found = coal_distance(shape, coal.Sphere(radius), at)
    assert true - 1e-4 < found < true + most + 1e-4


@pytest.mark.parametrize("seed", range(5))
def test_both_exponents_one_give_an_ellipsoid(seed: int):
    """The collision library has an ellipsoid of its own."""
    rng = np.random.default_rng(seed)
    shape, most = shape_of(axes := rng.uniform(0.1, 1.0, 3), 1.0, 1.0), 0.005
    ball = coal.Sphere(0.1)
    for _ in range(10):
        pose = random_pose(rng, 2.0)
        pose.translation *= 1.3 / min(gauge(pose.translation, shape), 1.0)
        true = coal.distance(
            coal.Ellipsoid(*axes),
            coal.Transform3s.Identity(),
            ball,
            coal.Transform3s(pose.rotation, pose.translation),
            coal.DistanceRequest(),
            coal.DistanceResult(),
        )
        assert true - 1e-5 < coal_distance(shape, ball, pose) < true + most * axes.max() + 1e-5


@pytest.mark.slow
@pytest.mark.parametrize(("e1", "e2"), EXTREMES)
def test_polytope_deviates_from_the_surface_by_at_most_the_bound(e1: float, e2: float):
    """Its vertices are on the surface; the largest deviations are between them."""
    rng = np.random.default_rng(3)
    for axes in ((1.0, 1.0, 1.0), (1.0, 0.3, 0.1), (0.07, 0.5, 1.4)):
        shape = shape_of(axes, e1, e2)
        vertices = shape.vertices()
        assert len(vertices) == 6 * INTERVALS**2 + 2
        np.testing.assert_allclose(gauge(vertices, shape), 1.0, atol=1e-9)
        # A share of the points lies close to the planes of symmetry, where sharp shapes bend most.
        rays = rng.normal(size=(1500, 3)) * rng.choice([1.0, 0.1, 0.01], size=(1500, 3))
        points = rays * axes / gauge(rays * axes, shape)[:, None]
        faces = ConvexHull(vertices).equations
        outside = (faces[:, :3] @ points.T + faces[:, 3:]).max(0)
        assert outside.max() < DEVIATION[1.0 if max(e1, e2) <= 1 else 2.0] * max(axes)
        assert outside.min() > -1e-9  # the polytope lies inside


@pytest.mark.parametrize("seed", range(20))
def test_implicit_function_agrees_with_the_definition(seed: int):
    rng = np.random.default_rng(seed)
    axes, (e1, e2) = rng.uniform(0.05, 2.0, 3), rng.uniform(0.1, 2.0, 2)
    p = rng.normal(size=(7, 5, 3)) * axes
    x, y, z = np.moveaxis(np.abs(p / axes), -1, 0)
    expected = (x ** (2 / e2) + y ** (2 / e2)) ** (e2 / e1) + z ** (2 / e1)
    np.testing.assert_allclose(implicit(p, tuple(axes), e1, e2), expected, rtol=1e-9)
    q = onto_surface(p, tuple(axes), e1, e2)
    np.testing.assert_allclose(implicit(q, tuple(axes), e1, e2), 1.0, rtol=1e-9)
    np.testing.assert_allclose(np.cross(q, p), 0.0, atol=1e-12 * np.abs(p).max() ** 2)  # same rays
    assert ((q * p).sum(-1) > 0).all()


@pytest.mark.parametrize("far", [1e-9, 1e3, 1e9])
def test_projection_to_the_surface_does_not_depend_on_the_distance(far: float):
    p = np.array([[0.3, -0.2, 0.7], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
    for e1, e2 in ((0.1, 0.1), (0.1, 2.0), (2.0, 0.1)):
        near = onto_surface(p, (0.4, 0.2, 0.9), e1, e2)
        np.testing.assert_allclose(onto_surface(far * p, (0.4, 0.2, 0.9), e1, e2), near, rtol=1e-9)


@pytest.mark.parametrize(("e1", "e2"), EXTREMES)
def test_all_corners_of_the_box_lie_on_the_superquadric_around_it(e1: float, e2: float):
    size = np.array([0.06, 0.6, 1.7])
    axes = around_box(tuple(size), e1, e2)
    shape = shape_of(axes, e1, e2)
    corners = np.array(np.meshgrid(*([-0.5, 0.5],) * 3)).reshape(3, 8).T * size
    np.testing.assert_allclose(gauge(corners, shape), 1.0, atol=1e-9)
    # The polytope contains them too, and therefore the whole box.
    faces = ConvexHull(shape.vertices()).equations
    assert (faces[:, :3] @ corners.T + faces[:, 3:]).max() < 1e-9
    assert (np.array(axes) > size / 2).all()


def test_superquadric_around_a_box_shrinks_with_its_exponents():
    growth = [around_box((2.0, 2.0, 2.0), e, e)[0] for e in (1.0, 0.5, 0.2, 0.1)]
    assert growth == sorted(growth, reverse=True)
    assert growth[0] == pytest.approx(np.sqrt(3))  # the ellipsoid's
    assert growth[-1] < 1.06


@pytest.mark.parametrize(("e1", "e2"), EXTREMES)
def test_mesh_for_drawing_covers_the_whole_surface(e1: float, e2: float):
    shape = shape_of((0.4, 0.25, 0.8), e1, e2)
    mesh = shape_mesh(shape)
    np.testing.assert_allclose(gauge(mesh.vertices, shape), 1.0, atol=1e-9)
    np.testing.assert_allclose(mesh.bounds, [[-0.4, -0.25, -0.8], [0.4, 0.25, 0.8]], atol=1e-9)
    # Slivers between points of a flat face may be left out, but no hole that could be seen.
    assert mesh.area == pytest.approx(ConvexHull(shape.vertices()).area, rel=1e-6)
    # The volume in closed form (Jaklič et al., 2000); the mesh lies inside.
    whole = 2 * 0.4 * 0.25 * 0.8 * e1 * e2 * beta(e1 / 2 + 1, e1) * beta(e2 / 2, e2 / 2)
    assert 0.975 * whole < mesh.volume < whole * (1 + 1e-9)


def test_polytope_is_shared_and_read_only():
    """Equal parameters give the same array."""
    vertices = polytope_vertices((0.3, 0.2, 0.1), 0.5, 0.5)
    assert polytope_vertices((0.3, 0.2, 0.1), 0.5, 0.5) is vertices
    with pytest.raises(ValueError, match="read-only"):
        vertices[0, 0] = 1.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"e1": 0.05}, "e1: Input should be greater than or equal to 0.1 (was 0.05)"),
        ({"e2": 2.5}, "e2: Input should be less than or equal to 2 (was 2.5)"),
        ({"e1": float("nan")}, "e1: Input should be"),
        ({"e2": float("inf")}, "e2: Input should be"),
        ({"semi_axes_m": (0.1, 0.0, 0.1)}, "semi_axes_m[1]: Input should be greater than 0"),
        ({"semi_axes_m": (0.1, 0.2, -0.1)}, "semi_axes_m[2]: Input should be greater than 0"),
        ({"semi_axes_m": (float("inf"), 0.2, 0.1)}, "semi_axes_m[0]: Input should be a finite"),
        ({"semi_axes_m": (0.1, 0.2)}, "semi_axes_m[2]: missing"),
        ({"semi_axis_m": (0.1, 0.2, 0.3)}, "did you mean 'semi_axes_m'"),
        ({"xyz_m": (0.0, float("nan"), 0.0)}, "xyz_m[1]: Input should be a finite"),
    ],
)
def test_invalid_parameter_is_refused_with_its_name_and_valid_values(change, message: str):
    given = {"type": "superquadric", "semi_axes_m": (0.1, 0.2, 0.3), "e1": 0.5, "e2": 0.5}
    Superquadric.model_validate(given)
    with pytest.raises(ValidationError) as caught:
        Superquadric.model_validate({**given, **change})
    assert message in explain(caught.value, Superquadric)
