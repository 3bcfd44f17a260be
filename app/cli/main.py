"""Entry point of the command line: it selects the subcommand, and prints errors as one line."""

import ast
import atexit
import errno
import inspect
import logging
import os
import re
import shutil
import sys
import textwrap
from contextlib import suppress
from importlib import import_module, metadata
from pathlib import Path
from typing import NoReturn

from app.errors import DbbError, check_name, extras_named, printable
from app.jobs.progress import ending_signals_raised
from app.system import open_standard_files, set_missing_folders

COMMANDS = {  # the commands by topic, each with the module that defines its function
    "Runs and pictures": {"serve": "serve", "run": "run"}
    | dict.fromkeys(("screenshot", "film", "report", "replay"), "pictures"),
    "The method": dict.fromkeys(("pairs", "border", "reach", "config", "bench"), "method"),
    "Many runs": dict.fromkeys(("reproduce", "sweep", "study"), "many"),
    "Robots": dict.fromkeys(("robots", "new-robot", "check-robot"), "robots"),
}
_MODULES = {name: module for group in COMMANDS.values() for name, module in group.items()}
_NARROWEST = 40  # [-] smallest number of columns of a help text
_FULL = errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EBADF  # errors of a write


def console() -> NoReturn:
    """Run the command line, and end the process without freeing all objects.

    Freeing them takes up to a second; during this time the process would ignore signals.
    """
    status = 0
    try:
        main()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else 0 if end.code is None else 1
    except BaseException as defect:
        sys.excepthook(type(defect), defect, defect.__traceback__)
        status = 1
    atexit._run_exitfuncs()  # as in multiprocessing's processes
    try:
        sys.stdout.flush()
    except OSError:  # a help text cannot be written
        status = status or 1
    with suppress(OSError):  # the reader has closed the pipe
        sys.stderr.flush()
    os._exit(status)


def main(args: list[str] | None = None) -> None:
    """Run a command line, by default `sys.argv[1:]`; an error exits, a defect raises."""
    open_standard_files()
    set_missing_folders()
    os.environ["MPLBACKEND"] = "agg"  # a notebook's backend needs a library of the notebook
    logging.basicConfig(level=logging.INFO, stream=sys.stderr)
    for handler in logging.getLogger().handlers:
        handler.setFormatter(_Plain("%(message)s"))
    try:
        with ending_signals_raised(), extras_named():
            _run(sys.argv[1:] if args is None else args)
        sys.stdout.flush()
        return
    except DbbError as error:
        fault = str(error)
    except MemoryError as error:
        fault = f"too little memory: {error}"
    except ImportError as error:
        if not str(error.path).endswith(".so"):  # a defect of this program
            raise
        fault = f"a library cannot be loaded: {error}"
    except OSError as error:
        if error.errno == errno.EPIPE:  # the reader, such as `head`, has ended
            sys.exit(1)
        where = error.filename or "a file or the standard output" * (error.errno in _FULL)
        fault = f"{where}: {error.strerror or error}".removeprefix(": ")
    except KeyboardInterrupt:
        _end("interrupted", 130)
    _end(f"error: {fault}", 2)


def _end(text: str, status: int) -> NoReturn:
    with suppress(OSError):  # the standard error is full, too
        print(printable(f"dbb: {text}"), file=sys.stderr)
    sys.exit(status)


class _Plain(logging.Formatter):
    """Formats log records; `printable` replaces their control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def _run(words: list[str]) -> None:
    """Run a command line without an import of the modules of other commands."""
    if not words:
        sys.stderr.write(overview())
        sys.exit(2)
    name, *rest = words
    if name in ("-h", "--help"):
        sys.stdout.write(overview())
        return
    if name == "--version":
        print(f"dbb {metadata.version('dbb-mobile-manipulator')}")
        return
    check_name("command (dbb --help lists them)", name, _MODULES)
    import tyro

    from app.cli.options import in_order

    if shutil.get_terminal_size().columns < _NARROWEST:
        os.environ["COLUMNS"] = str(_NARROWEST)  # in fewer columns tyro's help does not end
    module, rest = import_module(f"app.cli.{_MODULES[name]}"), in_order(rest)
    function = getattr(module, name.replace("-", "_"))
    if name == "run":  # each scenario has its own options
        scenario, function, rest = module.choose_run(rest)
        name = f"{name} {scenario}".strip()
    function.__doc__, description = _help_texts(function.__doc__ or "")
    marks = (tyro.conf.DisallowNone,)
    tyro.cli(function, prog=f"dbb {name}", description=description, args=rest, config=marks)


def _help_texts(doc: str) -> tuple[str, str]:
    """`doc` with each argument's text on one line; the text before the arguments, with line breaks.

    tyro joins lines that begin with a letter; therefore all lines after the first are indented.
    """
    doc = re.sub(r"\n {8,}(?=\S)", " ", inspect.cleandoc(doc))
    text = re.sub(r"(?<=\S)\n(?=\S)", " ", doc.partition("\n\nArgs:")[0])
    width, filled = shutil.get_terminal_size().columns, []
    for k, line in enumerate(filter(None, text.split("\n"))):
        item = re.match(r"  \S+ {2,}", line)  # a name and its description
        indent = "  " if k and not item else ""
        hanging = " " * (item.end() if item else 2)
        filled.append(textwrap.fill(line, width, initial_indent=indent, subsequent_indent=hanging))
    return doc, "\n".join(filled)


def overview() -> str:
    """All commands, one on each line, read from the source files because imports take time."""
    lines = ["usage: dbb COMMAND …, dbb COMMAND --help, dbb --version"]
    lines.append("Reactive self-collision avoidance for a mobile manipulator.")
    for title, commands in COMMANDS.items():
        lines.append(f"{title}:")
        for name, module in commands.items():
            source = Path(__file__).with_name(f"{module}.py").read_text(encoding="utf-8")
            functions = (n for n in ast.parse(source).body if isinstance(n, ast.FunctionDef))
            (command,) = (f for f in functions if f.name == name.replace("-", "_"))
            lines.append(f"  {name:12} {(ast.get_docstring(command) or '').splitlines()[0]}")
    return "\n".join(lines) + "\n"
