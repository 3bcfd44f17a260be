"""Explanation of the robot's motion in plain numbers, from the quantities of a control step.

Vectors are in the base's frame: "forward" and "left" are relative to the base.
"""

import math
from typing import Literal, NamedTuple

import numpy as np

from app.avoidance.acting_point import resultant_force
from app.border.score import ScoreField
from app.config import Config
from app.control.controller import Controller
from app.control.inputs import largest_command
from app.control.limits import position_bound, velocity_bound
from app.control.quantities import ControlStep
from app.robot.bases.kind import Axis, BaseKind
from app.robot.model import RobotModel
from app.strict import Array

Planar = tuple[float, float]
ByAxis = tuple[float, ...]  # [m/s² or rad/s²] along the base's axes

Controlled = Literal["guiding", "tracking"]
LevelName = Literal["base", "arm", "links", "ee", "posture", "free"]

ArmBound = Literal["torque", "torque rate", "position", "velocity", "barrier"]
BaseBound = Literal["acceleration", "angular acceleration", "speed", "turning speed"]
BoundKind = ArmBound | BaseBound

TOLERANCE = 1e-5
"""Tolerance of an active bound, in the unit of its row: N m or N for a torque, 1/s for a joint (the
row is divided by the speed limit), m/s² for a distance, m/s² or rad/s² for the base."""


class Bound(NamedTuple):
    """An active limit."""

    where: str  # name of a joint, "base", or a pair as in `lm-lEE`
    kind: BoundKind  # the limited quantity
    upper: bool  # whether it is the upper of the two bounds


class ForceSplit(NamedTuple):
    """The force on the base by one pair, split as in Figure 7, with components forward and left."""

    f: Planar  # [N] f_m,i of (14), the sum of `away` and `turn`
    away: Planar
    """[N] component of f along the horizontal part of n: it moves the base away from the arm."""
    turn: Planar  # [N] component of f across n, from the step (12), (13) towards a better score
    away_acceleration: ByAxis  # [m/s² or rad/s²] acceleration (16) by `away` alone, times β_m
    turn_acceleration: ByAxis  # [m/s² or rad/s²] acceleration (16) by `turn` alone, times β_m
    determinant: float
    """Absolute `BaseKind.measure` at p_act; (7) [m⁴/rad⁴] for a differential base."""
    reachability: float  # [-] R of (9) at p_act
    score: float  # [unit of the measure] S of (10) at p_act
    score_near: float  # [unit of the measure] S at p_n, where the force would act without the step


class NearPair(NamedTuple):
    """One link pair that is nearer than the buffer distance, or at the bound of its barrier."""

    a: str  # name of the body nearer to the base, as in `lm`
    b: str  # name of the other body, as in `lEE`
    mobile: bool  # whether one of the two bodies is the base (a pair of L_m)
    d: float  # [m] signed distance in the control step
    beta: float  # [-] activation β
    n: tuple[float, float, float]
    """Normal from `a` to `b`, in the base's frame, of length 1 or less."""
    above: float
    """[-] 1 − ‖n_xy‖: share of the force, 0 to 1, that is lost above the base; 0 within the arm."""
    arm_beta: float
    """[-] activation of the pair's rows T_rep; 0 if it has no such rows."""
    limited: bool  # whether the barrier of the pair's distance is active: it limits the approach
    force: ForceSplit | None
    """The force of the pair on the base. None for a pair within the arm, while the base has no
    active rows of T_sca, and without an acting point."""


class Level(NamedTuple):
    """The slack of one task: the task's demand minus the result."""

    name: LevelName
    """"base": the base's rows of T_sca; "links": the rows between links; "arm": the rows T_rep;
    "ee": T_2; "posture": the lowest task while tracking; "free": the lowest task while a person
    guides the arm, the motion without avoidance."""
    linear: float | None
    """[m/s²] norm of the linear part of the slack; None for "posture" and "free"."""
    angular: float | None
    """[rad/s²] norm of the angular part, or of the joints' slack; None for "arm" and "links"."""


class Explanation(NamedTuple):
    """One control step, explained."""

    controller: str
    mode: Controlled  # whether a person guides the arm, or the arm tracks a reference
    solved: bool
    """Whether readings are valid and q̈ has a solution; if not, the fallback command applies."""
    chain: tuple[str, ...]
    """Names of all bodies: the base, then those of the arm from the base outwards."""
    near: tuple[NearPair, ...]
    """Pairs nearer than d_b or at the bound of their barrier: first those of L_m, then those within
    the arm, each of these two groups in the order of decreasing activation."""
    nearest: tuple[str, str, float]
    """Body names and distance [m] of the nearest pair with the base, nearer than d_b or not."""
    axes: tuple[Axis, ...]  # the base's axes, which define the components of its accelerations
    base_avoidance: ByAxis
    """[m/s² or rad/s²] acceleration (16) of the base, times β_m; 0 without the base's rows."""
    commanded_acceleration: ByAxis  # [m/s² or rad/s²] commanded base acceleration
    assumed_acceleration: ByAxis
    """[m/s² or rad/s²] `a_base_meas`, which the arm's QP assumes, but not `hqp`; with the fallback
    command, the commanded acceleration."""
    levels: tuple[Level, ...]
    """Slack of each active task, as by `level_readings`; empty with the fallback command."""
    bounds: tuple[Bound, ...]  # the active limits of the step
    base_kind: str = "differential"  # kind of the base, which defines the measure in the score

    @property
    def forces(self) -> tuple[ForceSplit, ...]:
        """Forces on the base; the force of the most active pair is first."""
        return tuple(pair.force for pair in self.near if pair.force is not None)

    @property
    def bearing(self) -> NearPair | None:
        """The pair in deepest penetration, otherwise the first pair of `near`, if there is one."""
        inside = (pair for pair in self.near if pair.d < 0.0)
        return min(inside, key=lambda pair: pair.d, default=next(iter(self.near), None))


def explain(
    controller: Controller, w: ControlStep, config: Config, base_command: Array
) -> Explanation:
    """Explain the last step `w`; `base_command` (n_b,) [m/s or rad/s] is the velocity command."""
    model, solved = controller.state.model, bool(w.solved)
    bounds = active_bounds(model, w, config) if solved else []
    limited = {bound.where for bound in bounds if bound.kind == "barrier"}
    pairs = (_near_pair(model, w, i, limited=p.name in limited) for i, p in enumerate(w.pairs))
    near = sorted(filter(None, pairs), key=lambda p: (p.mobile, p.beta, -p.d), reverse=True)
    nearest = int(np.argmin(w.d[: w.n_mob]))
    base = model.description.base
    return Explanation(
        controller=controller.name,
        mode="tracking" if w.tracking else "guiding",
        solved=solved,
        chain=tuple(model.body_names),
        near=tuple(near),
        nearest=(w.pairs[nearest].a, w.pairs[nearest].b, float(w.d[nearest])),
        axes=base.axes,
        base_avoidance=_tuple_of(w.base_avoidance),
        commanded_acceleration=_tuple_of(w.a_base_cmd),
        assumed_acceleration=_tuple_of(w.a_base_meas if solved else w.a_base_cmd),
        levels=level_readings(base, w) if solved else (),
        bounds=(*bounds, *admittance_bounds(model, config, base_command)),
        base_kind=base.kind,
    )


def level_readings(base: BaseKind, w: ControlStep) -> tuple[Level, ...]:
    """The slack of each active task: w_sca* of (29), w_2 while tracking, and the lowest task's."""
    levels, n_b = [], base.n_b
    if w.B[0] > 0.0:
        angular = np.array([axis.angular for axis in base.axes])
        error = w.a_base_des - w.a_base_cmd
        levels.append(Level("base", _norm(error[~angular]), _norm(error[angular])))
    slack, links = row_slacks(w), slice(n_b, n_b + len(w.pairs) - w.n_mob)
    if (w.B[links.stop :] > 0.0).any():
        levels.append(Level("arm", _norm(slack[links.stop :]), None))
    if (w.B[links] > 0.0).any():
        levels.append(Level("links", _norm(slack[links]), None))
    if w.tracking:
        e = w.b_ee - w.J_ee @ w.qdd
        levels.append(Level("ee", _norm(e[:3]), _norm(e[3:])))
    lowest = _norm(objective_slack(w.H_low, w.c_low, w.qdd, n_b))
    return (*levels, Level("posture" if w.tracking else "free", None, lowest))


def objective_slack(H: Array, c: Array, qdd: Array, n_b: int) -> Array:
    """(n_m,) [rad/s² or m/s²] the arm's acceleration minus the one that minimises an objective.

    The objective ½ q̈ᵀ H q̈ + cᵀ q̈ is minimised without limits and other tasks. The base keeps its
    acceleration, which is the first n_b entries of `qdd` (n,).
    """
    return qdd[n_b:] + np.linalg.solve(H[n_b:, n_b:], c[n_b:] + H[n_b:, :n_b] @ qdd[:n_b])


def row_slacks(w: ControlStep) -> Array:
    """(n_s,) slack of each row of T_sca: printed blend of (29) minus the result; 0 if β = 0."""
    without = w.qdd.copy()
    without[w.n_b :] -= objective_slack(w.H, w.c, w.qdd, w.n_b)
    blend = w.B * w.b_sca + (1.0 - w.B) * (w.J_sca @ without)
    return np.where(w.B > 0.0, blend - w.J_sca @ w.qdd, 0.0)


def _norm(vector: Array) -> float:
    return float(np.linalg.norm(vector))


def split(f: Array, n: Array) -> tuple[Array, Array]:
    """The parts of a horizontal force f (3,) [N] along and across the horizontal part of n.

    If the normal n (3,) from the base to the arm is vertical, all of f is across.
    """
    horizontal = np.array([n[0], n[1], 0.0])
    length = _norm(horizontal)
    along = horizontal / length if length >= 1e-9 else np.zeros(3)
    away = float(f @ along) * along
    return away, f - away


def _near_pair(model: RobotModel, w: ControlStep, i: int, *, limited: bool) -> NearPair | None:
    """The i-th pair, or None if its activation is 0 and its barrier is not active."""
    mobile, beta, n = i < w.n_mob, float(w.beta[i]), w.normal[i]
    if beta == 0.0 and not limited:
        return None
    pushed = mobile and bool((w.B[w.n_b + len(w.pairs) - w.n_mob :] > 0.0).any())
    return NearPair(
        *w.pairs[i],
        mobile,
        float(w.d[i]),
        beta,
        n=tuple((w.R_base.T @ n).tolist()),
        above=1.0 - math.hypot(*n[:2].tolist()) if mobile else 0.0,
        arm_beta=beta if pushed else 0.0,
        limited=limited,
        force=_force_split(model, w, i) if mobile else None,
    )


def _force_split(model: RobotModel, w: ControlStep, i: int) -> ForceSplit | None:
    """The force on the base by a pair; None without active base rows or an acting point."""
    if not w.B[0] > 0.0 or np.isnan(w.p_act[i, 0]):
        return None
    field = ScoreField.of(model, w.pairs[i].b)
    score, score_near = field.score(np.array([w.p_act[i], w.p_n[i]])).tolist()
    base = model.description.base
    away, turn = split(w.f[i], w.R_base.T @ w.normal[i])
    away_acc, turn_acc = (
        w.B[0] * (base.A_b @ resultant_force(f[None], w.p_act[i : i + 1])) for f in (away, turn)
    )
    return ForceSplit(
        *((float(v[0]), float(v[1])) for v in (w.f[i], away, turn)),
        *(_tuple_of(v) for v in (away_acc, turn_acc)),
        determinant=float(field.singularity(w.p_act[i])),
        reachability=float(field.reachability(w.p_act[i])),
        score=score,
        score_near=score_near,
    )


def _tuple_of(v: Array) -> ByAxis:
    return tuple(v.tolist())


def active_bounds(model: RobotModel, w: ControlStep, config: Config) -> list[Bound]:
    """The active limits of a step with a solution: those of the arm, then those of the base."""
    low, high = met(w)
    n_m, joints = model.n_m, model.description.arm.joints
    bounds: list[Bound] = []
    convex = [
        pair.name for pair, rows in zip(w.pairs, w.rows, strict=True) for _ in rows[1:] or rows
    ]
    for i in np.flatnonzero(low | high).tolist():
        upper = bool(high[i])
        if i < n_m:
            at = (w.u_max if upper else w.u_min)[i]
            most = abs(at) >= model.tau_max[i] - TOLERANCE
            bounds.append(Bound(joints[i], "torque" if most else "torque rate", upper))
        elif i < 2 * n_m:
            kind = _joint_kind(model, w, config, i - n_m, upper)
            bounds.append(Bound(joints[i - n_m], kind, upper))
        else:
            bounds.append(Bound(convex[i - 2 * n_m], "barrier", upper))
    return [*dict.fromkeys(bounds), *_base_bounds(model, w)]


def admittance_bounds(model: RobotModel, config: Config, command: Array) -> list[Bound]:
    """The limits that the base's velocity command (n_b,) [m/s or rad/s] has reached."""
    base = model.description.base
    largest = largest_command(base, config.admittance)
    return [
        Bound("base", "turning speed" if axis.angular else "speed", bool(value > 0))
        for axis, value, most in zip(base.axes, command, largest, strict=True)
        if abs(value) >= most - 1e-9
    ]


def met(w: ControlStep) -> tuple[Array, Array]:
    """(m,) whether q̈ is at the lower, and (m,) at the upper limit of each row of the arm's QP.

    A row counts as at its limit if it is within `TOLERANCE` of the limit or beyond it. An active
    soft row is beyond its limit by its slack (see `solve_qp`).
    """
    m = int(w.n_limits)
    reached = w.C[:m] @ w.qdd
    return reached <= w.l[:m] + TOLERANCE, reached >= w.u[:m] - TOLERANCE


def _joint_kind(
    model: RobotModel, w: ControlStep, config: Config, joint: int, upper: bool
) -> ArmBound:
    """The limit, "position" or "velocity", that causes the tighter acceleration bound."""
    at, rates = int(upper), config.limit
    q, qd = w.q_m[joint], w.qd_m[joint]
    position = position_bound(q, qd, model.q_limits[at, joint], rates.position_rate)
    velocity = velocity_bound(qd, model.qd_limits[at, joint], rates.velocity_rate)
    return "position" if (position < velocity) == upper else "velocity"


def _base_bounds(model: RobotModel, w: ControlStep) -> list[Bound]:
    missing = w.a_base_des - w.a_base_cmd  # `limit_ee_drag` and `set_up_room` also contribute
    at_limit = np.sign(missing) * w.a_base_cmd > model.base_acceleration_max - TOLERANCE
    return [
        Bound("base", "angular acceleration" if axis.angular else "acceleration", bool(m > 0))
        for axis, m, at in zip(model.description.base.axes, missing, at_limit, strict=True)
        if at and abs(m) > TOLERANCE
    ]
