"""Properties of the compared methods: the terms that each adds, and the unchanged rest."""

import numpy as np
import pinocchio as pin
import pytest

from app.avoidance.closest_points import DistanceMonitor
from app.border.cache import BorderData
from app.config import BarrierConfig, Config
from app.control.controller import CONTROLLERS, Controller
from app.control.limits import barrier_bound
from app.control.quantities import ControlStep
from app.control.tasks import Reference
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, point_bias
from app.simulation.scenarios import scenario_by_name
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import Session

ZERO = np.zeros(3)
AT_ONCE = Config().replace("limit.torque_rate", 1e6)
"""Torques may change at once, so that one step shows the demand of the tasks."""


@pytest.fixture(scope="module", params=CONTROLLERS)
def controller(
    request: pytest.FixtureRequest, robot: RobotModel, border_data: BorderData
) -> Controller:
    return Controller(robot, border_data, Config(), name=request.param)


def near(robot: RobotModel, seed: int, low: float, high: float, speed: float = 0.05) -> Measurement:
    """A random slow state with the end-effector `low` to `high` [m] from the base, all else far."""
    rng = np.random.default_rng(seed)
    reader = PairDistances(robot, candidate_pairs(robot))
    names = [pair.name for pair in reader.pairs]
    while True:
        q_m = rng.uniform(robot.q_lower + 0.3, robot.q_upper - 0.3)
        reader.update(robot.configuration(ZERO, q_m))
        d = dict(zip(names, reader.distances(), strict=True))
        others = [v for name, v in d.items() if name not in ("lm-lEE", "l1-l2")]
        if low < d["lm-lEE"] < high and min(others) > 0.16:
            v = rng.normal(scale=speed, size=robot.n)
            return Measurement(ZERO, v[:2], q_m, v[2:])


def here(controller: Controller, acceleration: np.ndarray) -> Reference:
    return Reference(pin.SE3(controller.state.T_world_ee), np.zeros(6), acceleration)


def realised(controller: Controller, output: ControlStep) -> np.ndarray:
    """(n,) q̈ that results from the torques and base acceleration of a control step."""
    state = controller.state
    wheels = np.linalg.solve(state.model.J_m, output.a_base_cmd)
    rhs = output.u_cmd - state.h[2:] - state.M[2:, :2] @ wheels
    return np.concatenate([wheels, np.linalg.solve(state.M[2:, 2:], rhs)])


def bound(Jdqd: float, d_dot: float, d: float, config: BarrierConfig) -> float:
    """[m/s²] `barrier_bound` for the distance d [m], with the parameters of a configuration."""
    return barrier_bound(Jdqd, d_dot, d - config.d_min, config.rate, config.max_separation_speed)


@pytest.mark.parametrize("seed", range(4))
def test_repulsion_adds_no_acceleration_of_the_base(
    robot: RobotModel, border_data: BorderData, seed: int
) -> None:
    """With `repulsive`, the base follows the other tasks; a guided base comes to rest."""
    controller = Controller(robot, border_data, Config(), name="repulsive")
    m = near(robot, seed, 0.02, 0.12)
    output = controller.step(m)
    assert output.activation > 0.0
    rest = -Config().task.base_damping * output.base_velocity
    np.testing.assert_allclose(output.a_base_cmd, rest, atol=1e-12)
    reference = here(controller, np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0]))
    tracked = controller.step(m, reference)
    without = Controller(robot, border_data, Config(), name="none")
    without.step(m)
    plain = without.step(m, reference)
    assert np.abs(tracked.u_cmd - plain.u_cmd).max() > 0.1
    np.testing.assert_allclose(tracked.a_base_cmd, plain.a_base_cmd, atol=1e-4)


@pytest.mark.parametrize("seed", range(4))
def test_fully_active_repulsion_realises_the_closest_points_acceleration(
    robot: RobotModel, border_data: BorderData, seed: int
) -> None:
    """J_rep q̈ + J̇ q̇ = k_p n - k_v ṗ, with the base's columns zero, where no limit is active."""
    config = AT_ONCE.replace("repulsion.k_p", 3.0)
    controller = Controller(robot, border_data, config, name="repulsive")
    m = near(robot, seed, 0.01, 0.05, speed=0.01)
    output = controller.step(m)
    first, joint = 2 + len(output.pairs) - output.n_mob, robot.body_joints["lEE"]
    rows = slice(first, first + 3)
    np.testing.assert_array_equal(output.B[rows], np.ones(3))
    assert not output.B[first + 3 :].any()
    J, b = output.J_sca[rows], output.b_sca[rows]
    assert not J[:, :2].any()
    np.testing.assert_allclose(J @ realised(controller, output), b, atol=1e-2)
    state = controller.state
    xdd = b + np.array(point_bias(state.twists[joint], state.biases[joint], output.p_b[0]))
    np.testing.assert_allclose(xdd + 30.0 * (J @ output.qd), 3.0 * output.normal[0], atol=1e-9)


@pytest.mark.parametrize("seed", range(8))
def test_realised_acceleration_satisfies_the_barriers(
    robot: RobotModel, border_data: BorderData, seed: int
) -> None:
    """Base and arm together satisfy them, even if the reference accelerates into the base."""
    controller = Controller(robot, border_data, AT_ONCE, name="barrier")
    m = near(robot, seed, 0.051, 0.08, speed=0.02)
    controller.step(m)
    towards = np.concatenate([-20.0 * controller.step(m).normal[0], np.zeros(3)])
    output = controller.step(m, here(controller, towards))
    assert output.solved
    qdd = realised(controller, output)
    assert output.n_limits == 2 * robot.n_m + len(output.pairs)
    for J, Jdqd, d_dot, d in zip(output.J, output.Jdqd, output.d_dot, output.d, strict=True):
        least = bound(Jdqd, d_dot, d, AT_ONCE.barrier)
        assert J @ qdd >= least - 2 * Config().task.slack_weight * (20.0 + abs(least))


@pytest.mark.parametrize("seed", range(4))
def test_a_barrier_is_the_second_order_form_of_its_distance(robot: RobotModel, seed: int) -> None:
    """Its bound is the d̈ with which d̈ + 2 λ ḋ + λ² (d - d_min) = 0, by finite differences of d."""
    state, config = RobotState(robot), BarrierConfig()
    m = near(robot, seed, 0.03, 0.12, speed=0.2)
    rng = np.random.default_rng(seed)
    qdd = rng.normal(size=robot.n)
    state.update(m)
    pairs = PairDistances(robot, candidate_pairs(robot))
    index = [p.name for p in pairs.pairs].index("lm-lEE")
    (closest,) = DistanceMonitor(state, [pairs.pairs[index]]).find_closest_points()
    joints = np.array([[robot.body_joints[body] for body in closest.pair]])
    (J,), *moves = state.distance_motions(joints, closest.core[None], closest.n[None])
    least = bound(*[float(each[0]) for each in moves], closest.d, config)

    def distance(t: float) -> float:
        v = robot.S @ (state.qd * t + 0.5 * qdd * t * t)
        q = pin.integrate(robot.pin, robot.configuration(m.base_pose, m.q_m), v)
        pairs.update(q)
        return pairs.distances()[index]

    h = 1e-3
    ddot = (distance(h) - distance(-h)) / (2 * h)
    demanded = -2 * config.rate * ddot - config.rate**2 * (distance(0.0) - config.d_min)
    np.testing.assert_allclose(J @ state.qd, ddot, atol=1e-4)
    J_dot_qd = (
        -least - 2 * config.rate * (J @ state.qd) - config.rate**2 * (closest.d - config.d_min)
    )
    np.testing.assert_allclose(least, demanded - J_dot_qd, atol=1e-2)


def test_every_method_equals_none_far_from_the_base(
    robot: RobotModel, border_data: BorderData, controller: Controller
) -> None:
    plain = Controller(robot, border_data, Config(), name="none")
    m = Measurement(
        ZERO, np.array([0.1, -0.1]), np.array(robot.description.arm.ready_position), np.full(7, 0.1)
    )
    expected, output = plain.step(m), controller.step(m)
    np.testing.assert_allclose(output.u_cmd, expected.u_cmd, atol=1e-5)
    np.testing.assert_allclose(output.a_base_cmd, expected.a_base_cmd, atol=1e-5)


def run_a_line(
    robot: RobotModel, data: BorderData, name: str, config: Config, start: tuple[float, ...]
) -> tuple[float, float, float]:
    """Clearance [m], final error [m] and ∫ |v| + |ω| dt [m + rad] of the tracking line in 4 s."""
    scenario = scenario_by_name("tracking").changed(start=start, duration=4.0)  # type: ignore[arg-type]
    q_m = StartSolver(robot, data.pairs, config.border.d_b).solve(scenario.start, seed=0)
    session = Session(robot, data, config, controller=name, physics="kinematic")
    session.reset(q_m)
    orientation = session.T_world_ee.rotation.copy()
    clearance, path = np.inf, 0.0
    for _ in range(4000):
        step = session.step(reference=scenario.reference(session.t, orientation))
        clearance = min(clearance, *step.control.d[: step.control.n_mob].tolist())
        path += float(np.abs(step.measurement.base_velocity).sum()) * 0.001
    session.close()
    return clearance, step.ee_error, path


@pytest.mark.slow
def test_repulsive_avoids_contact_but_does_not_reach_the_target(
    robot: RobotModel, border_data: BorderData
) -> None:
    clearance, error, path = run_a_line(
        robot, border_data, "repulsive", Config(), (0.30, 0.68, 0.30)
    )
    assert clearance > 0.03
    assert error > 0.02
    assert path < 0.02


@pytest.mark.slow
def test_barrier_with_a_large_base_weight_stops_on_the_wheel_axis(
    robot: RobotModel, border_data: BorderData
) -> None:
    """The paper's method reaches the target from the same start."""
    start = (0.0, 0.68, 0.30)
    reluctant = Config().replace("task.base_weight", 1e6)
    clearance, error, path = run_a_line(robot, border_data, "barrier", reluctant, start)
    assert clearance > 0.025
    assert error > 0.02
    assert path < 0.02
    clearance, error, path = run_a_line(robot, border_data, "dbb", Config(), start)
    assert clearance > 0.03
    assert error < 0.005
    assert path > 0.1
