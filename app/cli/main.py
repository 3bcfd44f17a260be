"""Entry point: subcommands, and errors as one clear line with a status that is not zero."""

from __future__ import annotations

import logging
import os
import sys

import tyro

from app.cli.bench import bench
from app.cli.border import border
from app.cli.check_robot import check_robot
from app.cli.config import config
from app.cli.new_robot import new_robot
from app.cli.pairs import pairs
from app.cli.reach import reach
from app.cli.replay import replay
from app.cli.report import report
from app.cli.reproduce import reproduce
from app.cli.robots import robots
from app.cli.run import run
from app.cli.screenshot import screenshot
from app.cli.serve import serve
from app.cli.study import study
from app.cli.sweep import sweep
from app.errors import DbbError

_COMMANDS = {
    "serve": serve,
    "run": run,
    "pairs": pairs,
    "border": border,
    "reach": reach,
    "report": report,
    "replay": replay,
    "screenshot": screenshot,
    "reproduce": reproduce,
    "study": study,
    "sweep": sweep,
    "bench": bench,
    "config": config,
    "robots": robots,
    "new-robot": new_robot,
    "check-robot": check_robot,
}


def main(args: list[str] | None = None) -> None:
    """Run the command line; ends the process with status 0 only if it did what was asked."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        tyro.extras.subcommand_cli_from_dict(
            _COMMANDS,
            prog="dbb",
            description="Reactive self-collision avoidance for a mobile manipulator.",
            args=args,
            config=(tyro.conf.DisallowNone,),
        )
        sys.stdout.flush()
    except DbbError as error:
        print(f"dbb: error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:  # whoever read the results has gone, as `head` does
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)
    except KeyboardInterrupt:
        print("dbb: interrupted", file=sys.stderr)
        sys.exit(130)
