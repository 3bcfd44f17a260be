"""`report.html`: what a study found, on one page that needs nothing else."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import pairwise
from typing import Any

from app.studies.page import Grid, Part, page_html
from app.studies.pulls.envelope import Envelope, exerted
from app.studies.pulls.parameters import StudyParameters
from app.studies.pulls.play import Row, failed

_MOST_FAILURES = 200  # rows of the table of failures

_TEXTS = {
    "envelope": (
        "Where safety ends",
        "Each point is a case. Below the black line lies the envelope that these cases give: in "
        "each band of speed and delay, 0.9 of the force exerted in the weakest case that failed, "
        "or came nearer than 10 mm, with no more speed and no more delay.",
    ),
    "clearance": (
        "How near the arm came to the base",
        "The least true distance of each run; at the red line they touch. The grey line is d_b.",
    ),
    "errors": (
        "Where the hand ended",
        "A pull that leads to where the base cannot give way, such as down onto its top, is "
        "resisted, and the hand ends far from its target: that is meant.",
    ),
    "places": (
        "Starts and pulls in plan",
        "Lines lead from the start to where the hand is pulled"
        " to; the base begins in the grey box. What failed is red.",
    ),
}

_COLUMNS = {
    "case": "case",
    "kind": "from",
    "hand_force_clear_max_n": "force until near [N]",
    "hand_force_max_n": "largest force [N]",
    "speed_mps": "speed [m/s]",
    "hand_stiffness_npm": "spring [N/m]",
    "hand_mass_kg": "hand [kg]",
    "hand_f_max_n": "spring's limit [N]",
    "release_at_s": "let go [s]",
    "base_delay_s": "delay [s]",
    "v_max_mps": "v_max [m/s]",
    "slip": "slip",
    "mass_error": "mass error",
    "encoder_noise_rad": "noise [rad]",
    "min_clearance_m": "least distance [m]",
    "contacts": "contact [ms]",
    "arm_min_clearance_m": "within the arm [m]",
    "arm_contacts": "arm contact [ms]",
    "solver_failures": "QPs without solution",
}


def report_html(
    rows: Sequence[Row],
    parameters: StudyParameters,
    summary: Mapping[str, Any],
    pictures: Mapping[str, bytes],
) -> str:
    """The page.

    Args:
        rows: One a case.
        parameters: Of the study.
        summary: As `summary_of` gives it.
        pictures: PNG by the name of the figure.
    """
    title = f"{summary['cases']:,} random pulls, {parameters.controller}"
    parts = [
        Part(text=_verdict(summary)),
        *(Part(_TEXTS[name][0], name, [_TEXTS[name][1]], png) for name, png in pictures.items()),
        _envelope(summary),
        _forces(summary),
        _kinds(summary),
        _failures(rows),
    ]
    return page_html(title, _lead(parameters), parts)


def _lead(parameters: StudyParameters) -> str:
    ranges = parameters.ranges.model_dump()
    told = ", ".join(
        f"{name.replace('_', ' ')} {_number(v[0])} to {_number(v[1])}"
        for name, v in ranges.items()
        if isinstance(v, tuple)
    )
    inside = " Only cases inside of the stated envelope were drawn." if parameters.inside else ""
    return (
        f"A person pulls the hand towards the base from random starts around and "
        f"above it. Robot {parameters.robot}, plant {parameters.physics}, seed "
        f"{parameters.seed}; {told} (SI units), the stiffness logarithmically, all else "
        f"uniformly; {_percent(parameters.ranges.released)} let go on the way, and of these "
        f"{_percent(parameters.ranges.regrasped)} take hold again.{inside}"
    )


def _verdict(summary: Mapping[str, Any]) -> list[str]:
    s, least = summary, summary["min_clearance_m"]
    halves = s["envelope"]["inside_by_halves"]
    lines = [
        f"{s['contact']} of {s['cases']} runs had a contact between arm and base in the plant; in "
        f"{s['bodies_overlap']} the convex bodies met, which are fatter than the links and count "
        f"as failures here. Within the arm: {s['arm_contact']} and {s['arm_bodies_overlap']}. "
        f"In {s['solver_failure']} a QP had no solution; "
        f"{s['nan']} gave NaN; {s['error']} broke off.",
        _exerted(s),
        f"Least distance between arm and base: {_number(least['0_%'])} m; of half of the runs "
        f"{_number(least['50_%'])} m or more, of 95 in 100 {_number(least['5_%'])} m or more."
        if least
        else "",
        f"Of {halves['cases']} cases inside of an envelope fitted without them {halves['failed']} "
        f"failed: with 95 % confidence fewer than {_percent(halves['rate_bound_95'])} do."
        if halves["cases"]
        else "No case lies inside of an envelope fitted without it.",
        _stated(s["stated_envelope"]),
    ]
    return [line for line in lines if line]


def _exerted(s: Mapping[str, Any]) -> str:
    force, speed = s["hand_force_max_n"], s["hand_speed_max_mps"]
    if force is None or speed is None:
        return ""
    return (
        f"The person exerted {_number(force['0_%'])} to {_number(force['100_%'])} N (median "
        f"{_number(force['50_%'])} N), and the hand moved at {_number(speed['100_%'])} m/s at "
        f"most. In {_percent(s['entered_buffer_share'])} of the runs the arm came into the buffer "
        f"of the base."
    )


def _stated(stated: Mapping[str, Any]) -> str:
    inside, outside = stated["inside"], stated["outside"]
    if not inside["cases"]:
        return "No case lies inside of the envelope that the project states."
    return (
        f"Inside of the envelope that the project states {inside['failed']} of {inside['cases']} "
        f"cases failed (95 % bound {_percent(inside['rate_bound_95'])}), outside of it "
        f"{outside['failed']} of {outside['cases']}."
    )


def _envelope(summary: Mapping[str, Any]) -> Part:
    """F* of the fitted envelope and of the stated one, one row a band of speed."""
    fitted = Envelope.model_validate(
        {k: v for k, v in summary["envelope"].items() if not k.startswith("inside")}
    )
    tables = []
    for title, envelope in (("these cases", fitted), ("the project states", Envelope.stated())):
        head = [f"speed [m/s] ({title})"]
        head += [f"delay {a:.2f} to {b:.2f} s" for a, b in pairwise(envelope.base_delay)]
        body = [
            [f"{a:.3g} to {b:.3g}", *map(_number, limits)]
            for (a, b), limits in zip(pairwise(envelope.speed), envelope.force, strict=True)
        ]
        tables.append(Grid(head, body, numbers=True))
    return Part("F*, the largest force inside [N]", tables=tables)


def _forces(summary: Mapping[str, Any]) -> Part:
    head = [
        "force until near [N]",
        "cases",
        "failed",
        "in the buffer",
        "met base",
        "contact",
        "within the arm",
        "least [m]",
        "fastest hand [m/s]",
    ]
    body = []
    for counts in summary["by_force"]:
        low, high, *rest = counts.values()
        name = f"above {low:g}" if high is None else f"{low:g} to {high:g}"
        body.append([name, *map(_number, rest)])
    return Part("By the force that was exerted", tables=[Grid(head, body, numbers=True)])


def _kinds(summary: Mapping[str, Any]) -> Part:
    head = ["from", "cases", "failed", "met base", "within the arm", "no solution", "least [m]"]
    body = [[kind, *map(_number, counts.values())] for kind, counts in summary["by_kind"].items()]
    return Part("By where the pull comes from", tables=[Grid(head, body, numbers=True)])


def _failures(rows: Sequence[Row]) -> Part:
    bad = [row for row in rows if failed(row)]
    if not bad:
        return Part("How it fails", text=["No case failed."])
    bad.sort(key=exerted)
    body = [[_number(row.get(name)) for name in _COLUMNS] for row in bad[:_MOST_FAILURES]]
    more = f" The weakest {_MOST_FAILURES} of {len(bad)}." if len(bad) > _MOST_FAILURES else ""
    text = (
        f"Weakest first.{more} `dbb run --replay-case failures/case-NNNNN.json` plays one again, "
        "`dbb serve --replay-case` shows it."
    )
    grid = Grid(list(_COLUMNS.values()), body, numbers=True)
    return Part("How it fails", text=[text], tables=[grid])


def _number(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}".replace("-", "−") if isinstance(value, float) else str(value)


def _percent(rate: float) -> str:
    return f"{100 * rate:.2g} %"
