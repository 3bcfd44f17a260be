"""`dbb study`: random pulls by the thousand, and where safety ends."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import Annotated, Any

import tyro

from app.cli.common import print_json
from app.cli.options import (
    NO_DEFAULT,
    Flag,
    Json,
    Processes,
    Setup,
    SetupOptions,
    check_processes,
    make_folder,
)
from app.cli.records import Given, from_record
from app.jobs.progress import progress_bar
from app.strict import check_range
from app.studies.pulls.parameters import StudyParameters, StudyRange

_MOST_CASES = 10_000_000
_COUNTS = (
    "cases",
    "failed",
    "contact",
    "bodies_overlap",
    "arm_contact",
    "arm_bodies_overlap",
    "solver_failure",
    "nan",
    "error",
)
_WIDTHS = {"cases": 5, "failed": 6, "entered_buffer": 6, "bodies_overlap": 7, "contact": 7}


def study(
    cases: int = 2000,
    *,
    ranges: Annotated[Given, from_record(StudyRange)],
    setup: SetupOptions,
    inside: Annotated[
        Flag, tyro.conf.arg(help="Draw only cases inside of the stated envelope.")
    ] = False,
    scheduler: Annotated[str | None, NO_DEFAULT] = None,
    processes: Processes = None,
    out: Path = Path("out/study"),
    json: Json = False,
) -> None:
    """Pull the hand at the base by the thousand, at random.

    From all around, with noise, delay, slip and a wrong model. Weak and strong, soft and stiff,
    light and heavy hands pull; some let go on the way, and some of those take hold again. Each case
    is kept as soon as it is done: a study that was ended goes on where it was when it is called
    again with the same options, and more cases than before are added to it.

    Args:
        cases: How many.
        scheduler: Address of a running dask scheduler, whose workers have this project installed;
            by default processes on this machine.
        out: Folder for `results.parquet`, `study.json`, `report.html` and `failures/`.
    """
    check_range("--cases", cases, 1, _MOST_CASES)
    chosen = asdict(Setup(**setup))
    parameters = StudyParameters(**chosen, inside=inside, ranges=StudyRange(**ranges))
    side_by_side = check_processes(processes)
    # Imported here: it takes longer than to find a mistake in what was asked.
    from app.robot.description import load_robot

    load_robot(parameters.robot)
    make_folder(out)
    from app.studies.pulls.study import study as run_study

    with _kept(cases, out) as on_progress:
        result = run_study(
            parameters,
            cases,
            out,
            scheduler=scheduler,
            processes=side_by_side,
            on_progress=on_progress,
        )
    if json:
        print_json(result)
    else:
        _print(result, out)


@contextmanager
def _kept(cases: int, out: Path) -> Iterator[Callable[[float], None]]:
    """A progress bar that says, when it is interrupted, what is kept and how it goes on."""
    kept = 0.0

    def count(done: float) -> None:
        nonlocal kept
        kept = done
        update(done)

    try:
        with progress_bar(f"{cases} cases", cases) as update:
            yield count
    except KeyboardInterrupt:
        print(
            f"{kept:g} of {cases} cases are kept in {out}; the same command goes on with the rest",
            file=sys.stderr,
        )
        raise


def _print(result: dict[str, Any], out: Path) -> None:
    for key in _COUNTS:
        print(f"{key.replace('_', ' '):28} {result[key]}")
    if (least := result["min_clearance_m"]) is not None:
        print(f"{'least distance to the base':28} {least['0_%']:.4g} m, median {least['50_%']:.4g}")
    print(f"{'came into the buffer':28} {100 * result['entered_buffer_share']:.3g} %")
    if (force := result["hand_force_max_n"]) is not None:
        told = f"{force['0_%']:.3g} to {force['100_%']:.3g} N, median {force['50_%']:.3g}"
        print(f"{'largest force exerted':28} {told}")
    print(f"{'force until near [N]':28} cases failed buffer overlap contact  least [m] hand [m/s]")
    for counts in result["by_force"]:
        if counts["cases"]:
            print(_force_line(counts))
    for name, title in (("inside", "inside the stated envelope"), ("outside", "outside of it")):
        told = result["stated_envelope"][name]
        bound = f", at most {100 * told['rate_bound_95']:.2g} % with 95 % confidence"
        print(f"{title:28} {told['failed']} of {told['cases']} failed{bound}")
    print(f"{out / 'report.html'}")


def _force_line(counts: dict[str, Any]) -> str:
    low, high = counts["from_n"], counts["to_n"]
    name = f"above {low:g}" if high is None else f"{low:g} to {high:g}"
    numbers = (f"{counts[key]:{width}}" for key, width in _WIDTHS.items())
    least, fastest = counts["least_clearance_m"], counts["hand_speed_max_mps"]
    ends = (f"{'–' if value is None else f'{value:.3f}':>10}" for value in (least, fastest))
    return f"  {name:26} {' '.join(numbers)} {' '.join(ends)}"
