"""Algorithm 2 on one page: measurement in, arm torques and base velocity command out.

Comments name the line of the paper's Algorithm 2; a number in brackets is an equation. `w` is the
table of quantities (`app.control.quantities`). Most formulas of other modules take arrays instead
of `w`, and only this file connects them; `readings`, `references`, `estimate`, `hqp` and
`torque_reachable_bounds` work on `w` itself. docs/method.md has the formulas beyond the paper's.

Tasks have weights instead of strict levels, and each QP is strictly convex. Each row of T_sca for a
pair within the arm, and each row of T_rep (method `repulsive`), is a spring whose stiffness grows
with its activation β (`insert_rows`). The base's rows are blended with the other tasks
(`blend_base`); in `set_up_room` they are also springs. A row with β = 0 has no effect, so the
branch of lines 16 to 18, without T_sca, is not needed. The barriers do not depend on β.

The base's command (`command_base`) is computed before the arm's torques, because the base follows
its commands late. T_2 and the rows between links have slow gains (`slow`) in the QPs of the base,
because its commands are rare. The admittance law (§4.1, `update_command`) converts the commanded
acceleration of the base to the velocity command. If the axes of a base depend on each other,
`Controller` then replaces this command by an admissible one.

The arm's q̈ (`accelerate_arm`) minimises the errors of the tasks; the springs of T_sca compete with
them, (29). The arm's limits apply, and the base has its present acceleration (`assume_base`). The
torques follow from q̈, (26). The compared method `hqp` does not solve the QPs of base and arm: its
q̈ is the solution of the paper's hierarchy, which `Controller` computes.
"""

import math
from typing import Any

import numpy as np
from numba import types
from numba.core.typing.templates import Signature

from app.avoidance.acting_point import (
    avoidance_force,
    find_acting_point,
    generate_mob_acc,
    resultant_force,
)
from app.avoidance.closest_points import mean_nearest
from app.border.nearest import BORDER
from app.compiled import compiled
from app.control.inputs import GAINS, ROBOT
from app.control.limits import (
    barrier_bound,
    joint_bounds,
    joint_rows,
    torque_range,
    torque_reachable_bounds,
    torque_rows,
)
from app.control.qp import cholesky, clip, dot, fill, put, put_rows, solve_qp, solve_qp_step, times
from app.control.quantities import STEP
from app.control.readings import JUMP, LOCALISATION, READING, take_readings
from app.control.references import shift_reference
from app.control.tasks import (
    activation,
    add_base_rest_task,
    add_tracking,
    blend_base,
    end_effector_task,
    free_arm_torque,
    generate_avoidance_task,
    generate_rep_acc,
    generate_rep_force_acc,
    guided_objective,
    insert_rows,
    limit_ee_drag,
    mobile_activation,
    pose_error,
    posture_objective,
    reaction_torque,
    uncompensated_base_jacobian,
)
from app.robot.model import STABLE_STEPS
from app.robot.state import (
    coordinates,
    distance_motions,
    point_bias,
    point_jacobian,
    put_least,
    reduced_dynamics,
    seen_from,
    tip_motion,
)
from app.strict import Array

_MARGIN = 3.0  # [-] margin of speed limits and barriers, as a multiple of recent velocity errors
_MOST_MARGIN = 0.5  # [-] largest margin, relative to a joint's speed limit: a larger one would let
# the constraints throw the arm away from an obstacle that it hardly approaches
BUFFER_RATE = 0.1  # [m/s] speed at which the present buffer distance approaches the configured one:
# a jump would abruptly accelerate an arm inside the buffer

DRIVE_MODEL, BASE_MEASURED, BASE_AS_COMMANDED = range(3)
"""Source of the base's acceleration in the arm's QP: model of the drive, caller, or command."""

FREE_BASE, ROOM, ARM, HIERARCHY = range(4)
"""Rows of `qp_tried` and `qp_x`: QPs of `set_up_free_base`, `set_up_room` and `set_up_arm`, and the
hierarchy of `app.control.hqp`."""


@compiled()
def forget_reference(w: Any) -> None:
    """Forget all references, so that the next one counts as the first."""
    fill(w.x_sent[3], math.nan)
    w.way_time[()] = w.way_duration[()] = w.sample_interval[()] = w.since_sample[()] = 0.0


@compiled(
    Signature(
        types.b1,
        (ROBOT.type, GAINS.type, STEP.type, types.UniTuple(READING, 5), types.f8, types.f8),
        None,
    )
)
def update_estimate(
    robot: Any, gains: Any, w: Any, readings: tuple[Array, ...], now: float, time: float
) -> bool:
    """Estimate the robot's state from the readings, and convert it to pinocchio's coordinates.

    This is the part of line 2 of Algorithm 2 that precedes pinocchio's computation. The present
    buffer distance `w.d_b` starts at the configured one, and approaches a new one at `BUFFER_RATE`.
    Without valid readings, or with the fault `jump` (of the arm) or `localisation` (of the base),
    all references are forgotten. With valid readings, `shift_reference` then shifts the reference
    in `w.x_ref` by a jump of the base's pose. Returns whether the readings have a fault or are not
    valid. The arguments from `readings` on are those of `take_readings`.
    """
    way = BUFFER_RATE * gains.dt
    if math.isnan(w.d_b[()]):
        w.d_b[()] = gains.d_b
    w.d_b[()] += min(max(gains.d_b - w.d_b[()], -way), way)
    fill(w.qp_tried, 0.0)
    take_readings(robot, gains, w, readings, now, time)
    if w.valid[()] == 0.0 or w.faults[JUMP] != 0.0 or w.faults[LOCALISATION] != 0.0:
        forget_reference(w)
    if w.valid[()] == 0.0:
        return True
    qd, q_pin, v_pin = coordinates(
        w.base_pose, w.base_velocity, w.q_m, w.qd_m, robot.T_J_m, robot.J_m_inv
    )
    put(w.qd, qd)
    put(w.q_pin, q_pin)
    put(w.v_pin, v_pin)
    shift_reference(gains, w)
    return w.faults.max() > 0.0


def algorithm_2(
    robot: Any, gains: Any, slow: Any, border: Any, w: Any, base_source: int, tracking: bool
) -> float:
    """One control step of Algorithm 2, self-collision avoidance.

    Without valid readings the kinematics of the last valid step stay, no QP is solved, and
    `put_commands` writes the fallback command. If Python has to solve a QP (by ProxQP) or the
    hierarchy (by `app.control.hqp`), the step ends there; the caller then repeats the whole step,
    which computes the same values again, and uses Python's solution.

    `robot`, `gains`, `border` and `w` are the structs `ROBOT`, `GAINS`, `BORDER` and `STEP`; `slow`
    are the gains of the slower configuration `app.config.slowed`, for the base's QPs. `w` already
    contains the results of `update_estimate`, pinocchio and coal. `base_source` is `DRIVE_MODEL`,
    `BASE_MEASURED` (in `w.a_base_meas`) or `BASE_AS_COMMANDED`. `tracking` states whether there is
    a reference (in `w.x_ref`, `w.v_ref`, `w.a_ref`). Returns `w.qp_open`: the number of the problem
    that Python has to solve, or 0 after a complete step.
    """
    # fmt: off
    update_kinematics(robot, gains, w)               # line 2, closest points of lines 4 and 9
    activate_pairs(gains, w)                         # Figure 10
    push_base(robot, gains, border, w)               # lines 3 to 7, Algorithm 3, (12)-(18), (28)
    stack_avoidance_task(robot, gains, w)            # lines 8 to 13, (20)-(25), (27)
    stack_tasks(robot, gains, w, tracking)           # line 14, (26)
    w.qp_open[()] = 0.0
    if gains.hierarchy:
        take_hierarchy(robot, gains, w, base_source)
        return w.qp_open[()]
    command_base(robot, gains, slow, w)              # line 14, (29) of the base
    if w.qp_open[()] != 0.0:
        return w.qp_open[()]
    assume_base(robot, w, base_source)
    accelerate_arm(robot, gains, w)                  # line 15, (29) of the arm
    if w.qp_open[()] != 0.0:
        return w.qp_open[()]
    put_commands(robot, gains, w, base_source)       # line 15, (26), §4.1
    return 0.0
    # fmt: on


@compiled()
def activate_pairs(gains: Any, w: Any) -> None:
    """Write the activation β of each pair, a function of its distance and `w.d_b` (Figure 10)."""
    for i in range(len(w.beta)):
        w.beta[i] = activation(w.d[i], w.d_b[()], gains.d_full)


@compiled()
def push_base(robot: Any, gains: Any, border: Any, w: Any) -> None:
    """Lines 3 to 7: write acting points and forces of the pairs of arm and base, ẍ_m and β_m.

    A pair with β = 0 has no force, and its p_n, p_t, p_act, t and α are NaN.
    """
    for i in range(robot.n_mob):
        for unknown in (w.p_n[i], w.p_t[i], w.p_act[i], w.tangent[i]):
            fill(unknown, math.nan)
        w.alpha[i] = math.nan
        fill(w.f[i], 0.0)
        if w.beta[i] > 0.0:
            p_b = seen_from(w.R_base, w.p_o, w.p_b[i])
            n, score = times(w.R_base.T, w.normal[i]), robot.score_coefficients[i]
            step = gains.alpha_gain, gains.alpha_min, gains.alpha_max
            found = find_acting_point(border, i, score, p_b, w.d[i], step)  # line 5, Algorithm 3
            put(w.p_n[i], found.p_n)
            put(w.p_t[i], found.p_t)
            put(w.p_act[i], found.p_act)
            put(w.tangent[i], found.t)
            w.alpha[i] = found.alpha
            if not math.isnan(found.alpha):  # (14)
                put(w.f[i], avoidance_force(p_b, found.p_act, w.d[i], n, gains.f_max, w.d_b[()]))
    put(w.xdd_m, generate_mob_acc(robot.A_b, resultant_force(w.f, w.p_act)))  # line 6, (16)
    w.beta_m[()] = mobile_activation(w.beta[: robot.n_mob])  # (28)


@compiled()
def command_base(robot: Any, gains: Any, slow: Any, w: Any) -> None:
    """Write the base's accelerations: a_free, the blend a_des of (29), and the commanded one.

    While a person guides the arm, only the method `barrier` solves the QP of a_free; with the other
    methods a_free = −k ν, with k = `base_damping`. The command begins as a_des; with active rows of
    the base, `undragged` changes it. While tracking, the QP of `set_up_room` changes it as little
    as needed for the arm to fulfil T_2 within its limits. Finally, it is clipped to ±a_max. The
    function ends early if Python has to solve a QP. If a QP has no solution, the command is −k ν.
    """
    n_b, found = robot.n_b, True
    valid, tracking = w.valid[()] != 0.0, w.tracking[()] != 0.0
    a_rest = -gains.base_damping * w.base_velocity
    a_free = a_rest
    if valid and (tracking or gains.base_in_barrier):
        qdd, found = solve(w, FREE_BASE, set_up_free_base(robot, gains, slow, w))
        if w.qp_open[()] != 0.0:
            return
        if found:
            a_free = times(robot.J_m, qdd[:n_b])
        else:
            fill(w.B[:n_b], 0.0)
    put(w.a_base_free, a_free)
    put(w.a_base_des, blend_base(a_free, w.xdd_m, w.B[0]))
    put(w.a_base_cmd, undragged(robot, gains, w))
    if valid and tracking and found:
        qdd, found = solve(w, ROOM, set_up_room(robot, gains, slow, w))
        if w.qp_open[()] != 0.0:
            return
        if found:
            gain, _ = response(gains.virtual_mass, gains.virtual_damping, gains.command_period)
            change = times(robot.J_m, qdd[:n_b] - w.qp_fixed) / gain
            put(w.a_base_cmd, w.a_base_cmd + change)
        else:
            put(w.a_base_des, a_rest)
            put(w.a_base_cmd, a_rest)
    if valid:
        put(w.a_base_cmd, clip(w.a_base_cmd, -robot.a_max, robot.a_max))


@compiled()
def accelerate_arm(robot: Any, gains: Any, w: Any) -> None:
    """With valid readings, solve the arm's QP and write q̈, or leave this QP open for Python."""
    w.solved[()] = 0.0
    if w.valid[()] == 0.0:
        return
    m = set_up_arm(robot, gains, w)
    qdd, found = solve(w, ARM, m)
    if w.qp_open[()] == 0.0:
        w.n_limits[()] = m
        w.solved[()] = found
        put(w.qdd, qdd)


@compiled()
def update_kinematics(robot: Any, gains: Any, w: Any) -> None:
    """Write dynamics, end-effector motion, and distances with closest points and motions.

    This is the part of line 2 that follows pinocchio's computation, and lines 4 and 9.
    """
    M, h, g = reduced_dynamics(w.M_pin, w.h_pin, w.J_pin, w.Y_pin, robot.T_J_m)
    put_rows(w.M, M)
    put(w.h, h)
    put(w.g, g)
    put_rows(w.L_aa, cholesky(w.M[robot.n_b :, robot.n_b :]))
    put_rows(w.R_base, w.oMi[1, :3].T)
    put(w.p_o, w.oMi[1, 3])
    R_last = w.oMi[-1, :3].T
    for i in range(3):
        put(w.R_ee[i], times(robot.R_tip.T, R_last[i]))
    put(w.p_ee, times(R_last, robot.p_tip) + w.oMi[-1, 3])
    twists, biases, J_ee, v_ee, Jdqd_ee = tip_motion(w.J_pin, robot.T_J_m, w.v_pin, w.p_ee)
    put_rows(w.twists, twists)
    put_rows(w.biases, biases)
    put_rows(w.J_ee, J_ee)
    put(w.v_ee, v_ee)
    put(w.Jdqd_ee, Jdqd_ee)
    put_least(w.signed, robot.shape_order, robot.shape_firsts, w.d)
    placed = np.empty((4 * len(robot.body_joints), 3))
    for k in range(len(robot.body_joints)):
        T = w.oMi[robot.body_joints[k]]
        put_rows(placed[4 * k : 4 * k + 3], T[:3].T)
        put(placed[4 * k + 3], T[3])
    bodies = robot.shapes, robot.triangles, robot.nodes, robot.firsts
    points = mean_nearest(bodies, robot.sought, placed, gains.closest_point_smoothing)
    put_rows(w.p_a, points[:, 0])
    put_rows(w.p_b, points[:, 1])
    put_rows(w.normal, points[:, 2])
    put_rows(w.core, points[:, 3])
    J, Jdqd, d_dot = distance_motions(  # (21)
        w.J_pin, robot.T_J_m, w.twists, w.biases, robot.pair_joints, w.core, w.normal
    )
    put_rows(w.J, J)
    put(w.Jdqd, Jdqd)
    put(w.d_dot, d_dot)


@compiled()
def link_accelerations(robot: Any, gains: Any, w: Any) -> Array:
    """ẍ_r − J̇_r q̇ (k,) [m/s²] of the pairs within the arm (L_m^c)."""
    links = slice(robot.n_mob, len(w.beta))  # line 8
    return generate_rep_acc(w.d_dot[links], gains.k_p, gains.k_v) - w.Jdqd[links]  # line 10, (20)


@compiled()
def stack_avoidance_task(robot: Any, gains: Any, w: Any) -> None:
    """Write T_sca: rows of the base, of pairs within the arm, and T_rep (method `repulsive`)."""
    n_mob, n_b, links = robot.n_mob, robot.n_b, len(w.beta) - robot.n_mob
    b_r, beta_r = link_accelerations(robot, gains, w), np.zeros(links)
    if gains.link_rows:
        put(beta_r, w.beta[n_mob:])
    J_r = w.J[n_mob : n_mob + links]
    beta_m = w.beta_m[()] if gains.moves_base else 0.0
    generate_avoidance_task(
        robot.base_rows, w.xdd_m, beta_m, J_r, b_r, beta_r, w.J_sca, w.b_sca, w.B
    )  # line 13, (24), (25)
    first = n_b + links
    fill(w.B[first:], 0.0)
    for i in range(n_mob if gains.arm_rows else 0):
        if w.beta[i] > 0.0:
            joint, rows = robot.pair_joints[i, 1], slice(first + 3 * i, first + 3 * i + 3)
            J = point_jacobian(w.J_pin, robot.T_J_m, joint, w.p_b[i])
            put_rows(J[:, :n_b], np.zeros((3, n_b)))
            bias = point_bias(w.twists[joint], w.biases[joint], w.p_b[i])
            xdd = generate_rep_force_acc(w.normal[i], times(J, w.qd), gains.k_p, gains.k_v)
            put_rows(w.J_sca[rows], J)
            put(w.b_sca[rows], xdd - np.array([bias[0], bias[1], bias[2]]))
            fill(w.B[rows], w.beta[i])
    w.activation[()] = mobile_activation(w.B)


@compiled()
def track(gains: Any, w: Any, weight: float, damped: bool) -> tuple[Array, Array, Array, float]:
    """H (n, n) and c (n,) of T_2 and the task (`w.H_low`, `w.c_low`) together; b (6,) and λ [m²].

    b and λ are those of `end_effector_task`; without `damped`, λ is 0. `weight` [-] is that of T_2.
    """
    velocity, acceleration = w.v_ref - w.v_ee, w.a_ref - w.Jdqd_ee
    k_p, k_v, speed = gains.ee_stiffness, gains.ee_damping, gains.ee_speed
    b, lm_damping = end_effector_task(w.e_ee, velocity, acceleration, k_p, k_v, speed)
    if not damped:
        lm_damping = 0.0
    H, c = add_tracking(w.H_low, w.c_low, w.J_ee, b, lm_damping, k_v * w.qd, weight)
    return H, c, b, lm_damping


@compiled()
def stack_tasks(robot: Any, gains: Any, w: Any, tracking: bool) -> None:
    """Write the tasks below T_sca and the torque range; forget references when tracking ends."""
    if not tracking and w.tracking[()] != 0.0:
        forget_reference(w)
    w.tracking[()] = tracking
    # Without readings the damping acts on a prediction, not on a feedback that is late.
    time = gains.dt if w.valid[()] == 0.0 else max(w.blind_time[()], gains.dt)
    stable = robot.ready_inertia / (STABLE_STEPS * time)  # [N m s/rad or N s/m]
    damping = np.minimum(gains.joint_damping, stable)
    put(w.u_free, free_arm_torque(w.g, w.qd, damping))
    last = w.u_free if math.isnan(w.u_a[0]) else w.u_a
    u_min, u_max = torque_range(last, robot.tau_max, gains.torque_rate * gains.dt)
    put(w.u_min, u_min)
    put(w.u_max, u_max)
    if tracking:
        arm = gains.posture_stiffness, gains.posture_damping, gains.joint_centering
        base = gains.base_weight, gains.base_damping
        H, c = posture_objective(w.qd, w.q_m, w.q_posture, robot.q_limits, arm, base)
    else:
        near = slice(0, robot.n_mob)
        reaction = reaction_torque(w.d[near], w.J[near], gains.f_arm, w.d_b[()], robot.n_b)
        H, c = guided_objective(w.M, w.h, w.u_free + reaction)
    put_rows(w.H_low, H)
    put(w.c_low, c)
    if tracking:
        put(w.e_ee, pose_error(w.p_ee, w.R_ee, w.x_ref[3], w.x_ref[:3].T))
        H, c, b_ee, w.lm_damping[()] = track(gains, w, gains.ee_weight, True)
        put(w.b_ee, b_ee)
    put_rows(w.H, H)
    put(w.c, c)


@compiled()
def put_qp(w: Any, H: Array, c: Array, rows: slice, b: Array, least: float, fixed: int) -> None:
    """Store the objective of the next QP: (H, c) with `rows` of T_sca, by `insert_rows`."""
    H, c = insert_rows(H, c, w.J_sca[rows], b, w.B[rows], least, fixed)
    put_rows(w.qp_H, H)
    put(w.qp_c, c)


@compiled()
def write_limits(robot: Any, gains: Any, w: Any, which: int) -> int:
    """Write the limits of the QP `which` into w.C, w.l, w.u and w.softness; return their number.

    Each QP has the limits of torques and joints, with the approach rates of `gains`. The torque
    limits are hard: w.u_min and w.u_max in the arm's QP, otherwise those of the robot. Joint limits
    and barriers are soft. A barrier of a pair has a row for each convex part of l_a.

    - ARM: if the method has barriers, those of all pairs at d_min. The limits of joints and
      distances include external accelerations; those of speeds and distances have a
      margin for recent errors of velocities. While readings are rare or late (blind time T > dt),
      the limits of joints and distances also apply with a rate of at most 1/(2 T): a faster
      reaction to a wrong prediction would let the arm oscillate. `torque_reachable_bounds` then
      changes the limits of joints, so that each joint can satisfy them by its own torque.
    - FREE_BASE: for the method `barrier`, the barriers of all pairs at d_min.
    - ROOM: for the method `dbb`, the barriers of L_m at d_min, those within the arm at w.d_b.
    """
    for_arm, link_buffers = which == ARM, which == ROOM and gains.lookahead
    barrier = (for_arm and gains.barrier) or (which == FREE_BASE and gains.base_in_barrier)
    n_m, qd_limits = len(w.q_m), robot.qd_limits
    qdd_ext, u_min, u_max = np.zeros(n_m), robot.tau_limits[0], robot.tau_limits[1]
    v_error, fastest = qdd_ext, math.inf
    if for_arm:
        v_error = np.minimum(_MARGIN * w.v_error, _MOST_MARGIN * robot.qd_max)
        fastest = 0.5 / w.blind_time[()] if w.blind_time[()] > gains.dt else math.inf
        qdd_ext, u_min, u_max = w.x_est[2], w.u_min, w.u_max
        qd_limits = qd_limits + np.stack((v_error, -v_error))
    bounds = joint_bounds(
        w.q_m, w.qd_m, robot.q_limits, qd_limits, gains.position_rate, gains.velocity_rate, fastest
    )
    if for_arm:
        bounds = torque_reachable_bounds(robot, gains, w, bounds, qd_limits)
    torque_rows(w.M, w.h, u_min, u_max, w.C, w.l, w.u)
    joints = slice(n_m, 2 * n_m)
    joint_rows(bounds, qdd_ext, robot.qd_max, w.C[joints], w.l[joints], w.u[joints])
    count = len(robot.convex) if barrier or link_buffers else 0
    rate, most = gains.barrier_rate, gains.max_separation_speed
    for k in range(count):
        i, row = robot.convex[k], 2 * n_m + k
        h = w.d[i] - (w.d_b[()] if link_buffers and k >= robot.n_convex_mob else gains.d_min)
        J = w.J[i, robot.n_b :]
        d_dot = w.d_dot[i] - math.sqrt(dot(J * J, v_error * v_error))  # independent errors
        slow = barrier_bound(w.Jdqd[i], d_dot, h, min(rate, fastest), most)
        least = max(barrier_bound(w.Jdqd[i], d_dot, h, rate, most), slow)
        put(w.C[row], w.J[i])
        w.l[row], w.u[row] = least - dot(J, qdd_ext), math.inf
    fill(w.softness[:n_m], 0.0)
    fill(w.softness[n_m:], gains.slack_weight**2)
    return 2 * n_m + count


@compiled()
def assume_base(robot: Any, w: Any, base_source: int) -> None:
    """Write `w.a_base_meas` by the drive's model or the command; keep a measured acceleration."""
    if base_source == DRIVE_MODEL:
        for i in range(robot.n_b):
            v = min(max(w.v_cmd[i], -robot.v_max[i]), robot.v_max[i])
            a = (v - w.base_velocity[i]) / robot.drive_time
            w.a_base_meas[i] = min(max(a, -robot.a_max[i]), robot.a_max[i])
    elif base_source == BASE_AS_COMMANDED:
        put(w.a_base_meas, w.a_base_cmd)


@compiled()
def set_up_free_base(robot: Any, gains: Any, slow: Any, w: Any) -> int:
    """Set up the QP of a_free, for base and arm; return the number of limits.

    The tasks are T_2 with slow gains, posture, and slow springs of the pairs within the arm. While
    a person guides the arm, the task of the guided arm and a task that brings the base to rest
    replace T_2 and posture. The limits are those of `write_limits`, and |J_m q̈_b| ≤ a_max.
    """
    n_b, links = robot.n_b, len(w.beta) - robot.n_mob
    if w.tracking[()] != 0.0:  # no damping by a remaining error: the base drives to the target
        H, c, _, _ = track(slow, w, slow.ee_weight, False)
    else:
        H, c = add_base_rest_task(
            w.H_low, w.c_low, w.L_aa, w.qd, slow.base_weight, slow.base_damping, n_b
        )
    b_r = link_accelerations(robot, slow, w)
    put_qp(w, H, c, slice(n_b, n_b + links), b_r, slow.slack_weight, 0)
    m = write_limits(robot, gains, w, FREE_BASE)
    for i in range(n_b):
        put(w.C[m + i], robot.base_rows[i])
        w.l[m + i], w.u[m + i], w.softness[m + i] = -robot.a_max[i], robot.a_max[i], 0.0
    return m + n_b


@compiled()
def undragged(robot: Any, gains: Any, w: Any) -> Array:
    """(n_b,) base acceleration near a_des that drags the end-effector along less.

    If β_m (here `w.B[0]`) is 0, the result is a_des. Otherwise a_des is clipped to ±a_max, the mass
    in `limit_ee_drag` is β_m `ee_hold.weight` times the base's mass, and the command a_hold leads
    to the mean acceleration a_free of the base.
    """
    if not w.B[0] > 0.0:
        return w.a_base_des.copy()
    gain, drag = response(gains.virtual_mass, gains.virtual_damping, gains.command_period)
    R = uncompensated_base_jacobian(w.J_ee, robot.qd_max, robot.J_m_inv, gains.ee_hold_min_speed)
    return limit_ee_drag(
        clip(w.a_base_des, -robot.a_max, robot.a_max),
        w.a_base_free / gain + drag * w.base_velocity,
        robot.inertia,
        w.B[0] * gains.ee_hold_weight * robot.mass,
        R * gain,
    )


@compiled()
def set_up_room(robot: Any, gains: Any, slow: Any, w: Any) -> int:
    """Set up the QP that changes the base's acceleration to make room for the arm.

    Minimise ‖q̈ − q̈_0‖ in the metric H: the smallest change with which the arm fulfils T_2 within
    its limits. q̈_0 has the base's response to `w.a_base_cmd`, and minimises ½ q̈ᵀ H q̈ + cᵀ q̈ over
    the arm's entries. This cost contains posture, T_2 with `base_weight` times its weight in other
    QPs, and the base's rows as springs. The limits have slow approach rates, so the base reacts
    early: it turns before a wrist joint is at a limit, for example. Returns the number of limits.
    """
    H, c, _, _ = track(slow, w, slow.base_weight * slow.ee_weight, True)
    base = slice(0, robot.n_b)
    put_qp(w, H, c, base, w.b_sca[base], slow.slack_weight, 0)
    gain, drag = response(gains.virtual_mass, gains.virtual_damping, gains.command_period)
    put(w.qp_fixed, times(robot.J_m_inv, gain * (w.a_base_cmd - drag * w.base_velocity)))
    return write_limits(robot, slow, w, ROOM)


@compiled()
def set_up_arm(robot: Any, gains: Any, w: Any) -> int:
    """Set up the QP of the arm, for the base's assumed acceleration; return the number of limits.

    The tasks are all tasks below T_sca and, as springs, the rows of T_sca that are not the base's.
    There is no slack variable: the slack of a task or a row is its demand minus the result.
    """
    rows = slice(robot.n_b, len(w.B))
    put_qp(w, w.H, w.c, rows, w.b_sca[rows], gains.slack_weight, robot.n_b)
    put(w.qp_fixed, times(robot.J_m_inv, w.a_base_meas))
    return write_limits(robot, gains, w, ARM)


@compiled()
def solve(w: Any, which: int, m: int) -> tuple[Array, bool]:
    """Solve the QP `which` that has just been set up with m limits.

    FREE_BASE solves for all entries of q̈. ARM fixes the base's entries to `w.qp_fixed`; ROOM starts
    from these values, and can change them (`solve_qp_step`). If the active-set method finds no
    solution, this pass of the step marks the QP as open (`w.qp_open`), and the next pass returns
    ProxQP's solution. Returns the solution (n,), and whether a solution has been found.
    """
    C, l, u, softness = w.C[:m], w.l[:m], w.u[:m], w.softness[:m]
    fixed = w.qp_fixed[: 0 if which == FREE_BASE else len(w.qp_fixed)]
    if which == ROOM:
        x, found = solve_qp_step(w.qp_H, w.qp_c, C, l, u, softness, fixed)
    else:
        x, found = solve_qp(w.qp_H, w.qp_c, C, l, u, softness, fixed)
    if not found and w.qp_tried[which] != 0.0:
        return w.qp_x[which].copy(), not math.isnan(w.qp_x[which, 0])
    if not found:
        w.qp_open[()], w.qp_rows[()] = which + 1.0, m
    return x, found


@compiled()
def response(mass: Array, damping: Array, period: float) -> tuple[Array, Array]:
    """Gain (n_b,) [-] and drag (n_b,) [1/s] of the admittance law M_a v̇ + D_a v = M_a a (§4.1).

    The mean of v̇ over a command period [s] is gain · (a − drag · v_0), with the velocity v_0 at its
    start. `mass` and `damping` are the diagonals (n_b,) of M_a and D_a.
    """
    gain, drag = np.ones(len(mass)), damping / mass
    for i in range(len(mass)):
        decay = drag[i] * period
        if decay > 1e-12:
            gain[i] = -np.expm1(-decay) / decay
    return gain, drag


@compiled()
def next_command(
    acceleration: Array,
    command: Array,
    period: float,
    mass: Array,
    damping: Array,
    a_max: Array,
    v_max: Array,
) -> Array:
    """The velocity command after one command period: exact solution of M_a v̇ + D_a v = M_a a.

    The change of the command (n_b,) is limited to ±`a_max` [m/s² or rad/s²] times `period` [s], and
    the result to ±`v_max`; `command` and `v_max` are in m/s or rad/s. The input a, `acceleration`
    (n_b,) [m/s² or rad/s²], is the mean of `a_base_cmd` in the command period. The base's part of u
    would be a wrong input: it is not zero while the base is at rest, so the base would drift.
    `mass` and `damping` are the diagonals (n_b,) of M_a [kg or kg m²] and D_a [N s/m or N m s].
    """
    F, gain = mass * acceleration - damping * command, response(mass, damping, period)[0]
    change = clip(gain * F / mass * period, -a_max * period, a_max * period)
    return clip(command + change, -v_max, v_max)


@compiled()
def update_command(robot: Any, gains: Any, w: Any) -> None:
    """Integrate `a_base_cmd`; after each command period, compute the velocity command (§4.1)."""
    put(w.a_sum, w.a_sum + w.a_base_cmd * w.elapsed[()])
    w.t_sum[()] += w.elapsed[()]
    w.command_due[()] = w.t_sum[()] >= gains.command_period - gains.dt / 2
    if w.command_due[()] != 0.0:
        put(w.v_before, w.v_cmd)
        mean, M_a, D_a = w.a_sum / w.t_sum[()], gains.virtual_mass, gains.virtual_damping
        a_max, v_max = robot.a_max, gains.largest_command
        put(w.v_cmd, next_command(mean, w.v_cmd, w.t_sum[()], M_a, D_a, a_max, v_max))
        fill(w.a_sum, 0.0)
        w.t_sum[()] = 0.0


@compiled()
def put_commands(robot: Any, gains: Any, w: Any, base_source: int) -> None:
    """Write the torques by q̈, (26), or the fallback command; then update the velocity command.

    The fallback command is gravity compensation with damping of the joints, and a base that brakes.
    """
    for which in (FREE_BASE, ROOM):
        if w.qp_tried[which] != 0.0 and math.isnan(w.qp_x[which, 0]):
            w.given_up[()] += 1.0
    if w.solved[()] != 0.0:
        u = times(w.M[robot.n_b :], w.qdd) + w.h[robot.n_b :]  # (26)
    else:  # the fallback command
        w.failures[()] += 1.0
        u = w.u_free
        # Without valid readings, the base is assumed to move at the commanded velocity.
        v = w.base_velocity if w.valid[()] != 0.0 else w.v_cmd
        put(w.a_base_cmd, -gains.base_damping * v)
        if base_source == BASE_AS_COMMANDED:
            put(w.a_base_meas, w.a_base_cmd)
        fill(w.qdd, math.nan)
    put(w.u_cmd, clip(u, w.u_min, w.u_max))
    if not math.isnan(w.q_posture[0]):  # without a measured posture the torques are not stored
        put(w.u_a, w.u_cmd)
    update_command(robot, gains, w)


@compiled()
def take_hierarchy(robot: Any, gains: Any, w: Any, base_source: int) -> None:
    """Line 15 of Algorithm 2 as in the paper, for the method `hqp`.

    With valid readings, the first pass of a step only marks the hierarchy as open, and the second
    pass writes the commands by the solution of `app.control.hqp`. Without valid readings or a
    solution, `put_commands` writes the fallback command.
    """
    if w.valid[()] != 0.0 and w.qp_tried[HIERARCHY] == 0.0:
        w.qp_open[()] = HIERARCHY + 1.0
        return
    put(w.qdd, w.qp_x[HIERARCHY])
    w.n_limits[()] = 0.0
    w.solved[()] = w.valid[()] != 0.0 and not math.isnan(w.qdd[0])
    put(w.a_base_des, -gains.base_damping * w.base_velocity)
    if w.solved[()] != 0.0:
        put(w.a_base_des, times(robot.J_m, w.qdd[: robot.n_b]))
    put(w.a_base_cmd, clip(w.a_base_des, -robot.a_max, robot.a_max))
    assume_base(robot, w, base_source)
    put_commands(robot, gains, w, base_source)


run_algorithm_2 = compiled(
    Signature(
        types.f8,
        (ROBOT.type, GAINS.type, GAINS.type, BORDER.type, STEP.type, types.i8, types.b1),
        None,
    )
)(algorithm_2)
"""`algorithm_2`, compiled; it is last because the compiler needs all of its parts."""
