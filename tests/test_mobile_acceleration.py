"""The force on the base and the resulting accelerations, (14) to (19)."""

import numpy as np
import pytest

from app.avoidance.acting_point import avoidance_force, generate_mob_acc, resultant_force
from app.robot.bases.differential import control_point_jacobian, mobile_jacobian
from tests.robots import husky_panda

SIDE = np.array([0.0, 1.0, 0.0])


def force(p_b, p_act, d, n=SIDE, f_max=300.0, d_b=0.15):
    return avoidance_force(np.array(p_b), np.array(p_act), d, np.array(n), f_max, d_b)


@pytest.mark.parametrize(("d", "share"), [(0.15, 0.0), (0.075, 0.5), (0.0, 1.0)])
def test_force_falls_linearly_to_zero_at_the_border(d: float, share: float) -> None:
    f = force([0.3, 0.4, 0.2], [0.35, 0.5, 0.2], d)
    assert np.linalg.norm(f) == pytest.approx(300.0 * share)


@pytest.mark.parametrize("d", [-0.3, -0.01, 0.2, 5.0])
def test_force_magnitude_is_between_zero_and_f_max(d: float) -> None:
    assert 0.0 <= np.linalg.norm(force([0.3, 0.4, 0.2], [0.35, 0.5, 0.2], d)) <= 300.0 + 1e-9


def test_force_points_from_the_acting_point_to_the_closest_point() -> None:
    f = force([0.3, 0.4, 0.2], [0.3, 0.5, 0.2], 0.05)
    np.testing.assert_allclose(f / np.linalg.norm(f), [0.0, -1.0, 0.0])


def test_coincident_points_give_a_force_away_from_the_arm() -> None:
    f = force([0.3, 0.5, 0.2], [0.3, 0.5, 0.2], 0.075)
    np.testing.assert_allclose(f, [0.0, -150.0, 0.0])


@pytest.mark.parametrize(("across", "up"), [(0.8, 0.6), (0.28, -0.96)])
def test_force_scales_with_the_horizontal_part_of_the_normal(across: float, up: float) -> None:
    n = across * np.array([0.6, 0.8, 0.0]) + [0.0, 0.0, up]
    f = force([0.3, 0.4, 0.2], [0.3, 0.5, 0.2], 0.05, n=n)
    np.testing.assert_allclose(f, [0.0, -across * 200.0, 0.0])


def test_vertical_normal_gives_zero_force() -> None:
    up = [0.0, 0.0, 1.0]
    np.testing.assert_array_equal(force([0.1, 0.1, 0.4], [0.1, 0.1, 0.4], 0.02, n=up), np.zeros(3))
    np.testing.assert_array_equal(force([0.1, 0.1, 0.4], [0.6, 0.1, 0.4], 0.02, n=up), np.zeros(3))


def test_accelerations_have_the_same_virtual_power_as_the_forces() -> None:
    """M v̇ and I ω̇ are the generalised forces of the base without slip."""
    rng = np.random.default_rng(0)
    m, inertia, r, b = 60.0, 8.0, 0.165, 0.51
    forces = [(np.append(rng.normal(size=2), 0.0), rng.normal(size=3)) for _ in range(3)]
    base = husky_panda().description.base.model_copy(
        update={"mass_kg": m, "inertia_kgm2": inertia, "wheel_radius_m": r, "half_track_m": b}
    )
    f, p_act = map(np.array, zip(*forces, strict=True))
    v_dot, w_dot = generate_mob_acc(base.A_b, resultant_force(f, p_act))
    for wheels in np.eye(2):
        v, w = mobile_jacobian(r, b) @ wheels
        power = sum(
            f[:2] @ control_point_jacobian(p[0], p[1], 0.0, r, b) @ wheels for f, p in forces
        )
        assert m * v_dot * v + inertia * w_dot * w == pytest.approx(power)


def test_resultant_is_the_sum_of_forces_and_torques() -> None:
    f, p_act = np.tile([1.0, 2.0, 0.0], (3, 1)), np.tile([0.5, -1.0, 0.3], (3, 1))
    np.testing.assert_allclose(resultant_force(f, p_act), [3.0, 6.0, 6.0])
    nothing = resultant_force(np.zeros((0, 3)), np.zeros((0, 3)))
    np.testing.assert_array_equal(nothing, np.zeros(3))
    A_b = husky_panda().description.base.A_b
    np.testing.assert_array_equal(generate_mob_acc(A_b, nothing), np.zeros(2))


def test_pair_without_force_needs_no_acting_point() -> None:
    f, p_act = np.array([[1.0, 2.0, 0.0], [0.0, 0.0, 0.0]]), np.full((2, 3), np.nan)
    p_act[0] = 0.5, -1.0, 0.3
    np.testing.assert_allclose(resultant_force(f, p_act), [1.0, 2.0, 2.0])


def test_17_18_force_accelerates_along_x_and_torque_about_the_centre() -> None:
    base = husky_panda().description.base.model_copy(update={"mass_kg": 3.0, "inertia_kgm2": 8.0})
    np.testing.assert_allclose(base.A_b @ [6.0, 99.0, 4.0], [2.0, 0.5])


def test_J_m_agrees_with_the_control_points_jacobian_and_has_full_rank() -> None:
    """(19) with its second column corrected gives (6): [[cos φ, -y], [sin φ, x]] J_m = J_c."""
    rng = np.random.default_rng(1)
    for _ in range(20):
        x, y, phi = rng.normal(size=3)
        r, b = rng.uniform(0.05, 1.0, size=2)
        turned = np.array([[np.cos(phi), -y], [np.sin(phi), x]]) @ mobile_jacobian(r, b)
        np.testing.assert_allclose(turned, control_point_jacobian(x, y, phi, r, b), atol=1e-12)
    assert np.linalg.matrix_rank(mobile_jacobian(0.165, 0.51)) == 2
