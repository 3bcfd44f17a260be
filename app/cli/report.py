"""`dbb report`: a run's log as a page with figures and key numbers."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import tyro

from app.cli.common import print_json
from app.cli.options import Json, check_file


def report(
    log: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="LOG")],
    *,
    out: Path = Path("out/report.html"),
    json: Json = False,
) -> None:
    """Make one HTML file of a log: figures and key numbers.

    Args:
        log: File that `dbb run --log` or `--out` wrote.
        out: The HTML file.
    """
    # Imported here: matplotlib and pyarrow would make every other command start later.
    from app.simulation.trace.trace import read_trace
    from app.studies.run_report.report import key_numbers, run_report

    check_file("--out", out, (".html",))
    run = read_trace(log)
    out.write_text(run_report(run), encoding="utf-8")
    if json:
        about = {"scenario": run.meta.scenario, "robot": run.meta.robot, "seed": run.meta.seed}
        print_json({**about, "page": str(out), **key_numbers(run)})
    else:
        print(out)
