"""The base's admittance law."""

import numpy as np
import pytest

from app.config import AdmittanceConfig
from app.robot.model import RobotModel
from tests.admittance import RunningAdmittance

DT = 0.001  # [s]


def law(robot: RobotModel, **changes: float) -> RunningAdmittance:
    return RunningAdmittance(robot.description.base, AdmittanceConfig(**changes))


def after(admittance: RunningAdmittance, acceleration: list[float], seconds: float) -> np.ndarray:
    for _ in range(round(seconds / DT)):
        command = admittance.update(np.array(acceleration), DT)
    return command


def test_command_is_updated_ten_times_a_second(robot: RobotModel) -> None:
    admittance = law(robot)
    commands = [admittance.update(np.array([0.3, 0.2]), DT)[0] for _ in range(1000)]
    changes = np.flatnonzero(np.diff([0.0, *commands]))
    np.testing.assert_array_equal(changes, np.arange(99, 1000, 100))


def test_each_command_is_the_exact_solution_of_the_admittance_law(robot: RobotModel) -> None:
    c = AdmittanceConfig()
    admittance = law(robot)
    t, a = 0.7, np.array([0.4, 0.5])
    rate = np.array([c.damping / c.mass, c.angular_damping / c.inertia])
    np.testing.assert_allclose(after(admittance, a.tolist(), t), a / rate * -np.expm1(-rate * t))


def test_without_damping_velocity_is_the_integral_of_desired_acceleration(
    robot: RobotModel,
) -> None:
    admittance = law(robot, damping=0.0, angular_damping=0.0)
    np.testing.assert_allclose(after(admittance, [0.2, -0.3], 1.0), [0.2, -0.3])


def test_base_stays_at_rest_without_desired_acceleration(robot: RobotModel) -> None:
    np.testing.assert_array_equal(after(law(robot), [0.0, 0.0], 2.0), [0.0, 0.0])


def test_moving_base_comes_to_rest_without_desired_acceleration(robot: RobotModel) -> None:
    admittance = law(robot)
    fast = after(admittance, [1.0, 1.0], 0.5).copy()
    slow = after(admittance, [0.0, 0.0], 5.0)
    assert (np.abs(slow) < 0.01 * np.abs(fast)).all()


def test_acceleration_between_two_commands_counts_by_its_mean(robot: RobotModel) -> None:
    """A pulse of 10 ms has the same effect as its mean over the command period."""
    pulse, mean = law(robot), law(robot)
    for k in range(100):
        a = pulse.update(np.array([3.0 if 40 <= k < 50 else 0.0, 0.0]), DT)
        b = mean.update(np.array([0.3, 0.0]), DT)
    np.testing.assert_allclose(a, b)


@pytest.mark.parametrize("desired", [[1e3, 1e3], [-1e3, -1e3]])
def test_commands_satisfy_velocity_and_acceleration_limits_of_the_base(
    robot: RobotModel, desired: list[float]
) -> None:
    base, admittance = (
        robot.description.base,
        law(robot, damping=0.0, angular_damping=0.0, v_max=2.0, omega_max=4.0),
    )
    before = np.zeros(2)
    for _ in range(20):
        command = after(admittance, desired, 0.1).copy()
        limit = [base.max_linear_acceleration_mps2, base.max_angular_acceleration_radps2]
        assert (np.abs(command - before) <= np.array(limit) * 0.1 + 1e-12).all()
        before = command
    np.testing.assert_allclose(
        np.abs(before), [base.max_linear_velocity_mps, base.max_angular_velocity_radps]
    )


def test_commands_satisfy_the_configured_speed_limits(robot: RobotModel) -> None:
    admittance = law(robot, v_max=0.2, omega_max=0.3)
    np.testing.assert_allclose(after(admittance, [-9.0, 9.0], 3.0), [-0.2, 0.3])
