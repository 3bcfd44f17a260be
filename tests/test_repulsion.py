"""Laws of the repulsive rows, (20) to (23)."""

import numpy as np
import pinocchio as pin
import pytest
from finite_differences import derivative, jacobian

from app.avoidance.distances import ClosestPoints, DistanceMonitor
from app.avoidance.repulsion import distance_jacobian, distance_speed, generate_rep_acc
from app.config import RepulsionConfig
from app.robot.link_pairs import candidate_pairs
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState

CONFIG = RepulsionConfig(k_p=60.0, k_v=30.0)


class Moving:
    """A robot at a random place, each step of which is integrated from there."""

    def __init__(self, robot: RobotModel, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.model = robot
        self.state = RobotState(robot)
        span = robot.q_upper - robot.q_lower
        self.pose = rng.normal(size=3)
        self.q_m = robot.q_lower + span * rng.uniform(0.2, 0.8, size=robot.n_m)
        self.qd = rng.normal(size=robot.n)
        self.monitor = DistanceMonitor(self.state, candidate_pairs(robot))
        self.at(0.0, self.qd)

    def at(self, t: float, qd: np.ndarray) -> list[ClosestPoints]:
        """State after moving along `qd` for t, and the pairs there."""
        q = self.model.configuration(self.pose, self.q_m)
        q = pin.integrate(self.model.pin, q, self.model.S @ (qd * t))
        pose = np.array([q[0], q[1], np.arctan2(q[3], q[2])])
        measurement = Measurement(pose, self.model.J_m @ qd[:2], q[4:], qd[2:])
        self.state.update(measurement)
        return self.monitor.find_closest_points()


@pytest.mark.parametrize("seed", range(6))
def test_J_r_is_the_gradient_of_the_distance(robot: RobotModel, seed: int) -> None:
    moving = Moving(robot, seed)
    for i, closest in enumerate(moving.at(0.0, moving.qd)):
        row = generate_rep_acc(moving.state, closest, CONFIG)
        numeric = jacobian(lambda qd, i=i: moving.at(1.0, qd)[i].d, robot.n)
        moving.at(0.0, moving.qd)
        np.testing.assert_allclose(row.J_r, numeric, atol=2e-5)


@pytest.mark.parametrize("seed", range(6))
def test_distances_within_the_robot_do_not_depend_on_the_base(robot: RobotModel, seed: int) -> None:
    moving = Moving(robot, seed)
    for closest in moving.at(0.0, moving.qd):
        row = generate_rep_acc(moving.state, closest, CONFIG)
        np.testing.assert_allclose(row.J_r[:2], 0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(6))
def test_Jdqd_is_the_second_derivative_of_the_distance_of_points_fixed_to_their_links(
    robot: RobotModel, seed: int
) -> None:
    moving = Moving(robot, seed)
    closest_now = moving.at(0.0, moving.qd)
    data = moving.state.data
    for closest in closest_now:
        if closest.d < 0.03:
            continue
        joints = [robot.body_joint(closest.pair.a), robot.body_joint(closest.pair.b)]
        moving.at(0.0, moving.qd)
        row = generate_rep_acc(moving.state, closest, CONFIG)
        local = [
            data.oMi[j].actInv(p) for j, p in zip(joints, (closest.p_a, closest.p_b), strict=True)
        ]

        def gap(t: float, joints=joints, local=local) -> float:
            moving.at(t, moving.qd)
            a, b = (data.oMi[j].act(p) for j, p in zip(joints, local, strict=True))
            return float(np.linalg.norm(b - a))

        second = derivative(lambda t, gap=gap: derivative(lambda s: gap(t + s), 1e-4), 1e-4)
        assert row.Jdqd == pytest.approx(float(second), abs=2e-3, rel=2e-3)


def test_two_links_at_rest_are_parted_and_parting_links_are_braked(robot: RobotModel) -> None:
    moving = Moving(robot, 3)
    moving.at(0.0, np.zeros(robot.n))
    closest = moving.monitor.find_closest_points()[-1]
    assert generate_rep_acc(moving.state, closest, CONFIG).xdd_r == pytest.approx(60.0)
    row = generate_rep_acc(moving.state, closest, CONFIG)
    moving.at(0.0, row.J_r / np.linalg.norm(row.J_r) ** 2)  # distance grows by 1 m/s
    assert generate_rep_acc(moving.state, closest, CONFIG).xdd_r == pytest.approx(30.0)


def test_in_penetration_the_normal_still_parts_the_links(robot: RobotModel) -> None:
    """What witness points get wrong: they change sides."""
    rng = np.random.default_rng(0)
    moving = Moving(robot, 0)
    found = 0
    while found < 20:
        moving.q_m = rng.uniform(robot.q_lower, robot.q_upper)
        for i, closest in enumerate(moving.at(0.0, np.zeros(robot.n))):
            if not -0.05 < closest.d < -0.005:
                continue
            found += 1
            row = generate_rep_acc(moving.state, closest, CONFIG)
            along = row.J_r / np.linalg.norm(row.J_r) ** 2 * 1e-3
            assert moving.at(1.0, along)[i].d > closest.d
            moving.at(0.0, np.zeros(robot.n))


@pytest.mark.parametrize("seed", range(6))
def test_the_speed_alone_is_that_of_the_distance_jacobian(robot: RobotModel, seed: int) -> None:
    moving = Moving(robot, seed)
    for closest in moving.at(0.0, moving.qd):
        speed = distance_jacobian(moving.state, closest).speed
        assert distance_speed(moving.state, closest) == speed
        assert speed == pytest.approx(float(distance_jacobian(moving.state, closest).J @ moving.qd))
