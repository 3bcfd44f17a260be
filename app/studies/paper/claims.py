"""The paper's claims of §4.2 and §4.3, each against what was measured here."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

import numpy as np

from app.studies.paper import density, guiding, refrigerator, thresholds, tracking
from app.studies.paper.experiments import Experiment, Run, Sources
from app.studies.paper.thresholds import Threshold

Array = np.ndarray

WHEEL_AXIS = tracking.WHEEL_AXIS
DIRECTIONS = {
    "wheel axis, left": WHEEL_AXIS,
    "wheel axis, right": Experiment("tracking", "dbb", (0.0, -0.68, 0.30), move=(0.0, 0.2, 0.0)),
    "side": tracking.DBB,
    "front": guiding.FRONT,
}
"""From where the hand comes; where it tracks it has to arrive, too."""


class Finding(NamedTuple):
    """What was measured for a claim.

    Attributes:
        measured: In words, with its number and the threshold.
        holds: Whether it agrees with the claim.
        values: The numbers; keys end in their unit.
        limits: What they were held against.
    """

    measured: str
    holds: bool
    values: dict[str, float | None]
    limits: tuple[Threshold, ...] = ()


class Claim(NamedTuple):
    """One claim of the paper.

    Attributes:
        section: Where the paper says it.
        figure: With which figure it is judged.
        paper: What it says, in our words.
        measure: Judges it.
        needs: The experiments that it is judged by.
    """

    section: str
    figure: str
    paper: str
    measure: Callable[[Sources], Finding]
    needs: tuple[Experiment, ...] = ()


def judge(claim: Claim, sources: Sources) -> dict[str, object]:
    """The claim as a row of the report."""
    finding = claim.measure(sources)
    return {
        "section": claim.section,
        "figure": claim.figure,
        "paper": claim.paper,
        "measured": finding.measured,
        "values": finding.values,
        "holds": finding.holds,
        "limits": [limit._asdict() for limit in dict.fromkeys(finding.limits)],
    }


def claims_of(figures: Iterable[str]) -> list[Claim]:
    """The claims that are judged with these figures."""
    wanted = set(figures)
    return [claim for claim in CLAIMS if claim.figure in wanted]


def at_most(name: str, key: str, value: float | None, limit: Threshold) -> Finding:
    """A number that may not be larger; one that is missing does not hold."""
    return _held(name, key, value, f"at most {limit}", lambda v: v <= limit.value, limit)


def at_least(name: str, key: str, value: float | None, limit: Threshold) -> Finding:
    """A number that may not be smaller; one that is missing does not hold."""
    return _held(name, key, value, f"at least {limit}", lambda v: v >= limit.value, limit)


def between(name: str, key: str, value: float | None, low: Threshold, high: Threshold) -> Finding:
    """A number that has to lie within two others; one that is missing does not hold."""
    text = f"{low.value:g} to {high}"
    return _held(name, key, value, text, lambda v: low.value <= v <= high.value, low, high)


def all_of(*findings: Finding) -> Finding:
    """Several findings of one claim, all of which have to hold."""
    values: dict[str, float | None] = {}
    for finding in findings:
        values |= finding.values
    return Finding(
        "; ".join(finding.measured for finding in findings),
        all(finding.holds for finding in findings),
        values,
        tuple(limit for finding in findings for limit in finding.limits),
    )


def _held(
    name: str,
    key: str,
    value: float | None,
    text: str,
    test: Callable[[float], bool],
    *limits: Threshold,
) -> Finding:
    if value is None or not np.isfinite(value):
        return Finding(f"{name}: never (asked: {text})", False, {key: None}, limits)
    number = f"{value:.3g} {limits[0].unit}".strip()
    found = f"{name} {number} (asked: {text})"
    return Finding(found, bool(test(value)), {key: float(value)}, limits)


def _clearance(run: Run) -> Finding:
    least = run.figures["min_clearance_m"]
    return at_least("least distance", "min_clearance_m", least, thresholds.CLEAR)


def _reaches(s: Sources) -> Finding:
    run = s.runs[tracking.DBB]
    error = run.figures["ee_error_final_m"]
    return all_of(
        at_most("final error", "ee_error_final_m", error, thresholds.REACHED), _clearance(run)
    )


def _moves_back(s: Sources) -> Finding:
    back = -forward_motion(s.runs[tracking.DBB])
    return at_least("base moves back", "backward_m", back, thresholds.MOVED)


def _cannot_reach(s: Sources) -> Finding:
    figures = s.runs[tracking.REPULSIVE].figures
    clearance, error = figures["min_clearance_m"], figures["ee_error_final_m"]
    return all_of(
        at_least("least distance", "min_clearance_m", clearance, thresholds.AVOIDED),
        at_least("final error", "ee_error_final_m", error, thresholds.MISSED),
    )


def _needed(s: Sources) -> Finding:
    with_it, without = (s.runs[e].figures["min_clearance_m"] for e in (tracking.DBB, tracking.NONE))
    name = "without avoidance nearer by"
    return at_least(name, "nearer_m", with_it - without, thresholds.NEARER)


def _guided(experiment: Experiment) -> Callable[[Sources], Finding]:
    def measure(s: Sources) -> Finding:
        run = s.runs[experiment]
        moved = run.figures["base_displacement_m"]
        return all_of(
            _clearance(run), at_least("base moves", "base_moves_m", moved, thresholds.MOVED)
        )

    return measure


def _backs_off_in_front(s: Sources) -> Finding:
    back = -forward_motion(s.runs[guiding.FRONT])
    return at_least("base moves back", "backward_m", back, thresholds.MOVED)


def _continuous_beta(s: Sources) -> Finding:
    steps = {name: beta_step(s.runs[e]) for name, e in guiding.DIRECTIONS.items()}
    return all_of(
        *(
            at_most(f"{name}: largest change", f"{name}_beta_step", step, thresholds.BETA_STEP)
            for name, step in steps.items()
        )
    )


def _smooth(method: str) -> Callable[[Sources], Finding]:
    def measure(s: Sources) -> Finding:
        directions = guiding.COMPARED[method].items()
        return all_of(*(_smooth_run(name, s.runs[e]) for name, e in directions))

    return measure


def _smooth_run(name: str, run: Run) -> Finding:
    jump = run.figures["avoidance_acceleration_jump_max"]
    signs = run.figures["avoidance_acceleration_sign_changes"]
    text = f"{name}: largest change in a control step"
    return all_of(
        at_most(text, f"{name}_jump_mps2", jump["linear_mps2"], thresholds.LINEAR_JUMP),
        at_most("and", f"{name}_jump_radps2", jump["angular_radps2"], thresholds.ANGULAR_JUMP),
        at_most(
            "sign changes", f"{name}_sign_changes", max(signs.values()), thresholds.SIGN_CHANGES
        ),
    )


def _smoother_than_repulsive(s: Sources) -> Finding:
    changes = {
        name: max(s.runs[e].figures["torque_rate_sign_changes"] for e in experiments.values())
        for name, experiments in guiding.COMPARED.items()
    }
    own = at_most(
        "sign changes of a torque's rate",
        "dbb_torque_rate_sign_changes",
        changes["dbb"],
        thresholds.TORQUE_SIGN_CHANGES,
    )
    other = changes["repulsive"]
    than = Finding(
        f"repulsive {other}", changes["dbb"] < other, {"repulsive_torque_rate_sign_changes": other}
    )
    return all_of(own, than)


def _door_collides(s: Sources) -> Finding:
    met = s.runs[refrigerator.NONE].figures["door_met_base_s"]
    return between(
        "door meets the base at", "door_met_base_s", met, thresholds.MET_FROM, thresholds.MET_TO
    )


def _door_avoided(s: Sources) -> Finding:
    figures = s.runs[refrigerator.DBB].figures
    never = figures["door_met_base_s"] is None
    touched = "never" if never else f"at {figures['door_met_base_s']:.3g} s"
    least = figures["door_min_distance_m"]
    return all_of(
        Finding(f"door meets the base: {touched}", never, {}),
        at_least("least distance", "door_min_distance_m", least, thresholds.AVOIDED),
    )


def _door_open(s: Sources) -> Finding:
    opened = s.runs[refrigerator.DBB].figures["door_opened_80deg_at_s"]
    return at_most("80° open at", "door_opened_80deg_at_s", opened, thresholds.OPENED_BY)


def _base_backs_off(s: Sources) -> Finding:
    run = s.runs[refrigerator.DBB]
    begins = run.figures["base_back_off_s"]
    yaw = run.base_poses[:, 2] - run.base_poses[0, 2]
    return all_of(
        between(
            "base backs off from",
            "base_back_off_s",
            begins,
            thresholds.BACKS_FROM,
            thresholds.BACKS_TO,
        ),
        at_least("moves back", "backward_m", -forward_motion(run), thresholds.MOVED),
        at_least("turns clockwise by", "clockwise_rad", float(-yaw.min()), thresholds.TURNED),
    )


def _incomplete_knowledge(s: Sources) -> Finding:
    figures = s.runs[refrigerator.DBB].figures
    error, force = figures["radial_error_at_5s_rad"], figures["hand_force_max_n"]
    size = None if error is None else abs(error)
    return all_of(
        at_most(
            "error of the radial direction after 5 s",
            "radial_error_rad",
            size,
            thresholds.RADIAL_ERROR,
        ),
        at_most("largest force of the hand", "hand_force_max_n", force, thresholds.HAND_FORCE),
    )


def _any_direction(s: Sources) -> Finding:
    return all_of(*(_direction(name, s.runs[e], e) for name, e in DIRECTIONS.items()))


def _direction(name: str, run: Run, experiment: Experiment) -> Finding:
    """Clear of the base, which makes room; at its target, if the hand is not led by a person."""
    key, figures = name.replace(", ", "_").replace(" ", "_"), run.figures
    moved, least = figures["base_displacement_m"], figures["min_clearance_m"]
    found = [
        at_least(f"{name}: base moves", f"{key}_base_moves_m", moved, thresholds.MOVED),
        at_least("least distance", f"{key}_min_clearance_m", least, thresholds.CLEAR),
    ]
    if experiment.scenario == "tracking":
        error = figures["ee_error_final_m"]
        found.append(at_most("final error", f"{key}_ee_error_final_m", error, thresholds.REACHED))
    return all_of(*found)


def _trade_off(s: Sources) -> Finding:
    table = density.trade_off(s)
    points = table["border"] == "points"
    jump, cost, count = (table[k][points] for k in ("jump_max_m", "find_p50_us", "points"))
    text = ", ".join(
        f"{n} points: {1e3 * j:.0f} mm, {c:.0f} µs"
        for n, j, c in zip(count, jump, cost, strict=True)
    )
    surface = float(table["jump_max_m"][-1])
    values = {
        "jump_sparse_m": float(jump[0]),
        "jump_dense_m": float(jump[-1]),
        "find_sparse_us": float(cost[0]),
        "find_dense_us": float(cost[-1]),
        "jump_surface_m": surface,
    }
    return Finding(
        f"largest jump and time of a search: {text}; as a surface {1e3 * surface:.0f} mm",
        bool(jump[-1] < jump[0] and cost[-1] > cost[0]),
        dict(values),
    )


def _fast_enough(s: Sources) -> Finding:
    figures = density.run_at_50_000(s)
    median, slowest = figures["step_p50_us"], figures["step_p99_us"]
    return all_of(
        at_most(
            "whole control step, 99th percentile", "step_p99_us", slowest, thresholds.CONTROL_STEP
        ),
        Finding(f"median {median:.0f} µs, on this machine", True, {"step_p50_us": median}),
    )


def forward_motion(run: Run) -> float:
    """[m] how far the base moved along its first heading."""
    first, last = run.base_poses[[0, -1]]
    return float((last - first)[:2] @ [np.cos(first[2]), np.sin(first[2])])


def beta_step(run: Run) -> float:
    """[-] largest change of an activation of a pair of L_m between two rows of the log."""
    betas = [run.log[f"beta_{pair}"] for pair in ("lm-lEE", "lm-l3")]
    return max(float(np.abs(np.diff(beta)).max()) for beta in betas)


CLAIMS = (
    Claim(
        "4.2.1",
        "fig12",
        "With the proposed method the hand reaches its target, without an "
        "error of its position, and a collision is avoided.",
        _reaches,
        (tracking.DBB,),
    ),
    Claim(
        "4.2.1",
        "fig11",
        "A force moves the base back as the hand approaches.",
        _moves_back,
        (tracking.DBB,),
    ),
    Claim(
        "4.2.1",
        "fig12",
        "The repulsive method avoids the collision, but the hand cannot reach its target.",
        _cannot_reach,
        (tracking.REPULSIVE,),
    ),
    Claim(
        "4.2.1",
        "fig12",
        "The avoidance is needed: the motion approaches the base.",
        _needed,
        (tracking.DBB, tracking.NONE),
    ),
    Claim(
        "4.2.2",
        "fig13",
        "Guided from the lateral direction, the robot avoids the collision by a force on its base.",
        _guided(guiding.LATERAL),
        (guiding.LATERAL,),
    ),
    Claim(
        "4.2.2",
        "fig13",
        "Guided from the front, it avoids the collision.",
        _guided(guiding.FRONT),
        (guiding.FRONT,),
    ),
    Claim(
        "4.2.2",
        "fig13",
        "Guided from the front, the base moves back.",
        _backs_off_in_front,
        (guiding.FRONT,),
    ),
    Claim(
        "4.2.2",
        "fig14",
        "The activation rises as the distance falls, and the task is inserted continuously.",
        _continuous_beta,
        guiding.NEEDS,
    ),
    Claim(
        "4.2.2",
        "fig13",
        "Collisions are avoided whatever the direction of approach, the one "
        "along which the base cannot move included.",
        _any_direction,
        tuple(DIRECTIONS.values()),
    ),
    Claim(
        "4.2.3",
        "fig18",
        "Without avoidance the door collides with the base at 30 s.",
        _door_collides,
        (refrigerator.NONE,),
    ),
    Claim("4.2.3", "fig18", "With it the door never collides.", _door_avoided, (refrigerator.DBB,)),
    Claim(
        "4.2.3", "fig17", "The door is opened completely at 40 s.", _door_open, (refrigerator.DBB,)
    ),
    Claim(
        "4.2.3",
        "fig17",
        "The base moves back and turns clockwise, beginning at 20 s.",
        _base_backs_off,
        (refrigerator.DBB,),
    ),
    Claim(
        "4.2.3",
        "fig17",
        "The adaptive controller opens the door with incomplete knowledge, by "
        "estimating its radial direction.",
        _incomplete_knowledge,
        (refrigerator.DBB,),
    ),
    Claim(
        "4.3",
        "fig15",
        "The desired accelerations of the base are smooth (the method as "
        "printed, its border a cloud of points).",
        _smooth("points"),
        guiding.NEEDS_POINTS,
    ),
    Claim(
        "4.3",
        "fig15",
        "The same with the border as a continuous surface, which is not the "
        "paper's but is used here.",
        _smooth("dbb"),
        guiding.NEEDS,
    ),
    Claim(
        "4.3",
        "fig15",
        "Command values are free from chattering, unlike the repulsive method's.",
        _smoother_than_repulsive,
        guiding.NEEDS_COMPARED,
    ),
    Claim(
        "4.3",
        "density",
        "The denser the border, the more continuous the acting point and the higher the cost.",
        _trade_off,
        (guiding.LATERAL,),
    ),
    Claim(
        "4.3", "density", "With 50,000 points a border the algorithm runs at 1 kHz.", _fast_enough
    ),
)
"""In the order of the paper."""
