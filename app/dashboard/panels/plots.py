"""Plots: curves of the last seconds over a common time axis, with a cursor at the shown instant."""

import math
import time
from typing import Any

import numpy as np
import viser
from viser import uplot

from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.plans import PlotPlan

LENGTH = 20.0  # [s] length of the time axis
AHEAD = 5.0  # [s] shown time after an instant of the past
SPACING = 0.08  # [s] period of drawn values, about one per pixel
PERIOD, PERIOD_LIGHT, PERIOD_REST = 0.2, 0.5, 1.0  # [s] period of drawing
RESTING, STILL = 12, 2e-3  # [-] number of last values; their largest difference at rest
LINE = 1.6  # [px] width
_CURSOR = "#ff7a00"
SIGHT = "plots"  # reported by the page while the plots are visible
OFF = -9.0  # value of the cursor outside its scale


class Plots(Panel):
    """Plots of one viewer; hidden plots cost nothing."""

    of_instant = True

    def __init__(self, viewer: Viewer) -> None:
        """Create empty plots with the record's curves, in order; the view selects the plots."""
        super().__init__(viewer)
        self._viewer, plans = viewer, viewer.shared.plans
        viewer.channel.sight(SIGHT)
        self._drawn: tuple[object, ...] = ()
        self._due = 0.0
        self._plots = {plan.title: _plot(self._gui, plan) for plan in plans}
        begins = np.cumsum([1, *(len(plan.curves) for plan in plans)])
        self._columns = {
            plan.title: slice(int(begin), int(begin) + len(plan.curves))
            for plan, begin in zip(plans, begins, strict=False)
        }

    @property
    def hints(self) -> dict[str, dict[str, str]]:
        """Explanations of the lines for the pointer, by plot title and label."""
        named = {
            plan.title: dict(zip([c.label for c in plan.curves], plan.hints, strict=True))
            for plan in self._viewer.shared.plans
        }
        cursor = {"cursor": "the instant shown in the past"}
        return {title: {**hints, **cursor} for title, hints in named.items()}

    def update(self, moment: Moment) -> None:
        """Draw the time around the shown snapshot, if the viewer sees the plots."""
        shown, view, timeline = moment.shown, self._viewer.view, self._viewer.timeline
        newest = self._viewer.shared.last
        record, seen = self._viewer.shared.record, SIGHT in self._viewer.channel.seen
        here = {
            plan.title
            for plan in self._viewer.shared.plans
            if plan.title in view.plots and not math.isnan(plan.curves[0].value(shown))
        }
        for title, plot in self._plots.items():
            plot.visible = title in here
        request = (record, timeline.live, here)
        drawn = (*request, newest, shown.t)
        soon = timeline.live and request == self._drawn[:3] and time.monotonic() < self._due
        if not seen or soon or drawn == self._drawn:
            return
        self._drawn = drawn
        until = newest if timeline.live else min(newest, shown.t + AHEAD)
        table = record.columns(until, LENGTH)
        table = table[:, np.diff(np.floor(table[0] / SPACING), prepend=-1.0) > 0.0]
        now = [table[self._columns[title], -RESTING:] for title in here]
        rests = all(np.ptp(lines, axis=1).max() < STILL for lines in now)
        period = PERIOD_REST if rests else PERIOD_LIGHT if view.light else PERIOD
        self._due = time.monotonic() + period
        cursor = np.full(table.shape[1], OFF)
        if not timeline.live:
            cursor[int(np.abs(table[0] - shown.t).argmin())] = 1.0
        for title in here:
            self._plots[title].data = (table[0], *table[self._columns[title]], cursor)


def _plot(gui: viser.GuiApi, plan: PlotPlan) -> viser.GuiUplotHandle:
    """Create an empty plot.

    The range of values is constant, because a change would rebuild the plot in the browser. The
    time axis must change, because uPlot draws no numbers on a constant axis. The cursor is a line
    with its own scale, which is inside the plot at one instant only.
    """
    lines = []
    for i, (curve, colour) in enumerate(zip(plan.curves, plan.colours, strict=True)):
        more: dict[str, Any] = {"fill": colour + "40"} if plan.fill else {}
        if i >= len(plan.curves) - plan.dashed:
            more["dash"] = [6, 4]
        lines.append(_line(curve.label, colour, **more))
    lines.append(_line("cursor", _CURSOR, scale="cursor"))
    return gui.add_uplot(
        data=tuple(np.zeros(1) for _ in range(len(lines) + 1)),
        series=(uplot.Series(label="t [s]"), *lines),
        title=plan.title,
        # By default uPlot takes x for the time of day.
        scales={
            "x": uplot.Scale(time=False),
            "y": uplot.Scale(range=plan.y_range),
            "cursor": uplot.Scale(range=(0.0, 1.0)),
        },
        axes=(uplot.Axis(size=38), uplot.Axis(size=48)),
        legend=uplot.Legend(show=True, live=False),
        cursor=uplot.Cursor(show=False),
        height=plan.height,
        padding=(10, 12, 0, 0),
    )


def _line(label: str, colour: str, **more: Any) -> uplot.Series:
    return uplot.Series(
        label=label, stroke=colour, width=LINE, points=uplot.Series_Points(show=False), **more
    )
