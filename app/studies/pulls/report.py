"""The results of a study: figures in `study.json`, and the self-contained `report.html`."""

import math
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from app.config import parameter
from app.studies.page import Grid, Part, label, page_html
from app.studies.pulls.case import COLUMNS, entered_buffer, failed, met_base, met_itself
from app.studies.pulls.envelope import Envelope, exerted, fit_envelope, tally, tally_by_halves
from app.studies.pulls.figures import PICTURES
from app.studies.pulls.parameters import FAULTS, PARAMETERS, StudyParameters
from app.studies.runs import Row

_FORCES = (0.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, math.inf)  # [N] edges of a table
_SPREAD = (
    "hand_force_max_n",
    "hand_force_clear_max_n",
    "hand_speed_max_mps",
    "joint_speed_share_max",
    "base_path_after_release_m",
    "min_clearance_m",
    "arm_min_clearance_m",
    "ee_error_final_m",
)
_QUANTILES = (0.0, 0.01, 0.05, 0.5, 0.95, 1.0)
_FAILURES: dict[str, Callable[[Row], object]] = {
    "contact": lambda row: row.get("contacts"),
    "bodies_overlap": met_base,
    "arm_contact": lambda row: row.get("arm_contacts"),
    "arm_bodies_overlap": met_itself,
    "floor_contact": lambda row: row.get("floor_contacts"),
    "solver_failure": lambda row: row.get("solver_failures"),
    "nan": lambda row: row["nan"],
    "error": lambda row: row["error"],
}
_EVENTS = {**_FAILURES, "failed": failed, "entered_buffer": entered_buffer}
_BY_FORCE = ("failed", "entered_buffer", "bodies_overlap", "contact", "arm_bodies_overlap")
_BY_KIND = ("failed", "bodies_overlap", "arm_bodies_overlap", "solver_failure")
_MAX_FAILURES = 200  # rows of the table of failures
_SOON = 0.2  # [s] longest time from the beginning of a fault to a report in time

_COLUMNS = {
    "case": "case",
    "kind": "from",
    "hand_force_clear_max_n": "force before near [N]",
    "hand_force_max_n": "largest force [N]",
    "speed_mps": "speed [m/s]",
    "hand_stiffness_npm": "spring [N/m]",
    "hand_mass_kg": "hand [kg]",
    "hand_f_max_n": "spring's limit [N]",
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


def summary_of(rows: Sequence[Row], parameters: StudyParameters) -> tuple[dict[str, Any], Envelope]:
    """The summary of one or more cases, whose keys end in the unit, and the fitted envelope."""
    stated, fitted = Envelope.stated(), fit_envelope(rows, parameters.ranges)
    within = [row for row in rows if stated.holds(row)]
    whole = tally(rows)
    summary = {
        "cases": len(rows),
        "failed": whole["failed"],
        "failed_rate_bound_95": whole["rate_bound_95"],
        **_counts(rows, *_FAILURES),
        "redraws": sum(row["redraws"] for row in rows),
        "entered_buffer_share": sum(map(entered_buffer, rows)) / len(rows),
        "released": sum(row["release_at_s"] is not None for row in rows),
        "regrasped": sum(row["regrasp_at_s"] is not None for row in rows),
        **{column: _quantiles(rows, column) for column in _SPREAD},
        "by_force": [_of_force(rows, low, high) for low, high in pairwise(_FORCES)],
        "by_kind": {
            kind: _fared([row for row in rows if row["kind"] == kind], *_BY_KIND)
            for kind in sorted({row["kind"] for row in rows})
        },
        "faults": {name: _reported(rows, name) for name in FAULTS},
        "envelope": {
            **fitted.model_dump(mode="json"),
            "inside": tally([row for row in rows if fitted.holds(row)]),
            "inside_by_halves": tally_by_halves(rows, parameters.ranges),
        },
        "stated_envelope": {
            "inside": tally(within),
            **{f"inside_{key}": value for key, value in _counts(within, *_FAILURES).items()},
            "outside": tally([row for row in rows if not stated.holds(row)]),
        },
        "failures": [row["case"] for row in rows if failed(row)],
    }
    return summary, fitted


def _reported(rows: Sequence[Row], name: str) -> dict[str, int]:
    """Number of cases with a fault, of cases with a report, and of cases with a report in time."""
    none, column = parameter(PARAMETERS[name]).default, COLUMNS[name]
    having = [row for row in rows if row.get(column, none) != none]
    waits = [
        row[f"fault_{FAULTS[name]}_s"] - (0.0 if name == "stated_period" else row["fault_at_s"])
        for row in having
        if row.get(f"fault_{FAULTS[name]}_s") is not None
    ]
    soon = sum(wait <= _SOON for wait in waits)
    return {"cases": len(having), "reported": len(waits), "within_200_ms": soon}


def _of_force(rows: Sequence[Row], low: float, high: float) -> dict[str, Any]:
    """Results of the cases with a force from `low` to `high` [N] before two bodies were near."""
    here = [row for row in rows if low <= exerted(row) < high]
    return {
        "from_n": low,
        "to_n": high if math.isfinite(high) else None,
        **_fared(here, *_BY_FORCE),
        "hand_speed_max_mps": max(_known(here, "hand_speed_max_mps"), default=None),
    }


def _fared(rows: Sequence[Row], *events: str) -> dict[str, Any]:
    """Number of cases, number of cases with each event, and the smallest distance."""
    least = min(_known(rows, "min_clearance_m"), default=None)
    return {"cases": len(rows), **_counts(rows, *events), "least_clearance_m": least}


def _counts(rows: Sequence[Row], *events: str) -> dict[str, int]:
    """Number of cases with each event; a case may have several."""
    return {event: sum(bool(_EVENTS[event](row)) for row in rows) for event in events}


def _known(rows: Sequence[Row], column: str) -> list[float]:
    return [row[column] for row in rows if row.get(column) is not None]


def _quantiles(rows: Sequence[Row], column: str) -> dict[str, float] | None:
    if not (values := _known(rows, column)):
        return None
    found = np.quantile(values, _QUANTILES).tolist()
    return {f"{100 * q:g}_%": value for q, value in zip(_QUANTILES, found, strict=True)}


def report_html(
    rows: Sequence[Row],
    parameters: StudyParameters,
    summary: Mapping[str, Any],
    envelope: Envelope,
    pictures: Mapping[str, bytes],
) -> str:
    """The report's page, from the results of `summary_of` and PNG pictures by name."""
    title = f"{summary['cases']:,} random pulls, {parameters.controller}"
    said, forces = outcome(summary)
    parts = [
        said,
        *(Part(each.title, name, [each.caption], pictures[name]) for name, each in PICTURES.items()),
        _envelope(envelope),
        forces,
        _counted("By the direction of the pull", "from", summary["by_kind"]),
        _counted("Faults and their reports", "fault", summary["faults"]),
        _failures(rows),
    ]
    return page_html(title, _lead(parameters), parts)


def outcome(summary: Mapping[str, Any]) -> tuple[Part, Part]:
    """The results of the cases as a text, and as a table by the exerted force."""
    return Part(text=_verdict(summary)), _forces(summary)


def _lead(parameters: StudyParameters) -> str:
    ranges = parameters.ranges.model_dump()
    intervals = ", ".join(
        f"{name.replace('_', ' ')} {_number(v[0])} to {_number(v[1])}"
        for name, v in ranges.items()
        if isinstance(v, tuple)
    )
    inside = " Only cases inside the stated envelope were drawn." if parameters.inside else ""
    return (
        f"A person pulls the end-effector towards the base from random starts around and "
        f"above it. Robot {parameters.robot}, plant {parameters.physics}, seed "
        f"{parameters.seed}. Ranges in SI units: {intervals}. The stiffness has a logarithmic "
        f"distribution, all other quantities a uniform one. {_percent(parameters.ranges.faulty)} "
        f"of the cases have one to three of the faults {', '.join(FAULTS)}. In "
        f"{_percent(parameters.ranges.released)} of the cases the person releases the end-effector "
        f"early, and in {_percent(parameters.ranges.regrasped)} of these grasps it again.{inside}"
    )


def _verdict(summary: Mapping[str, Any]) -> list[str]:
    s, least = summary, summary["min_clearance_m"]
    halves = s["envelope"]["inside_by_halves"]
    lines = [
        f"{s['failed']} of {s['cases']} cases failed. "
        f"{s['contact']} of {s['cases']} runs had a contact between arm and base in the plant; in "
        f"{s['bodies_overlap']} the convex bodies met, which are larger than the links; this "
        f"counts as a failure. The same numbers within the arm are {s['arm_contact']} and "
        f"{s['arm_bodies_overlap']}. In {s['solver_failure']} runs a QP had no solution, "
        f"{s['nan']} runs had NaN, and {s['error']} runs stopped with an error.",
        _exerted(s),
        f"Smallest distance between arm and base: {_number(least['0_%'])} m; at least "
        f"{_number(least['50_%'])} m in half of the runs, {_number(least['5_%'])} m in 95 of 100."
        if least
        else "",
        f"Of {halves['cases']} cases inside an envelope that was fitted to other cases, "
        f"{halves['failed']} failed: the rate is below {_percent(halves['rate_bound_95'])} with "
        "95 % confidence."
        if halves["cases"]
        else "No case is inside an envelope that was fitted to other cases.",
        _stated(s["stated_envelope"]),
    ]
    return [line for line in lines if line]


def _exerted(s: Mapping[str, Any]) -> str:
    force, speed = s["hand_force_max_n"], s["hand_speed_max_mps"]
    if force is None or speed is None:
        return ""
    return (
        f"The person exerted {_number(force['0_%'])} to {_number(force['100_%'])} N (median "
        f"{_number(force['50_%'])} N), and the end-effector's largest speed was "
        f"{_number(speed['100_%'])} m/s. In {_percent(s['entered_buffer_share'])} of the runs the "
        f"arm entered the buffer of the base."
    )


def _stated(stated: Mapping[str, Any]) -> str:
    inside, outside = stated["inside"], stated["outside"]
    if not inside["cases"]:
        return "No case is inside the envelope that the project states."
    return (
        f"Inside the envelope that the project states, {inside['failed']} of {inside['cases']} "
        f"cases failed (95 % bound {_percent(inside['rate_bound_95'])}); outside, "
        f"{outside['failed']} of {outside['cases']} cases failed."
    )


def _envelope(fitted: Envelope) -> Part:
    both = [fitted.model_dump(), Envelope.stated().model_dump()]
    body = [[name.replace("_", " "), *(_interval(each[name]) for each in both)] for name in both[0]]
    grid = Grid(["inside up to [SI units]", "these cases", "the project states"], body, True)
    return Part("The envelope", tables=[grid])


def _forces(summary: Mapping[str, Any]) -> Part:
    found = {}
    for counts in summary["by_force"]:
        low, high, *_ = counts.values()
        name = f"above {low:g}" if high is None else f"{low:g} to {high:g}"
        found[name] = {key: v for key, v in counts.items() if key not in ("from_n", "to_n")}
    return _counted("By the exerted force", "force before near [N]", found)


def _counted(title: str, group: str, found: Mapping[str, Mapping[str, Any]]) -> Part:
    head = [group, *map(label, next(iter(found.values())))]
    body = [[name, *map(_number, counts.values())] for name, counts in found.items()]
    return Part(title, tables=[Grid(head, body, numbers=True)])


def _failures(rows: Sequence[Row]) -> Part:
    bad = [row for row in rows if failed(row)]
    if not bad:
        return Part("Failures", text=["No case failed."])
    bad.sort(key=exerted)
    body = [[_number(row.get(name)) for name in _COLUMNS] for row in bad[:_MAX_FAILURES]]
    cut = len(bad) > _MAX_FAILURES
    more = f" The table has {_MAX_FAILURES} of {len(bad)} failures." if cut else ""
    text = (
        f"The failures with the smallest forces are first.{more} "
        "`dbb run --case failures/case-NNNNN.json` repeats a case, `dbb serve --case` shows it."
    )
    grid = Grid(list(_COLUMNS.values()), body, numbers=True)
    return Part("Failures", text=[text], tables=[grid])


def _number(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}".replace("-", "−") if isinstance(value, float) else str(value)


def _interval(value: Any) -> str:
    return " to ".join(map(_number, value)) if isinstance(value, tuple) else _number(value)


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %"
