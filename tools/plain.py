"""Sentences that are hard to read: `python -m tools.plain [PATH ...]`, part of `make lint`.

It reads the docstrings, comments and messages of Python files and the text of Markdown pages; by
default those of the whole project without `EXCEPT`. It prints file and line, the sentence, and the
reason. The status is 1 if it finds such a sentence.
"""

from __future__ import annotations

import argparse
import ast
import io
import re
import sys
import tokenize
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

PROJECT = Path(__file__).resolve().parent.parent
CHECKED = ("app", "benchmarks", "docs", "examples", "tests", "tools")
EXCEPT = ("app/dashboard", "tests/test_plain.py")
"""The dashboard has its own wording; the test quotes hard sentences."""
LONGEST = 50  # [-] largest number of words of at least three letters in a sentence
MESSAGE = 4  # [-] words of the shortest string that counts as a message

PATTERNS = {
    re.compile(pattern, re.IGNORECASE): reason
    for pattern, reason in {
        r"\bwhat\b(?![- ]if\b|:)": "a clause with `what` as subject or object: use a noun",
        r"\b(who|what|which)ever\b": "a clause with `whoever` or `whatever`: use a noun",
        r"\bat (most|least)(?=[,.;:)]|$| (of|and|or|by|per|for)\b)": (
            "a bound as an adverb: say 'upper bound', 'lower bound', or 'at most 3'"
        ),
        r"\bby (less(?! than)|how much)\b": "a quantity as an adverb: name the quantity",
        r", (above|at|below|by|for|from|in|of|on|to|with) (which|whose|whom)\b": (
            "a relative clause that starts with a preposition: start a new sentence"
        ),
        r"\b(ask(s|ed)? (for|of)|(is|are|was|were) asked)\b": (
            "an everyday word: commanded, requested, required"
        ),
        r"\btold\b": "an everyday word: reported, specified",
        r"\b(as far as|otherwise than|none that|if need be|at (its|the) begin)\b": (
            "an everyday phrase: name the condition or the range"
        ),
        r"(?<!soon )(?<!long )\bas (it|they) (is|are|was|were|comes?|stands?)\b": (
            "a comparison that names no state: name the state"
        ),
        r"\b(he|him|himself|his)\b": "a person is 'they'",
    }.items()
}

_END = re.compile(
    r"(?<=[a-z0-9)`”\"'])[.!?](?=\s+[A-Z`\[(*“]|\s*$)"  # the end of a sentence
    r"|\n\s*\n|\s\|\s|\n(?=\s+(\*{0,2}\w+: |\S+ {2,}))"  # a paragraph, a cell, an argument
)
_ITEM = re.compile(r"^\s*([-*]|\d+\.|#+|>|\|)\s")
_CODE = re.compile(r"`[^`]*`|(?<=\])\([^)]*\)")
_MARKUP = re.compile(r"^\s*<|=>|\\b|^\s*(import|from) ", re.MULTILINE)
_WORD = re.compile(r"\b[A-Za-z]{3,}\b")


class Text(NamedTuple):
    """A connected piece of prose.

    Attributes:
        line: Line of its first word in the file.
        text: The words, with their line breaks.
        exact: Whether the text has the same line breaks as the file.
    """

    line: int
    text: str
    exact: bool = True


class Finding(NamedTuple):
    """A sentence with its line and the reason why it is hard to read."""

    line: int
    sentence: str
    reason: str


def texts_of_python(source: str) -> Iterator[Text]:
    """Docstrings, comments and strings of several words of a module.

    Consecutive lines of comments are one text; the fields of an f-string become an ellipsis.
    """
    yield from _comments(source)
    inner: set[int] = set()
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.JoinedStr):
            inner |= {id(part) for part in node.values}
            parts = [str(p.value) if isinstance(p, ast.Constant) else "…" for p in node.values]
            text, exact = "".join(parts), False
        elif isinstance(node, ast.Constant) and isinstance(node.value, str):
            text = node.value
            exact = node.end_lineno == node.lineno + text.count("\n")
        else:
            continue
        if id(node) not in inner and len(text.split()) >= MESSAGE and not _MARKUP.search(text):
            yield Text(node.lineno, text, exact)


def _comments(source: str) -> Iterator[Text]:
    block: list[str] = []
    last = 0
    for token in tokenize.generate_tokens(io.StringIO(source).readline):
        if token.type != tokenize.COMMENT:
            continue
        alone = not token.line[: token.start[1]].strip()
        if block and not (alone and token.start[0] == last + 1):
            yield Text(last - len(block) + 1, "\n".join(block))
            block = []
        block.append(token.string.lstrip("#! "))
        last = token.start[0]
        if not alone:
            yield Text(last, block.pop())
    if block:
        yield Text(last - len(block) + 1, "\n".join(block))


def texts_of_markdown(source: str) -> Iterator[Text]:
    """Paragraphs, items of lists and rows of tables of a page, without code.

    Generated blocks are left out: their words are strings of the code, or results on the disk.
    """
    block: list[str] = []
    first = 0
    fenced = made = False
    for number, line in enumerate([*source.splitlines(), ""], 1):
        fence = line.lstrip().startswith(("```", "~~~"))
        made = line.startswith("<!-- generated") or (made and not line.startswith("<!--"))
        apart = fenced or fence or made or not line.strip() or line.startswith(("    ", "<!--"))
        if block and (apart or _ITEM.match(line)):
            yield Text(first, "\n".join(block))
            block = []
        if not apart:
            first = first if block else number
            block.append(_ITEM.sub("", line, count=1))
        fenced ^= fence


def findings(text: Text) -> Iterator[Finding]:
    """The sentences of a text that match a pattern or are too long, each with one reason."""
    start = 0
    for end in [*(found.end() for found in _END.finditer(text.text)), len(text.text)]:
        piece = text.text[start:end]
        before = text.text[: start + len(piece) - len(piece.lstrip())].count("\n")
        line = text.line + before * text.exact
        sentence = " ".join(piece.split())
        start = end
        if sentence and not sentence.endswith("?") and (reason := reason_of(sentence)):
            yield Finding(line, sentence, reason)


def reason_of(sentence: str) -> str:
    """Why a sentence is hard to read; empty if no pattern finds it."""
    plain = _CODE.sub("`…`", sentence)
    for pattern, reason in PATTERNS.items():
        if pattern.search(plain):
            return reason
    words = len(_WORD.findall(plain))
    return f"a sentence of {words} words: split it" if words > LONGEST else ""


def check(path: Path) -> list[Finding]:
    """The findings of a file, by their lines."""
    source = path.read_text(encoding="utf-8")
    texts = texts_of_python if path.suffix == ".py" else texts_of_markdown
    return sorted(finding for text in texts(source) for finding in findings(text))


def files(paths: Iterable[Path]) -> list[Path]:
    """The Python files and Markdown pages among files and in folders."""
    return [
        file
        for path in paths
        for file in (sorted(path.rglob("*")) if path.is_dir() else [path])
        if file.suffix in (".py", ".md")
    ]


def whole() -> list[Path]:
    """All checked files of the project."""
    places = [*(PROJECT / name for name in CHECKED), *sorted(PROJECT.glob("*.md"))]
    apart = [PROJECT / name for name in EXCEPT]
    return [file for file in files(places) if not any(map(file.is_relative_to, apart))]


def main() -> int:
    """Print the findings; 1 if there are any."""
    parser = argparse.ArgumentParser(prog="python -m tools.plain", description=__doc__)
    parser.add_argument("paths", nargs="*", type=Path, help="files and folders; default: all")
    named = parser.parse_args().paths
    count = 0
    for path in files(named) or whole():
        for finding in check(path):
            where = path.resolve().relative_to(PROJECT)
            print(f"{where}:{finding.line}: {finding.sentence}\n    {finding.reason}")
            count += 1
    print(f"{count} sentences to rewrite" if count else "Every sentence passes.")
    return int(count > 0)


if __name__ == "__main__":
    sys.exit(main())
