"""The rows as one table, in three forms: `table.json`, `table.csv` and `table.md`."""

from __future__ import annotations

import csv
import json
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.names import PEERS
from benchmarks.peers.rows import Row

PATH_TITLES = {
    "side": "side",
    "front": "front",
    "axis-0mm": "axis, x = 0",
    "axis-1mm": "1 mm",
    "axis-10mm": "10 mm",
    "axis-50mm": "50 mm",
}
"""Displayed titles of the paths by their names."""


def write_table(folder: Path, rows: Sequence[Row], machine: dict[str, Any]) -> dict[str, Any]:
    """Write the table in three formats; returns the content of the JSON."""
    result = {**machine, "all_ran": all(row["status"] == "ok" for row in rows), "rows": list(rows)}
    text = json.dumps(result, indent=2, allow_nan=False) + "\n"
    (folder / "table.json").write_text(text, encoding="utf-8")
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with (folder / "table.csv").open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, columns)
        writer.writeheader()
        writer.writerows(rows)
    (folder / "table.md").write_text(markdown(rows), encoding="utf-8")
    return result


def markdown(rows: Sequence[Row]) -> str:
    """Markdown of a table for each cost of the base, then the reasons of missing rows."""
    parts = []
    for weight in dict.fromkeys(row["base_weight"] for row in rows):
        parts.append(f"{weight_title(weight)}:\n")
        parts.append(_one([row for row in rows if row["base_weight"] == weight]))
    if notes := _reasons(rows):
        parts.append("\n".join(notes) + "\n")
    return "\n".join(parts)


def weight_title(weight: float) -> str:
    """The title of a cost of the base relative to the arm; only the libraries square the cost."""
    cost = f"{weight:g}"
    squared = f"{cost}²" if weight != 1 else cost
    libraries = f"libraries {squared} (a cost of {cost})"
    return f"Weight of base motion: {libraries}; ours `task.base_weight` = {cost}"


def _one(rows: Sequence[Row]) -> str:
    """The table of one cost of the base, with a line for each peer."""
    paths = list(dict.fromkeys(row["path"] for row in rows))
    head = [
        "",
        "step, p50 / p99",
        *(PATH_TITLES.get(path, path) for path in paths),
        "smallest distance",
        "slip",
        "largest acceleration, base / arm",
    ]
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    for name in dict.fromkeys(row["peer"] for row in rows):
        found = {row["path"]: row for row in rows if row["peer"] == name}
        lines.append(f"| {' | '.join(_line(name, found, paths))} |")
    return "\n".join(lines) + "\n"


def _line(name: str, found: dict[str, Row], paths: Sequence[str]) -> Iterable[str]:
    good = [row for row in found.values() if row["status"] == "ok"]
    version = next((row["version"] for row in found.values() if row["version"]), "")
    yield f"{PEERS[name].title if name in PEERS else name} {version}".strip()
    if not good:
        yield from [next(iter(found.values()))["status"], *[""] * (len(paths) + 3)]
        return
    p50, p99 = (np.median([row[key] for row in good]) for key in ("step_p50_us", "step_p99_us"))
    yield f"{p50 / 1000:.3f} / {p99 / 1000:.2f} ms"
    for path in paths:
        row = found.get(path)
        if row is None or row["status"] != "ok":
            yield "failed" if row else ""
        else:
            yield f"{_mm(row['error_final_m'])}, {row['base_path_m']:.2f} m"
    yield _mm(min(row["clearance_m"] for row in good))
    yield _mm(max(row["slip_m"] for row in good))
    base, arm = (
        max(row[key] for row in good) for key in ("base_change_max_mps2", "arm_change_max_radps2")
    )
    yield f"{base:.1f} m/s², {arm:.0f} rad/s²"


def _mm(value: float) -> str:
    """A length [m] in readable form; rounding errors are 0."""
    if abs(value) < 5e-7:
        return "0"
    return f"{1000 * value:.0f} mm" if abs(value) >= 0.01 else f"{1000 * value:.2g} mm"


def _reasons(rows: Sequence[Row]) -> list[str]:
    """A line for each reason of rows without results."""
    found: dict[tuple[str, str, str], list[str]] = {}
    for row in rows:
        if row["status"] != "ok":
            key = row["peer"], row["status"], row["reason"]
            found.setdefault(key, []).append(f"{row['path']} at {row['base_weight']:g}")
    return [
        f"- {peer} {status} ({'all' if len(runs) > 6 else ', '.join(runs)}): {reason}"
        for (peer, status, reason), runs in found.items()
    ]
