"""The control law's measurements: `python -m benchmarks.law NAME`."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from functools import wraps
from typing import Any

os.environ.setdefault("OMP_NUM_THREADS", "1")  # before the import of numpy; children inherit it

import tyro

from app.errors import DbbError
from benchmarks.law.buffer import buffer
from benchmarks.law.continuity import continuity
from benchmarks.law.curvature import curvature
from benchmarks.law.energy import energy
from benchmarks.law.options import Options
from benchmarks.law.paths import paths
from benchmarks.law.pulls import pulls
from benchmarks.law.release import release
from benchmarks.law.report import Report, show
from benchmarks.law.speeds import speeds
from benchmarks.law.wander import wander

MEASUREMENTS: dict[str, Callable[..., Report]] = {
    "release": release,
    "pulls": pulls,
    "wander": wander,
    "continuity": continuity,
    "paths": paths,
    "curvature": curvature,
    "speeds": speeds,
    "energy": energy,
    "buffer": buffer,
}
"""The measurements by their names on the command line."""


def main() -> None:
    """Run the chosen measurement and print its table.

    Raises:
        SystemExit: An argument is wrong; the message names the fault.
    """
    try:
        tyro.extras.subcommand_cli_from_dict(
            {name: _shown(measure) for name, measure in MEASUREMENTS.items()},
            config=(tyro.conf.OmitArgPrefixes,),
        )
    except DbbError as error:
        sys.exit(f"error: {error}")


def _shown(measure: Callable[..., Report]) -> Callable[..., None]:
    """A function that has the arguments of a measurement and prints the measurement's report."""

    @wraps(measure)
    def run(options: Options, **others: Any) -> None:
        show(measure(options, **others), options)

    run.__annotations__ = {**measure.__annotations__, "return": None}
    return run


if __name__ == "__main__":
    main()
