"""How far an arm holds its hand while the base moves, and what the base is asked for then."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from app.control.hand_held import base_with_hand_held, farthest, with_hand_held

from app.avoidance.holding import HELD, Holding, arm_holding, hand_speeds
from app.config import AdmittanceConfig
from app.control.admittance import AdmittanceLaw, response
from app.robot.assets import load_robot, package_roots
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, at_rest
from tests.robots import husky_panda

V_MAX = AdmittanceConfig().v_max
INERTIA = np.array([46.0, 16.0])


@cache
def stretch() -> RobotModel:
    if not package_roots("stretch_urdf"):
        pytest.skip("pip install '.[robots]'")
    return RobotModel(load_robot("stretch_se3"))


def state_at(model: RobotModel, q_m: np.ndarray, nu: np.ndarray | None = None) -> RobotState:
    state = RobotState(model)
    state.update(at_rest(model, q_m)._replace(base_velocity=np.zeros(2) if nu is None else nu))
    return state


def middle_poses(model: RobotModel, count: int) -> list[np.ndarray]:
    """Random poses at least 0.2 s from every limit at full speed."""
    rng, room = np.random.default_rng(2), 0.2 * model.qd_max
    return [rng.uniform(model.q_lower + room, model.q_upper - room) for _ in range(count)]


def random_weight(rng: np.random.Generator) -> np.ndarray:
    root = rng.normal(size=(2, 2))
    return root @ root.T


def test_the_papers_arm_holds_its_hand_in_its_ready_pose() -> None:
    model = husky_panda()
    state = state_at(model, np.array(model.description.arm.ready_position), np.array([0.5, -1.0]))
    assert arm_holding(state, V_MAX) is HELD


def test_stretch_holds_its_hand_along_its_telescope_and_not_along_its_wheels() -> None:
    model = stretch()
    holding = arm_holding(state_at(model, np.array(model.description.arm.ready_position)), V_MAX)
    assert holding.share < 0.05
    assert holding.weight[0, 0] > 20
    assert holding.weight[1, 1] < 0.05


def test_hand_speeds_are_those_of_the_joints_speeds_with_the_height_kept() -> None:
    """Support of the ellipsoid {J W c, |c| ≤ 1} cut at z = 0, by its own inverse."""
    model = husky_panda()
    for q_m in middle_poses(model, 40):
        state = state_at(model, q_m)
        J = state.J_ee[:3, model.n_b :] * model.qd_max
        squares = 1.0 / np.linalg.eigvalsh(np.linalg.inv(J @ J.T)[:2, :2])
        speeds, along = hand_speeds(state)
        np.testing.assert_allclose(speeds, np.sqrt(squares[::-1]), rtol=1e-5)
        np.testing.assert_allclose(along.T @ along, np.eye(2), atol=1e-12)
        inverse = along @ np.diag(np.square(speeds)) @ along.T
        np.testing.assert_allclose(
            np.linalg.inv(inverse), np.linalg.inv(J @ J.T)[:2, :2], rtol=1e-4
        )


def test_hand_speeds_turn_with_the_robot() -> None:
    model, q_m, turn = husky_panda(), middle_poses(husky_panda(), 1)[0], 0.7
    one, other = state_at(model, q_m), RobotState(model)
    other.update(at_rest(model, q_m, np.array([3.0, -2.0, turn])))
    (speeds, along), (speeds_t, along_t) = hand_speeds(one), hand_speeds(other)
    R = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    np.testing.assert_allclose(speeds, speeds_t, rtol=1e-9)
    np.testing.assert_allclose(np.abs(along_t.T @ R @ along), np.eye(2), atol=1e-6)


def test_a_joint_at_its_limit_counts_only_where_it_comes_away_from_it() -> None:
    """Stretch's telescope, all in: the base may go where that draws it out, not the other way."""
    model = stretch()
    q_m = np.array(model.description.arm.ready_position)
    q_m[1:6] = 0.0, 0.0, 0.0, 0.0, 1.5
    hand = state_at(model, q_m)
    x = float(hand.to_base(hand.T_world_ee.translation)[0])
    away = np.array([0.0, 0.5]) * np.sign(x)  # takes the hand towards +y: drawn out to the right
    drawn, pushed = _along_y(model, q_m, away), _along_y(model, q_m, -away)
    assert drawn > 1.2
    assert pushed < 0.6 * drawn  # what is left is the wrist's


def _along_y(model: RobotModel, q_m: np.ndarray, nu: np.ndarray) -> float:
    """[m/s] hand's speed along y of the base, x and z kept."""
    speeds, along = hand_speeds(state_at(model, q_m, nu))
    inverse = along @ np.diag(1.0 / np.square(np.maximum(speeds, 1e-9))) @ along.T
    return float(1.0 / np.sqrt(inverse[1, 1]))


def test_the_share_moves_without_a_jump_along_a_path_through_poses_and_velocities() -> None:
    """Halving the steps halves the largest change."""
    model = husky_panda()
    rng = np.random.default_rng(4)
    q = rng.uniform(model.q_lower, model.q_upper, (2, model.n_m))
    nu = rng.uniform(-0.5, 0.5, (2, 2))

    def largest_change(steps: int) -> float:
        shares = [
            arm_holding(state_at(model, q[0] + s * (q[1] - q[0]), nu[0] + s * (nu[1] - nu[0])), 1.0)
            for s in np.linspace(0, 1, steps)
        ]
        values = np.array([s.share for s in shares])
        assert values.min() < 0.2 < 0.9 < values.max()
        return float(np.abs(np.diff(values)).max())

    coarse, fine = largest_change(1001), largest_change(4001)
    assert fine < 0.35 * coarse


@pytest.mark.parametrize("seed", range(5))
def test_without_a_weight_the_base_does_what_is_wanted(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted, held, carry = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(2, 2))
    asked = with_hand_held(wanted, held, np.zeros((2, 2)), carry=carry, mass=46.0, inertia=INERTIA)
    np.testing.assert_allclose(asked, wanted, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_the_heavier_the_hand_clings_the_less_it_is_taken_along(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted, held, carry = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(2, 2))
    u = rng.normal(size=2)
    u /= np.linalg.norm(u)
    taken = [
        abs(u @ carry @ (with_hand_held(wanted, held, w * np.outer(u, u), carry=carry, mass=46.0,
                                        inertia=INERTIA) - held))
        for w in (0.0, 0.1, 1.0, 10.0, 1e3, 1e6)
    ]  # fmt: skip
    assert (np.diff(taken) < 0).all()
    assert taken[-1] < 1e-4 * taken[0]


@pytest.mark.parametrize("seed", range(20))
def test_what_is_left_of_a_push_never_works_against_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted, held, carry = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(2, 2))
    weight = 10.0 ** rng.uniform(-2, 4) * random_weight(rng)
    asked = with_hand_held(wanted, held, weight, carry=carry, mass=46.0, inertia=INERTIA)
    push, done = INERTIA * (wanted - held), asked - held
    assert push @ done >= 0.0
    assert INERTIA @ np.square(done) <= INERTIA @ np.square(wanted - held) + 1e-12


@pytest.mark.parametrize("seed", range(20))
def test_the_farthest_point_lies_on_the_way_within_the_bounds_and_no_farther_one_does(
    seed: int,
) -> None:
    rng = np.random.default_rng(seed)
    lower, upper = -rng.uniform(0, 1, 3), rng.uniform(0, 1, 3)
    begin, end = rng.uniform(lower, upper), rng.normal(size=3)
    found = farthest(begin, end, lower, upper)
    share = (found - begin) @ (end - begin) / np.sum(np.square(end - begin))
    np.testing.assert_allclose(found, begin + share * (end - begin), atol=1e-12)
    assert ((found >= lower - 1e-12) & (found <= upper + 1e-12)).all()
    if share < 1.0 - 1e-12:
        on = begin + (share + 1e-6) * (end - begin)
        assert ((on < lower) | (on > upper)).any()
    else:
        np.testing.assert_allclose(found, end)


def test_a_held_hand_asks_for_what_is_wanted_within_the_limits_and_nothing_else() -> None:
    model = husky_panda()
    state = state_at(model, np.array(model.description.arm.ready_position), np.array([0.5, -1.0]))
    most = model.base_acceleration_max
    for wanted in (np.array([-1.0, 2.0]), np.array([-30.0, 2.0]), np.array([-30.0, 60.0])):
        asked = base_with_hand_held(
            state, wanted, np.array([0.3, 0.1]), HELD, 1.0, AdmittanceConfig()
        )
        np.testing.assert_allclose(asked, np.clip(wanted, -most, most), atol=1e-12)


def test_what_is_asked_turns_into_what_is_wanted_as_the_weight_goes() -> None:
    model = husky_panda()
    state = state_at(model, np.array(model.description.arm.ready_position), np.array([0.5, -1.0]))
    wanted, free = np.array([-30.0, 2.0]), np.zeros(2)
    most = model.base_acceleration_max
    for left in (1e-3, 1e-6):
        slack = Holding(1.0 - left, left * np.eye(2))
        asked = base_with_hand_held(state, wanted, free, slack, 1.0, AdmittanceConfig())
        np.testing.assert_allclose(asked, np.clip(wanted, -most, most), atol=100 * left)


def random_case(
    rng: np.random.Generator,
) -> tuple[RobotState, np.ndarray, np.ndarray, Holding]:
    """A state, `wanted` and `free` up to thrice the base's limits, and what an arm can do."""
    model = husky_panda()
    nu = rng.uniform(-1.2, 1.2, 2)
    state = state_at(model, np.array(model.description.arm.ready_position), nu)
    wanted, free = rng.uniform(-3, 3, (2, 2)) * model.base_acceleration_max
    share = rng.uniform(0, 1)
    return state, wanted, free, Holding(share, 10.0 ** rng.uniform(-3, 3) * random_weight(rng))


@pytest.mark.parametrize("seed", range(30))
def test_at_the_rim_of_the_buffer_the_base_does_what_it_did_outside(seed: int) -> None:
    """β → 0: the limit is what the controller asks without the base's rows."""
    state, _, free, holding = random_case(np.random.default_rng(seed))
    most = state.model.base_acceleration_max
    for beta in (1e-9, 1e-12):
        asked = base_with_hand_held(state, free, free, holding, beta, AdmittanceConfig())
        np.testing.assert_allclose(asked, np.clip(free, -most, most), atol=1e-5)


def test_a_turning_base_whose_arm_does_not_follow_brakes_at_the_rim_as_outside() -> None:
    model = husky_panda()
    nu, free = np.array([0.2, 1.0]), np.array([-0.6, -3.0])
    state = state_at(model, np.array(model.description.arm.ready_position), nu)
    lost = Holding(0.0, 1e3 * np.eye(2))
    asked = base_with_hand_held(state, free, free, lost, 1e-12, AdmittanceConfig())
    np.testing.assert_allclose(asked, free, atol=1e-6)


@pytest.mark.parametrize("seed", range(30))
def test_what_is_asked_of_the_base_is_within_its_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    state, wanted, free, holding = random_case(rng)
    asked = base_with_hand_held(state, wanted, free, holding, rng.uniform(), AdmittanceConfig())
    assert (np.abs(asked) <= state.model.base_acceleration_max + 1e-9).all()


@pytest.mark.parametrize("begin", [0.0, 0.5, 1.0, 3.0])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_hand_held_by_all_that_the_base_can_leaves_its_other_axis_free(
    begin: float, axis: int
) -> None:
    """Also where what holds it lies on or beyond a limit: a step across it stops nothing else."""
    model = husky_panda()
    state = state_at(model, np.array(model.description.arm.ready_position))
    most = model.base_acceleration_max
    free, wanted = np.zeros(2), np.zeros(2)
    gain = response(model.description.base, AdmittanceConfig()).gain
    free[axis] = begin * (most * gain)[axis]
    wanted[axis], wanted[1 - axis] = 1.001 * most[axis], 0.3 * most[1 - axis]
    for share in (0.0, 0.5):
        slack = Holding(share, np.zeros((2, 2)))
        asked = base_with_hand_held(state, wanted, free, slack, 1.0, AdmittanceConfig())
        assert asked[1 - axis] > 0.05 * most[1 - axis]


@pytest.mark.parametrize("seed", range(30))
def test_what_is_asked_of_the_base_moves_without_a_jump(seed: int) -> None:
    """Along a line of inputs, saturated ones among them, the steepest step looked at closer."""
    rng = np.random.default_rng(seed)
    (state, wanted, free, one), (_, wanted_b, free_b, other) = random_case(rng), random_case(rng)
    nu, nu_b, betas = *rng.uniform(-1.2, 1.2, (2, 2)), rng.uniform(0, 1, 2)
    q_m = state.measurement.q_m

    def at(s: float) -> np.ndarray:
        state.update(at_rest(state.model, q_m)._replace(base_velocity=nu + s * (nu_b - nu)))
        share = one.share + s * (other.share - one.share)
        holding = Holding(share, one.weight + s * (other.weight - one.weight))
        return base_with_hand_held(
            state, wanted + s * (wanted_b - wanted), free + s * (free_b - free), holding,
            float(betas[0] + s * (betas[1] - betas[0])), AdmittanceConfig(),
        )  # fmt: skip

    low, high, change = 0.0, 1.0, np.ones(1)
    for _ in range(4):
        places = np.linspace(low, high, 101)
        found = np.array([at(s) for s in places]) / state.model.base_acceleration_max
        change = np.abs(np.diff(found, axis=0)).max(axis=1)
        low, high = places[change.argmax()], places[change.argmax() + 1]
    assert change.max() < 1e-3


@pytest.mark.parametrize("seed", range(5))
def test_the_mass_is_that_of_the_base_in_whatever_order_its_axes_are(seed: int) -> None:
    rng = np.random.default_rng(seed)
    wanted, held, carry = rng.normal(size=2), rng.normal(size=2), rng.normal(size=(2, 2))
    weight = random_weight(rng)
    one = with_hand_held(wanted, held, weight, carry=carry, mass=46.0, inertia=INERTIA)
    turned = with_hand_held(
        wanted[::-1], held[::-1], weight, carry=carry[:, ::-1], mass=46.0, inertia=INERTIA[::-1]
    )
    np.testing.assert_allclose(turned[::-1], one, atol=1e-12)


@pytest.mark.parametrize("wanted", [[-3.0, -6.0], [3.0, 1.0], [-1.0, 6.0], [0.0, 6.0]])
def test_a_base_pushed_for_three_seconds_leaves_the_hand_of_stretch_where_it_is(
    wanted: list[float],
) -> None:
    """With the arm following by least squares, within its velocity limits."""
    drift, path = _pushed(np.array(wanted), hold=True)
    assert drift < 0.03
    assert path > 0.05
    loose, _ = _pushed(np.array(wanted), hold=False)
    assert loose > 10 * drift


def _pushed(wanted: np.ndarray, *, hold: bool) -> tuple[float, float]:
    """[m] how far the hand is taken along at most, and the base's path with its turning."""
    model, config, dt = stretch(), AdmittanceConfig(), 0.01
    law, state = AdmittanceLaw(model.description.base, config), RobotState(model)
    pose, nu = np.zeros(3), np.zeros(2)
    q_m = np.array(model.description.arm.ready_position)
    drift = path = 0.0
    begin: np.ndarray | None = None
    for _ in range(300):
        state.update_kinematics(Measurement(pose, nu, q_m, np.zeros(model.n_m)))
        hand = state.T_world_ee.translation.copy()
        begin = hand if begin is None else begin
        drift = max(drift, float(np.linalg.norm((hand - begin)[:2])))
        asked = wanted
        if hold:
            holding = arm_holding(state, config.v_max)
            asked = base_with_hand_held(state, wanted, -3.0 * nu, holding, 1.0, config)
        nu = law.update(asked, dt).copy()
        J, J_m = state.J_ee[:3], state.J_ee[:3, model.n_b :]
        carried = J[:, : model.n_b] @ model.J_m_inv @ nu
        qd = np.clip(np.linalg.pinv(J_m, rcond=0.15) @ -carried, -model.qd_max, model.qd_max)
        q_m = np.clip(q_m + dt * qd, model.q_lower, model.q_upper)
        c, s = np.cos(pose[2]), np.sin(pose[2])
        pose = pose + dt * np.array([c * nu[0], s * nu[0], nu[1]])
        path += dt * float(np.abs(nu).sum())
    return drift, path
