"""β of Figure 10 and β_m of (28)."""

import numpy as np
import pytest

from app.control.tasks import activation, mobile_activation

PAPER = {"d_b": 0.15, "d_full": 0.05}


def test_beta_has_the_papers_values_at_the_ends_and_middle_of_figure_10() -> None:
    assert activation(0.15, **PAPER) == 0.0
    assert activation(0.10, **PAPER) == pytest.approx(0.5)
    assert activation(0.05, **PAPER) == 1.0


def test_beta_rises_over_at_least_20_mm() -> None:
    beta = [activation(d, 0.05, 0.05) for d in (0.06, 0.05, 0.04, 0.03, 0.02)]
    assert beta == [0.0, 0.0, pytest.approx(0.5), 1.0, 1.0]


def test_beta_is_smooth_and_never_rises_with_the_distance() -> None:
    d = np.linspace(-0.1, 0.3, 4001)
    beta = np.array([activation(x, **PAPER) for x in d])
    assert (np.diff(beta) <= 0).all()
    assert beta[0] == 1.0
    assert beta[-1] == 0.0
    slope = np.gradient(beta, d)
    assert np.abs(np.diff(slope)).max() < 0.2  # [1/m]; 5 with a linear β


def test_beta_m_is_the_largest_of_its_pairs() -> None:
    assert mobile_activation(np.array([0.1, 0.7, 0.3])) == 0.7
    assert mobile_activation(np.zeros(0)) == 0.0
