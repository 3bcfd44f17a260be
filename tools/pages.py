"""Fill the generated blocks of README and docs: `python -m tools.pages [--check]`.

A pair of comments marks the place in a page:

    <!-- generated: results scenarios -->
    <!-- end -->

`BLOCKS` has the function that fills each block: tables of the results in docs/results, parameters
and commands of the program, packages by their docstrings.
"""

from __future__ import annotations

import argparse
import ast
import contextlib
import io
import re
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from unittest import mock

from app.cli.main import main as dbb
from app.cli.options import fields_of
from app.config import sections
from app.control.quantities import DIMENSIONS, QUANTITIES
from app.simulation.scenarios import SCENARIOS
from app.simulation.trace.metrics import DOOR, FIGURES
from app.studies.pulls.parameters import LOGARITHMIC, StudyRange
from tools import results
from tools.measured import grid

PROJECT = Path(__file__).resolve().parent.parent
BLOCK = re.compile(r"^(<!-- generated: (.+?) -->\n)(.*?)^(<!-- end -->)$", re.S | re.M)
COMMAND = re.compile(r"^\W*([a-z][a-z-]+) {2,}[A-Z]", re.M)
"""A command in the help of `dbb`: its name, then its description."""
WIDTH = "124"  # [-] characters in a line of a command's help


def pages() -> list[Path]:
    """All pages that can have generated blocks."""
    own = [PROJECT / name for name in ("README.md", "SECURITY.md")]
    return [*own, *sorted((PROJECT / "docs").rglob("*.md"))]


def generated(text: str) -> str:
    """A page with its blocks filled again.

    Raises:
        SystemExit: A block has an unknown name.
    """
    return BLOCK.sub(lambda found: f"{found[1]}{made(found[2])}\n{found[4]}", text)


def made(name: str) -> str:
    """The generated text of a block, without the comments around it.

    Raises:
        SystemExit: The name is unknown.
    """
    kind, _, argument = name.partition(" ")
    if kind not in BLOCKS or (kind == "results" and argument not in results.SETS):
        sys.exit(f"no generated block {name!r}; there are {', '.join(BLOCKS)}")
    return BLOCKS[kind](*argument.split())


def parameters() -> str:
    """A table of the parameters of each section, from the records of app/config.py."""
    parts = []
    for section in sections():
        rows = [
            [
                f"`{each.path.partition('.')[2]}`",
                f"`{each.default}`" if each.choices else f"{each.default:g}",
                " or ".join(f"`{choice}`" for choice in each.choices)
                or f"{each.low:g} to {each.high:g}",
                each.unit,
                each.help.replace("|", "\\|"),
                each.source,
            ]
            for each in section.tunables
        ]
        header = ["name", "default", "range", "unit", "meaning", "source of the default"]
        used = slice(None) if any(each.source for each in section.tunables) else slice(-1)
        table = grid(header[used], [row[used] for row in rows])
        parts.append(f"## `[{section.name}]`\n\n{section.about}\n\n{table}")
    return "\n\n".join(parts)


def quantities() -> str:
    """The table of quantities of a control step, from app/control/quantities.py."""
    sizes = grid(["size", "meaning"], [[f"`{k}`", text] for k, text in DIMENSIONS.items()])
    rows = [
        [f"`{q.name}`", q.symbol, q.meaning, q.shape or "1", q.unit or "-", q.frame, q.source]
        for q in QUANTITIES
    ]
    header = ["name", "symbol", "meaning", "shape", "unit", "frame", "source"]
    return f"{sizes}\n\n{grid(header, rows)}"


def study_range() -> str:
    """The table of the intervals from which `dbb study` draws random quantities, by option.

    The rows are the fields of the record `StudyRange` in app/studies/pulls/parameters.py.
    """
    rows = []
    for name, field in fields_of(StudyRange):
        unit, _, text = field.help.removeprefix("[").partition("]")
        value = field.default
        drawn = " to ".join(f"{x:g}" for x in value) if isinstance(value, tuple) else f"{value:g}"
        if name in LOGARITHMIC:
            text += " The distribution is uniform on a logarithmic scale."
        option, meaning = f"`--{name.replace('_', '-')}`", " ".join(text.split())
        rows.append([option, drawn.replace("-", "−"), unit, meaning])
    return grid(["option", "default", "unit", "meaning"], rows)


def commands() -> str:
    """The printed help of each command, and the options of each scenario."""
    own = grid(
        ["scenario", "its own options"],
        [
            [f"`{name}`", ", ".join(f"`--{each.replace('_', '-')}`" for each in scenario.options)]
            for name, scenario in SCENARIOS.items()
        ],
    )
    return f"{own}\n\n" + "\n\n".join(
        f"### `dbb {name}`\n\n```text\n{help_of(*name.split())}\n```" for name in command_names()
    )


def command_names() -> list[str]:
    """The commands in the order of `dbb --help`."""
    return list(dict.fromkeys(COMMAND.findall(help_of())))


def help_of(*words: str) -> str:
    """The output of `dbb WORDS --help`, without a terminal."""
    plain = {"COLUMNS": WIDTH, "NO_COLOR": "1", "TERM": "dumb"}
    printed = io.StringIO()
    with (
        mock.patch.dict("os.environ", plain),
        contextlib.redirect_stdout(printed),
        contextlib.suppress(SystemExit),
    ):
        dbb([*words, "--help"])
    return "\n".join(line.rstrip() for line in printed.getvalue().strip().splitlines())


def figures() -> str:
    """A table of the keys of a run's results, with the meaning of each result."""
    return grid(
        ["key", "meaning"],
        [[f"`{key}`", figure.about] for key, figure in {**FIGURES, **DOOR}.items()],
    )


def packages() -> str:
    """A row for each module directly in `app`, and for each package below it."""
    rows = []
    app = PROJECT / "app"
    for path in sorted(app.iterdir()):
        if path.suffix == ".py" and not path.stem.startswith("__"):
            rows.append([f"`app/{path.name}`", about(path)])
    for path in sorted(app.rglob("__init__.py")):
        if path.parent != app:
            rows.append([f"`{path.parent.relative_to(PROJECT).as_posix()}/`", about(path)])
    return grid(["module or package", "contents"], rows)


def step() -> str:
    """The files that a control step enters, in order, with their descriptions."""
    found = results.figures("house").get("house", {}).get("step", [])
    lines = [f"{k}. `{name}`: {about(PROJECT / name)}" for k, name in enumerate(found, start=1)]
    return "\n".join([*lines, "", results.caption("house")])


def about(path: Path) -> str:
    """The first paragraph of a module's docstring, in one line; a note if the file is missing."""
    if not path.is_file():
        return "(no longer there)"
    text = ast.get_docstring(ast.parse(path.read_text(encoding="utf-8"))) or ""
    return " ".join(text.partition("\n\n")[0].split()).replace("|", "\\|")


BLOCKS: dict[str, Callable[..., str]] = {
    "results": results.table,
    "parameters": parameters,
    "quantities": quantities,
    "commands": commands,
    "figures": figures,
    "study_range": study_range,
    "packages": packages,
    "step": step,
}


def words(text: str) -> list[str]:
    """The words of a page without its layout, because versions of tyro draw different boxes."""
    return re.sub(r"[\s╭╮╰╯│─┌┐└┘]+|-{5,}", " ", text).split()


def stale() -> Iterator[Path]:
    """Pages with outdated generated blocks."""
    for path in pages():
        text = path.read_text(encoding="utf-8")
        if words(generated(text)) != words(text):
            yield path


def main() -> int:
    """Write the pages, or list the outdated ones."""
    parser = argparse.ArgumentParser(prog="python -m tools.pages", description=__doc__)
    parser.add_argument("--check", action="store_true", help="status 1 if a page is outdated")
    options = parser.parse_args()
    if options.check:
        found = [path.relative_to(PROJECT) for path in stale()]
        print(*found, sep="\n", end="\n" if found else "")
        return int(bool(found))
    for path in pages():
        text = path.read_text(encoding="utf-8")
        if (new := generated(text)) != text:
            path.write_text(new, encoding="utf-8")
            print(path.relative_to(PROJECT))
    return 0


if __name__ == "__main__":
    sys.exit(main())
