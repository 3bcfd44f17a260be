"""`dbb screenshot`: pictures of a scenario without a display."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from app.cli.common import load_robot_and_border, print_json
from app.cli.looks import DarkOption, LightOption, Picture, is_dark
from app.cli.options import (
    ConfigOption,
    Json,
    Setup,
    SetupOptions,
    check_file,
    check_name,
    configured,
)
from app.cli.records import Given, from_record
from app.jobs.progress import progress_bar
from app.simulation.scenarios.names import SCENARIOS, scenario_of
from app.strict import check_range

if TYPE_CHECKING:
    from PIL import Image

    from app.config import Config

_MOST_PICTURES = 12


def screenshot(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")],
    *,
    at: Annotated[tuple[float, ...], tyro.conf.arg(metavar="SECONDS")],
    out: Path,
    picture: Annotated[Given, from_record(Picture)],
    setup: SetupOptions,
    dark: DarkOption = False,
    light: LightOption = False,
    config: ConfigOption = None,
    json: Json = False,
) -> None:
    """Draw a scenario at some times, in a browser that nobody sees.

    Args:
        scenario: As for `dbb run`.
        at: [s] into the scenario; several (--at 0 3 6) make a strip, side by side with their times.
        out: The picture, PNG.
    """
    check_name("scenario", scenario, SCENARIOS)
    chosen, shown = Setup(**setup), Picture(**picture)
    check_range("--at", len(at), 1, _MOST_PICTURES, "times")
    check_file("--out", out, (".png",))
    tuned = configured(config)
    ground = is_dark(dark=dark, light=light)
    whole = _draw(scenario, at, chosen, tuned, shown, dark=ground)
    whole.save(out, optimize=True)
    if json:
        print_json(
            {
                "picture": str(out),
                "scenario": scenario,
                "controller": chosen.controller,
                "robot": chosen.robot,
                "seed": chosen.seed,
                "at_s": list(at),
                "width_px": whole.width,
                "height_px": whole.height,
                "layer": shown.layer,
                "view": shown.view,
                "page": shown.page,
            }
        )
    else:
        print(out)


def _draw(
    name: str, at: tuple[float, ...], setup: Setup, config: Config, shown: Picture, *, dark: bool
) -> Image.Image:
    """Run the scenario and draw it at these times [s]."""
    # Imported here: viser and scipy would make every other command start later.
    from app.dashboard.export.browser import chromium
    from app.dashboard.export.screenshot import Look, strip, take_pictures
    from app.robot.assets import load_robot
    from app.simulation.run import steps_of
    from app.simulation.trace.trace import filmed

    scenario = scenario_of(load_robot(setup.robot), name)
    for t in at:
        check_range("--at", t, 0.0, scenario.duration, "s")
    look = Look(shown.width, shown.height, shown.layer, shown.view, dark, shown.page)
    with chromium() as browser:  # first of all: without one the rest is in vain
        model, data = load_robot_and_border(setup.robot)
        with progress_bar(f"{name}, {setup.controller}", max(at)) as on_progress:
            steps = steps_of(
                model,
                data,
                scenario,
                config,
                controller=setup.controller,
                physics=setup.physics,
                seed=setup.seed,
            )
            snapshots = filmed(steps, scenario, at, on_progress)
        pictures = take_pictures(browser, snapshots, at, model, data.clouds, look)
    return pictures[0] if len(pictures) == 1 else strip(pictures, at, dark=dark)
