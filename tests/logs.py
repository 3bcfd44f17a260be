"""Random snapshots and traces for tests of logs."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from app.config import Config
from app.control.buffer_watch import BufferReading
from app.simulation.people import PullReading
from app.simulation.plants.door import Door, DoorView
from app.simulation.trace.columns import frozen
from app.simulation.trace.snapshot import ActingReading, GhostReading, PairReading, Score, Snapshot
from app.simulation.trace.trace import Trace
from tests.robots import husky_panda

PAIRS = ("lm-lEE", "lm-l3", "l1-lEE", "l1-l3", "l2-lEE")
CONFIGS = (
    Config(),
    Config().replace("border.d_b", 0.2 + 1e-17),
    Config().replace("border.kind", "points").replace("force.f_max", 100.0 / 3.0),
)

DOORS = (
    Door(hinge="left", hinge_position=(1.0, 0.1 + 1e-17), yaw=1.0 / 3.0, width=0.6, friction=1.0),
    Door(hinge="right", hinge_position=(-0.0, 1e-9), yaw=-2.0, width=0.75, friction=0.0),
)


def random_snapshot(rng: np.random.Generator, t: float) -> Snapshot:
    """A random snapshot of the paper's robot at t [s], with numbers of any size."""

    def number() -> float:
        size = rng.choice([0.0, 1e-300, 1e-7, 1.0, 1e9])
        return float(rng.choice([-1.0, 1.0]) * size * rng.random())

    def vector(n: int) -> np.ndarray:
        return frozen([number() for _ in range(n)])

    def truth() -> bool:
        return bool(rng.integers(2))

    mobile = [name for name in PAIRS if name.startswith("lm") and truth()]
    return Snapshot(
        t=t,
        base_pose=vector(3),
        base_velocity=vector(2),
        base_velocity_command=vector(2),
        base_acceleration=vector(2),
        avoidance_acceleration=vector(2),
        wheel_angles=vector(2),
        q_m=vector(7),
        u_a=vector(7),
        p_ee=vector(3),
        wxyz_ee=vector(4),
        pairs=tuple(
            PairReading(name, name.startswith("lm"), number(), number(), vector(3), vector(3))
            for name in PAIRS
        ),
        acting=tuple(
            ActingReading(name, vector(3), vector(3), vector(3), vector(3)) for name in mobile
        ),
        beta_m=number(),
        hand_target=vector(3) if truth() else None,
        hand_force=vector(3),
        ee_error=number(),
        in_contact=truth(),
        arm_in_contact=truth(),
        solver_failures=int(rng.integers(2**40)),
        step_time_us=float(rng.choice([np.nan, 212.3])),
        realtime_factor=number(),
        overruns=int(rng.integers(9)),
        paused=truth(),
        mode=str(rng.choice(["guiding", "tracking"])),
        controller=str(rng.choice(["dbb", "none"])),
        config=CONFIGS[rng.integers(len(CONFIGS))],
        d_b=number(),
        buffer=BufferReading(
            number(), float(rng.choice([np.inf, 0.1])), number(), np.inf, truth(), truth()
        ),
        scenario=str(rng.choice(["", "tracking"])),
        speed=number(),
        ghosts=tuple(
            GhostReading(name, vector(3), vector(7), vector(2), vector(3), number())
            for name in ("none", "barrier")
            if truth()
        ),
        scores=tuple(
            Score(name, np.inf, *(number() for _ in range(6)), int(rng.integers(99)))
            for name in ("dbb", "none")
            if truth()
        ),
        same=str(rng.choice(["", "path", "force"])),
        pulls=tuple(
            PullReading(who, link, vector(3), vector(3), vector(3))
            for who, link in ((0, None), (12, "panda_joint4"))
            if truth()
        ),
        scenario_ends=number() if truth() else None,
        door=DoorView(DOORS[rng.integers(2)], number(), vector(3), number(), number(), truth())
        if truth()
        else None,
        qd_m=vector(7) if truth() else None,
        activation=number(),
        floor_contact=truth(),
        given_up=int(rng.integers(9)),
        ee_speed=number(),
        people=int(rng.integers(3)),
        duration_us=float(rng.choice([np.nan, 198.7])),
        physics="planar",
        seed=7,
    )


def random_snapshots(seed: int, count: int) -> list[Snapshot]:
    """Snapshots in order of time."""
    rng = np.random.default_rng(seed)
    times = np.cumsum(rng.uniform(1e-6, 0.1, count))
    return [random_snapshot(rng, float(t)) for t in times]


def trace_of(snapshots: Sequence[Snapshot]) -> Trace:
    """The trace of a run of the paper's robot."""
    return Trace.of_snapshots(husky_panda(), snapshots)


def difference(a: Any, b: Any, where: str = "") -> str:
    """The first difference of a and b, after its path `where`, or an empty text; NaN equals NaN."""
    if type(a) is not type(b):
        return f"{where}: {type(a).__name__} is not {type(b).__name__}"
    if isinstance(a, np.ndarray):
        same = a.dtype == b.dtype and np.array_equal(a, b, equal_nan=True)
        return "" if same else f"{where}: {a} is not {b}"
    if is_dataclass(a):
        inner = ((f.name, getattr(a, f.name), getattr(b, f.name)) for f in fields(a))
    elif isinstance(a, tuple):
        if len(a) != len(b):
            return f"{where}: {len(a)} is not {len(b)} long"
        inner = ((str(i), x, y) for i, (x, y) in enumerate(zip(a, b, strict=True)))
    else:
        return "" if a == b or (a != a and b != b) else f"{where}: {a!r} is not {b!r}"
    return next((d for name, x, y in inner if (d := difference(x, y, f"{where}.{name}"))), "")
