"""The paper's claims of §4.2 and §4.3, and the measurements that confirm or refute them."""

from collections.abc import Callable, Iterable
from functools import partial
from typing import Any, NamedTuple

import numpy as np

from app.simulation.run import RunResult
from app.studies.paper import density
from app.studies.paper import experiments as paper
from app.studies.paper.experiments import Experiment, Sources
from app.studies.style import docstring_of


class Threshold(NamedTuple):
    """A bound of a measured number."""

    value: float
    unit: str  # empty for a plain number
    source: str  # the reason for this value

    def __str__(self) -> str:
        return f"{self.value:g} {self.unit}".strip()


REACHED = Threshold(0.001, "m", "Figure 12(b) shows no error; 1 mm is the resolution of its axis")
CLEAR = Threshold(0.05, "m", "Figure 10: at smaller distances the avoidance task is fully active")
AVOIDED = Threshold(0.03, "m", "chosen: a visible gap")
MISSED = Threshold(0.02, "m", "chosen: a tenth of the end-effector's path")
MOVED = Threshold(0.05, "m", "chosen: a base motion that is visible in Figure 11")
_TURN = "chosen after the first runs: more than 1 degree is a turn; the paper gives no number"
TURNED = Threshold(0.02, "rad", _TURN)
_STEP = (
    "chosen: four times the product of the end-effector's largest speed, the largest slope in "
    "Figure 10, and 10 ms"
)
BETA_STEP = Threshold(0.05, "in 10 ms", _STEP)
_TENTH = "chosen after the first runs: a tenth of the base's limit"
LINEAR_JUMP = Threshold(0.3, "m/s²", _TENTH)
ANGULAR_JUMP = Threshold(0.6, "rad/s²", _TENTH)
_SIGNS = "chosen after the first runs: one on entering the buffer, one on leaving, one at rest"
SIGN_CHANGES = Threshold(3, "", _SIGNS)
_STEP_OF_LIMIT = "chosen: a tenth of the arm's torque-rate limit in a control step"
TORQUE_STEP = Threshold(0.1, "N m", _STEP_OF_LIMIT)
MET_FROM = Threshold(25.0, "s", "§4.2.3: at 30 s, with a tolerance of 5 s")
MET_TO = MET_FROM._replace(value=35.0)
OPENED_BY = Threshold(40.0, "s", "§4.2.3: open at 40 s")
BACKS_FROM = Threshold(15.0, "s", "§4.2.3: from 20 s on, with a tolerance of 5 s")
BACKS_TO = BACKS_FROM._replace(value=25.0)
DOOR_FORCE = Threshold(50.0, "N", "chosen: a person opens such a door with less force")
RADIAL_ERROR = Threshold(0.0873, "rad", "chosen: 5 degrees; the initial error is 30 degrees")
CONTROL_STEP = Threshold(1000.0, "µs", "§4.1: the arm is controlled at 1 kHz")


class Finding(NamedTuple):
    """One measurement for a claim."""

    measured: str  # a text with the number and the bound
    holds: bool
    values: dict[str, float | None]  # keys end in the unit; None for a missing or infinite number
    limits: tuple[Threshold, ...] = ()


def compare(
    text: str,
    key: str,
    value: float | None,
    *,
    low: Threshold | None = None,
    high: Threshold | None = None,
) -> Finding:
    """Compare a number with one or two bounds; a missing or infinite number violates them.

    The finding's text begins with `text`, before the number; `key` ends in the unit of the number.
    """
    limits = tuple(limit for limit in (low, high) if limit)
    required = f"at {'least' if low else 'most'} {limits[0]}"
    if low and high:
        required = f"{low.value:g} to {high}"
    if value is None or not np.isfinite(value):
        return Finding(f"{text}: never (required: {required})", False, {key: None}, limits)
    holds = (not low or value >= low.value) and (not high or value <= high.value)
    number = f"{value:.3g} {limits[0].unit}".strip()
    measured = f"{text} {number} (required: {required})"
    return Finding(measured, bool(holds), {key: float(value)}, limits)


Findings = Iterable[Finding]  # a claim holds if all of its findings hold
Measure = Callable[..., Findings]


class Claim(NamedTuple):
    """A claim of the paper."""

    section: str
    figure: str  # name of the figure with which `dbb reproduce` judges the claim
    paper: str  # the claim in this project's words
    needs: tuple[Experiment, ...]
    measure: Measure  # its arguments are the sources, and the run of each needed experiment

    def judge(self, sources: Sources) -> dict[str, Any]:
        """Measure the claim; return its entry in `metrics.json`."""
        findings = list(self.measure(sources, *(sources.runs[e] for e in self.needs)))
        limits = dict.fromkeys(limit for finding in findings for limit in finding.limits)
        return {
            "section": self.section,
            "figure": self.figure,
            "paper": self.paper,
            "measured": "; ".join(finding.measured for finding in findings),
            "values": {k: value for finding in findings for k, value in finding.values.items()},
            "holds": all(finding.holds for finding in findings),
            "limits": [limit._asdict() for limit in limits],
        }


def claim(section: str, figure: str, *needs: Experiment) -> Callable[[Measure], Claim]:
    """Decorator that makes a `Claim`: a function measures it, and the docstring is its text."""
    return lambda measure: Claim(section, figure, docstring_of(measure), needs, measure)


def beta_step(run: RunResult) -> float:
    """[-] largest change of an activation in 𝓛_m between successive rows, 10 ms apart."""
    betas = [run.trace[f"beta_{pair}"] for pair in ("lm-lEE", "lm-l3")]
    return max(float(np.abs(np.diff(beta)).max()) for beta in betas)


def _figure(text: str, key: str, run: RunResult, of: str = "", **bounds: Threshold) -> Finding:
    return compare(text, of + key, run.figures[key], **bounds)


_clear = partial(_figure, "smallest distance", "min_clearance_m", low=CLEAR)
_error = partial(_figure, "final error", "ee_error_final_m")


def _back(run: RunResult, text: str = "base moves back") -> Finding:
    first, last = run.trace.of("base_pose")[[0, -1]]
    ahead = (last - first)[:2] @ [np.cos(first[2]), np.sin(first[2])]  # [m] along the first heading
    return compare(text, "backward_m", -float(ahead), low=MOVED)


def _moved(run: RunResult, text: str = "base moves", of: str = "") -> Finding:
    return compare(text, f"{of}base_moves_m", run.figures["base_displacement_m"], low=MOVED)


def _smooth(*runs: RunResult) -> Findings:
    for name, run in zip(paper.GUIDING["dbb"], runs, strict=True):
        jump = run.figures["avoidance_acceleration_jump_max"]
        signs = max(run.figures["avoidance_acceleration_sign_changes"].values())
        text, linear = f"{name}: largest change in a control step", jump["linear_mps2"]
        yield compare(text, f"{name}_jump_mps2", linear, high=LINEAR_JUMP)
        yield compare("and", f"{name}_jump_radps2", jump["angular_radps2"], high=ANGULAR_JUMP)
        yield compare("sign changes", f"{name}_sign_changes", signs, high=SIGN_CHANGES)


DIRECTIONS = {
    "wheel axis, left": paper.WHEEL_AXIS,
    "wheel axis, right": paper.WHEEL_AXIS_RIGHT,
    "side": paper.TRACKING,
    "front": paper.FRONT,
}
"""Runs by the direction of the approach."""


@claim("4.2.1", "fig12", paper.TRACKING)
def reached(_: Sources, run: RunResult) -> Findings:
    """With the proposed method the end-effector reaches its target without a position error, and a
    collision is avoided.
    """
    return _error(run, high=REACHED), _clear(run)


@claim("4.2.1", "fig11", paper.TRACKING)
def moved_back(_: Sources, run: RunResult) -> Findings:
    """A force moves the base back as the end-effector approaches."""
    yield _back(run)


@claim("4.2.1", "fig12", paper.TRACKING_REPULSIVE)
def not_reached(_: Sources, run: RunResult) -> Findings:
    """The repulsive method avoids the collision, but the end-effector cannot reach its target."""
    return _clear(run, low=AVOIDED), _error(run, low=MISSED)


@claim("4.2.2", "fig13", paper.LATERAL)
def guided_laterally(_: Sources, run: RunResult) -> Findings:
    """Guided from the lateral direction, the robot avoids the collision by a force on its base."""
    return _clear(run), _moved(run)


@claim("4.2.2", "fig13", paper.FRONT)
def guided_from_the_front(_: Sources, run: RunResult) -> Findings:
    """Guided from the front, the robot avoids the collision."""
    return _clear(run), _moved(run)


@claim("4.2.2", "fig13", paper.FRONT)
def guided_back(_: Sources, run: RunResult) -> Findings:
    """Guided from the front, the base moves back."""
    yield _back(run)


@claim("4.2.2", "fig14", *paper.GUIDING["dbb"].values())
def continuous(_: Sources, *runs: RunResult) -> Findings:
    """While the distance falls, the activation has no jump: the task is inserted continuously."""
    for name, run in zip(paper.GUIDING["dbb"], runs, strict=True):
        text, key = f"{name}: largest change", f"{name}_beta_step"
        yield compare(text, key, beta_step(run), high=BETA_STEP)


@claim("4.2.2", "fig13", *DIRECTIONS.values())
def from_any_direction(_: Sources, *runs: RunResult) -> Findings:
    """Collisions are avoided for every direction of approach, including the wheel axis, along which
    the base cannot move.
    """
    for (name, experiment), run in zip(DIRECTIONS.items(), runs, strict=True):
        of = name.replace(", ", "_").replace(" ", "_") + "_"
        yield _moved(run, f"{name}: base moves", of)
        yield _clear(run, of)
        if experiment.scenario.name == "tracking":  # no person guides
            yield _error(run, of, high=REACHED)


@claim("4.2.1", "departures", paper.AS_PRINTED[0])
def reached_as_printed(_: Sources, run: RunResult) -> Findings:
    """The controller with the printed (26) to (29) moves the base back, and the end-effector
    reaches its target.
    """
    return _error(run, high=REACHED), _clear(run, low=AVOIDED), _back(run)


@claim("4.2.2", "departures", *paper.AS_PRINTED[2:])
def guided_as_printed(_: Sources, *runs: RunResult) -> Findings:
    """During guiding, the controller with the printed (26) to (29) avoids collisions by a force on
    the base.
    """
    for name, run in zip(paper.GUIDING["dbb"], runs, strict=True):
        yield _clear(run, f"{name}_", low=AVOIDED)
        yield _moved(run, f"{name}: base moves", f"{name}_")


@claim("4.2.3", "fig18", paper.DOOR_NONE)
def door_met(_: Sources, run: RunResult) -> Findings:
    """Without avoidance the door collides with the base at 30 s."""
    yield _figure("door meets the base at", "door_met_base_s", run, low=MET_FROM, high=MET_TO)


@claim("4.2.3", "fig18", paper.DOOR)
def door_avoided(_: Sources, run: RunResult) -> Findings:
    """With avoidance the door never collides."""
    met = run.figures["door_met_base_s"]
    met_at = "never" if met is None else f"at {met:.3g} s"
    yield Finding(f"door meets the base: {met_at}", met is None, {})
    yield _figure("smallest distance", "door_min_distance_m", run, low=AVOIDED)


@claim("4.2.3", "fig17", paper.DOOR)
def door_opened(_: Sources, run: RunResult) -> Findings:
    """In the experiment (Figure 19a), the door is opened completely at 40 s."""
    yield _figure("80° open at", "door_opened_80deg_at_s", run, high=OPENED_BY)


@claim("4.2.3", "fig17", paper.DOOR)
def base_backs_off(_: Sources, run: RunResult) -> Findings:
    """The base moves back and turns clockwise; in the experiment (Figure 19a) from 20 s on."""
    yaw = run.trace.of("base_pose")[:, 2]
    yield _figure("base begins to move at", "base_back_off_s", run, low=BACKS_FROM, high=BACKS_TO)
    yield _back(run, "moves back")
    yield compare("turns clockwise by", "clockwise_rad", yaw[0] - yaw.min(), low=TURNED)


@claim("4.2.3", "fig17", paper.DOOR)
def incomplete_knowledge(_: Sources, run: RunResult) -> Findings:
    """The adaptive controller opens the door with incomplete knowledge, by an estimate of the
    door's radial direction.
    """
    error = run.figures["radial_error_at_5s_rad"]
    text, size = "error of the radial direction after 5 s", None if error is None else abs(error)
    yield compare(text, "radial_error_rad", size, high=RADIAL_ERROR)
    yield _figure("largest force of the end-effector", "hand_force_max_n", run, high=DOOR_FORCE)


@claim("4.3", "fig15", *paper.GUIDING["points"].values())
def smooth_on_points(_: Sources, *runs: RunResult) -> Findings:
    """The desired accelerations of the base are smooth. (This row has a border of points, as in
    the paper.)
    """
    return _smooth(*runs)


@claim("4.3", "fig15", *paper.GUIDING["dbb"].values())
def smooth_on_the_surface(_: Sources, *runs: RunResult) -> Findings:
    """The desired accelerations of the base are smooth. (This row has the border as a continuous
    surface, the default of this project.)
    """
    return _smooth(*runs)


@claim("4.3", "fig12", paper.TRACKING, paper.TRACKING_REPULSIVE)
def smoother_than_repulsive(_: Sources, *runs: RunResult) -> Findings:
    """The joint torques do not chatter; those of the repulsive method do."""
    key, text = "torque_jump_max_nm", "largest change of a torque in a control step"
    for run, of, bound in zip(runs, ("", "repulsive_"), ("high", "low"), strict=True):
        method, signs = of.replace("_", " method: "), run.figures["torque_rate_sign_changes"]
        yield _figure(method + text, key, run, of, **{bound: TORQUE_STEP})
        values = {of + "torque_rate_sign_changes": signs}
        yield Finding(f"{method}sign changes of a torque's rate {signs}", True, values)


@claim("4.3", "density", paper.LATERAL)
def trade_off(s: Sources, _: RunResult) -> Findings:
    """A denser border makes the acting point more continuous, at a higher cost."""
    table = density.trade_off(s)
    *jump, surface = table["jump_max_m"].tolist()
    cost, count = (table[k][:-1].tolist() for k in ("find_p50_us", "points"))
    borders = ", ".join(
        f"{n} points: {1e3 * j:.0f} mm, {c:.0f} µs"
        for n, j, c in zip(count, jump, cost, strict=True)
    )
    jumps = {"jump_sparse_m": jump[0], "jump_dense_m": jump[-1], "jump_surface_m": surface}
    costs = {"find_sparse_us": cost[0], "find_dense_us": cost[-1]}
    text = f"largest jump and median time of a search: {borders}; jump on the surface: "
    holds = jump[-1] < jump[0] and cost[-1] > cost[0]
    yield Finding(f"{text}{1e3 * surface:.0f} mm", holds, {**jumps, **costs})


@claim("4.3", "density")
def fast_enough(s: Sources) -> Findings:
    """With 50,000 points in each border the algorithm runs at 1 kHz."""
    figures = density.run_at_50_000(s)
    median, text = figures["step_p50_us"], "99th percentile of a control step on this machine"
    yield compare(text, "step_p99_us", figures["step_p99_us"], high=CONTROL_STEP)
    yield Finding(f"median {median:.0f} µs", True, {"step_p50_us": median})


CLAIMS = [each for each in list(globals().values()) if isinstance(each, Claim)]
"""All claims, in the order of the report."""


def claims_of(figures: Iterable[str]) -> list[Claim]:
    """The claims that `dbb reproduce` judges with the figures of these names."""
    names = set(figures)
    return [claim for claim in CLAIMS if claim.figure in names]
