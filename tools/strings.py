"""All texts that a person can read on the page or the command line, panel by panel.

`python -m tools.strings [FILE ...]` prints them for reading in one sitting; default: the files
of the dashboard. Docstrings and comments are left out.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterator
from pathlib import Path

_ROOT = Path(__file__).parent.parent
_WORDS = re.compile(r"[A-Za-z]{2,}[^a-z]*\s+\S*[A-Za-z]|^[A-Z][a-z]+")
_MARKUP = re.compile(r"[<;{]|^\.|^/|:\s*\d|^[a-z_]+:[a-z-]+$")


def texts(source: str) -> Iterator[tuple[int, str]]:
    """Line and text of each string of a module that reads like words."""
    tree = ast.parse(source)
    documentation = {
        id(node.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            parts = (p.value if isinstance(p, ast.Constant) else "…" for p in node.values)
            documentation |= {id(part) for part in node.values}
            text = "".join(map(str, parts))
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
        else:
            continue
        if id(node) not in documentation and _WORDS.search(text) and not _MARKUP.search(text):
            yield node.lineno, " ".join(text.split())


def main(paths: list[str]) -> None:
    """Print the texts of files."""
    found = [Path(path) for path in paths] or sorted((_ROOT / "app/dashboard").rglob("*.py"))
    for path in found:
        lines = sorted(set(texts(path.read_text(encoding="utf-8"))))
        if lines:
            print(f"\n{path.resolve().relative_to(_ROOT)}")
            print("\n".join(f"{line:5}  {text}" for line, text in lines))


if __name__ == "__main__":
    main(sys.argv[1:])
