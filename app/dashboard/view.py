"""View of one viewer: layers, colours and plots that are shown.

Callbacks assign a field, the drawing thread reads it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field, fields
from typing import Literal, NamedTuple

import numpy as np

from app.dashboard.scene.legend import QUANTITIES

HIDDEN = "hidden"
"""Instead of a quantity: the border is not drawn."""
CHOICES = (*reversed(QUANTITIES), HIDDEN)
"""What a border may be coloured by."""


@dataclass
class View:
    """Layers of the scene; each field is one assignment of a callback."""

    borders: dict[str, str]
    """What the border of each pair of L_m is coloured by: one of `QUANTITIES`, or `HIDDEN`."""
    whole_border: bool = False
    """Also the part of the border above the base's top, which hides the arm."""
    slice: bool = True
    """The border's contour at the hand's height."""
    shell: bool = False
    """The border as a translucent body, in the place of its points."""
    meshes: bool = True
    bodies: bool = False
    distances: bool = True
    """Lines between the closest points of the pairs."""
    labels: Literal["active", "all", "none"] = "active"
    """Which of these lines carry their distance."""
    acting: bool = True
    """Acting points and the forces of avoidance."""
    names: bool = False
    """Names of p_a, p_b, p_n, p_t and p_act."""
    motion: bool = True
    """The person's force, and the accelerations asked of the base."""
    trails: bool = True
    """Where base and hand have been."""
    follow: bool = True
    """Whether the camera follows the base."""
    dark: bool = True
    light: bool = False
    """Drawn for who has no GPU: fewer triangles and points, no shadows, fewer pictures."""
    plots: set[str] = field(default_factory=set)
    """Titles of the plots that are shown."""

    def take_over(self, other: View) -> None:
        """See what another viewer sees."""
        for each in fields(self):
            setattr(self, each.name, copy(getattr(other, each.name)))

    def of_robot(self, pairs: list[str], plots: list[str]) -> View:
        """The same choices for another robot, as far as it has the pairs of L_m and the plots."""
        new, shown = View.first(pairs, plots), self.plots & set(plots)
        borders, first = new.borders, copy(new.borders)
        new.take_over(self)
        new.borders = {pair: self.borders.get(pair, HIDDEN) for pair in borders}
        if set(new.borders.values()) <= {HIDDEN} and set(self.borders.values()) - {HIDDEN}:
            new.borders = first
        new.plots = shown
        return new

    @classmethod
    def first(cls, pairs: list[str], plots: list[str]) -> View:
        """What a new viewer sees: the score of the first border, and the first three plots."""
        borders = dict.fromkeys(pairs, HIDDEN)
        if pairs:
            borders[pairs[0]] = "score"
        return cls(borders, plots=set(plots[:3]))


class Viewpoint(NamedTuple):
    """What a viewer sees, and where from: eye and target (3,) [m] of the camera, in the world."""

    view: View
    eye: np.ndarray
    target: np.ndarray
