"""The results of a study: the summary for `study.json`, the pictures, and the `report.html`."""

import math
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from itertools import pairwise
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.colors import Normalize
from matplotlib.figure import Figure

from app.config import parameter
from app.simulation.session import DT
from app.simulation.trace.words import number_text
from app.studies.page import Grid, Part, label, page_html
from app.studies.pulls import envelope as fit
from app.studies.pulls.case import COLUMNS, entered_buffer, failed, met_base, met_itself, too_fast
from app.studies.pulls.envelope import FORCE, Envelope, exerted, tally
from app.studies.pulls.parameters import FAULTS, PARAMETERS, StudyParameters
from app.studies.runs import Row
from app.studies.style import INK, SOFT, TARGET, new_panels, picture, pictures_in

_FORCES = (0.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, math.inf)  # [N] limits of intervals
_DISTRIBUTED = (
    *("hand_force_max_n", "hand_force_clear_max_n", "hand_speed_max_mps"),
    *("joint_speed_share_max", "joint_speed_share_unsaturated_max", "base_path_after_release_m"),
    *("min_clearance_m", "arm_min_clearance_m", "ee_error_final_m"),
)
"""Results whose quantiles are in the summary."""
_QUANTILES = (0.0, 0.01, 0.05, 0.5, 0.95, 1.0)
Rows = Sequence[Row]
Events = Mapping[str, Callable[[Row], object]]  # by name: whether a case has the event
_INCIDENTS: Events = {
    "contact": lambda row: row.get("contacts"),
    "bodies_overlap": met_base,
    "arm_contact": lambda row: row.get("arm_contacts"),
    "arm_bodies_overlap": met_itself,
    "floor_contact": lambda row: row.get("floor_contacts"),
    "solver_failure": lambda row: row.get("solver_failures"),
    "nan": lambda row: row["nan"],
    "error": lambda row: row["error"],
}
_FAULTY: Events = {
    "without_readings": lambda row: row.get("fault_stale_s") is not None,
    "too_fast": too_fast,
    "too_fast_without_floor_contact": lambda row: too_fast(row) and not row["floor_contacts"],
    "too_fast_with_readings": lambda row: (
        too_fast(row) and not row["floor_contacts"] and row.get("fault_stale_s") is None
    ),
}
"""Events after faulty readings; each of the last two includes only cases of the one before it."""
_BY_FORCE = ("failed", "entered_buffer", "bodies_overlap", "contact", "arm_bodies_overlap")
_BY_KIND = ("failed", "bodies_overlap", "arm_bodies_overlap", "solver_failure")
_COLUMNS = {
    "case": "case",
    "kind": "from",
    "hand_force_clear_max_n": "force before 10 mm [N]",
    "hand_force_max_n": "largest force [N]",
    "speed_mps": "speed [m/s]",
    "hand_stiffness_npm": "spring [N/m]",
    "hand_mass_kg": "hand [kg]",
    "hand_f_max_n": "limit of the spring [N]",
    "release_at_s": "release [s]",
    "base_delay_s": "delay [s]",
    "v_max_mps": "v_max [m/s]",
    "slip": "slip",
    "mass_error": "mass error",
    "encoder_noise_rad": "noise [rad]",
    "min_clearance_m": "smallest distance [m]",
    "contacts": "contact [ms]",
    "arm_min_clearance_m": "within the arm [m]",
    "arm_contacts": "arm contact [ms]",
    "solver_failures": "steps with the fallback command",
}
"""Titles of the columns in the table of failures; a step with a contact counts as 1 ms."""
_LARGEST = 0.3  # [m] end of the axes of distance
_ERRORS = 1e-5, 1.0  # [m] ends of the axes of errors
_INSIDE, _OUTSIDE = "#0072B2", "#E69F00"
_MARKS: dict[str, tuple[Callable[[Row], bool], dict[str, Any]]] = {
    "arm met base": (met_base, {"marker": "x", "s": 44, "c": TARGET}),
    "arm met itself": (met_itself, {"marker": "+", "s": 54, "c": "#882E72"}),
    "fallback command, NaN or error": (failed, {"marker": "^", "s": 34, "c": "#D55E00"}),
}
"""Markers of failed cases by reason; a case gets that of the first reason that applies to it."""


def summary_of(rows: Rows, parameters: StudyParameters, d_b: float) -> tuple[dict, Envelope]:
    """The summary of at least one row for `study.json`, and the fitted envelope; `d_b` is in m."""
    stated, fitted = Envelope.stated(), fit.fit_envelope(rows, parameters.ranges)
    within = [row for row in rows if stated.holds(row)]
    whole, entered = tally(rows), partial(entered_buffer, d_b=d_b)
    events = {**_INCIDENTS, "failed": failed, "entered_buffer": entered}
    by_force, by_kind = ({n: events[n] for n in names} for names in (_BY_FORCE, _BY_KIND))
    summary = {
        "cases": len(rows),
        "failed": whole["failed"],
        "failed_rate_bound_95": whole["rate_bound_95"],
        **_counts(rows, _INCIDENTS),
        **_counts(rows, _FAULTY),
        "redraws": sum(row["redraws"] for row in rows),
        "entered_buffer_share": sum(map(entered, rows)) / len(rows),
        "released": sum(row["release_at_s"] is not None for row in rows),
        "regrasped": sum(row["regrasp_at_s"] is not None for row in rows),
        **{column: _quantiles(rows, column) for column in _DISTRIBUTED},
        "by_force": [_of_force(rows, low, high, by_force) for low, high in pairwise(_FORCES)],
        "by_kind": {
            kind: _counts_and_distance([row for row in rows if row["kind"] == kind], by_kind)
            for kind in sorted({row["kind"] for row in rows})
        },
        "faults": {name: _reported(rows, name) for name in FAULTS},
        "envelope": {
            **fitted.model_dump(mode="json"),
            "inside": tally([row for row in rows if fitted.holds(row)]),
            "inside_by_halves": fit.tally_by_halves(rows, parameters.ranges),
        },
        "stated_envelope": {
            "inside": tally(within),
            **{f"inside_{key}": value for key, value in _counts(within, _INCIDENTS).items()},
            "outside": tally([row for row in rows if not stated.holds(row)]),
        },
        "failures": [row["case"] for row in rows if failed(row)],
    }
    return summary, fitted


def _reported(rows: Rows, name: str) -> dict[str, int]:
    """Count the cases with a fault, those with a report of it, and those with a report at most
    0.2 s after its beginning. A fault begins at the control step nearest to `fault_at_s`,
    `stated_period` at 0. A case whose first report is earlier counts as one without a report.
    """
    none, column, report = parameter(PARAMETERS[name]).default, COLUMNS[name], FAULTS[name]
    faulty = [row for row in rows if row.get(column, none) != none]
    delays = [
        row[f"fault_{report}_s"] - (0.0 if name == "stated_period" else row["fault_at_s"])
        for row in faulty
        if row.get(f"fault_{report}_s") is not None
    ]
    reported, timely = (sum(-DT < each <= last for each in delays) for last in (math.inf, 0.2))
    return {"cases": len(faulty), "reported": reported, "within_200_ms": timely}


def _of_force(rows: Rows, low: float, high: float, events: Events) -> dict[str, Any]:
    """Results of the cases whose force (`exerted`) is at least `low` and below `high` [N]."""
    here = [row for row in rows if low <= exerted(row) < high]
    return {
        "from_n": low,
        "to_n": high if math.isfinite(high) else None,
        **_counts_and_distance(here, events),
        "hand_speed_max_mps": max(_known(here, "hand_speed_max_mps"), default=None),
    }


def _counts_and_distance(rows: Rows, events: Events) -> dict[str, Any]:
    smallest = min(_known(rows, "min_clearance_m"), default=None)
    return {"cases": len(rows), **_counts(rows, events), "least_clearance_m": smallest}


def _counts(rows: Rows, events: Events) -> dict[str, int]:
    return {name: sum(bool(happened(row)) for row in rows) for name, happened in events.items()}


def _known(rows: Rows, column: str) -> list[float]:
    return [row[column] for row in rows if row.get(column) is not None]


def _quantiles(rows: Rows, column: str) -> dict[str, float] | None:
    if not (values := _known(rows, column)):
        return None
    found = np.quantile(values, _QUANTILES).tolist()
    return {f"{100 * q:g}_%": value for q, value in zip(_QUANTILES, found, strict=True)}


@picture("envelope", "Envelope of safety")
def draw_envelope(rows: Rows, envelope: Envelope, _: float) -> Figure:
    """Each point is a case; cases that stopped with an error are missing. The blue area is the
    envelope that is fitted to all cases. Its force is at most 0.9 times the smallest force of the
    cases that failed or in which the arm came nearer to the base than 10 mm.
    """
    figure, axes = new_panels(4.6)
    known = [row for row in rows if row.get(FORCE) is not None]
    low, high = envelope.speed
    axes.fill_between((low, high), envelope.force, color="#DCEBF5", zorder=0)
    axes.hlines(envelope.force, low, high, color=INK, linewidth=2, zorder=3)

    def scatter(shown: list[Row], **style: Any) -> PathCollection:
        speeds, forces = ([row[key] for row in shown] for key in ("speed_mps", FORCE))
        return axes.scatter(speeds, forces, **style)

    good = [row for row in known if not failed(row)]
    colours = {"c": [row["min_clearance_m"] for row in good], "cmap": "viridis"}
    look = {"norm": Normalize(0.0, 0.15), "s": 16, "linewidths": 0.4, "edgecolors": "white"}
    points = scatter(good, **colours, **look, zorder=4)
    text = "smallest distance, arm to base [m]"
    figure.colorbar(points, ax=axes, extend="max", pad=0.01, label=text)
    bad = [row for row in known if failed(row)]
    for name, (rule, marker) in _MARKS.items():
        scatter([row for row in bad if rule(row)], zorder=5, label=name, **marker)
        bad = [row for row in bad if not rule(row)]
    figure.legend(loc="outside upper center", ncols=len(_MARKS))
    axes.set(xlabel="speed of the person's hand [m/s]", xlim=(low - 0.02, high + 0.02))
    axes.set_ylabel("largest force before a distance of 10 mm [N]")
    axes.set_ylim(0.0, 1.15 * max(*_known(rows, FORCE), envelope.force, 1.0))
    return figure


@picture("clearance", "Smallest distance between arm and base")
def draw_clearance(rows: Rows, envelope: Envelope, d_b: float) -> Figure:
    """The smallest true distance between the convex bodies of arm and base in each run. The red
    line is at 0 m, the grey line at d_b. Left: number of cases inside and outside the envelope
    that is fitted to them. Right: each case, by the direction of its start; failed cases are red.
    """
    figure, (left, right) = new_panels(4.2, 1, 2, width_ratios=(3, 2))
    low = min([0.0, *_known(rows, "min_clearance_m")])
    bins = np.arange(np.floor(low / 0.01) * 0.01, _LARGEST + 0.01, 0.01)
    inside, outside = (
        _known([row for row in rows if envelope.holds(row) is held], "min_clearance_m")
        for held in (True, False)
    )
    clipped = [np.clip(part, bins[0], bins[-1]) for part in (inside, outside)]
    labels = [f"inside, {len(inside)}", f"outside, {len(outside)}"]
    left.hist(clipped, list(bins), stacked=True, color=[_INSIDE, _OUTSIDE], label=labels)
    left.axvline(0.0, color=TARGET, linewidth=1.2)
    left.axvline(d_b, color=SOFT, linewidth=1.2)
    left.set_xlabel("smallest distance between arm and base [m]; the last bar has no upper limit")
    left.set_ylabel("cases")
    left.legend(title="envelope", loc="upper center")
    right.axvline(0.0, color=TARGET, linewidth=1.2)
    _by_kind(right, rows, "min_clearance_m", (low, _LARGEST))
    right.set(xlabel="smallest distance [m]", xlim=(low - 0.01, _LARGEST))
    return figure


@picture("errors", "Final error of the end-effector")
def draw_errors(rows: Rows, *_: object) -> Figure:
    """The distance of the end-effector from its target at the end of each run, 0 if no person then
    holds it. If the base cannot move away in the direction of a pull, such as down onto the base,
    the arm resists the pull: the end-effector then intentionally ends far from the target.
    """
    figure, (left, right) = new_panels(3.8, 1, 2, width_ratios=(3, 2))
    values = np.clip(_known(rows, "ee_error_final_m"), *_ERRORS)
    left.hist(values, bins=list(np.geomspace(*_ERRORS, 41)), color=_INSIDE)
    left.set_xlabel("final distance [m]; the outer bars have the values beyond the axis")
    left.set(xscale="log", ylabel="cases")
    _by_kind(right, rows, "ee_error_final_m", _ERRORS)
    right.set(xscale="log", xlim=_ERRORS, xlabel="final distance [m]")
    return figure


def _by_kind(axes: Axes, rows: Rows, column: str, ends: tuple[float, float]) -> None:
    """Draw the known values of each kind of cases as a row of points, clipped to `ends`."""
    known = [row for row in rows if row.get(column) is not None]
    kinds = sorted({row["kind"] for row in known}, reverse=True)
    for y, kind in enumerate(kinds):
        here = [row for row in known if row["kind"] == kind]
        spread = y + 0.5 * (np.arange(len(here)) % 7 - 3) / 6
        colours = [TARGET if failed(row) else _INSIDE for row in here]
        values = np.clip([row[column] for row in here], *ends)
        axes.scatter(values, spread, c=colours, s=10, linewidths=0)
    axes.set_yticks(range(len(kinds)), kinds, fontsize=9)
    axes.grid(visible=False, axis="y")


PICTURES = pictures_in(globals())
"""Pictures of the report; `draw` takes the rows, the fitted envelope, and the robot's d_b [m]."""


def report_html(
    rows: Rows,
    parameters: StudyParameters,
    summary: dict,
    envelope: Envelope,
    pngs: dict[str, bytes],
) -> str:
    """The HTML of the report, with the results of `summary_of` and a PNG for each of `PICTURES`."""
    drawn = ((name.replace("_", " "), v) for name, v in parameters.ranges if isinstance(v, tuple))
    intervals = ", ".join(f"{name} {_interval(value)}" for name, value in drawn)
    inside = " Only pulls inside the stated envelope were drawn." if parameters.inside else ""
    lead = (
        "A person pulls the end-effector towards the base or along it, from random starts on all "
        f"sides of the base. Robot {parameters.robot}, plant {parameters.physics}, seed "
        f"{parameters.seed}. Ranges in SI units: {intervals}. The distributions are uniform, for "
        "the stiffness on a logarithmic scale. The probability of one to three of the faults "
        f"{', '.join(FAULTS)} is {_percent(parameters.ranges.faulty)}. The probability that the "
        f"person releases the end-effector early is {_percent(parameters.ranges.released)}, and "
        "the probability of a new grasp after a release is "
        f"{_percent(parameters.ranges.regrasped)}.{inside}"
    )
    verdict, forces = outcome(summary)
    both = [envelope.model_dump(), Envelope.stated().model_dump()]
    body = [[name.replace("_", " "), *(_interval(each[name]) for each in both)] for name in both[0]]
    head = ["largest force, intervals [SI units]", "fitted to these cases", "the project states"]
    parts = [
        verdict,
        *(Part(p.title, name, [p.caption], pngs[name]) for name, p in PICTURES.items()),
        Part("The envelope", tables=[Grid(head, body, numbers=True)]),
        forces,
        _counted("By the direction of the start", "from", summary["by_kind"]),
        _counted("Faults and their reports", "fault", summary["faults"]),
        _failures(rows),
    ]
    return page_html(f"{summary['cases']:,} random pulls, {parameters.controller}", lead, parts)


def outcome(summary: Mapping[str, Any]) -> tuple[Part, Part]:
    """The results of the cases as a text, and as a table by the exerted force."""
    s, halves = summary, summary["envelope"]["inside_by_halves"]
    force, speed, distance = (
        {quantile: number_text(value) for quantile, value in (s[key] or {}).items()}
        for key in ("hand_force_max_n", "hand_speed_max_mps", "min_clearance_m")
    )
    lines = [
        f"{s['failed']} of {s['cases']} cases failed. In {s['contact']} runs the arm touched the "
        f"base in the plant. In {s['bodies_overlap']} runs it touched the base, or the convex "
        f"bodies of arm and base, which enclose the links, met. In {s['arm_contact']} runs the arm "
        f"touched itself; in {s['arm_bodies_overlap']} runs it touched itself, or two of its "
        f"convex bodies met. {s['solver_failure']} runs had steps with the fallback command, "
        f"{s['nan']} runs had NaN, and {s['error']} runs stopped with an error."
    ]
    if force:
        lines.append(
            f"The largest force of the person in a run was {force['0_%']} to {force['100_%']} N "
            f"(median {force['50_%']} N). The largest speed of the end-effector was "
            f"{speed['100_%']} m/s. In {_percent(s['entered_buffer_share'])} of the runs the arm "
            "entered the buffer of the base."
        )
    if distance:
        lines.append(
            f"The smallest distance between arm and base was {distance['0_%']} m. It was at least "
            f"{distance['50_%']} m in half of the runs, and {distance['5_%']} m in 95 % of them."
        )
    lines.append(
        f"Of {halves['cases']} cases inside an envelope that was fitted to other cases, "
        f"{halves['failed']} failed: the failure rate is below "
        f"{_percent(halves['rate_bound_95'])} with 95 % confidence."
        if halves["cases"]
        else "No case is inside an envelope that was fitted to other cases."
    )
    inside, outside = (s["stated_envelope"][name] for name in ("inside", "outside"))
    lines.append(
        f"Inside the envelope that the project states, {inside['failed']} of {inside['cases']} "
        f"cases failed: the failure rate is below {_percent(inside['rate_bound_95'])} with 95 % "
        f"confidence. Outside, {outside['failed']} of {outside['cases']} cases failed."
        if inside["cases"]
        else "No case is inside the envelope that the project states."
    )
    forces = {}
    for counts in summary["by_force"]:
        low, high = counts["from_n"], counts["to_n"]
        name = f"from {low:g}" if high is None else f"{low:g} to {high:g}"
        forces[name] = {key: v for key, v in counts.items() if key not in ("from_n", "to_n")}
    table = _counted("By the exerted force", "force before 10 mm [N]", forces)
    return Part(text=lines), table


def _counted(title: str, group: str, found: Mapping[str, Mapping[str, Any]]) -> Part:
    """A table of the numbers `found` of each group; `group` is the title of the first column."""
    head = [group, *map(label, next(iter(found.values())))]
    body = [[name, *map(number_text, counts.values())] for name, counts in found.items()]
    return Part(title, tables=[Grid(head, body, numbers=True)])


def _failures(rows: Rows) -> Part:
    """The table of failed cases, at most the 200 with the smallest forces."""
    if not (bad := sorted(filter(failed, rows), key=exerted)):
        return Part("Failures", text=["No case failed."])
    body = [[number_text(row.get(name)) for name in _COLUMNS] for row in bad[:200]]
    more = f" The table has {len(body)} of {len(bad)} failures." if len(bad) > len(body) else ""
    text = (
        f"The failures with the smallest forces are first.{more} `dbb run --case FILE` with a file "
        "of the folder `failures` repeats a case; `dbb serve --case FILE` shows it."
    )
    return Part("Failures", text=[text], tables=[Grid([*_COLUMNS.values()], body, numbers=True)])


def _interval(value: Any) -> str:
    return " to ".join(map(number_text, value if isinstance(value, tuple) else (value,)))


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %"
