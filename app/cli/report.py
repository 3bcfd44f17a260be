"""`dbb report`: a run's log as a page with figures and key numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from app.cli.common import print_json
from app.cli.options import Json, check_file
from app.cli.wanted import trace_of
from app.system import write_whole


def report(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    out: Path = Path("out/report.html"),
    json: Json = False,
) -> None:
    """Make one HTML file of a log: figures and key numbers.

    Args:
        log: File that `dbb run --log` or `--out` wrote, or that of a case, JSON.
        out: The HTML file.
    """
    # Imported here: matplotlib and pyarrow would make every other command start later.
    from app.studies.run_report import key_numbers, run_report

    check_file("--out", out, (".html",))
    run = trace_of(log)
    write_whole(out, run_report(run))
    if json:
        about = {"scenario": run.meta.scenario, "robot": run.meta.robot, "seed": run.meta.seed}
        print_json({**about, "page": str(out), **key_numbers(run)})
    else:
        print(out)
