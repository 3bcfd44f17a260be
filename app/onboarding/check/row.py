"""A check of a robot, and how it ended."""

from __future__ import annotations

from typing import Literal, NamedTuple

Outcome = Literal["passed", "warned", "failed"]


class Row(NamedTuple):
    """One check.

    Attributes:
        name: What was checked.
        outcome: passed, warned or failed.
        text: One sentence.
        numbers: What was measured; keys end in their unit.
    """

    name: str
    outcome: Outcome
    text: str
    numbers: dict[str, float]
