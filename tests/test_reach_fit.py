"""(9) fitted to a map recovers known coefficients."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.score import fit_parabola, radial_profile

KNOWN = (525.9, 0.575, 100.0)  # [1/m², m, -] paper, §2.3.2
EDGES = (0.151, 0.999)  # [m] (9) with KNOWN is at least 5 between them


def ball(count: int, radius: float = 1.4, seed: int = 0) -> np.ndarray:
    """[m] distances from the centre of points that are uniform in a ball."""
    return radius * np.cbrt(np.random.default_rng(seed).uniform(size=count))


def parabola(rho: np.ndarray, A: float, B: float, C: float) -> np.ndarray:
    """(9), zero beyond its roots as in a map."""
    return np.maximum(C - A * (rho - B) ** 2, 0.0)


@pytest.mark.parametrize("known", [KNOWN, (380.0, 0.64, 88.0), (1000.0, 0.4, 60.0)])
def test_fit_of_positive_values_recovers_the_coefficients_exactly(known):
    A, B, C = known
    half = np.sqrt(0.9 * C / A)
    rho = np.linspace(B - half, B + half, 500)
    fit = fit_parabola(rho, parabola(rho, *known))
    np.testing.assert_allclose(fit[:3], known, rtol=1e-9)
    assert fit.r_squared == pytest.approx(1.0, abs=1e-9)
    assert fit.rms < 1e-9 * C
    np.testing.assert_allclose(fit.at(rho), parabola(rho, *known), rtol=1e-8)


def test_zeros_beyond_the_reach_are_ignored():
    rho = ball(200_000)
    fit = fit_parabola(rho, parabola(rho, *KNOWN))
    np.testing.assert_allclose(fit[:3], KNOWN, rtol=0.02)
    assert (fit.rho_min_m, fit.rho_max_m) == pytest.approx(EDGES, abs=0.051)  # whole shells
    assert fit.points < len(rho) / 2


def test_monotonic_map_has_no_best_distance():
    """As for a short arm on a lift, which is nearly always far from its mount."""
    rho = np.linspace(0.1, 0.6, 500)
    with pytest.raises(ValueError, match="both sides of a best distance"):
        fit_parabola(rho, parabola(rho, 100.0, -0.5, 200.0))


@pytest.mark.parametrize("seed", range(3))
def test_counting_noise_keeps_the_coefficients_and_lowers_pointwise_fit(seed):
    """Each value is a mean of few counts, as in a map."""
    rho = ball(50_000, seed=seed)
    rng = np.random.default_rng(seed)
    noisy = 25.0 * rng.poisson(parabola(rho, *KNOWN) / 25.0)
    fit = fit_parabola(rho, noisy)
    np.testing.assert_allclose(fit[:3], KNOWN, rtol=0.05)
    assert fit.r_squared > 0.98
    assert fit.r_squared_positions < 0.6


def test_stray_values_beyond_the_reach_are_ignored():
    rho = ball(100_000)
    values = parabola(rho, *KNOWN)
    plain = fit_parabola(rho, values)
    values[rho > 1.25] = 30.0
    assert fit_parabola(rho, values) == plain


def test_scaling_the_map_scales_only_A_and_C():
    rho = ball(50_000)
    values = parabola(rho, *KNOWN) + 3 * np.random.default_rng(0).random(len(rho))
    one, seven = fit_parabola(rho, values), fit_parabola(rho, 7 * values)
    assert seven.A_per_m2 == pytest.approx(7 * one.A_per_m2)
    assert pytest.approx(7 * one.C) == seven.C
    assert seven.B_m == pytest.approx(one.B_m)
    assert seven.r_squared == pytest.approx(one.r_squared)
    assert seven.rms == pytest.approx(7 * one.rms)


def test_fit_has_the_least_squared_error_over_its_range():
    rho = ball(20_000)
    values = parabola(rho, *KNOWN) ** 1.3
    fit = fit_parabola(rho, values)
    inside = (rho >= fit.rho_min_m) & (rho <= fit.rho_max_m)

    def error(A: float, B: float, C: float) -> float:
        return float(((values - C + A * (rho - B) ** 2)[inside] ** 2).sum())

    least = error(*fit[:3])
    for i in range(3):
        for factor in (0.999, 1.001):
            other = list(fit[:3])
            other[i] *= factor
            assert error(*other) > least


@pytest.mark.parametrize(
    ("rho", "reach", "words"),
    [
        ([], [], "no values"),
        ([0.5, 0.5, 0.6], [1.0, 1.0, 2.0], "too few distances"),
        (np.linspace(0.3, 0.9, 60), np.linspace(0.3, 0.9, 60) ** 2 + 1, "does not decrease"),
    ],
)
def test_data_without_concave_parabola_are_rejected(rho, reach, words):
    with pytest.raises(ValueError, match=words):
        fit_parabola(np.array(rho), np.array(reach))


def test_profile_is_mean_and_spread_of_each_shell():
    rho = ball(2000)
    values = np.random.default_rng(1).random(2000)
    profile = radial_profile(rho, values, 0.1)
    for middle, mean, spread, count in zip(
        profile.rho_m, profile.mean, profile.spread, profile.count, strict=True
    ):
        inside = values[np.abs(rho - middle) < 0.05]
        assert len(inside) == count > 0
        assert (mean, spread) == pytest.approx((inside.mean(), inside.std()))
