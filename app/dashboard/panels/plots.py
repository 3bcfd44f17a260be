"""Tab "Plots": curves over the last seconds, with a line at the shown instant."""

import math
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
import viser
from viser import uplot

from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.plans import Curve, PlotPlan
from app.dashboard.scene.colours import SERIES

LENGTH = 20.0  # [s] length of the time axis
AHEAD = 5.0  # [s] plotted time after a shown instant in the past
SPACING = 0.08  # [s] period of drawn values, about one per pixel
PERIOD, PERIOD_LIGHT, PERIOD_REST = 0.2, 0.5, 1.0  # [s] of drawing: usual, low detail, all at rest
RESTING, STILL = 12, 2e-3  # number of last values; their largest difference in a curve at rest
LINE = 1.6  # [px] width
_INSTANT = Curve("shown instant", lambda _: OFF, "#ff7a00", "the instant shown in the past")
SIGHT = "plots"  # name that the page reports while the plots are visible
OFF = -9.0  # value of `_INSTANT` at all other instants, beyond its scale from 0 to 1


class Plots(Panel):
    """Plots of one viewer, who may add curves of `plans.quantities`; hidden plots are not drawn."""

    def __init__(self, viewer: Viewer, tab: viser.GuiTabHandle) -> None:
        super().__init__(viewer)
        self._tab = tab
        self._drawn: tuple[object, ...] = ()
        self._due = 0.0
        # Content of each plot, by its title; callbacks replace it:
        self._plans = {plan.title: plan for plan in viewer.shared.plans}
        self._plots: dict[str, tuple[PlotPlan, viser.GuiUplotHandle]] = {}
        with tab:
            viewer.channel.sight(SIGHT)
            with self._gui.add_folder("Add a curve", expand_by_default=False):
                names = tuple(viewer.shared.quantities)
                self._name = self._gui.add_dropdown("Quantity", names)
                self.on_update(self._name, self._explain)
                self._explain()
                self._into = self._gui.add_dropdown("Plot", tuple(self._plans))
                acts = {"Add": lambda: self._change(add=True), "Remove": self._change}
                self.buttons("Curve", acts, hint="An added curve has the axis on the right.")
            note = self._gui.add_markdown("Drag in a plot to zoom; double click to see all again.")
        self._order = note.order
        self._make(self._plans)

    @property
    def hints(self) -> dict[str, dict[str, str]]:
        """Tooltip of each curve in the legends, by the plot's title and the curve's label."""
        return {
            title: {curve.label: curve.hint for curve in (*plan.curves, _INSTANT)}
            for title, plan in self._plans.items()
        }

    def update(self, moment: Moment) -> None:
        """Draw `LENGTH` of the run, up to the present or to `AHEAD` after a shown past instant.

        A plot is hidden if it is not chosen, or if its first curve has no value at the shown
        instant, as without a door. No curve is drawn if the viewer does not see the tab, if nothing
        has changed, or if the next drawing of the present is not yet due.
        """
        newest, shown = moment.newest.t, moment.shown
        view, live, plans = self._viewer.view, moment.live, dict(self._plans)
        self._make(plans)
        here = {
            title: plan.curves
            for title, plan in plans.items()
            if title in view.plots and not math.isnan(plan.curves[0].value(shown))
        }
        for title, (_, plot) in self._plots.items():
            plot.visible = title in here
        request = (live, here)
        drawn = (*request, newest, shown.t)
        soon = live and request == self._drawn[:2] and time.monotonic() < self._due
        until = newest if live else min(newest, shown.t + AHEAD)
        if SIGHT not in self._viewer.channel.seen or soon or drawn == self._drawn:
            return
        past = self._viewer.timeline.between(until - LENGTH, until, SPACING)
        if not past:  # the simulation has just restarted
            return
        self._drawn = drawn
        times = np.array([snapshot.t for snapshot in past])
        instant = np.full(len(times), OFF)
        if not live:
            instant[int(np.abs(times - shown.t).argmin())] = 1.0
        rests = True
        for title, curves in here.items():
            lines = [np.array([curve.value(s) for s in past]) for curve in curves]
            self._plots[title][1].data = (times, *lines, instant)
            rests = rests and all(np.ptp(line[-RESTING:]) < STILL for line in lines)
        period = PERIOD_REST if rests else PERIOD_LIGHT if view.light else PERIOD
        self._due = time.monotonic() + period

    def _explain(self, _: object = None) -> None:
        self._name.hint = f"Column of a log: {self._shared.quantities[self._name.value].hint}"

    def _change(self, *, add: bool = False) -> None:
        """Remove the chosen quantity from the chosen plot, or add it if `add`; show the plot."""
        name, title = self._name.value, self._into.value
        plan, view = self._plans[title], self._viewer.view
        curves = tuple(curve for curve in plan.curves if curve.label != name)
        if add:
            used, curve = {curve.colour for curve in curves}, self._shared.quantities[name]
            colour = next((each for each in SERIES if each not in used), SERIES[0])
            curves += (curve._replace(colour=colour, hint=f"right axis; {curve.hint}"),)
            if math.isnan(curve.value(self._viewer.timeline.shown())):
                text = f"{name} has no value at this instant; its curve starts with the next value."
                self._notifier.tell(self._viewer.client, "Empty curve", text)
        self._plans[title] = plan._replace(curves=curves)
        view.plots = view.plots | {title}

    def _make(self, plans: Mapping[str, PlotPlan]) -> None:
        """Create each plot that is new or has another content; the drawing thread calls this."""
        for k, (title, plan) in enumerate(plans.items()):
            before, plot = self._plots.get(title, (None, None))
            if before == plan:
                continue
            if plot is not None:
                plot.remove()
            with self._tab:
                self._plots[title] = plan, _plot(self._gui, plan, self._order + 0.01 * (k + 1))
            self._drawn = ()
            if before is not None:
                self._viewer.channel.tell("hints", self.hints)


def _plot(gui: viser.GuiApi, plan: PlotPlan, order: float) -> viser.GuiUplotHandle:
    """Create a plot without data; its options are constant, because a change would rebuild it."""
    lines, hidden = [], uplot.Series_Points(show=False)
    for curve in (*plan.curves, _INSTANT):
        scale = "instant" if curve is _INSTANT else "right" if curve.right else "y"
        look: dict[str, Any] = {"stroke": curve.colour, "width": LINE, "points": hidden}
        if plan.fill and scale == "y":
            look["fill"] = curve.colour + "40"
        if curve.dashed:
            look["dash"] = [6, 4]
        lines.append(uplot.Series(label=curve.label, scale=scale, **look))
    axes = [uplot.Axis(size=38), uplot.Axis(size=48)]
    if any(curve.right for curve in plan.curves):
        axes.append(uplot.Axis(size=48, side=1, scale="right"))
    return gui.add_uplot(
        data=tuple(np.zeros(1) for _ in range(len(lines) + 1)),
        series=(uplot.Series(label="t [s]"), *lines),
        title=plan.title,
        # By default uPlot takes x for the time of day.
        scales={
            "x": uplot.Scale(time=False),
            "y": uplot.Scale(range=plan.y_range),
            "instant": uplot.Scale(range=(0.0, 1.0)),
        },
        axes=tuple(axes),
        legend=uplot.Legend(show=True, live=True),
        cursor=uplot.Cursor(show=True, y=False),
        height=plan.height,
        padding=(10, 12, 0, 0),
        order=order,
    )
