"""Plots of a robot: titles, curves, colours and ranges."""

import math
from collections.abc import Sequence
from typing import Any, NamedTuple

from app.config import tunable
from app.dashboard.panels import phrases as words
from app.dashboard.record import Curve
from app.dashboard.scene.colours import ACTING, BETA, PERSON, SERIES, css
from app.robot.bases.kind import Axis, acceleration_symbol
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

_MOVES = "β_m ẍ_m: base acceleration commanded by avoidance along this axis, (16) to (18)"
_ACTIVATION = "activation β_m of the pairs with the base: 0 at d_b, 1 at d_full, Figure 10, (28)"
_THRESHOLD = "#98a0ab"


class PlotPlan(NamedTuple):
    """Content of a plot."""

    title: str
    """Title with the unit."""
    curves: Sequence[Curve]
    colours: tuple[str, ...]
    y_range: Any
    """Range in uPlot's format."""
    height: int
    """[px] height without title and legend."""
    fill: bool = False
    """Whether the area under the lines is filled."""
    dashed: int = 0
    """Number of lines at the end that are thresholds."""
    hints: tuple[str, ...] = ()
    """Hints for the lines' names: symbol, unit, range and equation."""


def plot_plans(model: RobotModel, names: list[str], door: str) -> list[PlotPlan]:
    """Return all plots of a robot; `names` are its link pairs, in the order of the snapshots.

    The pair `door` of base and door has a separate plot.
    """
    axes = model.description.base.axes
    torques = [
        Curve(f"{i + 1}", lambda s, i=i, most=float(most): s.u_a[i] / most)
        for i, most in enumerate(model.tau_max)
    ]
    beta = Curve("activation β_m", lambda s: s.beta_m)
    avoidance = [_avoidance(i, axis) for i, axis in enumerate(axes)]
    of_axes = (*_series(len(axes) - 2), css(PERSON), css(ACTING))[-len(axes) :]
    error = Curve("hand error", lambda s: 1000.0 * s.ee_error)
    step = Curve("mean over 1 s", lambda s: s.step_time_us)
    return [
        _distances("distance [m]", model, names, 160),
        _distances("distance to the door [m]", model, [door], 100),
        PlotPlan(
            "activation of the avoidance β_m",
            [beta],
            (BETA,),
            (-0.02, 1.05),
            100,
            fill=True,
            hints=(_ACTIVATION,),
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
    """Plan a plot of the distances of some pairs and of d_b, with a height [px]."""
    apart = "signed distance d [m] of the convex bodies, negative where they overlap"
    d_b = tunable("border.d_b")
    curves = [
        Curve(words.spoken(name, model.body_names), lambda s, name=name: distance(s, name))
        for name in names
    ]
    return PlotPlan(
        title,
        [*curves, Curve("buffer d_b", lambda s: s.d_b)],
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
    """Return the hints for the lines of the joint torques."""
    return tuple(
        f"{name}: u_a divided by its limit of {most:g} N m, −1 to 1, (26)"
        for name, most in zip(model.description.arm.joints, model.tau_max, strict=True)
    )


def distance(snapshot: Snapshot, pair: str) -> float:
    """Return the signed distance [m] of a pair such as `lm-lEE`, or NaN if the pair is absent."""
    return next((reading.d for reading in snapshot.pairs if reading.name == pair), math.nan)


def _series(count: int) -> tuple[str, ...]:
    return tuple(SERIES[i % len(SERIES)] for i in range(count))


def _avoidance(i: int, axis: Axis) -> Curve:
    """Return the curve of the avoidance acceleration along an axis of the base."""
    unit = "rad/s²" if axis.angular else "m/s²"
    return Curve(
        f"{'turn' if axis.angular else axis.way} {acceleration_symbol(axis)} [{unit}]",
        lambda s: float(s.avoidance_acceleration[i]),
    )


def _soft(low: float, high: float) -> dict[str, dict[str, float]]:
    """Return a range of at least [low, high], which grows with the data with a margin of 10 %."""
    return {
        "min": {"pad": 0.1, "soft": low, "mode": 1},
        "max": {"pad": 0.1, "soft": high, "mode": 1},
    }
