"""Plots: curves of the last seconds on one axis of time, with a cursor at the shown instant."""

import math
import time
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
import viser
from viser import uplot

from app.config import tunable
from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.panels import phrases as words
from app.dashboard.record import Curve
from app.dashboard.scene.colours import ACTING, BETA, PERSON, SERIES, css
from app.robot.bases.kind import Axis, acceleration_symbol
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

LENGTH = 20.0  # [s] of the axis of time
AHEAD = 5.0  # [s] shown after the instant that a viewer has gone back to
SPACING = 0.08  # [s] of drawn values, as many as there are pixels
PERIOD, PERIOD_LIGHT, PERIOD_REST = 0.2, 0.5, 1.0  # [s] between two pictures of what goes on
RESTING, STILL = 12, 2e-3  # [-] values, and how far they differ in the units of the plots, at rest
LINE = 1.6  # [px]
_MOVES = "β_m ẍ_m: base acceleration commanded by avoidance along this axis, (16) to (18)"
_ACTIVATION = "activation β_m of the pairs with the base: 0 at d_b, 1 at d_full, Figure 10, (28)"
_THRESHOLD = "#98a0ab"
_CURSOR = "#ff7a00"
SIGHT = "plots"  # whether a person sees them
OFF = -9.0  # of the cursor, below its scale


class PlotPlan(NamedTuple):
    """What a plot shows."""

    title: str
    """With the unit."""
    curves: Sequence[Curve]
    colours: tuple[str, ...]
    y_range: Any
    """As uPlot takes it."""
    height: int
    """[px] without title and legend."""
    fill: bool = False
    """Whether the area under the lines is filled."""
    dashed: int = 0
    """How many of the last lines are thresholds."""
    hints: tuple[str, ...] = ()
    """What the pointer over each line's name says: symbol, unit, range and equation."""


def plot_plans(model: RobotModel, names: list[str], door: str) -> list[PlotPlan]:
    """All plots of a robot; `names` are its link pairs, in the order of the snapshots.

    The pair of base and `door` has a plot of its own, that comes with it.
    """
    axes = model.description.base.axes
    torques = [
        Curve(f"{i + 1}", lambda s, i=i, most=float(most): s.u_a[i] / most)
        for i, most in enumerate(model.tau_max)
    ]
    beta = Curve("β_m", lambda s: s.beta_m)
    avoidance = [_avoidance(i, axis) for i, axis in enumerate(axes)]
    of_axes = (*_series(len(axes) - 2), css(PERSON), css(ACTING))[-len(axes) :]
    error = Curve("error", lambda s: 1000.0 * s.ee_error)
    step = Curve("mean over 1 s", lambda s: s.step_time_us)
    return [
        _distances("distance [m]", model, names, 160),
        _distances("distance to the door [m]", model, [door], 100),
        PlotPlan(
            "activation β_m", [beta], (BETA,), (-0.02, 1.05), 100, fill=True, hints=(_ACTIVATION,)
        ),
        PlotPlan(
            "avoidance acceleration of the base, β ẍ",
            avoidance,
            of_axes,
            _soft(-1.0, 1.0),
            125,
            hints=(_MOVES,) * len(axes),
        ),
        PlotPlan(
            "joint torque / limit",
            torques,
            _series(len(torques)),
            (-1.05, 1.05),
            140,
            hints=_about_torques(model),
        ),
        PlotPlan(
            "hand error [mm]",
            [error],
            (BETA,),
            _soft(0.0, 5.0),
            100,
            hints=("distance [mm] of the end-effector from its target",),
        ),
        PlotPlan(
            "control step time [µs]",
            [step],
            (css(PERSON),),
            _soft(0.0, 1000.0),
            100,
            hints=("time [µs] of Algorithm 2 in a control step; the period is 1000",),
        ),
    ]


def _distances(title: str, model: RobotModel, names: list[str], height: int) -> PlotPlan:
    """Distances of some pairs beside d_b, so many pixels high."""
    apart = "signed distance d [m] of the convex bodies, negative where they overlap"
    d_b = tunable("border.d_b")
    curves = [
        Curve(words.spoken(name, model.body_names), lambda s, name=name: distance(s, name))
        for name in names
    ]
    return PlotPlan(
        title,
        [*curves, Curve("d_b", lambda s: s.d_b)],
        (*_series(len(names)), _THRESHOLD),
        _soft(0.0, 0.4),
        height,
        dashed=1,
        hints=(
            *(f"{name}: {apart}" for name in names),
            f"buffer distance d_b, (3), {d_b.allowed}",
        ),
    )


def _about_torques(model: RobotModel) -> tuple[str, ...]:
    """What is said of the lines of the joints' torques."""
    return tuple(
        f"{name}: u_a over its limit of {most:g} N m, −1 to 1, (26)"
        for name, most in zip(model.description.arm.joints, model.tau_max, strict=True)
    )


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


def distance(snapshot: Snapshot, pair: str) -> float:
    """[m] signed distance of a pair, such as `lm-lEE`; not a number where there is none."""
    return next((reading.d for reading in snapshot.pairs if reading.name == pair), math.nan)


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


def _series(count: int) -> tuple[str, ...]:
    return tuple(SERIES[i % len(SERIES)] for i in range(count))


def _avoidance(i: int, axis: Axis) -> Curve:
    """The acceleration of avoidance along an axis of the base."""
    unit = "rad/s²" if axis.angular else "m/s²"
    return Curve(
        f"{acceleration_symbol(axis)} [{unit}]", lambda s: float(s.avoidance_acceleration[i])
    )


def _soft(low: float, high: float) -> dict[str, dict[str, float]]:
    """A range that holds [low, high] and grows, with a tenth of a margin, if the data need it."""
    return {
        "min": {"pad": 0.1, "soft": low, "mode": 1},
        "max": {"pad": 0.1, "soft": high, "mode": 1},
    }
