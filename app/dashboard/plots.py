"""Live plots of distances, activation and the base's accelerations."""

from __future__ import annotations

from typing import Any

import numpy as np
import viser
from viser import uplot

from app.dashboard.colours import ACTING, PERSON, SERIES, css
from app.dashboard.window import Window
from app.simulation.snapshot import Snapshot

Array = np.ndarray

LINE = 1.6  # [px]
_BETA = "#8e6bd8"
_THRESHOLD = "#98a0ab"


class Plots:
    """Three plots over the last seconds, with the newest instant at the right edge."""

    def __init__(self, server: viser.ViserServer, names: list[str]) -> None:
        """Empty plots in the GUI container that is now open.

        Args:
            server: The page.
            names: Link pairs, in the order of the snapshots.
        """
        self._window = Window(len(names))
        colours = [SERIES[i % len(SERIES)] for i in range(len(names))]
        distances = [_line(name, colour) for name, colour in zip(names, colours, strict=True)]
        distances.append(_line("d_b", _THRESHOLD, dash=[6, 4]))
        beta = [_line("β_m", _BETA, fill=_BETA + "40")]
        acceleration = [_line("v̇ [m/s²]", css(PERSON)), _line("ω̇ [rad/s²]", css(ACTING))]
        self._distances = _plot(server, "distance [m]", distances, 160, _soft(0.0, 0.4))
        self._beta = _plot(server, "activation β_m", beta, 112, (-0.02, 1.05))
        self._acceleration = _plot(
            server, "base acceleration of avoidance, β ẍ", acceleration, 135, _soft(-1.0, 1.0)
        )

    @property
    def last(self) -> float:
        """[s] time up to which the plots have been filled."""
        return self._window.last

    def update(self, snapshots: list[Snapshot], latest: Snapshot) -> None:
        """Append the snapshots and show the window that ends at the newest.

        Args:
            snapshots: New since `last`, in order of time.
            latest: The newest of all; the buffer distance is drawn as it is now.
        """
        self._window.extend(snapshots, latest.t)
        columns = self._window.columns()
        t, distances, beta, acceleration = columns[0], columns[1:-3], columns[-3:-2], columns[-2:]
        d_b = np.full(len(t), latest.config.border.d_b)
        self._distances.data = (t, *distances, d_b)
        self._beta.data = (t, *beta)
        self._acceleration.data = (t, *acceleration)


def _plot(
    server: viser.ViserServer, title: str, lines: list[uplot.Series], height: int, y_range: Any
) -> viser.GuiUplotHandle:
    """An empty plot, so many pixels high without title and legend.

    The range of values is given once: a change would rebuild the plot in the browser. Time runs
    through it as it is: with an axis that never changes uPlot would not draw its numbers.
    """
    return server.gui.add_uplot(
        data=tuple(np.zeros(1) for _ in range(len(lines) + 1)),
        series=(uplot.Series(label="t [s]"), *lines),
        title=title,
        # uPlot takes x for the time of day unless it is told otherwise.
        scales={"x": uplot.Scale(time=False), "y": uplot.Scale(range=y_range)},
        axes=(uplot.Axis(size=38), uplot.Axis(size=48)),
        legend=uplot.Legend(show=True, live=False),
        cursor=uplot.Cursor(show=False),
        height=height,
        padding=(10, 12, 0, 0),
    )


def _line(label: str, colour: str, **more: Any) -> uplot.Series:
    return uplot.Series(
        label=label, stroke=colour, width=LINE, points=uplot.Series_Points(show=False), **more
    )


def _soft(low: float, high: float) -> dict[str, dict[str, float]]:
    """A range that holds [low, high] and grows, with a tenth of a margin, if the data need it."""
    return {
        "min": {"pad": 0.1, "soft": low, "mode": 1},
        "max": {"pad": 0.1, "soft": high, "mode": 1},
    }
