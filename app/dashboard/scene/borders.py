"""Borders: coloured point clouds that move with the base, and their slice at the arm's height."""

from __future__ import annotations

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import viser

from app.border.cloud import Cloud
from app.border.dbb import construct_dbb
from app.border.mobile import MobileBody
from app.border.offset import OffsetContours
from app.border.score import ScoreField
from app.border.surface import BorderSurface
from app.config import BorderConfig
from app.dashboard.scene.colours import Rgb, viridis
from app.dashboard.scene.legend import Legend, make_legend, normalised
from app.dashboard.scene.lines import hidden_line, set_polylines
from app.dashboard.scene.robot import ROOT
from app.dashboard.view import HIDDEN, View
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

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


POINT_SIZE = 0.0035  # [m] small enough to see the acting points behind it


class BorderCloud:
    """Draws each pair's border anew whenever its quantity, d_b or ε has changed."""

    def __init__(self, scene: viser.SceneApi, borders: Borders) -> None:
        """Nothing drawn yet.

        Args:
            scene: Where to draw, under the robot's node.
            borders: Gives the points and their colours.
        """
        self._scene, self._borders = scene, borders
        self._drawn: dict[str, tuple[object, ...]] = {}
        self._clouds: dict[str, viser.PointCloudHandle] = {}
        self._legends: dict[str, Legend] = {}

    @property
    def legends(self) -> list[Legend]:
        """Of the borders that are drawn."""
        return list(self._legends.values())

    def update(self, view: View, border: BorderConfig) -> bool:
        """Redraw what has changed.

        Returns:
            Whether something has, and `legends` is new.
        """
        changed = [
            self._update(pair, quantity, view, border) for pair, quantity in view.borders.items()
        ]
        return any(changed)

    def _update(self, pair: str, quantity: str, view: View, border: BorderConfig) -> bool:
        wanted = (quantity, view.whole_border, border.d_b, border.eps)
        if self._drawn.get(pair) == wanted:
            return False
        self._drawn[pair] = wanted
        coloured = None
        if quantity != HIDDEN:
            coloured = self._borders.coloured(pair, quantity, border, whole=view.whole_border)
        if coloured is None:
            self._legends.pop(pair, None)
            if pair in self._clouds:
                self._clouds[pair].visible = False
            return True
        self._legends[pair] = coloured.legend
        # One message for points and colours: no browser may see one without the other.
        self._clouds[pair] = self._scene.add_point_cloud(
            f"{ROOT}/border_{pair}",
            coloured.points,
            coloured.colours,
            point_size=POINT_SIZE,
            point_shape="circle",
            precision="float32",
        )
        return True


_GRAIN = 0.002  # [m] of height by which the slice has to change to be sent anew
_EVERY = 3  # rays of the contour between two drawn points
_ON_DARK: Rgb = (255, 255, 255)
_ON_LIGHT: Rgb = (20, 24, 30)


class BorderSlice:
    """A bright line around the base for each pair of L_m, at the height of its p_b."""

    def __init__(self, scene: viser.SceneApi, borders: Borders, pairs: list[str]) -> None:
        """Hidden lines.

        Args:
            scene: Where to draw.
            borders: Gives the slices.
            pairs: Names of the pairs of L_m.
        """
        self._borders = borders
        self._lines = {
            pair: hidden_line(scene, f"{ROOT}/slice_{pair}", _ON_DARK, 2.5) for pair in pairs
        }
        self._drawn: dict[str, tuple[object, bool]] = {}

    def update(self, snapshot: Snapshot, view: View) -> None:
        """Move the slice of the pair that is nearest to the base; the others are hidden."""
        mobile = [pair for pair in snapshot.pairs if pair.name in self._lines]
        nearest = min(mobile, key=lambda pair: pair.d).name if mobile and view.slice else None
        for pair in mobile:
            self._lines[pair.name].visible = pair.name == nearest and self._draw(
                pair.name, float(pair.p_b[2]), snapshot, view
            )

    def _draw(self, pair: str, z: float, snapshot: Snapshot, view: View) -> bool:
        """Renew a slice; gives whether there is one at that height."""
        border = snapshot.config.border
        wanted = (round(z / _GRAIN), border.d_b, border.eps, view.dark)
        if pair in self._drawn and self._drawn[pair][0] == wanted:
            return self._drawn[pair][1]
        curves = self._borders.curves(pair, border, z)
        self._drawn[pair] = wanted, bool(curves)
        if curves:
            kept = [np.concatenate([curve[:-1:_EVERY], curve[-1:]]) for curve in curves]
            set_polylines(self._lines[pair], kept, _ON_DARK if view.dark else _ON_LIGHT)
        return bool(curves)
