"""Forces, levels and limits in the explanation of a step agree with independent computations."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.border.cache import BorderData
from app.border.score import ScoreField
from app.config import Config
from app.control.controller import CONTROLLERS, Controller
from app.control.explanation import (
    TOLERANCE,
    Bound,
    Explanation,
    Level,
    NearPair,
    admittance_bounds,
    explain,
    level_readings,
    met,
    split,
)
from app.control.limits import barrier_bound
from app.control.quantities import ControlStep
from app.control.tasks import Reference, free_arm_torque, reaction_torque
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.loop.pacing import Pacer
from app.simulation.session import Session
from app.simulation.trace.snapshot import make_snapshot
from tests.qps import Limits, Objective, Rows, ee_task, inserted, solved

AT_ONCE = Config().replace("limit.torque_rate", 1e6)
UNHELD = AT_ONCE.replace("ee_hold.weight", 0.01)
"""The hold of the end-effector has almost no weight, so that the base follows (29)."""
REST = np.zeros(2)
SEEDS = range(4)


@pytest.fixture(scope="module")
def controllers(robot: RobotModel, border_data: BorderData) -> dict[str, Controller]:
    """One controller of each kind; torques may change at once and are those of the QP."""
    return {name: Controller(robot, border_data, AT_ONCE, name=name) for name in CONTROLLERS}


@pytest.fixture(scope="module")
def dbb(controllers: dict[str, Controller]) -> Controller:
    return controllers["dbb"]


def near(robot: RobotModel, pair: str, seed: int, low: float = 0.06, high: float = 0.12):
    """A random slow state with a pair's distance within bounds and its normal not steep."""
    rng = np.random.default_rng(seed)
    reader = PairDistances(robot, candidate_pairs(robot))
    names = [p.name for p in reader.pairs]
    while True:
        q_m = rng.uniform(robot.q_lower + 0.4, robot.q_upper - 0.4)
        reader.update(robot.configuration(np.zeros(3), q_m))
        d = dict(zip(names, reader.distances(), strict=True))
        n_z = reader.closest(names.index(pair)).n[2]
        if low < d[pair] < high and abs(n_z) < 0.7 and all(v > 0.02 for v in d.values()):
            pose = np.array([1.0, -2.0, rng.uniform(-3, 3)])
            return Measurement(pose, rng.normal(0, 0.05, 2), q_m, rng.normal(0, 0.05, robot.n_m))


def explained(
    controller: Controller,
    m: Measurement,
    reference: Reference | None = None,
    config: Config = AT_ONCE,
    command: np.ndarray = REST,
) -> tuple[Explanation, ControlStep]:
    controller.reset()
    controller.configure(config)
    output = controller.step(m, reference).copy()
    return explain(controller, output, config, command), output


def qdd_of(controller: Controller, output: ControlStep) -> np.ndarray:
    """q̈ by the equation of motion, from torques and the base's acceleration alone."""
    state = controller.state
    qdd_b = np.linalg.solve(state.model.J_m, output.a_base_cmd)
    M_a = state.M[2:]
    rest = output.u_cmd - state.h[2:] - M_a[:, :2] @ qdd_b
    return np.concatenate([qdd_b, np.linalg.solve(M_a[:, 2:], rest)])


def level(why: Explanation, name: str) -> Level:
    return next(level for level in why.levels if level.name == name)


def here(controller: Controller, m: Measurement, *, off: float = 0.0) -> Reference:
    """A reference at rest at the end-effector, or `off` metres above it."""
    controller.state.update(m)
    pose = controller.state.T_world_ee
    pose = pin.SE3(pose.rotation.copy(), pose.translation + np.array([0.0, 0.0, off]))
    return Reference(pose, np.zeros(6), np.zeros(6))


# Forces


def number_of(output: ControlStep, pair: NearPair) -> int:
    """Index of the pair among the pairs of a step."""
    return [each.name for each in output.pairs].index(f"{pair.a}-{pair.b}")


@given(
    st.floats(-np.pi, np.pi), st.floats(0, 600), st.floats(-np.pi, np.pi), st.floats(-1.57, 1.57)
)
def test_away_and_turn_sum_to_the_force_and_are_orthogonal(heading, size, azimuth, height):
    f = size * np.array([np.cos(heading), np.sin(heading), 0.0])
    n = np.array([*(np.cos(height) * np.array([np.cos(azimuth), np.sin(azimuth)])), np.sin(height)])
    away, turn = split(f, n)
    np.testing.assert_allclose(away + turn, f, atol=1e-9)
    assert abs(away @ turn) <= 1e-9 * (1 + size**2)
    assert abs(turn @ n) <= 1e-6 * (1 + size)
    assert away[2] == turn[2] == 0.0


@pytest.mark.parametrize("seed", SEEDS)
def test_a_pairs_force_and_its_parts_give_the_base_acceleration(robot, dbb, seed):
    why, output = explained(dbb, near(robot, "lm-lEE", seed))
    assert why.forces
    for pair in why.near:
        if pair.force is None:
            continue
        f = output.f[number_of(output, pair)]
        np.testing.assert_allclose([*pair.force.f, 0.0], f, atol=1e-12)
        np.testing.assert_allclose(np.add(pair.force.away, pair.force.turn), f[:2], atol=1e-9)
    total = sum(np.add(f.away_acceleration, f.turn_acceleration) for f in why.forces)
    np.testing.assert_allclose(total, output.base_avoidance, atol=1e-9)
    np.testing.assert_allclose(why.base_avoidance, total, atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_the_turn_moves_a_higher_score_towards_the_end_effector(robot, dbb, seed):
    """The other part of the force moves the base away from the end-effector."""
    why, output = explained(dbb, near(robot, "lm-lEE", seed))
    assert why.forces
    for pair in why.near:
        if pair.force is None:
            continue
        i = number_of(output, pair)
        assert np.dot(pair.force.away, pair.n[:2]) < 0.0 or pair.above == 1.0
        step = (output.p_t[i] - output.p_n[i])[:2]
        assert np.dot(pair.force.turn, step) <= 1e-9
        assert pair.force.score >= pair.force.score_near - 1e-12


@pytest.mark.parametrize("seed", SEEDS)
def test_determinant_reachability_and_score_are_the_fields_at_p_act(robot, dbb, seed):
    why, output = explained(dbb, near(robot, "lm-l3", seed))
    assert not np.isnan(output.p_act[:, 0]).all()
    for pair, p_act, p_n in zip(output.pairs, output.p_act, output.p_n, strict=False):
        if np.isnan(p_act[0]):
            continue
        field = ScoreField.of(robot, pair.b)
        force = next(p.force for p in why.near if (p.a, p.b) == tuple(pair))
        assert force is not None
        assert force.determinant == pytest.approx(float(field.singularity(p_act)))
        assert force.reachability == pytest.approx(float(field.reachability(p_act)))
        assert force.score == pytest.approx(float(field.score(p_act)))
        assert force.score_near == pytest.approx(float(field.score(p_n)))


def test_forces_and_normals_do_not_depend_on_the_base_pose(robot, dbb):
    m = near(robot, "lm-lEE", 1)
    here_, there = (
        explained(dbb, m._replace(base_pose=np.array(pose)))[0]
        for pose in ([0.0, 0.0, 0.0], [3.0, -1.0, 2.2])
    )
    np.testing.assert_allclose(here_.forces[0].f, there.forces[0].f, atol=1e-6)
    np.testing.assert_allclose(here_.near[0].n, there.near[0].n, atol=1e-9)


# Levels


@pytest.mark.parametrize("name", ["dbb", "repulsive", "barrier", "none"])
@pytest.mark.parametrize("off", [0.0, 0.8])
def test_the_end_effectors_slack_is_the_residual_of_its_task(robot, controllers, name, off):
    """With an error of 0.8 m the task demands 30 m/s² (`ee_speed`), beyond the torque limits."""
    controller, m = controllers[name], near(robot, "lm-lEE", 2)
    reference = here(controller, m, off=off)
    why, output = explained(controller, m, reference)
    task = ee_task(controller.state, reference, AT_ONCE.task)
    w = task.b - task.J @ qdd_of(controller, output)
    ee = level(why, "ee")
    assert ee.linear is not None
    assert (ee.linear, ee.angular) == pytest.approx(
        (np.linalg.norm(w[:3]), np.linalg.norm(w[3:])), abs=1e-4, rel=1e-3
    )
    assert (off > 0.0) == (ee.linear > 10.0) or name == "repulsive"


def test_a_level_that_is_met_has_no_slack(robot, dbb):
    m = near(robot, "lm-lEE", 2)
    why, _ = explained(dbb, m, here(dbb, m), config=UNHELD)
    assert level(why, "ee").linear == pytest.approx(0.0, abs=1e-2)  # up to its weight
    assert level(why, "base")[1:] == pytest.approx((0.0, 0.0), abs=1e-2)
    names = [reading.name for reading in why.levels]
    assert (names[0], *names[-2:]) == ("base", "ee", "posture")


@pytest.mark.parametrize("seed", SEEDS)
def test_the_slack_of_the_posture_is_the_missing_acceleration(robot, dbb, seed):
    m = near(robot, "lm-lEE", seed)
    why, output = explained(dbb, m, here(dbb, m))
    lower, upper = robot.q_limits
    out = (2.0 * m.q_m - lower - upper) / (upper - lower)
    task = AT_ONCE.task  # the posture is the current one
    wanted = -task.posture_damping * m.qd_m - task.joint_centering * (upper - lower) / 2 * out**5
    expected = np.linalg.norm(qdd_of(dbb, output)[2:] - wanted)
    assert level(why, "posture").angular == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("pair", ["lm-lEE", "l1-l3"])
def test_the_slack_of_a_guided_arm_is_its_deviation_from_free_motion(robot, dbb, pair):
    why, output = explained(dbb, near(robot, pair, 0))
    u_0, near_base = free_arm_torque(output.g, output.qd, robot.joint_damping), slice(output.n_mob)
    distances, f_arm = (output.d[near_base], output.J[near_base]), AT_ONCE.force.f_arm
    u_0 += reaction_torque(*distances, f_arm, float(output.d_b), 2)
    expected = np.linalg.norm(np.linalg.solve(output.M[2:, 2:], output.u_cmd - u_0))
    assert level(why, "free").angular == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("gap", [0.0, 2.0, 5.0])
def test_contradicting_rows_share_their_difference_equally(robot, dbb, gap):
    _, output = explained(dbb, near(robot, "l1-l3", 0))
    e = np.eye(9)
    objective, base = Objective(e, np.zeros(9)), Rows(e[:2], np.zeros(2), np.ones(2))
    rows = Rows(e[[5, 5]], np.array([1.0, 1.0 + gap]), np.ones(2))
    limits = Limits(e[:1], np.array([-1e6]), np.array([1e6]), np.full(1, 1e-6))
    above = Rows(*map(np.concatenate, zip(base, rows, strict=True)))
    output.qdd[:] = solved(inserted(objective, above, 1e-6), limits)
    (output.H_low[:], output.c_low[:]), (output.H[:], output.c[:]) = objective, objective
    assert len(output.pairs) - output.n_mob >= 2
    output.B[:] = 0.0
    output.J_sca[2:4], output.b_sca[2:4], output.B[2:4] = rows
    links, free = level_readings(robot.description.base, output)
    assert links == ("links", pytest.approx(np.sqrt(2.0) * gap / 2.0, abs=1e-4), None)
    assert free.angular == pytest.approx(1.0 + gap / 2.0, abs=1e-4)


def test_the_slack_of_the_base_is_the_demand_beyond_its_acceleration(robot, dbb):
    strong = UNHELD.replace("force.f_max", 600.0)
    seeds = (explained(dbb, near(robot, "lm-lEE", s, 0.02, 0.04), config=strong) for s in range(20))
    why, output = next((w, o) for w, o in seeds if any(b.where == "base" for b in w.bounds))
    most = np.array(robot.description.base.max_acceleration)
    wanted = output.beta_m * output.xdd_m  # β = 1: no other term
    assert output.beta_m == 1.0
    excess = np.maximum(np.abs(wanted) - most, 0.0)
    assert level(why, "base")[1:] == pytest.approx(tuple(excess), abs=1e-2)
    kinds = {bound.kind for bound in why.bounds if bound.where == "base"}
    names = np.array(["acceleration", "angular acceleration"])
    assert kinds == set(names[excess > 0.0])


@pytest.mark.parametrize("seed", SEEDS)
def test_the_slack_of_the_base_has_motion_that_the_arm_cannot_compensate(
    robot, border_data, dbb, seed
):
    """This part is reported as slack of the base, not as a limit of the base."""
    speeds = tuple(float(v) for v in robot.qd_max / 50)
    arm = robot.description.arm.model_copy(update={"max_velocity": speeds})
    slow = RobotModel(robot.description.model_copy(update={"arm": arm}))
    m = near(robot, "lm-lEE", seed)
    m = Measurement(m.base_pose, REST, m.q_m, np.zeros(7))
    why, output = explained(Controller(slow, border_data, AT_ONCE), m)
    wanted = output.beta_m * output.xdd_m  # no other term at rest
    missing = np.abs(wanted - output.a_base_cmd)
    assert level(why, "base")[1:] == pytest.approx(tuple(missing), abs=1e-9)
    assert np.linalg.norm(missing) > 0.5 * np.linalg.norm(wanted) > 0.0
    assert not [b for b in why.bounds if b.where == "base" and "acceleration" in b.kind]


# Limits


@pytest.mark.parametrize("seed", range(10))
def test_a_bound_is_reported_exactly_if_relaxing_it_changes_the_result(robot, dbb, seed):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(9, 9))
    objective = Objective(A @ A.T + np.eye(9), 3.0 * rng.normal(size=9))
    softness = np.repeat([0.0, 1e-6], 3)
    limits = Limits(np.eye(9)[:6], np.full(6, -0.3), np.full(6, 0.3), softness)
    qdd, w = solved(objective, limits), dbb.last.copy()
    w.C[:6], w.l[:6], w.u[:6], w.softness[:6] = limits
    w.n_limits[()], w.qdd[:] = 6, qdd
    low, high = met(w)
    assert (low | high).any()
    for i in range(6):
        for side, at in ((limits.l, low[i]), (limits.u, high[i])):
            kept, side[i] = side[i], 10.0 * side[i]
            moved = np.abs(solved(objective, limits) - qdd).max()
            side[i] = kept
            assert (moved > 10 * TOLERANCE) == at


def test_a_torque_limit_is_reported_for_each_joint_at_its_limit(robot, dbb):
    m = near(robot, "lm-lEE", 2)
    for off in (0.0, 0.8):
        why, output = explained(dbb, m, here(dbb, m, off=off))
        full = np.abs(output.u_cmd) >= robot.tau_max - 1e-5
        joints = robot.description.arm.joints
        reported = {bound.where for bound in why.bounds if bound.kind == "torque"}
        assert reported == {joint for joint, at in zip(joints, full, strict=True) if at}
        assert bool(reported) == (off > 0.0)


@pytest.mark.parametrize("upper", [True, False])
@pytest.mark.parametrize("kind", ["position", "velocity"])
def test_a_joint_braked_before_its_limit_reports_the_limit(robot, dbb, kind, upper):
    sign, joint = (1.0 if upper else -1.0), 0
    q_m, qd_m = np.array(robot.description.arm.ready_position), np.zeros(robot.n_m)
    if kind == "position":
        q_m[joint] = (robot.q_upper if upper else robot.q_lower)[joint] - sign * 0.01
        qd_m[joint] = sign * 0.5
    else:
        qd_m[joint] = sign * 1.3 * robot.qd_max[joint]
    prompt = AT_ONCE.replace("limit.velocity_rate", 100.0)  # brakes before the joint's damping does
    why, _ = explained(dbb, Measurement(np.zeros(3), np.zeros(2), q_m, qd_m), config=prompt)
    assert Bound(robot.description.arm.joints[joint], kind, upper) in why.bounds
    qd_m[:] = 0.0
    q_m[joint] = robot.description.arm.ready_position[joint]
    why, _ = explained(dbb, Measurement(np.zeros(3), np.zeros(2), q_m, qd_m))
    assert why.bounds == ()


def test_a_torque_rate_limit_is_reported_until_the_torque_is_reached(robot, dbb):
    slow = Config()  # with the limit of the torque rate
    m = near(robot, "l1-l3", 0)
    dbb.reset()
    dbb.configure(slow)

    def step() -> ControlStep:
        dbb.last.v_last[:] = np.nan  # a gap, so that no person is assumed to hold the arm
        return dbb.step(m)

    for _ in range(3):
        output = step()
        why = explain(dbb, output, slow, REST)
        late = np.minimum(output.u_cmd - output.u_min, output.u_max - output.u_cmd) < TOLERANCE
        joints = [b.where for b in why.bounds if b.kind == "torque rate"]
        assert joints == [j for j, at in zip(robot.description.arm.joints, late, strict=True) if at]
        assert joints
    for _ in range(200):
        output = step()
    assert "torque rate" not in {b.kind for b in explain(dbb, output, slow, REST).bounds}


@pytest.mark.parametrize(
    ("command", "expected"),
    [
        ((0.0, 0.0), []),
        ((0.499, -0.999), []),
        ((-0.5, 0.2), [Bound("base", "speed", upper=False)]),
        ((0.5, -1.0), [Bound("base", "speed", True), Bound("base", "turning speed", False)]),
    ],
)
def test_a_commanded_top_speed_of_the_base_is_reported(robot, command, expected):
    assert admittance_bounds(robot, Config(), np.array(command)) == expected


# Methods and failures


def test_only_methods_that_move_the_base_have_forces(robot, controllers):
    m = near(robot, "lm-lEE", 0)
    why = {name: explained(controller, m)[0] for name, controller in controllers.items()}
    assert {name for name, each in why.items() if each.forces} == {"dbb", "hqp"}
    assert {name: each.controller for name, each in why.items()} == {n: n for n in CONTROLLERS}
    assert all(each.near[0][:5] == why["dbb"].near[0][:5] for each in why.values())
    assert why["repulsive"].near[0].arm_beta == why["repulsive"].near[0].beta > 0.0
    assert why["none"].near[0].arm_beta == 0.0


def test_a_barrier_is_active_exactly_if_its_row_is_at_its_bound(robot, controllers):
    held = set()
    for seed in range(6):
        why, output = explained(controllers["barrier"], near(robot, "lm-lEE", seed, 0.01, 0.06))
        qdd = qdd_of(controllers["barrier"], output)
        c, moves = AT_ONCE.barrier, zip(output.Jdqd, output.d_dot, output.d, strict=True)
        bounds = [
            barrier_bound(*at, d - c.d_min, c.rate, c.max_separation_speed) for *at, d in moves
        ]
        for J, least, pair in zip(output.J, bounds, output.pairs, strict=True):
            at = J @ qdd < least + AT_ONCE.task.slack_weight + TOLERANCE
            name = pair.name
            assert (Bound(name, "barrier", upper=False) in why.bounds) == at
            reading = next((p for p in why.near if f"{p.a}-{p.b}" == name), None)
            assert (reading is not None and reading.limited) == at
            held.add(at)
    assert held == {True, False}


def test_an_unsolved_step_is_reported_with_its_near_pairs(robot, dbb):
    dbb.reset()
    dbb.configure(AT_ONCE)
    output = dbb.step(near(robot, "lm-lEE", 0), base_acceleration=np.full(2, 1e308))
    why = explain(dbb, output, AT_ONCE, REST)
    assert not why.solved
    assert np.isnan(output.qdd).all()
    assert why.levels == ()
    assert why.near[0].b == "lEE"


def test_an_explanation_is_small_and_has_only_plain_types(robot, dbb):
    why, _ = explained(dbb, near(robot, "lm-lEE", 0))
    assert pickle.loads(pickle.dumps(why)) == why
    assert len(pickle.dumps(why)) < 2000  # [bytes] 3000 explanations are stored
    assert {type(x) for x in leaves(why)} <= {str, float, bool, type(None)}


def leaves(value: object):
    if isinstance(value, tuple):
        for item in value:
            yield from leaves(item)
    else:
        yield value


def test_a_snapshot_contains_the_explanation_of_its_step(robot, border_data):
    session = Session(robot, border_data, Config(), physics="kinematic")
    m = near(robot, "lm-lEE", 3)
    session.reset(m.q_m)
    step = session.step()
    snapshot = make_snapshot(session, step, Pacer(0.001), paused=False)
    session.close()
    why = snapshot.explanation
    assert why is not None
    assert (why.mode, snapshot.mode) == ("guiding", "guiding")
    assert isinstance(why.near[0], NearPair)
    assert why.near[0].d == pytest.approx(snapshot.pairs[0].d)
    np.testing.assert_allclose(why.commanded_acceleration, snapshot.base_acceleration)
    np.testing.assert_allclose(why.base_avoidance, snapshot.avoidance_acceleration)
