"""The files of a sweep: `sweep.json`, `sweep.csv`, and a map for each height and speed."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import numpy as np

from app.studies.rows import Row, write_json
from app.system import write_whole

Array = np.ndarray

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
    # Imported here: matplotlib would make the dashboard start later.
    from app.robot.description import load_robot
    from app.robot.model import RobotModel
    from app.studies.style import png_of, styled
    from app.studies.sweep.maps import above_map, polar_map
    from app.studies.sweep.sweep import LISTS

    model = RobotModel(load_robot(result["robot"]))
    names = ["sweep.json", "sweep.csv"]
    with styled():
        for speed in result["speeds_mps"]:
            for height in result["heights_m"]:
                names.append(f"sweep_h{height:g}_v{speed:g}.png")
                write_whole(out / names[-1], png_of(polar_map(result, height, speed, model)))
            if result["above"] or any(row["kind"] == "above" for row in result["unreachable"]):
                names.append(f"sweep_above_v{speed:g}.png")
                write_whole(out / names[-1], png_of(above_map(result, speed, model)))
    rows = [{"kind": kind, **row} for kind, key in LISTS.items() for row in result[key]]
    write_whole(out / "sweep.csv", _csv(rows + result["unreachable"]))
    write_json(out / "sweep.json", {**result, "files": names})
    return names


def newest_map(folder: Path) -> Path | None:
    """The picture of the newest sweep from the side in a folder, or None."""
    found = list(folder.glob("sweep_h*_v*.png")) if folder.is_dir() else []
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name), default=None)


def read_map(path: Path) -> Array:
    """(H, W, 3) the picture's pixels, 0 to 255."""
    from matplotlib.image import imread

    return np.round(255.0 * imread(path)[..., :3]).astype(np.uint8)


def _csv(rows: list[Row]) -> str:
    """One row a path, those that could not begin included."""
    text = io.StringIO(newline="")
    writer = csv.DictWriter(text, dict.fromkeys([*_FIRST, *(name for row in rows for name in row)]))
    writer.writeheader()
    writer.writerows(rows)
    return text.getvalue()
