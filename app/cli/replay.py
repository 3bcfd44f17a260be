"""`dbb replay`: a run's log as a page that plays in any browser."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from app.cli.common import load_robot_and_border, print_json, progress_bar
from app.cli.looks import Flag, LayerOption, ViewOption, is_dark
from app.cli.options import Json, check_file


def replay(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    out: Path = Path("out/replay.html"),
    layer: LayerOption = "score",
    view: ViewOption = "iso",
    dark: Flag = False,
    light: Flag = False,
    json: Json = False,
) -> None:
    """Make one HTML file of a log that plays the run in any browser, without a network.

    Args:
        log: File that `dbb run --log` wrote.
        out: The HTML file.
        layer: What the border is coloured by; none hides it.
        view: Where the run is looked at from at first.
        dark: A dark page, the default.
        light: A light page.
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: viser and pyarrow would make every other command start later.
    from app.dashboard.export.replay import replay_html
    from app.simulation.trace.log import read_log

    ground = is_dark(dark=dark, light=light)
    check_file("--out", out, (".html",))
    read = read_log(log)
    model, data = load_robot_and_border(read.meta.robot)
    duration = read.snapshots[-1].t - read.snapshots[0].t
    with progress_bar(out.name, duration) as on_progress:
        page = replay_html(
            read, model, data.clouds, layer=layer, view=view, dark=ground, on_progress=on_progress
        )
    out.write_text(page, encoding="utf-8")
    if json:
        print_json(
            {
                "page": str(out),
                "scenario": read.meta.scenario,
                "robot": read.meta.robot,
                "duration_s": duration,
                "size_bytes": out.stat().st_size,
            }
        )
    else:
        print(out)
