"""Borders: coloured point clouds that move with the base, and their slice at the arm's height."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import viser

from app.border.dbb import Cloud, construct_dbb
from app.border.mobile import MobileBody
from app.border.offset import OffsetContours
from app.border.score import ScoreField
from app.border.surface import BorderSurface
from app.config import BorderConfig
from app.dashboard.scene.canvas import ROOT, Canvas
from app.dashboard.scene.colours import Rgb, viridis
from app.dashboard.scene.legend import Legend, make_legend, normalised
from app.dashboard.view import HIDDEN, View
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

MAX_POINTS = 20_000
"""Points drawn; more of them only hide what lies behind and slow the browser down."""
LIGHT_POINTS = 4000
"""The same where a page draws in software."""
_KEPT = 32  # clouds and surfaces that are kept for other viewers
POINT_SIZE = 0.0035  # [m] small enough to see the acting points behind it
LIGHT_SIZE = 0.006  # [m] of one of few points
_GRAIN = 0.002  # [m] of height by which the slice has to change to be sent anew
_EVERY = 3  # rays of the contour between two drawn points
_ON_DARK: Rgb = (255, 255, 255)
_ON_LIGHT: Rgb = (20, 24, 30)


class ColouredCloud(NamedTuple):
    """A border as it is sent to a browser: (N, 3) [m] in the base's frame, and (N, 3) uint8."""

    points: Array
    colours: Array
    legend: Legend


class Borders:
    """Selects borders from the stored clouds; what one viewer has asked for, the next finds.

    Attributes:
        pairs: Names of the pairs of L_m.
        fields: Their scores, by the pair.
        top: [m] height of the base's top; what lies above it is drawn on demand only.
    """

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud]) -> None:
        """Nothing is selected yet; `clouds` are P_i of every pair of L_m, by the pair's name."""
        self.pairs = frozenset(clouds)
        self.top = float(MobileBody(model).upper[2])
        self._model, self._clouds = model, clouds
        # A pair of L_m is named `lm-<body of the arm>`.
        self.fields = {pair: ScoreField.of(model, pair.partition("-")[2]) for pair in clouds}
        self._kept: dict[tuple[object, ...], Any] = {}

    def coloured(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool
    ) -> ColouredCloud | None:
        """A border's points with the colours of a quantity; None if it has no points.

        Args:
            pair: Name of a pair of L_m.
            quantity: One of `app.dashboard.scene.legend.QUANTITIES`.
            border: d_b and ε.
            whole: Also what lies above the base's top.
        """
        return self._keep(
            (pair, quantity, border.d_b, border.eps, whole),
            lambda: self._colour(pair, quantity, border, whole=whole),
        )

    def curves(self, pair: str, border: BorderConfig, z: float) -> list[Array]:
        """(K, 3) [m] each, the border's slice at a height z [m], in the base's frame."""
        return self.surface(pair, border).curves(z)

    def surface(self, pair: str, border: BorderConfig) -> BorderSurface:
        """The border as contours."""
        return self._keep(
            (pair, border.d_b, border.eps),
            lambda: BorderSurface(
                construct_dbb(self._clouds[pair], border.d_b, border.eps),
                OffsetContours(self._model, border.d_b),
            ),
        )

    def values(self, pair: str, quantity: str, points: Array) -> Array:
        """(N,) a quantity, one of `QUANTITIES`, at points (N, 3) [m] in the base's frame."""
        field = self.fields[pair]
        return {
            "determinant": field.singularity,
            "reachability": field.reachability,
            "score": field.score,
        }[quantity](points)

    def _keep(self, key: tuple[object, ...], make: Callable[[], Any]) -> Any:
        if key not in self._kept:
            if len(self._kept) >= _KEPT:
                self._kept.pop(next(iter(self._kept)))
            self._kept[key] = make()
        return self._kept[key]

    def _colour(
        self, pair: str, quantity: str, border: BorderConfig, *, whole: bool
    ) -> ColouredCloud | None:
        points = construct_dbb(self._clouds[pair], border.d_b, border.eps).points
        if not whole:
            points = points[points[:, 2] <= self.top]
        if not len(points):
            return None
        values = self.values(pair, quantity, points)
        keep = subsample(len(points), MAX_POINTS)
        top = None if whole else self.top
        base = self._model.description.base
        legend = make_legend(pair, quantity, base, border.d_b, values, len(keep), top)
        return ColouredCloud(points[keep], viridis(normalised(values[keep], legend)), legend)


def subsample(total: int, most: int) -> Array:
    """Indices of at most `most` points out of `total`, always the same, in no visible pattern."""
    if total <= most:
        return np.arange(total)
    return np.random.default_rng(0).permutation(total)[:most]


class BorderCloud:
    """Draws each pair's border anew whenever its quantity, d_b or ε has changed."""

    def __init__(self, scene: viser.SceneApi, borders: Borders) -> None:
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
        changed = False
        for pair, quantity in view.borders.items():
            wanted = (quantity, view.whole_border, view.light, view.shell, border.d_b, border.eps)
            if self._drawn.get(pair) != wanted:
                self._drawn[pair] = wanted
                self._draw(pair, quantity, view, border)
                changed = True
        return changed

    def _draw(self, pair: str, quantity: str, view: View, border: BorderConfig) -> None:
        coloured = None
        if quantity != HIDDEN:
            coloured = self._borders.coloured(pair, quantity, border, whole=view.whole_border)
        if coloured is None:
            self._legends.pop(pair, None)
            if pair in self._clouds:
                self._clouds[pair].visible = False
            return
        most, size = (LIGHT_POINTS, LIGHT_SIZE) if view.light else (MAX_POINTS, POINT_SIZE)
        keep = subsample(len(coloured.points), most)
        self._legends[pair] = coloured.legend._replace(drawn=len(keep))
        # One message for points and colours: no browser may see one without the other.
        self._clouds[pair] = self._scene.add_point_cloud(
            f"{ROOT}/border_{pair}",
            coloured.points[keep],
            coloured.colours[keep],
            point_size=size,
            point_shape="circle",
            precision="float32",
            visible=not view.shell,  # whose body hides no robot
        )


class BorderSlice:
    """A bright line around the base: the border at the height of p_b of the nearest pair of L_m."""

    def __init__(self, borders: Borders) -> None:
        self._borders = borders
        self._key: tuple[object, ...] = ()
        self._curves: list[Array] = []

    def draw(self, canvas: Canvas, snapshot: Snapshot, *, dark: bool) -> None:
        """Draw the slice, if there is one at that height; on a dark page or a light one."""
        mobile = [pair for pair in snapshot.pairs if pair.name in self._borders.pairs]
        if not mobile:
            return
        nearest, border = min(mobile, key=lambda pair: pair.d), snapshot.config.border
        z = float(nearest.p_b[2])
        key = (nearest.name, round(z / _GRAIN), border.d_b, border.eps)
        if key != self._key:
            curves = self._borders.curves(nearest.name, border, z)
            self._key = key
            self._curves = [np.concatenate([curve[:-1:_EVERY], curve[-1:]]) for curve in curves]
        if self._curves:
            node = f"{ROOT}/slice_{nearest.name}"
            canvas.lines(node, self._curves, _ON_DARK if dark else _ON_LIGHT, 2.5)
