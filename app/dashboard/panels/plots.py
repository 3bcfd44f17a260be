"""Plots: curves of the last seconds on one axis of time, with a cursor at the shown instant."""

import math
import time
from typing import Any

import numpy as np
import viser
from viser import uplot

from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.plans import PlotPlan

LENGTH = 20.0  # [s] of the axis of time
AHEAD = 5.0  # [s] shown after the instant that a viewer has gone back to
SPACING = 0.08  # [s] of drawn values, as many as there are pixels
PERIOD, PERIOD_LIGHT, PERIOD_REST = 0.2, 0.5, 1.0  # [s] between two pictures of what goes on
RESTING, STILL = 12, 2e-3  # [-] values, and how far they differ in the units of the plots, at rest
LINE = 1.6  # [px]
_CURSOR = "#ff7a00"
SIGHT = "plots"  # whether a person sees them
OFF = -9.0  # of the cursor, below its scale


class Plots(Panel):
    """The plots of one viewer; those that are not shown cost nothing."""

    of_instant = True

    def __init__(self, viewer: Viewer) -> None:
        """Empty plots, whose curves are the record's, in order; the view says which are shown."""
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
        """What the pointer says over the names of lines, by the plot's title."""
        named = {
            plan.title: dict(zip([c.label for c in plan.curves], plan.hints, strict=True))
            for plan in self._viewer.shared.plans
        }
        cursor = {"cursor": "the instant shown in the past"}
        return {title: {**hints, **cursor} for title, hints in named.items()}

    def update(self, moment: Moment) -> None:
        """Show the stretch of time around the snapshot that is shown, if anybody sees it."""
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
        asked = (record, timeline.live, here)
        drawn = (*asked, newest, shown.t)
        soon = timeline.live and asked == self._drawn[:3] and time.monotonic() < self._due
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
    """An empty plot, so many pixels high without title and legend.

    The range of values is given once: a change would rebuild the plot in the browser. Time runs
    through it as it is: with an axis that never changes uPlot would not draw its numbers. The
    cursor is a line on a scale of its own that leaves the plot but at one instant.
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
        # uPlot takes x for the time of day by default.
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
