"""`dbb screenshot` and `film`: pictures of a scenario; `replay` and `report`: HTML of a log."""

from __future__ import annotations

import math
from contextlib import ExitStack, closing
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import Annotated, Any

import tyro

from app.cli import common, options
from app.control import CONTROLLERS
from app.dashboard.export import Look
from app.errors import ConfigError, check_name
from app.jobs.progress import progress_bar
from app.simulation.case import RunSpec
from app.simulation.scenarios.line import Point
from app.strict import check_range
from app.system import whole_file, write_whole

_BESIDE = tyro.conf.arg(metavar="CONTROLLER …", help_behavior_hint="")


def screenshot(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")],
    *,
    at: Annotated[tuple[float, ...], tyro.conf.arg(metavar="SECONDS …")],
    out: Path,
    picture: Annotated[options.Given, options.from_record(Look, leave=("pair",))],
    setup: options.SetupOptions,
    config: options.ConfigOption = None,
    json: options.Json = False,
) -> None:
    """Draw pictures of a scenario at some times, without a display.

    Args:
        scenario: A scenario of `dbb run`, or the JSON file of a case; a case determines robot,
            parameters and seed.
        at: [s] one to 12 times since the start of the scenario; several times, such as
            --at 0 3 6, make a strip of pictures.
        out: The PNG file.
    """
    common.is_case(scenario)
    look = Look(**picture)
    check_range("--at", len(at), 1, 12, "times")
    options.check_file("--out", out, (".png",))
    asked = common.spec_named(scenario, setup, config)
    for t in at:
        check_range("--at", t, 0.0, asked.scenario.duration, "s")
    from app.dashboard.export.browser import chromium
    from app.dashboard.export.screenshot import strip, take_pictures

    with chromium() as browser:  # first, because a missing browser must be reported at once
        model, data = common.load_robot_and_border(asked.robot)
        snapshots = common.filmed(asked, model, data, at)
        pictures = take_pictures(browser, snapshots, at, model, data.clouds, look)
    whole = pictures[0] if len(pictures) == 1 else strip(pictures, at, dark=look.dark)
    with whole_file(out) as beside:
        whole.save(beside, "PNG", optimize=True)
    result = {
        "picture": str(out),
        "scenario": asked.scenario.name,
        **{name: getattr(asked, name) for name in ("controller", "robot", "seed")},
        "at_s": list(at),
        "width_px": whole.width,
        "height_px": whole.height,
        **{name: getattr(look, name) for name in ("layer", "view", "page")},
    }
    common.print_json(result) if json else print(out)


@dataclass(frozen=True)
class Filming:
    rate: float = 25.0
    """[1/s] frame rate of the film."""
    speed: float = 1.0
    """[-] playback speed; 1 is real time."""
    orbit: float = 0.0
    """[deg/s] angular speed of the camera around the robot, per second of the film."""
    span: tuple[float, float] | None = None
    """[s] start and end of the filmed part of the scenario; default: the whole scenario."""
    side_by_side: bool = False
    """Draw the robot of each controller of --beside in its own view, left of the main view, not as
    a ghost."""
    start: Point | None = None
    """[m] start of the end-effector in the world; default: that of the scenario."""
    move: Point | None = None
    """[m] displacement of the end-effector in the world; default: that of the scenario."""
    codec: str = ""
    """Codec of the film: h264 (default) or h265 for .mp4; vp9 (default) or vp8 for .webm."""

    def __post_init__(self) -> None:
        check_range("--rate", self.rate, 1.0, 60.0, "1/s")
        check_range("--speed", self.speed, 0.05, 20.0)
        check_range("--orbit", self.orbit, -360.0, 360.0, "deg/s")


def film(
    scenario: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")],
    *,
    out: Path,
    beside: Annotated[tuple[str, ...], _BESIDE] = (),
    filming: Annotated[options.Given, options.from_record(Filming)],
    picture: Annotated[options.Given, options.from_record(Look, leave=("page", "pair"))],
    setup: options.SetupOptions,
    config: options.ConfigOption = None,
    json: options.Json = False,
) -> None:
    """Film a scenario without a display, frame by frame.

    Args:
        scenario: A scenario of `dbb run`, or the JSON file of a case; a case determines robot,
            parameters and seed.
        out: The file, which ends in .mp4, .webm, .webp (animated) or .gif.
        beside: Controllers for comparison; their robots appear as ghosts, or in views of their own
            with --side-by-side.
    """
    from app.dashboard.export.offscreen import CODECS

    common.is_case(scenario)
    for name in beside:
        check_name("controller of --beside", name, CONTROLLERS)
    look, how = Look(**picture), Filming(**filming)
    options.check_file("--out", out, tuple(CODECS))
    codecs = CODECS[out.suffix.lower()]
    if how.side_by_side and not beside:
        raise ConfigError("--side-by-side needs --beside CONTROLLER")
    codec = how.codec or next(iter(codecs))
    check_name(f"--codec of {out.suffix}", codec, codecs)
    asked = common.spec_named(scenario, setup, config)
    asked = asked._replace(scenario=asked.scenario.changed(start=how.start, move=how.move))
    result = {"film": str(out), "scenario": asked.scenario.name, "beside": list(beside)}
    result |= _film(asked, beside, how, codec, look, out)
    common.print_json(result) if json else print(out)


def _film(
    asked: RunSpec, beside: tuple[str, ...], how: Filming, codec: str, look: Look, out: Path
) -> dict[str, Any]:
    from app.dashboard.export.browser import chromium
    from app.dashboard.export.offscreen import film_pictures, side_by_side, with_ghosts, write_film

    duration = asked.scenario.duration
    begin, end = how.span or (0.0, duration)
    check_range("--span", end, 0.0, duration, "s")
    check_range("--span: the start", begin, 0.0, end, "s")
    step = how.speed / how.rate
    times = [begin + k * step for k in range(1 + int((end - begin) / step + 1e-9))]
    with chromium() as browser:  # first, because a missing browser must be reported at once
        model, data = common.load_robot_and_border(asked.robot)
        runs = [asked, *(asked._replace(controller=name) for name in beside)]
        found = [common.filmed(run, model, data, times) for run in runs]
        scene, orbit = (times, model, data.clouds, look), math.radians(how.orbit) / how.rate
        if how.side_by_side:
            framed, robots = [*chain.from_iterable(found)], (*found[1:], found[0])
            films = [film_pictures(browser, each, *scene, orbit, framed=framed) for each in robots]
            pictures = (side_by_side(each) for each in zip(*films, strict=True))
        else:
            shown = with_ghosts(found[0], found[1:])
            films = [pictures := film_pictures(browser, shown, *scene, orbit)]
        with progress_bar(out.name, len(times)) as on_progress, ExitStack() as stack:
            for each in films:
                stack.enter_context(closing(each))
            began = perf_counter()
            count = write_film(out, pictures, how.rate, codec, on_progress)
            took = perf_counter() - began
    return {
        "pictures": count,
        "codec": codec,
        "duration_s": count / how.rate,
        "size_bytes": out.stat().st_size,
        "pictures_per_second": count / took,
    }


def replay(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    out: Path = Path("out/replay.html"),
    looks: Annotated[options.Given, options.from_record(Look, only=("layer", "view", "light"))],
    json: options.Json = False,
) -> None:
    """Make a web page that replays the run of a log in any browser.

    The page needs no network.

    Args:
        log: A .csv or .parquet log of `dbb run`, or the JSON file of a case, whose run is then
            executed.
        out: The HTML file.
    """
    from app.dashboard.export.offscreen import replay_html

    look = Look(**looks)
    options.check_file("--out", out, (".html",))
    read = common.trace_of(log)
    model, data = common.load_robot_and_border(read.meta.robot)
    duration = read.snapshots[-1].t - read.snapshots[0].t
    with progress_bar(out.name, 1.0) as on_progress:
        page = replay_html(read, model, data.clouds, look, on_progress=on_progress)
    write_whole(out, page)
    result = {"page": str(out), "scenario": read.meta.scenario, "robot": read.meta.robot}
    result |= {"duration_s": duration, "size_bytes": out.stat().st_size}
    common.print_json(result) if json else print(out)


def report(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    out: Path = Path("out/report.html"),
    json: options.Json = False,
) -> None:
    """Make one HTML file from a log, with plots and key numbers.

    Args:
        log: A .csv or .parquet log of `dbb run`, or the JSON file of a case, whose run is then
            executed.
        out: The HTML file.
    """
    from app.studies.run_report import key_numbers, run_report

    options.check_file("--out", out, (".html",))
    run = common.trace_of(log)
    write_whole(out, run_report(run))
    if json:
        about = {"scenario": run.meta.scenario, "robot": run.meta.robot, "seed": run.meta.seed}
        common.print_json({**about, "page": str(out), **key_numbers(run)})
    else:
        print(out)
