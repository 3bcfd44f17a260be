"""`dbb reproduce`: the paper's experiments and figures, and whether its claims hold here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from app.cli.common import print_json
from app.cli.options import Json, Processes, check_processes, check_seed, make_folder
from app.jobs.progress import progress_bar


def reproduce(
    figures: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FIGURE")] = (),
    *,
    out: Path = Path("out/reproduction"),
    seed: int = 0,
    processes: Processes = None,
    json: Json = False,
) -> None:
    """Run the paper's experiments, draw its figures, judge its claims.

    Args:
        figures: fig3, fig5 to fig8, fig10 to fig18, or density and continuity for §4.3; all if none
            is named.
        out: Folder for a PNG and CSVs a figure, `metrics.json` and `index.html`.
        seed: Seed of everything random in the runs.
    """
    # Imported here: matplotlib and scipy would make every other command start later.
    from app.studies.paper import report

    names = report.chosen(figures)
    check_seed(seed)
    side_by_side = check_processes(processes)
    make_folder(out)
    text = f"{len(names)} figures" if len(names) > 1 else names[0]
    with progress_bar(text, report.work(names)) as on_progress:
        result = report.reproduce(
            names, out, seed=seed, processes=side_by_side, on_progress=on_progress
        )
    if json:
        print_json(result)
    else:
        _print(result, out)


def _print(result: dict[str, Any], out: Path) -> None:
    for name, figure in result["figures"].items():
        print(f"{name:8} {figure['title']}")
    for claim in result["claims"]:
        print(
            f"{'holds   ' if claim['holds'] else 'DOES NOT'} §{claim['section']} {claim['paper']}"
        )
        print(f"         {claim['measured']}")
    print(f"{out / result['page']}")
