"""The files of a sweep: `sweep.json`, `sweep.csv`, and a map for each height and speed."""

from __future__ import annotations

import csv
import json
from pathlib import Path

from app.robot.assets import load_robot
from app.robot.model import RobotModel
from app.studies.style import png_of, styled
from app.studies.sweep.paths import KINDS
from app.studies.sweep.polar import Plan, polar_map
from app.studies.sweep.polar_above import above_map
from app.studies.sweep.result import LISTS, Row

_FIRST = (
    "kind",
    "controller",
    "height_m",
    "speed_mps",
    "direction_deg",
    "offset_m",
    "place_x_m",
    "place_y_m",
    "passed",
)


def write_sweep(result: Row, out: Path) -> list[str]:
    """Write what a sweep gave into an existing folder; returns the names of the files."""
    plan = Plan.of(RobotModel(load_robot(result["robot"])))
    names = ["sweep.json", "sweep.csv"]
    with styled():
        for speed in result["speeds_mps"]:
            for height in result["heights_m"]:
                names.append(f"sweep_h{height:g}_v{speed:g}.png")
                _write(out / names[-1], png_of(polar_map(result, height, speed, plan)))
            if result["above"] or any(row["kind"] == "above" for row in result["unreachable"]):
                names.append(f"sweep_above_v{speed:g}.png")
                _write(out / names[-1], png_of(above_map(result, speed, plan)))
    _write_csv(out / "sweep.csv", table(result))
    text = json.dumps({**result, "files": names}, indent=2, allow_nan=False) + "\n"
    (out / "sweep.json").write_text(text, encoding="utf-8")
    return names


def table(result: Row) -> list[Row]:
    """One row a path, those that could not begin included."""
    rows = [{"kind": kind, **row} for kind in KINDS for row in result[LISTS[kind]]]
    return rows + result["unreachable"]


def _write(path: Path, data: bytes) -> None:
    """Whole or not at all: a dashboard may be reading it."""
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(data)
    part.replace(path)


def _write_csv(path: Path, rows: list[Row]) -> None:
    names = list(dict.fromkeys([*_FIRST, *(name for row in rows for name in row)]))
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, names)
        writer.writeheader()
        writer.writerows(rows)
