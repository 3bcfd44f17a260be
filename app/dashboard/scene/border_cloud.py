"""The distance buffer borders as coloured point clouds that move with the base."""

from __future__ import annotations

import viser

from app.config import BorderConfig
from app.dashboard.scene.borders import Borders
from app.dashboard.scene.legend import Legend
from app.dashboard.scene.robot import ROOT
from app.dashboard.view import HIDDEN, View

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
