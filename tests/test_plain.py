"""The checker of prose finds sentences that reviewers had to read twice, and passes plain ones."""

from __future__ import annotations

from pathlib import Path

import pytest

from tools import plain

HARD = """
What the base is asked besides T_sca's own rows is asked with gains that its rate can follow, else
it and the arm would fight.

That is, of what base and arm would do if the arm had no limits, T_ee being far costlier, and the
base's rows as far as they are active.

The rows fix it once the solution without them is known, in which the arm's own rows against the
base have no part: there the base's rows say how it helps.

Parts of a link that are farther than its nearest by less share in the closest point.

At which the hand takes back an error at most, however large it is.

By how much others accelerate a joint otherwise a second later; or m/s².

Noise of measured velocities at least, per noise of positions; more of it is learnt.

The third differences of what is not known of a motion are noise of the positions, with 20 times
its variance.

So it gives in by ε at most of what the tasks alone would have asked beyond it, and no soft limit,
nor two that contradict each other, can leave the problem without an answer.

The change (k,) of what is given with which all x come nearest to the least with it.

If it asked for all at once, the torques of all others would swing from end to end for it, each
too late, and throw an arm that is overpowered about.

It does not hold the hand: the base takes it along, the distance stays what it was, and the base
would drive on with the hand before it.

At each of the table's heights some ring shows: what hides one is nearer to the outside.

What gives nothing back writes to its arguments: they stay as they are.

The same with arrays as they come: of any strides, and read-only if need be.

What it takes to play again what has begun in the last second, or, of what people may pull as they
like, has ended; else None.

Who is compared stays in the list where he was chosen.
"""
"""Sentences of earlier docstrings and help texts, as a review quotes them; blank lines between."""

PLAIN = """
Upper bound of the end-effector's correction speed.
All base motion that does not come from T_sca uses gains slow enough for the base's 10 Hz.
Each limit's slack is at most ε times the violation of the unconstrained solution.
What is a link pair?
""".strip().splitlines()


@pytest.mark.parametrize("sentence", [" ".join(each.split()) for each in HARD.split("\n\n")])
def test_a_sentence_that_a_review_quotes_is_found(sentence: str) -> None:
    assert plain.reason_of(sentence)


@pytest.mark.parametrize("sentence", PLAIN)
def test_a_plain_sentence_passes(sentence: str) -> None:
    assert list(plain.findings(plain.Text(1, sentence))) == []


def test_docstrings_comments_and_messages_are_read_with_their_lines(tmp_path: Path) -> None:
    module = tmp_path / "module.py"
    module.write_text(
        '"""A module.\n\nIt does what it does.\n"""\n'
        "\n"
        "x = 1  # what is one here\n"
        "# A block whose second line\n"
        "# was told something.\n"
        'message = f"the value {x} is what was read"\n'
        'what = "what"\n',
        encoding="utf-8",
    )
    assert [finding.line for finding in plain.check(module)] == [3, 6, 7, 9]


def test_paragraphs_items_and_rows_of_a_page_are_read_without_its_code(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "# A page\n\nPlain words\nand what is not.\n\n- an item\n- what an item is\n\n"
        "| a row | whatever |\n\n```python\n# what is code\n```\n\nThe option `what` is code.\n",
        encoding="utf-8",
    )
    assert [finding.line for finding in plain.check(page)] == [3, 7, 9]


def test_a_long_sentence_is_found() -> None:
    assert plain.reason_of("word " * (plain.LONGEST + 1)).startswith("a sentence of 51 words")
    assert not plain.reason_of("word " * plain.LONGEST)


def test_the_whole_project_is_checked() -> None:
    """The check is part of `make lint`."""
    names = {path.name for path in plain.whole()}
    assert {"README.md", "method.md", "config.py", "oracle.py"} <= names
