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
    """Make one HTML file of a log, with figures and key numbers, that needs nothing else.

    Args:
        log: File that `dbb run --log` wrote.
        out: The HTML file.
        json: Print the key numbers as one JSON object on standard output and nothing else there.
    """
    # Imported here: matplotlib and pyarrow would make every other command start later.
    from app.simulation.trace.log import read_log
    from app.studies.run_report.numbers import key_numbers, track_of
    from app.studies.run_report.report import run_report

    check_file("--out", out, (".html",))
    read = read_log(log)
    out.write_text(run_report(read), encoding="utf-8")
    if json:
        about = {"scenario": read.meta.scenario, "robot": read.meta.robot, "seed": read.meta.seed}
        print_json({**about, "page": str(out), **key_numbers(read, track_of(read))})
    else:
        print(out)
