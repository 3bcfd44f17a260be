"""Properties of the base's drive."""

from __future__ import annotations

import numpy as np
import pytest

from app.control.drive import Drive
from tests.robots import husky_panda

BASE = husky_panda().description.base
GENTLE = np.array([0.05, 0.1])  # m/s and rad/s: below v = a_max τ the limits do not act


def follow(drive: Drive, command, steps: int) -> np.ndarray:
    return np.array([drive.step(command) for _ in range(steps)])


def test_a_small_command_is_followed_exponentially_with_the_time_constant():
    dt = 0.001
    v = follow(Drive(BASE, dt), GENTLE, 300)
    t = dt * np.arange(1, 301)[:, None]
    np.testing.assert_allclose(v, GENTLE * (1 - np.exp(-t / BASE.drive_time_constant_s)), rtol=1e-9)


@pytest.mark.parametrize("dt", [0.0001, 0.001, 0.01, 0.1, 1.0])
def test_drive_overshoots_at_no_period(dt):
    v = follow(Drive(BASE, dt), (1.0, -2.0), max(20, int(3 / dt)))
    assert np.all(np.diff(v[:, 0]) >= 0)
    assert np.all(np.diff(v[:, 1]) <= 0)
    np.testing.assert_allclose(v[-1], (1.0, -2.0), rtol=1e-6)


def test_velocity_and_acceleration_stay_within_the_limits():
    drive, dt, rng = Drive(BASE, 0.001), 0.001, np.random.default_rng(0)
    v = np.vstack([follow(drive, rng.normal(0, 10, 2), 200) for _ in range(30)])
    a = np.diff(v, axis=0) / dt
    limits = BASE.max_linear_acceleration_mps2, BASE.max_angular_acceleration_radps2
    np.testing.assert_allclose(np.abs(a).max(axis=0), limits, rtol=1e-9)
    fastest = np.abs(v).max(axis=0)
    assert fastest[0] <= BASE.max_linear_velocity_mps
    assert fastest[1] <= BASE.max_angular_velocity_radps
    assert fastest[0] > 0.9 * BASE.max_linear_velocity_mps


def test_drive_acceleration_predicts_the_next_step():
    drive, dt, rng = Drive(BASE, 1e-5), 1e-5, np.random.default_rng(1)
    for _ in range(50):
        command, before = rng.normal(0, 1, 2), drive.velocity
        expected = BASE.drive_acceleration(before, drive.state, command)
        np.testing.assert_allclose(
            np.subtract(drive.step(command), before) / dt, expected, rtol=2e-4
        )
        follow(drive, command, 500)


def test_reset_sets_the_velocity_to_zero():
    drive = Drive(BASE, 0.001)
    follow(drive, GENTLE, 10)
    drive.reset()
    np.testing.assert_array_equal(drive.velocity, np.zeros(2))
