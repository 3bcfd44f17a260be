"""The trace of a run, its recorder, the stored snapshots of the live loop, and a stuck arm."""

from __future__ import annotations

import math
import pickle
import zlib
from collections import deque
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import compress, takewhile
from operator import attrgetter
from typing import Any, NamedTuple

import numpy as np
from typing_extensions import Self

from app.control.buffer_watch import BufferReading
from app.errors import LogError
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.scenarios.leading import Scenario
from app.simulation.session import DT, Session, Step
from app.simulation.trace.columns import NAN, Column, Take, TraceMeta
from app.simulation.trace.snapshot import EVERY, QUANTITIES, Snapshot, make_snapshot
from app.strict import Array

SNAPSHOTS_STORED = 3000  # 60 s at 50 Hz
_UNPACKED = 1050  # [-] number of the newest snapshots that are objects; plots show 20 s
SHORT = 1e-3  # [m] error above which the end-effector counts as stuck
_RESTING = 1e-6  # [m/s, m/s²] largest velocity and acceleration of a resting reference
_MOVING = 1e-3  # [m/s] speed towards the target above which the end-effector counts as moving
_AT_LIMIT = 0.005  # [-] largest distance of a joint at a limit, relative to the joint's range
_AT_SPEED = 0.99  # [-] smallest ratio of speed to speed limit of a joint at its speed limit
_STRETCHED = 0.05  # [-] the arm counts as stretched if a singular value of its Jacobian is smaller
_PUSHED = 0.01  # [m/s²] smallest acceleration away from the target that counts as a push


class Trace:
    """A run over time: a table with a row for each recorded step, and snapshots."""

    def __init__(
        self,
        meta: TraceMeta,
        table: Array,
        snapshots: Sequence[Snapshot] = (),
        names: Sequence[str] = tuple(QUANTITIES),
    ) -> None:
        """`table` (N, C) has the columns of the quantities `names`, and rows in order of time; each
        snapshot belongs to one of the rows.
        """
        self.meta, self.table = meta, table
        self.snapshots, self._quantities = tuple(snapshots), names
        self.columns: list[Column] = []  # columns of the table, in order
        self._slices: dict[str, slice | int] = {}
        for name in names:
            begin = len(self.columns)
            self.columns += [each for each in QUANTITIES[name].columns(meta) if each.often]
            if (end := len(self.columns)) > begin:
                self._slices[name] = begin if QUANTITIES[name].single else slice(begin, end)
        self.index = {column.name: k for k, column in enumerate(self.columns)}  # places by names

    @property
    def controllers(self) -> tuple[str, ...]:
        """Names of the controllers of the snapshots, in the order of their first use."""
        return tuple(dict.fromkeys(snapshot.controller for snapshot in self.snapshots))

    @classmethod
    def of_snapshots(cls, model: RobotModel, snapshots: Sequence[Snapshot]) -> Self:
        """Make a trace with a row for each snapshot; the first one determines `meta`. If there are
        no snapshots, the times do not increase or the pairs differ, this raises a LogError.
        """
        if not snapshots:
            raise LogError("there are no snapshots for a log")
        first = snapshots[0]
        pairs = {pair.name: pair.mobile for pair in first.pairs}
        about = {"scenario": first.scenario, "physics": first.physics, "seed": first.seed}
        meta = TraceMeta.of(model, pairs, first.config, **about)
        often, last = [column.often for column in columns_of(meta)], -math.inf
        for s in snapshots:
            if not s.t > last:
                raise LogError(f"a snapshot at {s.t:g} s follows one at {last:g} s")
            if tuple(pair.name for pair in s.pairs) != meta.pairs:
                raise LogError(f"at {s.t:g} s the link pairs differ from the link pairs of the log")
            last = s.t
        rows = [[float(x) for x in compress(cells_of(s, meta), often)] for s in snapshots]
        return cls(meta, np.array(rows), snapshots)

    def __len__(self) -> int:
        return len(self.table)

    def __getitem__(self, column: str) -> Array:
        """(N,) a column of the table by its name, such as `d_lm-lEE_m`."""
        return self.table[:, self.index[column]]

    def of(self, quantity: str) -> Array:
        """(N,) or (N, k) values of a field of `Snapshot`; raises a LogError if there are none."""
        if quantity not in self._slices:
            raise LogError(f"the log does not have {quantity!r}")
        return self.table[:, self._slices[quantity]]

    @property
    def groups(self) -> dict[str, list[str]]:
        """Names of the columns of each quantity in the table, by quantity, without the time."""
        every = np.array([column.name for column in self.columns])
        places = {name: place for name, place in self._slices.items() if name != "t"}
        return {name: np.atleast_1d(every[place]).tolist() for name, place in places.items()}

    @property
    def t(self) -> Array:
        """(N,) [s] times of the rows."""
        return self.of("t")

    @property
    def distances(self) -> Array:
        """(N, P) [m] signed distances of the pairs."""
        return self.of("pairs")[:, : len(self.meta.pairs)]

    @property
    def betas(self) -> Array:
        """(N, P) [-] activations of the pairs."""
        return self.of("pairs")[:, len(self.meta.pairs) :]

    @property
    def buffer(self) -> BufferReading:
        """Reading of the `BufferWatch` at the last row."""
        return BufferReading(*self.of("buffer")[-1].tolist())

    @property
    def angular(self) -> Array:
        """(n_b,) whether each axis of the base is angular."""
        return np.array([name.endswith("_radps") for name in self.meta.velocities])

    @property
    def finite(self) -> bool:
        """Whether all torques, and all poses of the base, are finite numbers."""
        return bool(np.isfinite(self.of("u_a")).all() and np.isfinite(self.of("base_pose")).all())

    @property
    def each_step(self) -> bool:
        """Whether the trace has a row for each control step."""
        return bool((np.diff(self.t) < 1.5 * DT).all())

    def row_at(self, t: float) -> int:
        """Number of the row nearest to a time [s]."""
        return int(np.abs(self.t - t).argmin())

    def at(self, t: float) -> Snapshot:
        """The snapshot nearest to a time [s]."""
        return min(self.snapshots, key=lambda snapshot: abs(snapshot.t - t))

    def rows(self, which: slice | Array) -> Trace:
        """The rows `which` (slice, numbers or flags) of the table, without snapshots."""
        return Trace(self.meta, self.table[which], names=self._quantities)


class Recorder:
    """Records every control step of a run."""

    def __init__(self, scenario: Scenario | None = None, *, drawn: bool = False) -> None:
        """Start without steps; with `drawn`, snapshots are made at 50 Hz from the first step on."""
        self._scenario, self._drawn = scenario, drawn
        self._meta: TraceMeta | None = None
        self._rows = bytearray()  # needs a fifth of a list's memory, and no garbage collection
        self._last: tuple[Session, Step] | None = None
        self._faults: dict[str, float] = {}
        self._farthest: Step | None = None  # step with the largest tracking error
        self.snapshots: list[Snapshot] = []

    def add(self, session: Session, step: Step) -> None:
        """Record one control step, with the session after the step."""
        if self._meta is None:
            self._begin(session, step)
        self._last = session, step
        largest = SHORT if self._farthest is None else self._farthest.ee_error
        if step.reference is not None and step.ee_error > largest:
            self._farthest = step._replace(control=step.control.copy())
        if len(session.loop.reported) > len(self._faults):
            self._faults |= dict.fromkeys(session.loop.reported - self._faults.keys(), step.t)
        seldom = round(step.t / DT) % EVERY == 0
        computed = [take(session, step) if seldom else NAN for take in self._computed]
        values = (*self._recorded(step), *computed)
        self._rows += b"".join([np.asarray(value, dtype=float).tobytes() for value in values])
        if seldom and self._drawn:
            led = self._scenario
            about = {"scenario": led.name, "scenario_ends": led.duration} if led else {}
            self.snapshots.append(make_snapshot(session, step, None, explained=False, **about))

    def trace(self) -> Trace:
        """The recorded trace; at least one step must be recorded."""
        assert self._meta is not None, "no step was recorded"
        assert self._last is not None
        session, step = self._last
        stuck, farthest = find_stuck(session.model, step), self._farthest
        left = farthest and _off_target(session.model, farthest)
        results = {"stuck": stuck and stuck._asdict(), "left_way": left and left._asdict()}
        meta = self._meta.model_copy(update=results | {"faults": self._faults})
        rows = np.frombuffer(self._rows).reshape(-1, len(self._order))
        return Trace(meta, rows.take(self._order, axis=1), self.snapshots)

    def _begin(self, session: Session, step: Step) -> None:
        """Prepare the rows: the attributes of steps, then the computed numbers."""
        pairs = {p.name: p.a == session.model.body_names[0] for p in step.control.pairs}
        scenario = self._scenario.name if self._scenario else ""
        about = {"scenario": scenario, "physics": session.kind, "seed": session.seed}
        self._meta = TraceMeta.of(session.model, pairs, session.config, **about)
        paths, self._computed, is_computed = list[str](), list[Take](), list[bool]()
        for quantity in QUANTITIES.values():
            often = [column for column in quantity.columns(self._meta) if column.often]
            is_computed += [not quantity.paths] * len(often)
            paths += quantity.paths
            if often and not quantity.paths and quantity.take is not None:
                self._computed.append(quantity.take)
        self._recorded = attrgetter(*paths)
        self._order = np.argsort(np.argsort(is_computed, kind="stable"))


class Stored:
    """A snapshot that `pack` converts to bytes, except its configuration, which many share."""

    __slots__ = ("_config", "_content", "run", "t")

    def __init__(self, snapshot: Snapshot) -> None:
        self.t, self.run, self._config = snapshot.t, snapshot.run, snapshot.config
        self._content: Snapshot | bytes = snapshot

    def pack(self) -> Self:
        """Convert the snapshot to bytes, and return this object."""
        if not isinstance(self._content, bytes):
            bare = replace(self._content, config=None)  # type: ignore[arg-type]
            self._content = zlib.compress(pickle.dumps(bare), 1)
        return self

    @property
    def snapshot(self) -> Snapshot:
        """The snapshot; after `pack` it is a copy, and the 512 last used copies are cached."""
        content = self._content  # another thread may pack it
        return _unpacked(self) if isinstance(content, bytes) else content


@lru_cache(maxsize=512)
def _unpacked(stored: Stored) -> Snapshot:
    content = pickle.loads(zlib.decompress(stored._content))  # type: ignore[arg-type]
    return replace(content, config=stored._config)


class History:
    """The newest snapshots of a run in order of time; all but the newest 1050 are packed."""

    def __init__(self, stored: int = SNAPSHOTS_STORED) -> None:
        """Start empty; `stored` is the largest number of snapshots."""
        self._stored: deque[Stored] = deque(maxlen=stored)
        self._latest: Snapshot | None = None

    @property
    def latest(self) -> Snapshot:
        """The newest snapshot; the history must not be empty."""
        assert self._latest is not None, "start the loop first"
        return self._latest

    def add(self, snapshot: Snapshot) -> None:
        """Append a snapshot, which replaces the newest one if both have the same time. A snapshot
        of another run, or of an earlier time, replaces all.
        """
        newest, stored = self._latest, Stored(snapshot)
        if newest is None or not snapshot.follows(newest):
            # A new deque: other threads read the history meanwhile, so it must not become empty.
            self._stored = deque([stored], self._stored.maxlen)
        elif snapshot.t == newest.t:
            self._stored[-1] = stored
        else:
            self._stored.append(stored)
            if len(self._stored) > _UNPACKED:
                self._stored[-1 - _UNPACKED].pack()
        self._latest = snapshot

    def after(self, t: float) -> list[Stored]:
        """Snapshots later than `t` [s], oldest first."""
        return [*takewhile(lambda stored: stored.t > t, reversed(tuple(self._stored)))][::-1]


def columns_of(meta: TraceMeta) -> list[Column]:
    """All columns of a file, in order."""
    return [column for quantity in QUANTITIES.values() for column in quantity.columns(meta)]


def cells_of(snapshot: Snapshot, meta: TraceMeta) -> list[Any]:
    """The values of a snapshot as a row of a file, in the order of `columns_of`."""
    return [x for name, q in QUANTITIES.items() for x in q.cells(getattr(snapshot, name), meta)]


class Stuck(NamedTuple):
    """Position of an end-effector that is not at its target, and the reasons."""

    t_s: float  # [s] simulated time
    ee_error_m: float  # [m] distance of the end-effector from its target
    ee_m: tuple[float, ...]  # (3,) [m] position of the end-effector, in the world
    target_m: tuple[float, ...]  # (3,) [m] target, in the world
    reasons: tuple[str, ...]  # all reasons of `_off_target` that apply, or "unknown"
    joints: tuple[str, ...]  # names of the joints at their position limits


def find_stuck(model: RobotModel, step: Step) -> Stuck | None:
    """Why the end-effector is more than 1 mm away from a resting reference; None if it is not."""
    reference = step.reference
    if reference is None or step.ee_error <= SHORT:
        return None
    rates = np.abs((reference.velocity, reference.acceleration))
    return None if rates.max() > _RESTING else _off_target(model, step)


def _off_target(model: RobotModel, step: Step) -> Stuck:
    """Where the end-effector is in a step with a reference, and why it is not at its target. With
    "links too near", rows of T_sca for pairs within the arm are active. With "border against
    end-effector", avoidance by the base moves the end-effector away from its target.
    """
    state, n_b, q_m, reference = RobotState(model), model.n_b, step.truth.q_m, step.reference
    assert reference is not None
    state.update(step.truth)
    ee, target = state.T_world_ee.translation, reference.pose.translation
    towards = (target - ee) / np.linalg.norm(target - ee)
    margin = _AT_LIMIT * (model.q_upper - model.q_lower)
    at_limit = (q_m < model.q_lower + margin) | (q_m > model.q_upper - margin)
    joints = tuple(compress(model.description.arm.joints, at_limit.tolist()))
    w, speeds = step.control, np.abs(step.truth.qd_m) / model.qd_max
    in_arm = w.B[n_b:][: len(w.pairs) - w.n_mob]
    pushed = state.J_ee[:3, :n_b] @ (model.J_m_inv @ w.base_avoidance)
    smallest_singular = np.linalg.svd(state.J_ee[:, n_b:], compute_uv=False)[-1]
    found = {
        "still moving": bool(state.v_ee[:3] @ towards > _MOVING),
        "joint limits": bool(joints),
        "joint speeds": bool((speeds > _AT_SPEED).any()),
        "links too near": bool((in_arm > 0.0).any()),
        "border against end-effector": bool(pushed @ towards < -_PUSHED),
        "full stretch": bool(smallest_singular < _STRETCHED),
    }
    reasons = tuple(compress(found, found.values())) or ("unknown",)
    places = tuple(ee.tolist()), tuple(target.tolist())
    return Stuck(step.t, step.ee_error, *places, reasons, joints)
