"""Entry point: subcommands, and errors as one clear line with a status that is not zero."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from importlib import import_module
from typing import Any

from app.cli.signals import ending_signals_raised
from app.errors import DbbError, extras_named

_COMMANDS = (
    "serve",
    "run",
    "pairs",
    "border",
    "reach",
    "report",
    "replay",
    "screenshot",
    "reproduce",
    "study",
    "sweep",
    "bench",
    "config",
    "robots",
    "new-robot",
    "check-robot",
    "compare-robots",
)


def main(args: list[str] | None = None) -> None:
    """Run the command line; ends the process with status 0 only if it did what was asked."""
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    try:
        with ending_signals_raised(), extras_named():
            _run(sys.argv[1:] if args is None else args)
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


def _run(words: list[str]) -> None:
    """Only the command that is asked for is imported: a process that is spawned begins here too."""
    import tyro

    config = (tyro.conf.DisallowNone,)
    if words and words[0] in _COMMANDS:
        tyro.cli(_command(words[0]), prog=f"dbb {words[0]}", args=words[1:], config=config)
        return
    tyro.extras.subcommand_cli_from_dict(
        {name: _command(name) for name in _COMMANDS},
        prog="dbb",
        description="Reactive self-collision avoidance for a mobile manipulator.",
        args=words,
        config=config,
    )


def _command(name: str) -> Callable[..., Any]:
    """The function of a command: it stands in the module of its own name."""
    own = name.replace("-", "_")
    return getattr(import_module(f"app.cli.{own}"), own)
