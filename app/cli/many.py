"""`dbb reproduce`, `sweep` and `study`: the paper's runs, paths from all sides, random pulls."""

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import tyro

from app.cli import options
from app.cli.common import print_json, print_table, show
from app.cli.options import Given, from_record
from app.jobs.progress import progress_bar
from app.strict import check_range
from app.studies.pulls.parameters import StudyParameters, StudyRange
from app.studies.sweep.plan import OPTIONS, SweepPlan

_FIGURES = tyro.conf.arg(metavar="[FIGURE …]", help_behavior_hint="")
_OF_SWEEP = {"buffer_distance": "border.d_b", "base_weight": "task.base_weight"}


def reproduce(
    figures: Annotated[tuple[str, ...], tyro.conf.Positional, _FIGURES] = (),
    *,
    out: Path = Path("out/reproduction"),
    seed: int = 0,
    processes: options.Processes = None,
    json: options.Json = False,
) -> None:
    """Run the paper's experiments, draw its figures, check its claims.

    Args:
        figures: Names of figures: fig3, fig5 to fig8, fig10 to fig18; density and continuity (both
            for §4.3); departures (effects of departures from (26) to (29)). Default: all.
        out: Folder for a PNG and CSV files of each figure, `metrics.json` and `index.html`.
        seed: Seed of all random numbers of the runs.
    """
    from app.studies.paper import report

    names = report.chosen(figures)
    options.check_seed(seed)
    workers = options.check_processes(processes)
    options.make_folder(out)
    text = f"{len(names)} figures" if len(names) > 1 else names[0]
    with progress_bar(text, report.work(names)) as on_progress:
        result = report.reproduce(names, out, seed=seed, processes=workers, on_progress=on_progress)
    if json:
        print_json(result)
        return
    for name, figure in result["figures"].items():
        print(f"{name:8} {figure['title']}")
    for claim in result["claims"]:
        mark = "holds   " if claim["holds"] else "DOES NOT"
        print(f"{mark} §{claim['section']} {claim['paper']}\n         {claim['measured']}")
    print(out / result["page"])


def sweep(
    plan: Annotated[Given, from_record(SweepPlan, leave=("config",), names=OPTIONS)],
    parameter: Annotated[Given, options.parameter_options(_OF_SWEEP)],
    config: options.ConfigOption = None,
    processes: options.Processes = None,
    out: Path = Path("out/sweep"),
    json: options.Json = False,
) -> None:
    """Move the end-effector towards the base from all sides; draw maps.

    There are three kinds of paths: horizontal paths to the middle of the base's bounding box,
    horizontal paths parallel to the wheel axis and, with --above, vertical paths down onto the
    base. Each path starts outside all buffers, at --start-distance or, if the arm does not reach
    this start, at another distance. The output lists a path without a start as unreachable. At the
    start of a path parallel to the wheel axis, the arm's closest point has the x coordinate 0, ±1,
    ±10 or ±50 mm in the base's frame.

    Args:
        out: Folder for `sweep.json`, `sweep.csv`, and a PNG for each height and speed; with
            --above, also a PNG of the vertical paths for each speed.
    """
    if "controllers" in plan:
        plan["controllers"] = [name for name in ",".join(plan["controllers"]).split(",") if name]
    for name in OPTIONS.keys() & plan.keys():
        plan[name] = tuple(dict.fromkeys(plan[name]))
    tuned = options.configured(plan.get("robot", SweepPlan.robot), config, parameter, _OF_SWEEP)
    made = SweepPlan(**plan, config=tuned)
    options.check_seed(made.seed)
    workers = options.check_processes(processes)
    options.make_folder(out)
    from app.studies.sweep.sweep import sweep as make
    from app.studies.sweep.sweep import write_sweep

    with progress_bar("sweep", 1.0) as on_progress:
        result = make(made, processes=workers, on_progress=on_progress)
    result["files"] = write_sweep(result, out)
    if json:
        print_json(result)
        return
    found = [(name, *each) for name, kinds in result["summary"].items() for each in kinds.items()]
    for controller, kind, s in found:
        print(f"{controller}, {kind.replace('_', ' ')}:")
        print(f"  {s['passed']} of {s['runs']} runs passed, {s['unreachable']} starts unreachable")
        if s["runs"]:
            print(
                f"  largest final error {1000 * s['ee_error_final_max_m']:.3g} mm, "
                f"smallest clearance {s['min_clearance_m']:.3f} m, "
                f"{s['runs_with_contact']} with contact, {s['solver_failures']} solver failures"
            )
    for row in result["unreachable"]:
        where = ", ".join(f"{k} {v:g}" for k, v in row.items() if k not in ("kind", "reason"))
        print(f"unreachable: {row['kind'].replace('_', ' ')}, {where}: {row['reason']}")
    for name in result["files"]:
        print(out / name)


def study(
    cases: int = 2000,
    *,
    ranges: Annotated[Given, from_record(StudyRange)],
    setup: options.SetupOptions,
    inside: options.Flag = False,
    time_stamps: options.Flag = False,
    scheduler: Annotated[str | None, options.NO_DEFAULT] = None,
    processes: options.Processes = None,
    out: Path = Path("out/study"),
    json: options.Json = False,
) -> None:
    """Simulate persons who pull the end-effector, in random cases.

    The pulls lead towards or along the base from all sides, with noise, delay, slip and model
    errors. The force, stiffness and mass of the hand vary. In some cases the person releases the
    end-effector early, and in some of these cases grasps it again. Each finished case is stored.
    After an interruption, the same command continues the study. More --cases extend the study.

    Args:
        cases: Number of cases.
        inside: Narrow the ranges of the random quantities to the envelope that
            docs/safety_study.md states; a range completely outside the envelope is an error.
        time_stamps: The controller gets the time of a clock and the time stamps of the readings.
        scheduler: Address of a running dask scheduler; the scheduler's workers need this project.
            Default: processes on this machine.
        out: Folder for `results.parquet`, `study.json`, `report.html` and `failures/`.
    """
    check_range("--cases", cases, 1, 10_000_000)
    chosen, drawn = asdict(options.Setup(**setup)), StudyRange(**ranges)
    parameters = StudyParameters(**chosen, inside=inside, time_stamps=time_stamps, ranges=drawn)
    workers = options.check_processes(processes)
    from app.robot.description import load_robot

    load_robot(parameters.robot)
    options.make_folder(out)
    from app.studies.pulls.study import study as run_study

    with _resumable(cases, out) as on_progress:
        result = run_study(
            parameters, cases, out, scheduler=scheduler, processes=workers, on_progress=on_progress
        )
    if json:
        print_json(result)
        return
    from app.studies.pulls.report import outcome

    verdict, forces = outcome(result)
    for text in verdict.text:
        show(text)
    for grid in forces.tables:
        print_table(grid.head, [list(map(str, row)) for row in grid.rows], forces.title)
    print(out / "report.html")


@contextmanager
def _resumable(cases: int, out: Path) -> Iterator[Callable[[float], None]]:
    """Show a progress bar; after Ctrl-C, print the number of stored cases, and how to continue."""
    stored = 0.0

    def count(done: float) -> None:
        nonlocal stored
        stored = done
        update(done)

    try:
        with progress_bar(f"{cases} cases", cases) as update:
            yield count
    except KeyboardInterrupt:
        text = f"{stored:.0f} of {cases} cases are stored in {out}"
        print(f"{text}; the same command continues the study", file=sys.stderr)
        raise
