"""§2.3: score of the border."""

from __future__ import annotations

import numpy as np
import pytest

from app.avoidance.acting_point import uphill
from app.border.score import ScoreField, field_at
from app.errors import DescriptionError
from app.robot.bases.differential import (
    control_point_jacobian,
    mobile_jacobian,
)
from tests.finite_differences import jacobian
from tests.robots import husky_panda

R, B_TRACK = 0.165, 0.51  # [m] paper, §2.3.1
REACH = {"A": 525.9, "B": 0.575, "C": 100.0}  # paper, §2.3.2
P_BASE = np.array([0.3, 0.0, 0.3883])  # [m]


@pytest.fixture(scope="module")
def field() -> ScoreField:
    return ScoreField.of(husky_panda(), "lEE")


def reachability(p: np.ndarray) -> np.ndarray:
    """(9) with the paper's numbers; it does not depend on the base."""
    return ScoreField(husky_panda().description.base, P_BASE, **REACH).reachability(p)


def points(count: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform([-1, -0.8, 0], [1, 0.8, 1.2], (count, 3))


def test_6_is_the_velocity_of_a_point_fixed_to_the_base():
    """The reference is a finite difference of the moved point."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        phi, wheels, local = rng.uniform(-3, 3), rng.uniform(-2, 2, 2), rng.uniform(-1, 1, 2)
        v, w = mobile_jacobian(R, B_TRACK) @ wheels
        h = 1e-6  # [s]

        def at(t, phi=phi, v=v, w=w, local=local):
            turn = phi + w * t
            rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
            return v * t * np.array([np.cos(phi), np.sin(phi)]) + rotation @ local

        moved = (at(h) - at(-h)) / (2 * h)
        x, y = at(0.0)
        J_c = control_point_jacobian(x, y, phi, R, B_TRACK)
        np.testing.assert_allclose(J_c @ wheels, moved, atol=1e-8)


def test_7_is_the_determinant_of_the_jacobian_of_6():
    p = points(200)
    expected = [
        np.linalg.det(J @ J.T)
        for J in (control_point_jacobian(x, y, 0.0, R, B_TRACK) for x, y, _ in p)
    ]
    measured = np.abs(husky_panda().description.base.measure.at(p[:, 0]))
    np.testing.assert_allclose(measured, expected, rtol=1e-8, atol=1e-18)


def test_8_the_determinant_vanishes_only_on_the_wheel_axis():
    p, base = points(50), husky_panda().description.base
    p[:, 0] = 0.0
    assert (base.measure.at(p[:, 0]) == 0).all()
    p[:, 0] = 1e-3
    assert (base.measure.at(p[:, 0]) > 0).all()


def test_9_equals_the_papers_parabola_well_above_zero():
    for rho in np.linspace(0.155, 0.995, 50):
        p = P_BASE + rho * np.array([0.6, 0.0, 0.8])
        printed = -525.9 * (rho - 0.575) ** 2 + 100
        assert printed > 5.0
        assert reachability(p) == pytest.approx(printed, rel=1e-12)


def test_9_is_positive_and_falls_on_both_sides_of_its_maximum():
    rho = np.linspace(0.575, 5.0, 2000)
    values = reachability(P_BASE + rho[:, None] * np.array([1.0, 0, 0]))
    assert (values > 0).all()
    assert (np.diff(values) < 0).all()
    inward = np.linspace(0.575, 0.0, 500)
    values = reachability(P_BASE + inward[:, None] * np.array([1.0, 0, 0]))
    assert (values > 0).all()
    assert (np.diff(values) < 0).all()


def test_9_is_smooth_at_the_transition_to_its_tail():
    join = 0.575 + np.sqrt(95 / 525.9)  # [m] where (9) is 5
    h = 1e-7  # [m]
    p = P_BASE + np.outer([join - 2 * h, join - h, join + h, join + 2 * h], [1.0, 0.0, 0.0])
    at = reachability(p)
    assert at[1] == pytest.approx(5.0, abs=1e-3)
    assert at[3] - at[2] == pytest.approx(at[1] - at[0], rel=1e-3)


def test_10_is_symmetric_in_y_and_has_the_sign_of_x(field):
    p = points(500)
    np.testing.assert_allclose(field.score(p), field.score(p * [1, -1, 1]), rtol=1e-12)
    assert (np.sign(field.score(p)) == np.sign(p[:, 0])).all()
    expected = np.sign(p[:, 0]) * field.singularity(p) * field.reachability(p)
    np.testing.assert_allclose(field.score(p), expected, rtol=1e-12)


def test_the_gradient_of_10_equals_finite_differences(field):
    p = np.concatenate([points(500), P_BASE + 1.5 * points(100, seed=1)])
    numeric = jacobian(lambda step: field.score(p + step), 3)
    np.testing.assert_allclose(field.gradient(p), numeric, atol=1e-7 * np.abs(numeric).max())
    np.testing.assert_allclose(field.gradient(p[0]), field.gradient(p)[0], rtol=1e-14)


def test_the_gradient_is_finite_at_the_mount_and_zero_on_the_wheel_axis(field):
    assert np.isfinite(field.gradient(field.p_base)).all()
    assert (field.gradient(np.array([0.0, 0.5, 0.2])) == 0).all()


def test_the_uphill_direction_is_e_x_at_the_wheel_axis(field):
    for x in (-1e-7, 0.0, 1e-7):
        np.testing.assert_allclose(
            uphill(field.gradient(np.array([x, 0.6, 0.3]))), [1.0, 0.0, 0.0], atol=1e-5
        )


def test_the_uphill_direction_is_the_normalised_gradient(field):
    p = np.array([0.4, 0.5, 0.3])
    gradient = field.gradient(p)
    np.testing.assert_allclose(uphill(field.gradient(p)), gradient / np.linalg.norm(gradient))


def test_score_and_gradient_at_one_point_equal_the_array_functions(field):
    near, far = points(500), P_BASE + 2.0 * points(500, seed=1)
    for p in [*near, *far, P_BASE, np.array([0.0, 0.5, 0.2]), np.array([-1e-9, 0.5, 0.2])]:
        _, S, gradient = field_at(field.coefficients(), p)
        scale = np.abs(field.gradient(p)).max()
        np.testing.assert_allclose(S, field.score(p), rtol=1e-12)
        np.testing.assert_allclose(gradient, field.gradient(p), rtol=1e-12, atol=1e-13 * scale)


def test_the_field_has_the_papers_numbers(field):
    base = husky_panda().description.base
    assert field.base == base
    assert (field.A, field.B, field.C) == (525.9, 0.575, 100.0)
    np.testing.assert_allclose(field.p_base, P_BASE, atol=1e-12)


def test_the_error_of_missing_coefficients_names_the_body():
    model = husky_panda()
    with pytest.raises(DescriptionError, match=r"reachability\.l1"):
        ScoreField.of(model, "l1")
