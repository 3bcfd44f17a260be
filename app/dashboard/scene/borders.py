"""Borders of all pairs of L_m as they are drawn: points, values and slices, each made once."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from app.border.cloud import Cloud
from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.border.offset import OffsetContours
from app.border.score import ScoreField
from app.border.surface import BorderSurface
from app.config import BorderConfig
from app.dashboard.scene.colours import viridis
from app.dashboard.scene.legend import Legend, make_legend, normalised
from app.robot.model import RobotModel

Array = np.ndarray

MAX_POINTS = 20_000
"""Points drawn; more of them only hide what lies behind and slow the browser down."""
_KEPT = 16  # clouds and surfaces that are kept for other viewers


class ColouredCloud(NamedTuple):
    """A border as it is sent to a browser.

    Attributes:
        points: (N, 3) [m] in the base's frame.
        colours: (N, 3) uint8.
        legend: What the colours mean.
    """

    points: Array
    colours: Array
    legend: Legend


class Borders:
    """Selects borders from the stored clouds; what one viewer has asked for, the next finds."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud]) -> None:
        """Prepare; nothing is selected yet.

        Args:
            model: The robot.
            clouds: P_i of every pair of L_m, by the pair's name.
        """
        self.top = float(MobileBody(model).upper[2])
        """[m] height of the base's top; what lies above it is drawn on demand only."""
        self._model, self._clouds = model, clouds
        # A pair of L_m is named `lm-<body of the arm>`.
        self._fields = {pair: ScoreField.of(model, pair.partition("-")[2]) for pair in clouds}
        self._coloured: dict[tuple[object, ...], ColouredCloud | None] = {}
        self._surfaces: dict[tuple[object, ...], BorderSurface] = {}

    def coloured(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool
    ) -> ColouredCloud | None:
        """A border's points with the colours of a quantity.

        Args:
            pair: Name of a pair of L_m.
            quantity: One of `app.dashboard.scene.legend.QUANTITIES`.
            border: d_b and ε.
            whole: Also what lies above the base's top.

        Returns:
            None if the border has no points.
        """
        key = (pair, quantity, border.d_b, border.eps, whole)
        if key not in self._coloured:
            _make_room(self._coloured)
            self._coloured[key] = self._colour(pair, quantity, border, whole=whole)
        return self._coloured[key]

    def curves(self, pair: str, border: BorderConfig, z: float) -> list[Array]:
        """(K, 3) [m] each, the border's slice at a height z [m], in the base's frame."""
        key = (pair, border.d_b, border.eps)
        if key not in self._surfaces:
            _make_room(self._surfaces)
            selected = construct_dbb(self._clouds[pair], border.d_b, border.eps)
            offset = OffsetContours(self._model, border.d_b)
            self._surfaces[key] = BorderSurface(selected, offset)
        return self._surfaces[key].curves(z)

    def _colour(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool
    ) -> ColouredCloud | None:
        points = construct_dbb(self._clouds[pair], border.d_b, border.eps).points
        if not whole:
            points = points[points[:, 2] <= self.top]
        if not len(points):
            return None
        values = self._values(quantity, pair, points)
        keep = subsample(len(points), MAX_POINTS)
        top = None if whole else self.top
        base = self._model.description.base
        legend = make_legend(pair, quantity, base, border.d_b, values, len(keep), top)
        return ColouredCloud(points[keep], viridis(normalised(values[keep], legend)), legend)

    def _values(self, quantity: str, pair: str, points: Array) -> Array:
        field = self._fields[pair]
        if quantity == "determinant":
            return field.singularity(points)
        return field.reachability(points) if quantity == "reachability" else field.score(points)


def subsample(total: int, most: int) -> Array:
    """Indices of at most `most` points out of `total`, always the same, in no visible pattern."""
    if total <= most:
        return np.arange(total)
    return np.random.default_rng(0).permutation(total)[:most]


def _make_room(cache: dict) -> None:
    if len(cache) >= _KEPT:
        cache.pop(next(iter(cache)))
