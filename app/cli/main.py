"""Entry point: subcommands, and errors as one clear line with a status that is not zero."""

from __future__ import annotations

import inspect
import logging
import os
import sys
from collections.abc import Callable
from importlib import import_module, metadata
from typing import Any

from app.errors import DbbError, UnknownNameError, extras_named
from app.jobs.signals import ending_signals_raised

COMMANDS = {
    "A robot that moves": ("serve", "run", "screenshot", "report", "replay"),
    "The method": ("pairs", "border", "reach", "config", "bench"),
    "Many runs": ("reproduce", "sweep", "study"),
    "Robots": ("robots", "new-robot", "check-robot"),
}
"""The commands, by what they are about; each stands in the module of its own name."""
_FORMERLY = {"compare-robots": ("sweep", "robots")}
_ABOUT = "Reactive self-collision avoidance for a mobile manipulator."


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
    if not words:
        sys.stderr.write(overview())
        sys.exit(2)
    if words[0] in ("-h", "--help"):
        sys.stdout.write(overview())
    elif words[0] == "--version":
        print(f"dbb {metadata.version('dbb-mobile-manipulator')}")
    else:
        _run_command(*_FORMERLY.get(words[0], words[:1]), *words[1:])


def _run_command(name: str, *words: str) -> None:
    """Import the command that is asked for, and what it needs; nothing else is imported."""
    import tyro

    from app.cli.options import check_once, in_present_words

    path, function, rest = choose(name, in_present_words(words))
    check_once(rest)
    tyro.cli(function, prog=f"dbb {path}", args=rest, config=(tyro.conf.DisallowNone,))


def choose(name: str, words: list[str]) -> tuple[str, Callable[..., Any], list[str]]:
    """The function behind a command, its name with that of what it is about, and the other words.

    Raises:
        UnknownNameError: No such command, or nothing that it could be about.
    """
    known = [each for group in COMMANDS.values() for each in group]
    if name not in known:
        raise UnknownNameError("command (dbb --help lists them)", name, known)
    module = import_module(f"app.cli.{name.replace('-', '_')}")
    if not hasattr(module, "choose"):
        return name, getattr(module, name.replace("-", "_")), words
    about, function, rest = module.choose(words)
    return f"{name} {about}".strip(), function, rest


def overview() -> str:
    """All commands, one line each."""
    lines = ["usage: dbb COMMAND …, dbb COMMAND --help, dbb --version", _ABOUT]
    for title, names in COMMANDS.items():
        lines.append(f"{title}:")
        for name in names:
            _, function, _ = choose(name, [])
            lines.append(f"  {name:12} {(inspect.getdoc(function) or '').splitlines()[0]}")
    return "\n".join(lines) + "\n"
