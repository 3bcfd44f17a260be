"""The distance buffer border as a coloured point cloud that moves with the base."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import viser

from app.config import BorderConfig
from app.dashboard.colours import viridis
from app.dashboard.legend import Legend, make_legend, normalised
from app.dashboard.robot import ROOT
from app.dashboard.view import View

Array = np.ndarray

MAX_POINTS = 20_000
"""Points drawn; more of them only hide what lies behind and slow the browser down."""
POINT_SIZE = 0.0035  # [m] small enough to see the acting points behind it

BorderOf = Callable[[str, BorderConfig], Array]
"""(N, 3) [m] points of a pair's border in the base's frame."""
ValuesOf = Callable[[str, str, Array], Array]
"""(N,) values of a quantity at points (N, 3) of a pair's border."""


class BorderCloud:
    """Draws the border of the chosen pair anew whenever pair, quantity, d_b or ε has changed."""

    def __init__(
        self, server: viser.ViserServer, top: float, border_of: BorderOf, values_of: ValuesOf
    ) -> None:
        """An empty cloud under the robot's node.

        Args:
            server: The page.
            top: [m] height of the base's top; what lies above it is drawn on demand only.
            border_of: Selects a border from the stored cloud.
            values_of: Gives the values that it is coloured by.
        """
        self._server, self._top = server, top
        self._border_of, self._values_of = border_of, values_of
        self._drawn: tuple[object, ...] | None = None
        self._cloud: viser.PointCloudHandle | None = None
        self.legend: Legend | None = None

    def update(self, view: View, border: BorderConfig) -> bool:
        """Redraw if something that it depends on has changed.

        Returns:
            Whether it was redrawn, and `legend` is new.
        """
        wanted = (view.pair, view.quantity, view.whole_border, border.d_b, border.eps)
        if wanted == self._drawn:
            return False
        self._drawn = wanted
        if view.quantity == "hidden":
            self._hide()
            return True
        points = self._border_of(view.pair, border)
        if not view.whole_border:
            points = points[points[:, 2] <= self._top]
        if not len(points):
            self._hide()
            return True
        values = self._values_of(view.quantity, view.pair, points)
        keep = subsample(len(points), MAX_POINTS)
        top = None if view.whole_border else self._top
        self.legend = make_legend(view.pair, view.quantity, border.d_b, values, len(keep), top)
        self._draw(points[keep], viridis(normalised(values[keep], self.legend)))
        return True

    def _draw(self, points: Array, colours: Array) -> None:
        # One message for points and colours: no browser may see one without the other.
        self._cloud = self._server.scene.add_point_cloud(
            f"{ROOT}/border", points, colours, point_size=POINT_SIZE, point_shape="circle",
            precision="float32",
        )  # fmt: skip

    def _hide(self) -> None:
        self.legend = None
        if self._cloud is not None:
            self._cloud.visible = False


def subsample(total: int, most: int) -> Array:
    """Indices of at most `most` points out of `total`, always the same, in no visible pattern."""
    if total <= most:
        return np.arange(total)
    return np.random.default_rng(0).permutation(total)[:most]
