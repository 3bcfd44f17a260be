"""`dbb run`: a scenario, headless and faster than real time."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from app.cli.common import as_json, load_robot_and_border, print_json, progress_bar
from app.cli.options import (
    Json,
    PointOption,
    check_name,
    check_parameter,
    check_point,
    check_range,
    check_seed,
    make_folder,
)
from app.config import Config
from app.control.controller import CONTROLLERS
from app.simulation.plants import PLANTS
from app.simulation.scenario import scenario_by_name

if TYPE_CHECKING:
    from app.simulation.run import RunResult

_DURATIONS = 0.01, 3600.0  # [s] shortest and longest run


def run(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")],
    controller: str = "dbb",
    robot: str = "husky_panda",
    start: PointOption = None,
    move: PointOption = None,
    duration: float | None = None,
    physics: str = "planar",
    buffer_distance: float | None = None,
    out: Path | None = None,
    seed: int = 0,
    json: Json = False,
) -> None:
    """Run a scenario and print its figures.

    Args:
        scenario: guiding-lateral, guiding-front, guiding-above, guiding-fold or tracking.
        controller: dbb, or none for the same stack without avoidance.
        robot: Name of the robot; `dbb robots` lists them.
        start: [m] where the hand starts, in the world (default: the scenario's).
        move: [m] how far the hand is led, in the world (default: the scenario's).
        duration: [s] of the run (default: the scenario's); the motion scales with it.
        physics: planar (base on velocity motors), contact (base on wheels in contact) or kinematic
            (a stand-in without physics).
        buffer_distance: [m] d_b (default: the configuration's).
        out: Folder for `log.csv` and `metrics.json`.
        seed: Seed of everything random in the run.
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: scipy would make every other command start later.
    from app.simulation.run import run_scenario

    chosen = scenario_by_name(scenario)
    check_name("controller", controller, CONTROLLERS)
    check_name("physics", physics, PLANTS)
    check_point("--start", start)
    check_point("--move", move)
    check_seed(seed)
    if duration is not None:
        check_range("--duration", duration, *_DURATIONS, "s")
    config = Config()
    if buffer_distance is not None:
        check_parameter("--buffer-distance", buffer_distance, "border.d_b")
        config = config.replace("border.d_b", buffer_distance)
    make_folder(out)
    chosen = chosen.changed(start=start, move=move, duration=duration)
    model, data = load_robot_and_border(robot)
    with progress_bar(f"{scenario}, {controller}", chosen.duration) as on_progress:
        result = run_scenario(
            model, data, chosen, config, controller=controller, physics=physics, seed=seed,
            on_progress=on_progress,
        )  # fmt: skip
    if out is not None:
        _write(out, result)
    if json:
        print_json(result.figures)
        return
    for key, value in result.figures.items():
        print(f"{key:28} {_text(value)}")


def _write(out: Path, result: RunResult) -> None:
    result.recorder.write_log(out / "log.csv")
    (out / "metrics.json").write_text(as_json(result.figures), encoding="utf-8")


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)
