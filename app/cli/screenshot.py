"""`dbb screenshot`: pictures of a scenario without a display."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from app.cli.common import load_robot_and_border, print_json, progress_bar
from app.cli.looks import Flag, LayerOption, ViewOption, is_dark
from app.cli.options import Json, check_file, check_name, check_range, check_seed, configured
from app.control.controller import CONTROLLERS
from app.robot.assets import load_robot
from app.simulation.plants.choice import chosen_plant
from app.simulation.scenarios.names import SCENARIOS, scenario_of

_SIZES = 64, 8192  # [px]
_MOST_PICTURES = 12


def screenshot(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")],
    *,
    at: Annotated[tuple[float, ...], tyro.conf.arg(metavar="SECONDS")],
    out: Path,
    controller: str = "dbb",
    robot: str = "husky_panda",
    layer: LayerOption = "score",
    view: ViewOption = "iso",
    width: int = 1280,
    height: int = 720,
    page: Flag = False,
    dark: Flag = False,
    light: Flag = False,
    config: Path | None = None,
    physics: str | None = None,
    seed: int = 0,
    json: Json = False,
) -> None:
    """Draw a scenario at some times, in a browser of its own that nobody sees.

    Args:
        scenario: As for `dbb run`.
        at: [s] into the scenario; several make a strip, side by side with their times.
        out: The picture, PNG.
        controller: dbb, or one it is compared with (repulsive, barrier), or none.
        robot: Name of the robot; `dbb robots` lists them.
        layer: What the border is coloured by; none hides it.
        view: Where the scene is looked at from.
        width: [px] of each picture.
        height: [px] of each picture.
        page: The whole dashboard, not the scene alone.
        dark: A dark ground, the default.
        light: A light ground.
        config: File of parameters, TOML, as `dbb config` writes it.
        physics: planar, mujoco, mujoco-contact or kinematic (default: planar where pybullet is
            installed, else mujoco).
        seed: Seed of everything random in the run.
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: viser and scipy would make every other command start later.
    from app.dashboard.export.browser import chromium
    from app.dashboard.export.screenshot import Look, strip, take_pictures
    from app.simulation.run import steps_of
    from app.simulation.trace.tape import filmed

    check_name("scenario", scenario, SCENARIOS)
    chosen = scenario_of(load_robot(robot), scenario)
    check_name("controller", controller, CONTROLLERS)
    physics = chosen_plant(physics)
    check_range("--at", len(at), 1, _MOST_PICTURES, "times")
    for t in at:
        check_range("--at", t, 0.0, chosen.duration, "s")
    check_range("--width", width, *_SIZES, "px")
    check_range("--height", height, *_SIZES, "px")
    check_seed(seed)
    check_file("--out", out, (".png",))
    look = Look(width, height, layer, view, is_dark(dark=dark, light=light), page)
    tuned = configured(config)
    with chromium() as browser:  # first of all: without one the rest is in vain
        model, data = load_robot_and_border(robot)
        with progress_bar(f"{scenario}, {controller}", max(at)) as on_progress:
            steps = steps_of(
                model, data, chosen, tuned, controller=controller, physics=physics, seed=seed
            )
            snapshots = filmed(steps, chosen, at, on_progress)
        pictures = take_pictures(browser, snapshots, at, model, data.clouds, look)
    whole = pictures[0] if len(pictures) == 1 else strip(pictures, at, dark=look.dark)
    whole.save(out, optimize=True)
    if json:
        print_json(
            {
                "picture": str(out),
                "scenario": scenario,
                "controller": controller,
                "robot": robot,
                "seed": seed,
                "at_s": list(at),
                "width_px": whole.width,
                "height_px": whole.height,
                "layer": layer,
                "view": view,
                "page": page,
            }
        )
    else:
        print(out)
