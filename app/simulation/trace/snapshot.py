"""The quantities of a run: one declaration for each, with columns, units and computation.

A `Snapshot` has all quantities at one instant, a `Trace` has their columns over time. A new
quantity is one more field at the end of `Snapshot`, with a default value for older log files.
"""

import json
import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import Annotated, Any, NamedTuple, get_type_hints

import numpy as np
import pinocchio as pin
from numba import types
from numba.core.typing.templates import Signature
from pydantic import TypeAdapter

from app.compiled import compiled, direct
from app.config import BorderConfig, Config
from app.control.buffer_watch import BufferReading
from app.control.explanation import Explanation, explain
from app.control.limits import force_bound, steady_torques
from app.control.quantities import STEP
from app.simulation.case import RunCase
from app.simulation.loop.pacing import Pacer
from app.simulation.people import PullReading
from app.simulation.plants.door import NO_DOOR, Door, DoorView
from app.simulation.session import Session, Step
from app.simulation.trace.columns import (
    NAN,
    Cell,
    Column,
    Quantity,
    TraceMeta,
    column_names,
    config_changes,
    drawn,
    frozen,
    number,
    records,
)
from app.simulation.trace.words import millimetres, outcome
from app.strict import Array

_D_B_STEP = 0.005  # [m] step of a changing d_b after which the border is drawn again
EVERY = 20  # control steps between two snapshots: 50 Hz, in the live loop and in logs

_door_of = lru_cache(maxsize=64)(TypeAdapter(Door).validate_json)
_door_text = lru_cache(maxsize=64)(lambda door: json.dumps(asdict(door)))


class PairReading(NamedTuple):
    """One link pair at one instant; the points are those of the controller, in the world."""

    name: str  # name of the pair, such as `lm-lEE`
    mobile: bool  # whether one body is the base (a pair of L_m)
    d: float  # [m] true signed distance
    beta: float  # [-] activation β
    p_a: Array  # (3,) [m] closest point on the link nearer to the base
    p_b: Array  # (3,) [m] closest point on the link farther from the base


class ActingReading(NamedTuple):
    """The acting point of one active pair with the base; positions and force are in the world."""

    name: str
    p_n: Array  # (3,) [m] point of the border nearest to p_b, at the height of p_b
    p_t: Array  # (3,) [m] p_n moved along the tangent, (12)
    p_act: Array  # (3,) [m] acting point: the point of the border nearest to p_t
    f: Array  # (3,) [N] force f_m,i of (14)


class GhostReading(NamedTuple):
    """A compared robot at one instant."""

    controller: str
    base_pose: Array  # (3,) x, y [m] and heading φ [rad] of the base
    q_m: Array  # (n_m,) [rad or m] joint positions of the arm
    wheel_angles: Array  # (n_w,) [rad] angles of the base's wheels, for drawing
    p_ee: Array  # (3,) [m] position of the end-effector in the world
    clearance: float  # [m] present smallest distance of the pairs with the base


class Score(NamedTuple):
    """Results of a robot in a comparison; steps after its scenario's motion do not count."""

    controller: str
    clearance: float  # [m] smallest distance of any pair with the base
    error: float  # [m] last distance of the end-effector from its target, as `Snapshot.ee_error`
    error_max: float  # [m] largest distance of the end-effector from its target
    base_path: float  # [m] length of the path of the base's centre
    acceleration_jump: float  # [m/s²] largest change of a commanded linear acceleration in a step
    angular_jump: float  # [rad/s²] largest change of the commanded angular acceleration in a step
    torque_jump: float  # [N m or N] largest change of a joint's torque or force in one step
    contacts: int  # number of control steps with a contact of any kind (`Contacts`)

    @property
    def text(self) -> str:
        """The result in words, such as "no contact, smallest distance 105 mm"."""
        least, touched = self.clearance, bool(self.contacts)
        if least < 0.0:
            contact = "contact, " if touched else ""
            return f"{contact}bodies overlap by {millimetres(-least)}"
        return f"{outcome(least, touched=touched)}, smallest distance {millimetres(least)}"


class Refusal(NamedTuple):
    """The failure of a command; the run continues."""

    number: int  # number of the refusal since the start of the loop, from 1 on
    message: str


def _pairs() -> Quantity:
    """Make the quantity `pairs`: d, β, p_a and p_b of each pair."""

    def columns(meta: TraceMeta) -> Sequence[Column]:
        often = [n for x in ("d_{pair}_m", "beta_{pair}") for n in column_names(x, meta)]
        points = [n for x in "ab" for n in column_names(f"p_{x}_{{pair}}_{{xyz}}_m", meta)]
        return [*(Column(name, often=True) for name in often), *map(Column, points)]

    def take(session: Session, step: Step) -> tuple[PairReading, ...]:
        base, w = session.model.body_names[0], step.control
        numbers = step.distances.tolist(), w.beta.tolist()
        return tuple(
            PairReading(pair.name, pair.a == base, d, beta, frozen(p_a), frozen(p_b))
            for pair, d, beta, p_a, p_b in zip(w.pairs, *numbers, w.p_a, w.p_b, strict=False)
        )

    def cells(pairs: Sequence[PairReading], _: TraceMeta) -> Sequence[Cell]:
        of_pairs = list(zip(*pairs, strict=True))[2:]  # without name and kind
        return np.concatenate(of_pairs, axis=None).tolist()

    def value(cells: Sequence[float], meta: TraceMeta) -> tuple[PairReading, ...]:
        n = len(meta.pairs)
        p_a, p_b = map(frozen, np.reshape(cells[2 * n :], (2, n, 3)))
        mobile = [pair in meta.mobile_pairs for pair in meta.pairs]
        of_pair = zip(meta.pairs, mobile, cells[:n], cells[n : 2 * n], p_a, p_b, strict=True)
        return tuple(map(PairReading._make, of_pair))

    return Quantity(columns, cells, value, take, paths=("distances", "control.beta"))


def _acting() -> Quantity:
    """Make the quantity `acting`, which is empty while the base's rows are not active."""
    vectors = ("p_n", "m"), ("p_t", "m"), ("p_act", "m"), ("f", "n")
    templates = [f"{vector}_{{mobile}}_{{xyz}}_{unit}" for vector, unit in vectors]

    def columns(meta: TraceMeta) -> Sequence[Column]:
        return [Column(n, optional=True) for each in templates for n in column_names(each, meta)]

    def take(session: Session, step: Step) -> tuple[ActingReading, ...]:
        found, w, state = [], step.control, session.state
        for i in range(w.n_mob):
            if w.B[0] > 0.0 and not np.isnan(w.p_act[i, 0]):
                points = map(state.to_world, (w.p_n[i], w.p_t[i], w.p_act[i]))
                vectors = map(frozen, (*points, state.R_world_base @ w.f[i]))
                found.append(ActingReading(w.pairs[i].name, *vectors))
        return tuple(found)

    def cells(acting: Sequence[ActingReading], meta: TraceMeta) -> Sequence[Cell]:
        points, nothing = {name: points for name, *points in acting}, np.full((4, 3), NAN)
        groups = [points.get(pair, nothing) for pair in meta.mobile_pairs]
        return np.swapaxes(groups, 0, 1).ravel().tolist()

    def value(cells: Sequence[float], meta: TraceMeta) -> tuple[ActingReading, ...]:
        groups = np.swapaxes(np.reshape(cells, (4, -1, 3)), 0, 1)
        return tuple(
            ActingReading(name, *map(frozen, vectors))
            for name, vectors in zip(meta.mobile_pairs, groups, strict=True)
            if not np.isnan(vectors).all()
        )

    return Quantity(columns, cells, value, take)


def _buffer() -> Quantity:
    """Make the quantity `buffer`: approach speeds, the d_b that they require, and two flags."""
    numbers = "approach_speed_mps buffer_needed_m approach_speed_max_mps buffer_needed_max_m"
    columns = [Column(name, often=True) for name in numbers.split()]
    columns.append(Column("buffer_too_small", "bool", often=True))
    columns.append(Column("buffer_too_small_ever", "bool", often=True))
    return Quantity(
        lambda _: columns,
        lambda buffer, _: buffer,
        lambda cells, _: BufferReading(*cells[:4], *map(bool, cells[4:])),
        lambda _, step: step.buffer,
        paths=tuple(f"buffer.{field}" for field in BufferReading._fields),
    )


def _door() -> Quantity:
    """Make the quantity `door`: its geometry as JSON (empty without a door), and its numbers."""
    forces = [f"door_force_{axis}_n" for axis in "xyz"]
    names = ["door_angle_rad", *forces, "radial_force_n", "radial_error_rad"]
    numbers = (Column(name, "float", True, True) for name in names)
    columns = (Column("door", "text"), *numbers, Column("door_contact", "bool", True, True))

    def cells(view: DoorView | None, _: TraceMeta) -> Sequence[Cell]:
        text, numbers = (_door_text(view.door), view.numbers) if view else ("", NO_DOOR)
        return (text, *numbers.tolist())

    def value(cells: Sequence[Any], _: TraceMeta) -> DoorView | None:
        text, angle, x, y, z, *radial, contact = cells
        if not text:
            return None
        return DoorView(_door_of(text), angle, frozen((x, y, z)), *radial, contact=contact == 1.0)

    def take(_: Session, step: Step) -> DoorView | None:
        return step.door and step.door._replace(force=frozen(step.door.force))

    return Quantity(lambda _: columns, cells, value, take, paths=("door_numbers",))


def _smallest_force_bound(session: Session, step: Step) -> float:
    """[N] largest force of a person that the arm can resist; NaN without a person or a bound."""
    if not (step.pulls and step.control.solved):  # the fallback command respects no limits
        return NAN
    force, size = step.person.hand, math.hypot(*step.person.hand.tolist())
    return _least_bound_once(step.control.struct, force, size, session.model.tau_max)


_VECTOR = types.Array(types.f8, 1, "A")


@compiled(Signature(types.f8, (STEP.type, _VECTOR, types.f8, _VECTOR), None))
def _least_bound(w: Any, force: Array, size: float, tau_max: Array) -> float:
    """[N] smallest `force_bound`, or NaN; `size` [N] is the norm of the person's `force` (3,)."""
    qdd, n_b, least = w.qdd.copy(), len(w.qdd) - len(tau_max), np.inf
    qdd[n_b:] += w.x_est[2]
    load = steady_torques(w.M, w.h, qdd)
    for i in range(len(w.beta)):
        if w.beta[i] > 0.0:
            bound = force_bound(w.d[i], w.J[i], w.d_dot[i], w.M, load, tau_max)
            least = min(least, bound)
    if size > 0.0:
        against = -(force / size) @ w.J_ee[:3]
        least = min(least, force_bound(np.inf, against, 0.0, w.M, load, tau_max))
    return least if least < np.inf else np.nan


_least_bound_once = direct(_least_bound)


@dataclass(frozen=True, slots=True)
class Snapshot:
    """The whole simulation at one instant.

    Fields with a declaration are quantities, with columns in a file: `number` declares one that is
    recorded at each control step (`force_bound`: at 50 Hz), `drawn` one that is recorded at
    snapshots. A declaration names the attribute of `Step` with the value, or computes the value
    from the session s after the step and the step o; if it does neither, `make_snapshot` or its
    caller sets the value. Of the fields without a declaration, files store `physics` and `seed`.
    """

    t: Annotated[float, number("t_s", "t")]  # [s] simulated time since the last reset
    base_pose: Annotated[Array, number("base_{pose}", "truth.base_pose")]
    """(3,) x, y [m] and heading φ [rad] of the base."""
    base_velocity: Annotated[Array, number("base_{velocity}", "truth.base_velocity")]
    """(n_b,) [m/s or rad/s] true velocity along the base's axes; v and ω of a differential base."""
    base_velocity_command: Annotated[Array, number("command_{velocity}", "base_command")]
    """(n_b,) [m/s or rad/s] velocity command; it changes once in each `admittance.period`."""
    base_acceleration: Annotated[Array, number("base_{acceleration}", "control.a_base_cmd")]
    """(n_b,) [m/s² or rad/s²] commanded base acceleration, the input of the admittance law."""
    avoidance_acceleration: Annotated[
        Array, number("avoidance_{acceleration}", "control.base_avoidance")
    ]
    """(n_b,) [m/s² or rad/s²] β_m ẍ_m with ẍ_m of (16), Figure 15; 0 without rows of the base."""
    wheel_angles: Annotated[Array, drawn("wheel_{wheel}_rad", lambda s, o: s.wheel_angles)]
    """(n_w,) [rad] angles of the base's wheels, for drawing."""
    q_m: Annotated[Array, number("q_{joint}_{position}", "truth.q_m")]
    """(n_m,) [rad or m] joint positions of the arm."""
    u_a: Annotated[Array, number("u_{joint}_{effort}", "control.u_cmd")]
    """(n_m,) [N m or N] commanded joint torques of the arm."""
    p_ee: Annotated[Array, number("p_ee_{xyz}_m", "state.p_ee")]
    """(3,) [m] position of the end-effector in the world."""
    wxyz_ee: Annotated[
        Array, drawn("q_ee_{wxyz}", lambda s, o: np.roll(pin.Quaternion(s.state.R_ee).coeffs(), 1))
    ]
    """(4,) orientation of the end-effector in the world as a unit quaternion, w first."""
    pairs: Annotated[tuple[PairReading, ...], _pairs()]
    """All link pairs; the pairs with the base (L_m) are first."""
    acting: Annotated[tuple[ActingReading, ...], _acting()]
    """Acting points of the pairs with the base inside their buffer, if the controller uses them."""
    beta_m: Annotated[float, number("beta_m", "control.beta_m")]
    """[-] β_m of (28)."""
    hand_target: Annotated[
        Array | None, drawn("hand_target_{xyz}_m", lambda s, o: o.hand_target, optional=True)
    ]
    """(3,) [m] target of the (first) person at the end-effector, in the world, or None."""
    hand_force: Annotated[Array, number("hand_force_{xyz}_n", "hand_force")]
    """(3,) [N] force of all people on the end-effector, in the world; while a scenario opens a
    door, the force of the end-effector on the door."""
    ee_error: Annotated[float, number("ee_error_m", "ee_error")]
    """[m] true distance of the end-effector from the target of the (first) person who holds it;
    without such a person, from its reference; 0 if there is neither."""
    in_contact: Annotated[bool, number("contact", "contacts.arm_base", "bool")]
    """Whether arm and base touch."""
    arm_in_contact: Annotated[bool, number("arm_contact", "contacts.arm_arm", "bool")]
    """Whether parts of the arm touch."""
    solver_failures: Annotated[int, number("solver_failures", "control.failures", "int")]
    """Number of steps with the fallback command since the last reset."""
    step_time_us: Annotated[float, drawn("step_time_us")]
    """[µs] mean time of the controller in a step, over 1 s simulated; NaN without a `Pacer`."""
    realtime_factor: Annotated[float, drawn("realtime_factor")]
    """[-] ratio of simulated to real time in the last second; NaN without a `Pacer`."""
    overruns: Annotated[int, drawn("overruns", kind="int")]
    """Number of control steps since the last reset that exceeded their period or began after it."""
    paused: Annotated[bool, drawn("paused", kind="bool")]
    """Whether the simulation is paused."""
    mode: Annotated[
        str, drawn("mode", lambda s, o: "tracking" if o.control.tracking else "guiding", "text")
    ]
    """"guiding", or "tracking" while the arm follows a reference."""
    controller: Annotated[str, drawn("controller", lambda s, o: s.controller.name, "text")]
    config: Annotated[Config, config_changes(lambda s, o: s.config)]
    """The parameters in use, which include the changes of `Scenario.adapted`."""
    d_b: Annotated[float, drawn("d_b_m", lambda s, o: s.controller.d_b)]
    """[m] present buffer distance, which slowly approaches `config.border.d_b`."""
    buffer: Annotated[BufferReading, _buffer()]
    """Whether d_b is sufficient for the arm's approach speed."""
    pulls: Annotated[
        tuple[PullReading, ...],
        records("pulls_json", PullReading, lambda s, o: tuple(map(_frozen_pull, o.pulls))),
    ] = ()
    """All people who hold the robot; a scenario's person has the number -1."""
    ghosts: Annotated[tuple[GhostReading, ...], records("ghosts_json", GhostReading)] = ()
    """Compared robots at `t`, each with the same input and its own controller."""
    scores: Annotated[tuple[Score, ...], records("scores_json", Score)] = ()
    """Scores of this robot and the ghosts in the present comparison; empty without ghosts."""
    same: Annotated[str, drawn("ghosts_have_the_same", kind="text")] = ""
    """The common input of this robot and the ghosts, "path" or "force"; empty without ghosts."""
    scenario: Annotated[str, drawn("scenario", kind="text")] = ""
    """Name of the present scenario; empty during free motion."""
    scenario_ends: Annotated[float | None, drawn("scenario_ends_s", optional=True)] = None
    """[s] simulated time at which the scenario ends; None during free motion."""
    door: Annotated[DoorView | None, _door()] = None
    """The door that the end-effector holds, also after the scenario."""
    speed: Annotated[float, drawn("speed")] = 1.0
    """[-] desired ratio of simulated to real time."""
    qd_m: Annotated[Array | None, number("qd_{joint}_{speed}", "truth.qd_m", optional=True)] = None
    """(n_m,) [rad/s or m/s] joint velocities of the arm; None if unknown."""
    activation: Annotated[float, number("activation", "control.activation")] = 0.0
    """[-] largest activation of the rows that the controller has inserted; 0 without rows."""
    floor_contact: Annotated[bool, number("floor_contact", "contacts.arm_floor", "bool")] = False
    """Whether arm and floor touch."""
    given_up: Annotated[int, number("solver_given_up", "control.given_up", "int")] = 0
    """Number of steps since the last reset in which the base's QP had no solution."""
    ee_speed: Annotated[float, number("hand_speed_mps", "ee_speed")] = 0.0
    """[m/s] true speed of the end-effector."""
    people: Annotated[int, number("people", "people", "int")] = 0
    """Number of people who hold the robot."""
    duration_us: Annotated[float, number("duration_us", "duration_us")] = NAN
    """[µs] real time of the controller in this step."""
    force_bound: Annotated[float, number("force_bound_n", _smallest_force_bound)] = NAN
    """[N] largest force of a person that the arm can resist; NaN without a person or a bound."""
    physics: str = ""  # name of the plant; empty if unknown
    seed: int | None = None  # seed of all random numbers; None if unknown
    run: int = 0  # number of the run since the start of the loop
    busy: str = ""  # the operation for which the simulation pauses, or empty
    changing: str = ""  # a text about a parameter that is changing gradually, or empty
    refusal: Refusal | None = None  # the newest failure of a command, or None
    case: RunCase | None = None  # case of the scenario that started in the last simulated second
    explanation: Explanation | None = None  # of the motion in the step at `t`, if requested

    def follows(self, before: "Snapshot") -> bool:
        """Whether this snapshot belongs to the run of `before`, and is not earlier than it."""
        return self.run == before.run and self.t >= before.t

    @property
    def border(self) -> BorderConfig:
        """The border's parameters with the present d_b, in 5 mm steps while it changes."""
        commanded = self.config.border
        if abs(self.d_b - commanded.d_b) < _D_B_STEP or not math.isfinite(self.d_b):
            return commanded  # it is not finite in a changed log
        d_b = round(round(self.d_b / _D_B_STEP) * _D_B_STEP, 3)
        return commanded.model_copy(update={"d_b": d_b})

    @property
    def nearest(self) -> PairReading:
        """The link pair with the smallest distance."""
        return min(self.pairs, key=lambda pair: pair.d)

    @property
    def clearance(self) -> float:
        """[m] smallest distance of the pairs with the base; infinite without such a pair."""
        return min((pair.d for pair in self.pairs if pair.mobile), default=math.inf)

    @property
    def touches(self) -> bool:
        """Whether the plant reports any contact."""
        door = self.door is not None and self.door.contact
        return self.in_contact or self.arm_in_contact or self.floor_contact or door


QUANTITIES: dict[str, Quantity] = {
    name: hint.__metadata__[0]
    for name, hint in get_type_hints(Snapshot, globals(), include_extras=True).items()
    if hasattr(hint, "__metadata__")
}
"""All recorded quantities, by the fields of `Snapshot`."""


def make_snapshot(
    session: Session, step: Step, pacer: Pacer | None, *, explained: bool = True, **fields: Any
) -> Snapshot:
    """Make a snapshot in separate, read-only memory, from the last step and the session after it.

    The `pacer` has the real-time statistics; without one, snapshots of equal runs are equal except
    for `duration_us`. `explained` states whether the snapshot has the explanation of the motion,
    which no file stores. `fields` are values of further fields of `Snapshot`.
    """
    values = {name: q.take(session, step) for name, q in QUANTITIES.items() if q.take is not None}
    computed = {k: frozen(v) if isinstance(v, np.ndarray) else v for k, v in values.items()}
    why = (session.controller, step.control, session.config, step.base_command)
    return Snapshot(
        **computed,
        step_time_us=pacer.step_time_us if pacer else NAN,
        realtime_factor=pacer.realtime_factor if pacer else NAN,
        overruns=pacer.overruns if pacer else 0,
        physics=session.kind,
        seed=session.seed,
        explanation=explain(*why) if explained else None,
        **{"paused": False, **fields},
    )


def _frozen_pull(pull: PullReading) -> PullReading:
    who, link, *vectors = pull
    return PullReading(who, link, *map(frozen, vectors))
