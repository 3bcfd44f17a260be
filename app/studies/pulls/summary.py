"""What a study says: counts, distributions and the envelope, as `study.json` keeps them."""

from __future__ import annotations

import math
from collections.abc import Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from app.studies.pulls.envelope import (
    Envelope,
    Tally,
    exerted,
    fit_envelope,
    tally,
    tally_by_halves,
)
from app.studies.pulls.parameters import StudyParameters
from app.studies.pulls.play import Row, entered_buffer, failed, met_base, met_itself

_FORCES = (0.0, 20.0, 30.0, 40.0, 50.0, 60.0, 80.0, 100.0, math.inf)  # [N] edges of a table
_QUANTILES = (0.0, 0.01, 0.05, 0.5, 0.95, 1.0)


def summary_of(rows: Sequence[Row], parameters: StudyParameters) -> dict[str, Any]:
    """Figures of all cases; keys end in their unit.

    Args:
        rows: One a case; at least one.
        parameters: Of the study.
    """
    stated, fitted = Envelope.stated(), fit_envelope(rows, parameters.ranges)
    within = [row for row in rows if stated.holds_row(row)]
    return {
        "cases": len(rows),
        "failed": tally(rows).failures,
        "failed_rate_bound_95": tally(rows).rate_bound,
        **_counts(rows),
        "redraws": sum(row["redraws"] for row in rows),
        "entered_buffer_share": sum(map(entered_buffer, rows)) / len(rows),
        "released": sum(row["release_at_s"] is not None for row in rows),
        "regrasped": sum(row["regrasp_at_s"] is not None for row in rows),
        "hand_force_max_n": _quantiles(rows, "hand_force_max_n"),
        "hand_force_clear_max_n": _quantiles(rows, "hand_force_clear_max_n"),
        "hand_speed_max_mps": _quantiles(rows, "hand_speed_max_mps"),
        "joint_speed_share_max": _quantiles(rows, "joint_speed_share_max"),
        "base_path_after_release_m": _quantiles(rows, "base_path_after_release_m"),
        "by_force": by_force(rows),
        "min_clearance_m": _quantiles(rows, "min_clearance_m"),
        "arm_min_clearance_m": _quantiles(rows, "arm_min_clearance_m"),
        "ee_error_final_m": _quantiles(rows, "ee_error_final_m"),
        "by_kind": {
            kind: _of_kind([row for row in rows if row["kind"] == kind])
            for kind in sorted({row["kind"] for row in rows})
        },
        "envelope": {
            **fitted.model_dump(mode="json"),
            "inside": _told(tally([row for row in rows if fitted.holds_row(row)])),
            "inside_by_halves": _told(tally_by_halves(rows, parameters.ranges)),
        },
        "stated_envelope": {
            "inside": _told(tally(within)),
            **{f"inside_{key}": value for key, value in _counts(within).items()},
            "outside": _told(tally([row for row in rows if not stated.holds_row(row)])),
        },
        "failures": [row["case"] for row in rows if failed(row)],
    }


def by_force(rows: Sequence[Row]) -> list[dict[str, Any]]:
    """How cases fared by the force that was exerted before two bodies were near."""
    found = []
    for low, high in pairwise(_FORCES):
        here = [row for row in rows if low <= exerted(row) < high]
        least = [row["min_clearance_m"] for row in here if row.get("min_clearance_m") is not None]
        speeds = [row["hand_speed_max_mps"] for row in here if "hand_speed_max_mps" in row]
        found.append(
            {
                "from_n": low,
                "to_n": high if math.isfinite(high) else None,
                "cases": len(here),
                "failed": tally(here).failures,
                "entered_buffer": sum(map(entered_buffer, here)),
                "bodies_overlap": sum(map(met_base, here)),
                "contact": sum(bool(row.get("contacts")) for row in here),
                "arm_bodies_overlap": sum(map(met_itself, here)),
                "least_clearance_m": min(least, default=None),
                "hand_speed_max_mps": max(speeds, default=None),
            }
        )
    return found


def _counts(rows: Sequence[Row]) -> dict[str, int]:
    """Cases with each kind of failure; one may have several."""
    return {
        "contact": sum(bool(row.get("contacts")) for row in rows),
        "bodies_overlap": sum(map(met_base, rows)),
        "arm_contact": sum(bool(row.get("arm_contacts")) for row in rows),
        "arm_bodies_overlap": sum(map(met_itself, rows)),
        "floor_contact": sum(bool(row.get("floor_contacts")) for row in rows),
        "solver_failure": sum(bool(row.get("solver_failures")) for row in rows),
        "nan": sum(bool(row["nan"]) for row in rows),
        "error": sum(bool(row["error"]) for row in rows),
    }


def _of_kind(rows: Sequence[Row]) -> dict[str, Any]:
    counts = _counts(rows)
    least = [row["min_clearance_m"] for row in rows if row.get("min_clearance_m") is not None]
    return {
        "cases": len(rows),
        "failed": tally(rows).failures,
        "bodies_overlap": counts["bodies_overlap"],
        "arm_bodies_overlap": counts["arm_bodies_overlap"],
        "solver_failure": counts["solver_failure"],
        "least_clearance_m": min(least, default=None),
    }


def _quantiles(rows: Sequence[Row], column: str) -> dict[str, float] | None:
    values = [row[column] for row in rows if row.get(column) is not None]
    if not values:
        return None
    found = np.quantile(values, _QUANTILES).tolist()
    return {f"{100 * q:g}_%": value for q, value in zip(_QUANTILES, found, strict=True)}


def _told(counted: Tally) -> dict[str, Any]:
    return {"cases": counted.cases, "failed": counted.failures, "rate_bound_95": counted.rate_bound}
