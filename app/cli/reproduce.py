"""`dbb reproduce`: the paper's experiments and figures, and whether its claims hold here."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from app.cli.common import print_json, progress_bar
from app.cli.options import Json, check_range, check_seed, make_folder

_MOST_PROCESSES = 64


def reproduce(
    figures: Annotated[tuple[str, ...], tyro.conf.Positional, tyro.conf.arg(metavar="FIGURE")] = (),
    *,
    out: Path = Path("out/reproduction"),
    seed: int = 0,
    processes: int | None = None,
    json: Json = False,
) -> None:
    """Run the experiments of §4.2, draw the paper's figures with their data, judge its claims.

    Args:
        figures: fig3, fig5 to fig8, fig10 to fig18, or density and continuity for §4.3; all if none
            is named.
        out: Folder for a PNG and CSVs a figure, `metrics.json` and `index.html`.
        seed: Seed of everything random in the runs.
        processes: How many runs to do side by side (default: 2, or as many as there are cores).
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: matplotlib and scipy would make every other command start later.
    from app.studies.paper.experiments import default_processes
    from app.studies.paper.names import chosen
    from app.studies.paper.report import reproduce as make
    from app.studies.paper.report import work

    names = chosen(figures)
    check_seed(seed)
    if processes is not None:
        check_range("--processes", processes, 1, _MOST_PROCESSES)
    make_folder(out)
    text = f"{len(names)} figures" if len(names) > 1 else names[0]
    with progress_bar(text, work(names)) as on_progress:
        result = make(
            names,
            out,
            seed=seed,
            processes=processes or default_processes(),
            on_progress=on_progress,
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
