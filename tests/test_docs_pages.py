"""README and documentation agree with the project: tables, links, files, packages."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from app.simulation.plants import default_plant
from tests.readme import DOCS, PROJECT, README, page
from tools import pages

LONGEST_README = 220  # [-] lines
HARD_WORDS = ("told", "at the begin", "whoever", "somebody", "thrice")
"""Words that a plain sentence does not need."""
LINK = re.compile(r"\]\(([^)\s]+)\)")


def prose(path: Path) -> str:
    """A page without code and generated blocks."""
    text = pages.BLOCK.sub("", path.read_text(encoding="utf-8"))
    return re.sub(r"^```.*?^```$", "", text, flags=re.M | re.S)


def anchors(path: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and Sphinx make them."""
    headings = re.findall(r"^#+ (.+)$", prose(path), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


@pytest.mark.parametrize("path", pages.pages(), ids=lambda path: path.name)
def test_generated_blocks_are_up_to_date(path: Path) -> None:
    if path.name == "commands.md" and default_plant() != "planar":
        pytest.skip("the default plants on this page require pybullet")
    text = path.read_text(encoding="utf-8")
    same = pages.words(pages.generated(text)) == pages.words(text)
    assert same, f"{path.name} is stale: python -m tools.pages"


@pytest.mark.parametrize("path", pages.pages(), ids=lambda path: path.name)
def test_every_link_within_the_project_has_a_target(path: Path) -> None:
    for link in LINK.findall(prose(path)):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (path.parent / file) if file else path
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target), link


@pytest.mark.parametrize("path", pages.pages(), ids=lambda path: path.name)
def test_every_file_that_a_page_names_exists(path: Path) -> None:
    folders = "app|tests|tools|benchmarks|examples|robot_assets|dbb_cache|docs"
    named = re.findall(rf"`((?:{folders})/[\w./]*)`", path.read_text(encoding="utf-8"))
    missing = [name for name in named if "NAME" not in name and not (PROJECT / name).exists()]
    assert missing == []


@pytest.mark.parametrize("path", pages.pages(), ids=lambda path: path.name)
def test_a_page_avoids_hard_words(path: Path) -> None:
    found = re.findall(rf"\b(?:{'|'.join(HARD_WORDS)})\b", prose(path), re.I)
    assert found == []


def test_every_page_is_listed_in_the_index() -> None:
    listed = set(re.findall(r"^([a-z_]+)$", page("index"), re.M))
    assert listed == {path.stem for path in DOCS.glob("*.md")} - {"index"}


def test_every_package_is_named_in_the_architecture() -> None:
    packages = {path.parent for path in (PROJECT / "app").glob("*/__init__.py")}
    names = {f"`{path.relative_to(PROJECT).as_posix()}/`" for path in packages}
    assert len(names) > 5
    assert [name for name in sorted(names) if name not in page("architecture")] == []


def test_the_readme_is_short() -> None:
    assert len(README.splitlines()) <= LONGEST_README


def test_an_unknown_generated_block_is_refused() -> None:
    text = "<!-- generated: riddles -->\n<!-- end -->\n"
    with pytest.raises(SystemExit, match="'riddles'; there are results, parameters"):
        pages.generated(text)


def test_only_the_content_of_a_block_is_replaced() -> None:
    text = "before\n\n<!-- generated: packages -->\n<stale>\n<!-- end -->\n\nafter\n"
    made = pages.generated(text)
    assert made.startswith("before\n\n<!-- generated: packages -->\n| module or package |")
    assert made.endswith("|\n<!-- end -->\n\nafter\n")
    assert "<stale>" not in made
    assert pages.generated(made) == made
