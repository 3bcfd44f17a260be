"""The slice of a border at the height of the arm's closest point: where p_n moves."""

from __future__ import annotations

import numpy as np
import viser

from app.dashboard.scene.borders import Borders
from app.dashboard.scene.colours import Rgb
from app.dashboard.scene.lines import hidden_line, set_polylines
from app.dashboard.scene.robot import ROOT
from app.dashboard.view import View
from app.simulation.trace.snapshot import Snapshot

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
