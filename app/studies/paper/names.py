"""All figures by their names: what each needs, and the function that draws it."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import NamedTuple

from app.errors import UnknownNameError
from app.studies.drawing import Drawing
from app.studies.paper import acting, continuity, density, guiding, offline, refrigerator, tracking
from app.studies.paper.experiments import Experiment, Sources


class FigureMaker(NamedTuple):
    """How a figure is made.

    Attributes:
        draw: Draws it from the runs.
        needs: The experiments that it shows.
    """

    draw: Callable[[Sources], Drawing]
    needs: tuple[Experiment, ...] = ()


FIGURES = {
    "fig3": FigureMaker(offline.figure_3),
    "fig5": FigureMaker(offline.figure_5),
    "fig6": FigureMaker(offline.figure_6),
    "fig7": FigureMaker(acting.figure_7, acting.NEEDS_7),
    "fig8": FigureMaker(acting.figure_8, acting.NEEDS),
    "fig10": FigureMaker(acting.figure_10),
    "fig11": FigureMaker(tracking.figure_11, tracking.METHODS),
    "fig12": FigureMaker(tracking.figure_12, tracking.METHODS),
    "fig13": FigureMaker(guiding.figure_13, guiding.NEEDS),
    "fig14": FigureMaker(guiding.figure_14, guiding.NEEDS),
    "fig15": FigureMaker(guiding.figure_15, guiding.NEEDS_COMPARED),
    "fig16": FigureMaker(refrigerator.figure_16, (refrigerator.DBB,)),
    "fig17": FigureMaker(refrigerator.figure_17, refrigerator.NEEDS),
    "fig18": FigureMaker(refrigerator.figure_18, refrigerator.NEEDS),
    "density": FigureMaker(density.figure_density, density.NEEDS),
    "continuity": FigureMaker(continuity.figure_continuity, continuity.NEEDS),
}
"""In the order of the paper."""


def chosen(names: Iterable[str]) -> list[str]:
    """The figures of these names, each once and in the order of the paper; all if none is named.

    Raises:
        UnknownNameError: Lists those that exist.
    """
    asked = set(names)
    for name in sorted(asked - FIGURES.keys()):
        raise UnknownNameError("figure", name, FIGURES)
    return [name for name in FIGURES if name in asked or not asked]
