"""Figures of merit of a run: the results of `dbb run`, sweeps, studies, claims and reports."""

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple

import numpy as np

from app.errors import LogError
from app.simulation.plants.door import BODY
from app.simulation.trace.trace import Trace
from app.simulation.trace.words import outcome, spoken
from app.strict import Array

NEAR = 0.01
"""[m] distance below which two bodies count as in contact, for the figures of a person's force."""

_DEAD_BAND = 0.01  # [m/s², rad/s²] dead band of an acceleration's sign
_TORQUE_BAND = 0.003  # [N m] or [N] dead band of the sign of a torque's change in one step
OPENED = math.radians(80)  # [rad] smallest angle of an open door
_ESTIMATE_AT = 5.0  # [s] time at which the estimated radial direction is evaluated
_BACKED_OFF = 0.01  # [m] smallest motion of the base that counts
_SATURATED = 0.999  # [-] smallest ratio of a torque to its limit that is a saturation
_AFTER_SATURATION = 0.1  # [s] time after a saturation in which its effect can last
_TOUCHED = {"contacts": "the base", "arm_contacts": "itself", "floor_contacts": "the floor"}


class Figure(NamedTuple):
    """A figure of merit of a run: its description in one sentence, and its computation."""

    about: str
    of: Callable[[Trace], Any]


def metrics(run: Trace) -> dict[str, Any]:
    """Compute all figures of a run.

    A figure for which the trace has no data is None. Changes between control steps have data only
    if each step has a row. The figures of `DOOR` are included only if the run opened a door.
    """
    figures: dict[str, Any] = dict.fromkeys(FIGURES)
    for key, figure in FIGURES.items():
        with suppress(LogError):
            figures[key] = figure.of(run)
    if not run.each_step:
        changes = ("_jump_max", "_jump_max_nm", "_sign_changes")
        figures |= dict.fromkeys(key for key in figures if key.endswith(changes))
    estimated = ~np.isnan(run["radial_error_rad"]) if "radial_error_rad" in run.index else []
    opening = run.rows(np.flatnonzero(estimated))
    if len(opening) and any(pair.endswith(BODY) for pair in run.meta.pairs):
        figures |= {key: figure.of(opening) for key, figure in DOOR.items()}
    return figures


def touches(figures: dict[str, Any]) -> list[str]:
    """The contacts of a run: "the arm touched the base and itself", "the door touched the base"."""
    arm = " and ".join(part for key, part in _TOUCHED.items() if figures[key])
    door = ["the door touched the base"] if figures.get("door_contacts") else []
    return [f"the arm touched {arm}", *door] if arm else door


def verdict(figures: dict[str, Any], chain: Sequence[str] = ()) -> str:
    """The result of a run in words: contact, smallest distance, remaining error, missing values.
    With a `chain` of the bodies' names from the base outwards, pairs have displayed names.
    """
    touched, distances = touches(figures), figures["min_distance_m"]
    known = {pair: d for pair, d in distances.items() if d is not None and math.isfinite(d)}
    names = {pair: spoken(pair, chain) if chain else pair for pair in distances}
    least, error = min(known.values(), default=math.inf), figures["ee_error_final_m"]
    result = outcome(least, touched=bool(touched))
    text = (", and ".join(touched) or result).capitalize()
    if known:
        near = f"smallest distance {1000 * least:.0f}"
        if least < 0:
            near = f"bodies overlapped by {-1000 * least:.1f}"
        text += f"; {near} mm ({names[min(known, key=known.__getitem__)]})"
    if lost := sorted(distances.keys() - known.keys()):
        text += f"; without a distance: {', '.join(names[pair] for pair in lost)}"
    final = "is missing" if error is None or not math.isfinite(error) else f"{1000 * error:.1f} mm"
    text += f"; final end-effector error {final}."
    if result == "overlap":
        text += " Distances are between convex bodies that enclose the links: they can overlap"
        text += " without contact."
    return text


def clearance(run: Trace, *, mobile: bool) -> float | None:
    """[m] smallest distance of pairs with the base (`mobile`) or within the arm; None without."""
    chosen = [(pair in run.meta.mobile_pairs) == mobile for pair in run.meta.pairs]
    return float(run.distances[:, chosen].min()) if any(chosen) else None


def path(run: Trace) -> float:
    """[m] length of the path of the base's centre."""
    return float(np.hypot(*np.diff(run.of("base_pose")[:, :2], axis=0).T).sum())


def largest(values: Array, at_least: float = 0.0) -> float:
    """The largest of `at_least` and of all values; NaN is ignored."""
    return float(np.fmax.reduce(values, axis=None, initial=at_least))


def jumps(run: Trace, quantity: str) -> dict[str, float]:
    """Largest change of a base acceleration from row to row, for linear and angular axes."""
    linear, angular = (np.abs(np.diff(each, axis=0)) for each in _by_axis(run, quantity))
    return {"linear_mps2": largest(linear), "angular_radps2": largest(angular)}


def sign_changes(values: Array, band: float) -> int:
    """Largest number of sign changes in a column of `values` (N, k); ignores values in ±`band`."""
    signs = (np.sign(column[np.abs(column) > band]) for column in values.T)
    return max((int((s[1:] != s[:-1]).sum()) for s in signs), default=0)


def _base_sign_changes(run: Trace, quantity: str) -> dict[str, int]:
    linear, angular = (sign_changes(each, _DEAD_BAND) for each in _by_axis(run, quantity))
    return {"linear": linear, "angular": angular}


def _by_axis(run: Trace, quantity: str) -> tuple[Array, Array]:
    """Values of a quantity of the base: (N, k) for its linear axes, (N, l) for its angular ones."""
    values = run.of(quantity)
    return values[:, ~run.angular], values[:, run.angular]


def _path_after_release(run: Trace) -> float | None:
    held = np.flatnonzero(run.of("people"))
    released = len(held) and held[-1] < len(run.t) - 1
    return path(run.rows(slice(held[-1], None))) if released else None


def _clear_since(run: Trace) -> float | None:
    near = np.flatnonzero((run.betas >= 1.0).any(axis=1))
    if not len(near):
        return 0.0
    return float(run.t[near[-1]]) if near[-1] < len(run.t) - 1 else None


def _force(run: Trace) -> Array:
    return np.linalg.norm(run.of("hand_force"), axis=1)


def _clear_force(run: Trace) -> float:
    near = np.flatnonzero((run.distances < NEAR).any(axis=1))
    return largest(_force(run)[: near[0] + 1 if len(near) else None])


def _joint_speed_share(run: Trace) -> float | None:
    limits = run.meta.joint_speeds
    return largest(np.abs(run.of("qd_m")) / limits) if limits else None


def _unsaturated_speed_share(run: Trace) -> float | None:
    limits, torques = run.meta.joint_speeds, run.meta.joint_torques
    if not (limits and torques):
        return None
    saturated = (np.abs(run.of("u_a")) > _SATURATED * np.array(torques)).any(axis=1)
    last = np.maximum.accumulate(np.where(saturated, run.t, -np.inf))
    free = run.t - last > _AFTER_SATURATION
    return largest((np.abs(run.of("qd_m")) / limits)[free])


def _percentile(run: Trace, q: float) -> float | None:
    durations = run.of("duration_us")
    return None if np.isnan(durations).any() else float(np.percentile(durations, q))


def _moves(run: Trace) -> Array:
    """(N, 3) [m, rad] displacement of the base's pose from the start."""
    return run.of("base_pose") - run.of("base_pose")[0]


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _first(run: Trace, holds: Array) -> float | None:
    """[s] first time at which a flag (N,) is true, or None."""
    return float(run.t[np.argmax(holds)]) if holds.any() else None


def _door_distance(run: Trace) -> Array:
    """(N,) [m] distance between the base and the door."""
    return run[f"d_{next(pair for pair in run.meta.pairs if pair.endswith(BODY))}_m"]


_ABOUT = {
    "min_distance_m": "Smallest distance of each link pair; a negative distance is an overlap of "
    "bodies.",
    "min_clearance_m": "Smallest distance of the pairs with the base.",
    "contacts": "Steps in which the arm touched the base.",
    "arm_min_clearance_m": "Smallest distance of the pairs within the arm.",
    "arm_contacts": "Steps in which the arm touched itself.",
    "floor_contacts": "Steps in which the arm touched the floor.",
    "ee_error_max_m": "Largest distance of the end-effector from its target.",
    "ee_error_final_m": "Final distance of the end-effector from its target.",
    "base_displacement_m": "Displacement of the base from start to end.",
    "base_path_m": "Length of the path of the base's centre.",
    "base_path_after_release_m": "Length of the base's path since the last release; null without a "
    "release, or if a person holds the robot at the end.",
    "base_speed_final_mps": "Final speed of the base's centre.",
    "base_yaw_rad": "Rotation of the base from start to end.",
    "activation_max": "Largest activation of the controller's avoidance rows; 0 without such rows.",
    "base_acceleration_jump_max": "Largest change of the commanded base acceleration in one step.",
    "base_acceleration_sign_changes": "Sign changes of the commanded base acceleration.",
    "avoidance_acceleration_jump_max": "Largest change of the base acceleration of avoidance in "
    "one step.",
    "avoidance_acceleration_sign_changes": "Sign changes of the base acceleration of avoidance.",
    "torque_jump_max_nm": "Largest change of a joint's torque or force in one step.",
    "torque_rate_sign_changes": "Largest number of sign changes of a torque's rate.",
    "hand_force_max_n": "Largest force of people on the end-effector, or of the end-effector on "
    "the door it holds.",
    "hand_force_clear_max_n": "As `hand_force_max_n`, until two bodies first come nearer than 10 "
    "mm.",
    "force_bound_min_n": "Smallest value during the run of the largest force of a person that the "
    "arm can resist, computed at 50 Hz; null if it was never computed.",
    "hand_speed_max_mps": "Largest speed of the end-effector.",
    "joint_speed_share_max": "Largest ratio of a joint's speed to its limit.",
    "joint_speed_share_unsaturated_max": "Largest ratio of a joint's speed to its limit, except "
    "while a torque is at its limit and for 0.1 s afterwards, because the arm cannot resist then.",
    "clear_since_s": "Time after which no pair is fully activated; 0 if none ever was, null if a "
    "pair is fully activated at the end.",
    "approach_speed_max_mps": "Speed of the approach to the base that requires the largest d_b.",
    "buffer_needed_m": "The d_b that the approach of `approach_speed_max_mps` requires; null if "
    "none suffices.",
    "solver_failures": "Steps with the fallback command.",
    "solver_given_up": "Steps in which the base's QP had no solution.",
    "stuck": "The end-effector's error at the end with its reasons, if the reference rests and the "
    "error exceeds 1 mm; otherwise null.",
    "left_way": "The largest tracking error with its reasons, if it exceeds 1 mm; otherwise null.",
    "fault_s": "Time of the first report of each fault of the readings.",
    "step_p50_us": "Median time of the controller in a step.",
    "step_p99_us": "99th percentile of the time of the controller in a step.",
    "door_angle_final_rad": "Final angle of the door.",
    "door_opened_80deg_at_s": "Time at which the door was first open by 80°; null if never.",
    "door_min_distance_m": "Smallest distance between base and door.",
    "door_contacts": "Steps in which the base touched the door.",
    "first_door_contact_s": "Time of the first contact of the base with the door; null if never.",
    "door_met_base_s": "Time of the first contact or overlap of the base with the door; null if "
    "never.",
    "radial_error_at_5s_rad": "Error of the estimated radial direction after 5 s; null in a "
    "shorter run.",
    "base_back_off_s": "Time at which the base is first 10 mm from its start; null if never.",
}
"""Descriptions of the figures, by their keys."""

_OF_RUN: dict[str, Callable[[Trace], Any]] = {
    "min_distance_m": lambda r: dict(
        zip(r.meta.pairs, r.distances.min(axis=0).tolist(), strict=True)
    ),
    "min_clearance_m": lambda r: clearance(r, mobile=True),
    "contacts": lambda r: int(r.of("in_contact").sum()),
    "arm_min_clearance_m": lambda r: clearance(r, mobile=False),
    "arm_contacts": lambda r: int(r.of("arm_in_contact").sum()),
    "floor_contacts": lambda r: int(r.of("floor_contact").sum()),
    "ee_error_max_m": lambda r: largest(r.of("ee_error")),
    "ee_error_final_m": lambda r: r.of("ee_error")[-1].item(),
    "base_displacement_m": lambda r: float(np.hypot(*_moves(r)[-1, :2])),
    "base_path_m": path,
    "base_path_after_release_m": _path_after_release,
    "base_speed_final_mps": lambda r: math.hypot(*r.of("base_velocity")[-1, ~r.angular]),
    "base_yaw_rad": lambda r: float(_moves(r)[-1, 2]),
    "activation_max": lambda r: largest(r.of("activation")),
    "base_acceleration_jump_max": lambda r: jumps(r, "base_acceleration"),
    "base_acceleration_sign_changes": lambda r: _base_sign_changes(r, "base_acceleration"),
    "avoidance_acceleration_jump_max": lambda r: jumps(r, "avoidance_acceleration"),
    "avoidance_acceleration_sign_changes": lambda r: _base_sign_changes(
        r, "avoidance_acceleration"
    ),
    "torque_jump_max_nm": lambda r: largest(np.abs(np.diff(r.of("u_a"), axis=0))),
    "torque_rate_sign_changes": lambda r: sign_changes(np.diff(r.of("u_a"), axis=0), _TORQUE_BAND),
    "hand_force_max_n": lambda r: largest(_force(r)),
    "hand_force_clear_max_n": _clear_force,
    "force_bound_min_n": lambda r: _finite(-largest(-r.of("force_bound"), -math.inf)),
    "hand_speed_max_mps": lambda r: largest(r.of("ee_speed")),
    "joint_speed_share_max": _joint_speed_share,
    "joint_speed_share_unsaturated_max": _unsaturated_speed_share,
    "clear_since_s": _clear_since,
    "approach_speed_max_mps": lambda r: r.buffer.approach_speed_max,
    "buffer_needed_m": lambda r: _finite(r.buffer.needed_max),
    "solver_failures": lambda r: int(r.of("solver_failures")[-1]),
    "solver_given_up": lambda r: int(r.of("given_up")[-1]),
    "stuck": lambda r: r.meta.stuck,
    "left_way": lambda r: r.meta.left_way,
    "fault_s": lambda r: r.meta.faults,
    "step_p50_us": lambda r: _percentile(r, 50),
    "step_p99_us": lambda r: _percentile(r, 99),
}

_OF_DOOR: dict[str, Callable[[Trace], Any]] = {
    "door_angle_final_rad": lambda r: float(r["door_angle_rad"][-1]),
    "door_opened_80deg_at_s": lambda r: _first(r, r["door_angle_rad"] >= OPENED),
    "door_min_distance_m": lambda r: float(_door_distance(r).min()),
    "door_contacts": lambda r: int(r["door_contact"].sum()),
    "first_door_contact_s": lambda r: _first(r, r["door_contact"] > 0),
    "door_met_base_s": lambda r: _first(r, (r["door_contact"] > 0) | (_door_distance(r) <= 0.0)),
    "radial_error_at_5s_rad": lambda r: next(
        iter(r["radial_error_rad"][r.t >= _ESTIMATE_AT].tolist()), None
    ),
    "base_back_off_s": lambda r: _first(r, np.hypot(*_moves(r)[:, :2].T) >= _BACKED_OFF),
}


FIGURES = {key: Figure(_ABOUT[key], of) for key, of in _OF_RUN.items()}
"""Figures of every run, by their keys."""
DOOR = {key: Figure(_ABOUT[key], of) for key, of in _OF_DOOR.items()}
"""Figures of the opening of a door."""


def extremes(run: Trace) -> dict[str, Any]:
    """Duration of a run, largest speeds of the base, and largest torque or force of each joint."""
    speeds = np.abs(run.of("base_velocity"))
    efforts = np.abs(run.of("u_a")).max(axis=0)
    return {
        "duration_s": float(run.t[-1] - run.t[0]),
        "base_speed_max_mps": float(np.hypot.reduce(speeds[:, ~run.angular], axis=1).max()),
        "base_turn_max_radps": largest(speeds[:, run.angular]),
        "effort_max": dict(zip(run.groups["u_a"], efforts.tolist(), strict=True)),
    }
