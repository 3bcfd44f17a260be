"""Laws of β (Figure 10), (28), and of the share from above."""

import numpy as np
import pytest

from app.avoidance.activation import (
    activation,
    arm_activation,
    distance_to_come,
    mobile_activation,
    share_from_above,
)
from app.config import ActivationConfig

PAPER = {"d_b": 0.15, "d_full": 0.05}


def test_the_papers_ends_and_middle_of_figure_10() -> None:
    assert activation(0.15, **PAPER) == 0.0
    assert activation(0.10, **PAPER) == pytest.approx(0.5)
    assert activation(0.05, **PAPER) == 1.0


def test_beta_is_flat_at_both_ends_and_never_rises_with_the_distance() -> None:
    d = np.linspace(-0.1, 0.3, 4001)
    beta = np.array([activation(x, **PAPER) for x in d])
    assert (np.diff(beta) <= 0).all()
    assert beta[0] == 1.0
    assert beta[-1] == 0.0
    slope = np.gradient(beta, d)
    assert np.abs(np.diff(slope)).max() < 0.2  # [1/m] a kink would show as 15


def test_beta_m_is_the_largest_of_its_pairs() -> None:
    assert mobile_activation([0.1, 0.7, 0.3]) == 0.7
    assert mobile_activation([]) == 0.0


def test_from_the_side_the_arm_has_no_share_and_from_above_all() -> None:
    assert share_from_above(0.0) == share_from_above(0.8) == share_from_above(-0.8) == 0.0
    assert share_from_above(1.0) == share_from_above(-1.0) == 1.0
    shares = [share_from_above(x) for x in np.linspace(0, 1, 1001)]
    assert (np.diff(shares) >= 0).all()
    assert np.abs(np.diff(shares)).max() < 0.01


def arm_share(d: float, n_z: float) -> float:
    return arm_activation(d, n_z, ActivationConfig())


def test_from_the_side_the_arm_resists_only_as_the_last_resort() -> None:
    config = ActivationConfig()
    assert arm_share(config.d_last, 0.0) == arm_share(config.d_full, 0.5) == 0.0
    assert arm_share(0.5 * config.d_last, 0.0) == arm_share(-0.05, 0.0) == 1.0


def test_from_above_the_arm_resists_earlier() -> None:
    config = ActivationConfig()
    assert arm_share(config.d_above, 1.0) == 0.0
    assert arm_share(0.5 * config.d_above, 1.0) == arm_share(0.5 * config.d_above, -1.0) == 1.0


def test_over_the_edge_the_arms_buffer_turns_without_a_jump() -> None:
    for d in (-0.02, 0.01, 0.02, 0.04, 0.06, 0.09):
        shares = [arm_share(d, n_z) for n_z in np.linspace(0, 1, 1001)]
        assert (np.diff(shares) >= 0).all()
        assert np.abs(np.diff(shares)).max() < 0.03


def test_a_hand_at_rest_or_on_its_retreat_is_met_at_its_distance() -> None:
    for speed in (0.0, 0.3, 5.0):
        assert distance_to_come(0.06, speed, ActivationConfig()) == 0.06


def test_an_approach_is_met_where_it_will_be_and_the_earlier_the_faster() -> None:
    config = ActivationConfig()
    assert distance_to_come(0.06, -0.5, config) == pytest.approx(0.06 - 0.5 * config.ahead)
    to_come = [distance_to_come(0.06, v, config) for v in np.linspace(-10.0, 1.0, 11001)]
    assert (np.diff(to_come) >= 0).all()
    assert np.diff(to_come).max() <= 1.001e-3 * config.ahead
    at_once = ActivationConfig(ahead=0.0)
    assert distance_to_come(0.06, -0.5, at_once) == 0.06


def test_what_is_asked_of_an_approach_is_bounded_however_fast_it_is_said_to_be() -> None:
    config = ActivationConfig()
    assert distance_to_come(1.0, -np.inf, config) == distance_to_come(1.0, -3.0, config) > 0.8
