"""`dbb sweep`: hand paths towards the base from everywhere, as a polar map."""

from __future__ import annotations

import json as json_reader
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tyro

from app.cli.common import print_json, progress_bar
from app.cli.options import (
    Json,
    check_name,
    check_parameter,
    check_range,
    check_seed,
    configured,
    make_folder,
)
from app.config import Config, make_config
from app.control.controller import CONTROLLERS
from app.errors import ConfigError
from app.robot.assets import load_robot
from app.simulation.plants.choice import chosen_plant

if TYPE_CHECKING:
    from app.studies.sweep.plan import SweepPlan

_MOST_PROCESSES = 64
_HEIGHTS = 0.02, 2.0  # [m]
_SPEEDS = 0.001, 1.0  # [m/s]
_STEPS = 0.5, 90.0  # [deg]
_LENGTHS = 0.01, 0.5  # [m]
_HOLDS = 0.0, 60.0  # [s]
_SPACINGS = 0.02, 1.0  # [m]
_FARTHEST = 0.5  # [m] a start from the base


def sweep(
    controller: Annotated[tuple[str, ...], tyro.conf.arg(metavar="NAME …")] = ("dbb",),
    robot: str = "husky_panda",
    height: Annotated[tuple[float, ...], tyro.conf.arg(metavar="Z …")] = (0.3,),
    speed: Annotated[tuple[float, ...], tyro.conf.arg(metavar="V …")] = (0.025,),
    step: float = 5.0,
    mode: Literal["tracking", "guiding"] = "tracking",
    wheel_axis: bool = True,
    above: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    above_spacing: float = 0.15,
    length: float = 0.2,
    hold: float = 3.0,
    start_distance: float | None = None,
    buffer_distance: float | None = None,
    base_weight: float | None = None,
    config: Path | None = None,
    parameters: Path | None = None,
    physics: str | None = None,
    processes: int | None = None,
    out: Path = Path("out/sweep"),
    seed: int = 0,
    json: Json = False,
) -> None:
    """Lead the hand towards the base from all around, and draw how that ends as a polar map.

    Each path begins at a clear posture with the arm at the same distance from the base, and leads
    straight towards the base's centre. Directions without such a posture are listed as unreachable.
    Paths along the wheel axis begin with the arm's closest point at x = 0, ±1, ±10 and ±50 mm.

    Args:
        controller: One or several of dbb, repulsive, barrier and none, with blanks or commas.
        robot: Name of the robot; `dbb robots` lists them.
        height: [m] of the hand, one or several.
        speed: [m/s] mean speed of the hand on its way, one or several.
        step: [deg] between two directions.
        mode: tracking with the orientation held, or guiding, where a person pulls the hand.
        wheel_axis: Paths along the wheel axis too.
        above: Paths down onto the base too, over a grid of places.
        above_spacing: [m] at most, between two of these places.
        length: [m] of each path.
        hold: [s] how long the hand is held at the end.
        start_distance: [m] between arm and base at the start (default: 0.02 beyond the buffer).
        buffer_distance: [m] d_b (default: the configuration's).
        base_weight: How much costlier the base's motion is than the arm's (default: the
            configuration's).
        config: File of parameters, TOML, as `dbb config` or the dashboard writes it; what is not in
            it is at its default, and other options come before it.
        parameters: The same as JSON, by section and name.
        physics: planar, mujoco, mujoco-contact or kinematic (default: planar where pybullet is
            installed, else mujoco).
        processes: How many runs to do side by side (default: 2, or as many as there are cores).
        out: Folder for `sweep.json`, `sweep.csv` and a PNG for each height and speed.
        seed: Seed of everything random.
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: matplotlib and scipy would make every other command start later.
    from app.studies.paper.experiments import default_processes
    from app.studies.sweep.files import write_sweep
    from app.studies.sweep.plan import SweepPlan
    from app.studies.sweep.sweep import sweep as make

    tuned = _config(config, parameters, buffer_distance, base_weight)
    plan = SweepPlan(
        robot,
        _names(controller),
        _several("--height", height, _HEIGHTS, "m"),
        _several("--speed", speed, _SPEEDS, "m/s"),
        step,
        mode,
        wheel_axis,
        above,
        above_spacing,
        length,
        hold,
        start_distance,
        chosen_plant(physics),
        seed,
        tuned,
    )
    _check(plan)
    if processes is not None:
        check_range("--processes", processes, 1, _MOST_PROCESSES)
    load_robot(robot)
    make_folder(out)
    with progress_bar("sweep", 1.0) as on_progress:
        result = make(plan, processes=processes or default_processes(), on_progress=on_progress)
    result["files"] = write_sweep(result, out)
    if json:
        print_json(result)
    else:
        _print(result, out)


def _names(given: tuple[str, ...]) -> tuple[str, ...]:
    """The controllers, each once."""
    names = [name for text in given for name in text.split(",") if name]
    if not names:
        raise ConfigError(f"--controller: name one or several of {', '.join(CONTROLLERS)}")
    for name in names:
        check_name("controller", name, CONTROLLERS)
    return tuple(dict.fromkeys(names))


def _several(
    option: str, values: tuple[float, ...], bounds: tuple[float, float], unit: str
) -> tuple[float, ...]:
    """The numbers of an option that takes one or several, each once."""
    if not values:
        raise ConfigError(f"{option}: give one or several numbers")
    for value in values:
        check_range(option, value, *bounds, unit)
    return tuple(dict.fromkeys(values))


def _config(
    file: Path | None,
    parameters: Path | None,
    buffer_distance: float | None,
    base_weight: float | None,
) -> Config:
    if file is not None and parameters is not None:
        raise ConfigError("--parameters: --config gives them already; leave one of them")
    config = configured(file) if parameters is None else read_parameters(parameters)
    if buffer_distance is not None:
        check_parameter("--buffer-distance", buffer_distance, "border.d_b")
        config = config.replace("border.d_b", buffer_distance)
    if base_weight is not None:
        check_parameter("--base-weight", base_weight, "task.base_weight")
        config = config.replace("task.base_weight", base_weight)
    return config


def read_parameters(path: Path) -> Config:
    """The parameters of a JSON file, over the defaults.

    Raises:
        ConfigError: It is not there, no JSON object, or holds what is no parameter.
    """
    try:
        given = json_reader.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise ConfigError(f"--parameters: cannot read {path}: {error}") from None
    if not isinstance(given, dict):
        raise ConfigError(f"--parameters: {path} must hold a JSON object of sections")
    return make_config(given)


def _check(plan: SweepPlan) -> None:
    from app.studies.sweep.plan import MORE_THAN_BUFFER

    check_range("--step", plan.step, *_STEPS, "deg")
    check_range("--above-spacing", plan.above_spacing, *_SPACINGS, "m")
    check_range("--length", plan.length, *_LENGTHS, "m")
    check_range("--hold", plan.hold, *_HOLDS, "s")
    if plan.start_distance is not None:
        least = plan.config.border.d_b + MORE_THAN_BUFFER
        check_range("--start-distance", plan.start_distance, least, _FARTHEST, "m")
    if abs(360.0 / plan.step - round(360.0 / plan.step)) > 1e-9:
        raise ConfigError(f"--step: 360° is not a multiple of {plan.step:g}°")
    check_seed(plan.seed)


def _print(result: dict[str, Any], out: Path) -> None:
    for controller, kinds in result["summary"].items():
        for kind, s in kinds.items():
            print(f"{controller}, {kind.replace('_', ' ')}:")
            print(
                f"  {s['passed']} of {s['runs']} runs passed, {s['unreachable']} starts unreachable"
            )
            if s["runs"]:
                print(
                    f"  largest final error {1000 * s['ee_error_final_max_m']:.3g} mm, "
                    f"least clearance {s['min_clearance_m']:.3f} m, "
                    f"{s['runs_with_contact']} with contact, {s['solver_failures']} solver failures"
                )
    for row in result["unreachable"]:
        where = ", ".join(f"{k} {v:g}" for k, v in row.items() if k not in ("kind", "reason"))
        print(f"unreachable: {row['kind'].replace('_', ' ')}, {where}: {row['reason']}")
    for name in result["files"]:
        print(out / name)
