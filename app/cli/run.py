"""`dbb run`: a scenario, headless and faster than real time."""

from __future__ import annotations

import json as json_module
from pathlib import Path
from typing import Annotated, Literal

import tyro

from app.cli.common import Json, load_robot_and_border, print_json, progress_bar
from app.config import Config
from app.control.controller import CONTROLLERS
from app.errors import ConfigError, UnknownNameError
from app.simulation.run import run_scenario
from app.simulation.scenario import scenario_by_name

Point = tuple[float, float, float]


def run(
    scenario: Annotated[str, tyro.conf.Positional],
    controller: str = "dbb",
    robot: str = "husky_panda",
    start: Point | None = None,
    move: Point | None = None,
    duration: float | None = None,
    physics: Literal["planar", "contact", "kinematic"] = "planar",
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
        physics: Planar base on velocity motors, base on wheels in contact, or a kinematic stand-in.
        buffer_distance: [m] d_b.
        out: Folder for `log.csv` and `metrics.json`.
        seed: Seed of everything random in the run.
        json: Print one JSON object on standard output and nothing else there.
    """
    chosen = scenario_by_name(scenario)
    if controller not in CONTROLLERS:
        raise UnknownNameError("controller", controller, CONTROLLERS)
    if duration is not None and not 0.01 <= duration <= 3600.0:
        raise ConfigError(f"--duration: {duration:g} s is not within 0.01 to 3600 s")
    chosen = chosen.changed(start=start, move=move, duration=duration)
    config = Config()
    if buffer_distance is not None:
        config = config.replace("border.d_b", buffer_distance)
    model, data = load_robot_and_border(robot)
    with progress_bar(f"{scenario}, {controller}", chosen.duration) as progress:
        result = run_scenario(
            model, data, chosen, config, controller=controller, physics=physics, seed=seed,
            on_progress=lambda t: progress.update(0, completed=t),
        )  # fmt: skip
    if out is not None:
        out.mkdir(parents=True, exist_ok=True)
        result.recorder.write_log(out / "log.csv")
        text = json_module.dumps(result.figures, indent=2) + "\n"
        (out / "metrics.json").write_text(text, encoding="utf-8")
    if json:
        print_json(result.figures)
        return
    for key, value in result.figures.items():
        print(f"{key:28} {_text(value)}")


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)
