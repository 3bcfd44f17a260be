"""`dbb run`: a scenario, headless and faster than real time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from app.avoidance.self_collision import BORDERS
from app.cli.common import as_json, load_robot_and_border, print_json, progress_bar
from app.cli.options import (
    Json,
    PlaceOption,
    PointOption,
    PoseOption,
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
    border: str = "surface",
    out: Path | None = None,
    seed: int = 0,
    json: Json = False,
    door_width: float | None = None,
    hinge: Literal["left", "right"] | None = None,
    hinge_position: PlaceOption = None,
    door_friction: float | None = None,
    door_angle: float | None = None,
    door_yaw: float | None = None,
    radial_guess: float | None = None,
    opening_rate: float | None = None,
    base: PoseOption = None,
) -> None:
    """Run a scenario and print its figures.

    Args:
        scenario: guiding-lateral, guiding-front, guiding-above, guiding-fold, tracking or
            refrigerator. The options from --door-width on are the refrigerator's, --start and
            --move those of the others.
        controller: dbb, one it is compared with (repulsive, barrier), or none for the same stack
            without avoidance.
        robot: Name of the robot; `dbb robots` lists them.
        start: [m] where the hand starts, in the world (default: the scenario's).
        move: [m] how far the hand is led, in the world (default: the scenario's).
        duration: [s] of the run (default: the scenario's); a motion along a line scales with it.
        physics: planar (base on velocity motors), contact (base on wheels in contact) or kinematic
            (a stand-in without physics).
        buffer_distance: [m] d_b (default: the configuration's).
        border: surface, or points for the paper's way, where the acting point jumps.
        out: Folder for `log.csv` and `metrics.json`.
        seed: Seed of everything random in the run.
        json: Print one JSON object on standard output and nothing else there.
        door_width: [m] from the hinge to the free edge (default: 0.6).
        hinge: Side of the hinge for the robot that stands before the door (default: left).
        hinge_position: [m] of the hinge in the world (default: 1 m ahead and 0.1 m to its side).
        door_friction: [N m] of the hinge (default: 1).
        door_angle: [deg] how far the door is open at the start (default: 0).
        door_yaw: [deg] where one looks who stands before the closed door (default: 0, along x).
        radial_guess: [deg] by how much the first guess of the direction towards the hinge is wrong;
            positive is turned into the door (default: 30).
        opening_rate: [deg/s] how fast the door is opened (default: 2.15).
        base: [m] [m] [deg] where the base starts (default: before the door, farther away from a
            wider one).
    """
    # Imported here: scipy would make every other command start later.
    from app.simulation.run import run_scenario

    chosen = scenario_by_name(scenario)
    check_name("controller", controller, CONTROLLERS)
    check_name("physics", physics, PLANTS)
    check_name("border", border, BORDERS)
    check_point("--start", start)
    check_point("--move", move)
    check_point("--hinge-position", hinge_position)
    check_point("--base", None if base is None else base[:2])
    check_seed(seed)
    if base is not None:
        check_range("--base", base[2], -360.0, 360.0, "deg")
    chosen = chosen.changed(
        start=start, move=move, duration=duration, door_width=door_width, hinge=hinge,
        hinge_position=hinge_position, door_friction=door_friction, door_angle=door_angle,
        door_yaw=door_yaw, radial_guess=radial_guess, opening_rate=opening_rate,
        base=None if base is None else (base[0], base[1], math.radians(base[2])),
    )  # fmt: skip
    if duration is not None:
        check_range("--duration", duration, *_DURATIONS, "s")
    config = Config().replace("border.kind", border)
    if buffer_distance is not None:
        check_parameter("--buffer-distance", buffer_distance, "border.d_b")
        config = config.replace("border.d_b", buffer_distance)
    make_folder(out)
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
