"""How the page names what (10) makes its score of, by kind of base."""

from __future__ import annotations

from typing import NamedTuple


class BaseMeasure(NamedTuple):
    """Words for `BaseKind.singularity`.

    Attributes:
        title: Its name, as HTML.
        unit: Of it, and of the score.
        label: Its name in a table, as HTML.
        hint: What it says of a point.
        score: How (10) makes the score of it.
    """

    title: str = "measure of the base"
    unit: str = ""
    label: str = "measure of the base"
    hint: str = "how well the base moves the point; in the place of (7)"
    score: str = "measure · R"


_BY_KIND = {
    "differential": BaseMeasure(
        title="det(J<sub>c</sub>J<sub>c</sub><sup>T</sup>), (7)",
        unit="m⁴/rad⁴",
        label="far from singular, det",
        hint="(7): 0 on the wheels' axis, where the base cannot move the point sideways",
        score="sign · det · R",
    )
}


def measure_of(kind: str) -> BaseMeasure:
    """The words for a kind of base, by its name in a description."""
    return _BY_KIND.get(kind, BaseMeasure())
