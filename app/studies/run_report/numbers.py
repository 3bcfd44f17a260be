"""A run as its log has it: columns over time, and its key numbers."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from app.config import Config
from app.simulation.trace.log import Log

Array = np.ndarray


class Track(NamedTuple):
    """What a log says over time; N rows, P link pairs, n_m joints of the arm.

    Attributes:
        t: (N,) [s].
        base: (N, 3) x, y [m] and heading [rad] of the base.
        velocity: (N, 2) v [m/s] and ω [rad/s] of the base, as measured.
        command: (N, 2) the same as commanded.
        asked: (N, 2) v̇ [m/s²] and ω̇ [rad/s²] that the HQP asks of the base.
        avoidance: (N, 2) what avoidance inserts of them.
        u_a: (N, n_m) [N m] arm torques.
        p_ee: (N, 3) [m] end-effector in the world.
        d: (N, P) [m] signed distances.
        beta: (N, P) [-] activations.
        beta_m: (N,) [-] of (28).
        error: (N,) [m] of the end-effector.
        force: (N,) [N] magnitude of the hand's force.
        contact: (N,) bool, arm on base or within the arm.
    """

    t: Array
    base: Array
    velocity: Array
    command: Array
    asked: Array
    avoidance: Array
    u_a: Array
    p_ee: Array
    d: Array
    beta: Array
    beta_m: Array
    error: Array
    force: Array
    contact: Array


def track_of(log: Log) -> Track:
    """The log's rows as columns."""
    rows = log.snapshots
    return Track(
        t=np.array([s.t for s in rows]),
        base=np.array([s.base_pose for s in rows]),
        velocity=np.array([s.base_velocity for s in rows]),
        command=np.array([s.base_velocity_command for s in rows]),
        asked=np.array([s.base_acceleration for s in rows]),
        avoidance=np.array([s.avoidance_acceleration for s in rows]),
        u_a=np.array([s.u_a for s in rows]),
        p_ee=np.array([s.p_ee for s in rows]),
        d=np.array([[pair.d for pair in s.pairs] for s in rows]),
        beta=np.array([[pair.beta for pair in s.pairs] for s in rows]),
        beta_m=np.array([s.beta_m for s in rows]),
        error=np.array([s.ee_error for s in rows]),
        force=np.array([np.linalg.norm(s.hand_force) for s in rows]),
        contact=np.array([s.in_contact or s.arm_in_contact for s in rows]),
    )


def key_numbers(log: Log, track: Track) -> dict[str, Any]:
    """The run's figures, from its 50 rows a second; keys end in their unit."""
    steps = np.diff(track.base[:, :2], axis=0)
    last = log.snapshots[-1]
    return {
        "duration_s": float(track.t[-1] - track.t[0]),
        "least_distance_m": dict(zip(log.meta.pairs, track.d.min(axis=0).tolist(), strict=True)),
        "largest_activation": float(track.beta.max()),
        "largest_error_m": float(track.error.max()),
        "final_error_m": float(track.error[-1]),
        "base_path_m": float(np.linalg.norm(steps, axis=1).sum()),
        "base_displacement_m": float(np.linalg.norm(track.base[-1, :2] - track.base[0, :2])),
        "base_turn_rad": float(track.base[-1, 2] - track.base[0, 2]),
        "largest_base_speed_mps": float(np.abs(track.velocity[:, 0]).max()),
        "largest_base_turn_radps": float(np.abs(track.velocity[:, 1]).max()),
        "largest_hand_force_n": float(track.force.max()),
        "largest_torque_nm": dict(
            zip(log.meta.joints, np.abs(track.u_a).max(axis=0).tolist(), strict=True)
        ),
        "rows_in_contact": int(track.contact.sum()),
        "solver_failures": last.solver_failures,
    }


def config_changes(configs: Sequence[Config]) -> list[tuple[str, Any, Any]]:
    """Parameters that differ from the defaults in any of the configurations.

    Returns:
        Path as in `border.d_b`, default, and the values it had, in order, joined if there are more.
    """
    known = Config().model_dump()
    changes = []
    for section, defaults in known.items():
        for name, default in defaults.items():
            had = list(dict.fromkeys(getattr(getattr(c, section), name) for c in configs))
            if had != [default]:
                changes.append((f"{section}.{name}", default, had[0] if len(had) == 1 else had))
    return changes


def spans(flags: Array, t: Array) -> list[tuple[float, float]]:
    """Begin and end [s] of the stretches in which a flag (N,) holds, at times t (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [
        (float(t[a]), float(t[min(b, len(t) - 1)]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
