"""Content of the plots: titles, curves and ranges, and further quantities for curves."""

import math
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from app.config import tunable
from app.dashboard import phrases as words
from app.dashboard.scene.colours import ACTING, BETA, PERSON, SERIES, css
from app.robot.bases.kind import Axis, acceleration_symbol
from app.robot.model import RobotModel
from app.simulation.trace.columns import TraceMeta
from app.simulation.trace.snapshot import QUANTITIES, Snapshot
from app.strict import field_docs

_MOVES = "β_m ẍ_m: base acceleration by the avoidance force along this axis, (16) to (18)"
_ACTIVATION = "activation β_m of the pairs with the base: 0 at d_b, 1 at d_full, Figure 10, (28)"
_ERROR = "distance [mm] of the end-effector from its target"
_STEP = "real time [µs] of the controller in a control step; the period is 1000 µs"


class Curve(NamedTuple):
    label: str
    value: Callable[[Snapshot], float]
    colour: str
    hint: str  # symbol, unit, range and equation
    dashed: bool = False  # for a threshold
    right: bool = False  # whether the line has the axis on the right, which fits all its values


class PlotPlan(NamedTuple):
    title: str  # with the unit
    curves: tuple[Curve, ...]
    y_range: Any  # in uPlot's format
    height: int = 100  # [px] without title and legend
    fill: bool = False  # whether the areas under the curves are filled


def plot_plans(model: RobotModel, names: list[str], door: str) -> list[PlotPlan]:
    """Return all plots; `names` are the link pairs, and `door` is the pair of base and door."""
    axes, joints = model.description.base.axes, model.description.arm.joints
    colours = (*map(_series, range(len(axes) - 2)), css(PERSON), css(ACTING))[-len(axes) :]
    torques = tuple(map(_torque, range(len(joints)), joints, model.tau_max, model.joint_units))
    beta = Curve("activation β_m", lambda s: s.beta_m, BETA, _ACTIVATION)
    error = Curve("end-effector error", lambda s: 1000.0 * s.ee_error, BETA, _ERROR)
    step = Curve("mean over 1 s", lambda s: s.step_time_us, css(PERSON), _STEP)
    avoidance = tuple(map(_avoidance, range(len(axes)), axes, colours))
    return [
        _distances("distance [m]", model, names, 160),
        _distances("distance to the door [m]", model, [door], 100, len(names)),
        PlotPlan("activation of the avoidance β_m", (beta,), (-0.02, 1.05), fill=True),
        PlotPlan("avoidance acceleration of the base, β_m ẍ_m", avoidance, _soft(-1.0, 1.0), 125),
        PlotPlan("joint torque / limit", torques, (-1.05, 1.05), 140),
        PlotPlan("end-effector error [mm]", (error,), _soft(0.0, 5.0)),
        PlotPlan("control step time [µs]", (step,), _soft(0.0, 1000.0)),
    ]


def quantities(model: RobotModel, snapshot: Snapshot) -> dict[str, Curve]:
    """Return a curve, still without colour, for each numeric column of a log except the time."""
    docs = {name: text.split(". ")[0] for name, text in field_docs(Snapshot)}
    pairs = {pair.name: pair.mobile for pair in snapshot.pairs}
    meta = TraceMeta.of(model, pairs, snapshot.config)

    def value(field: str, i: int, s: Snapshot) -> float:
        data = getattr(s, field)
        if field == "pairs":  # without the pair of a door
            data = [pair for pair in data if pair.name in pairs]
        return float(QUANTITIES[field].cells(data, meta)[i])

    return {
        column.name: Curve(column.name, partial(value, field, i), "", docs[field], right=True)
        for field, quantity in QUANTITIES.items()
        for i, column in enumerate(quantity.columns(meta))
        if column.kind != "text" and field != "t"
    }


def _distances(
    title: str, model: RobotModel, names: list[str], height: int, first: int = 0
) -> PlotPlan:
    """Return a plot of the pairs' distances and d_b; the colours start at `SERIES[first]`."""
    meaning = "signed distance d [m] of the convex bodies, negative if they overlap"
    spoken = partial(words.spoken, chain=model.body_names)
    curves = (
        Curve(spoken(name), partial(distance, pair=name), _series(i), f"{name}: {meaning}")
        for i, name in enumerate(names, first)
    )
    about = f"buffer distance d_b, (3), {tunable('border.d_b').allowed}"
    d_b = Curve("buffer d_b", lambda s: s.d_b, "#98a0ab", about, dashed=True)
    return PlotPlan(title, (*curves, d_b), _soft(0.0, 0.4), height)


def distance(snapshot: Snapshot, pair: str) -> float:
    """Return the signed distance [m] of a pair such as `lm-lEE`, or NaN if the pair is absent."""
    return next((reading.d for reading in snapshot.pairs if reading.name == pair), math.nan)


def _series(i: int) -> str:
    return SERIES[i % len(SERIES)]


def _torque(i: int, name: str, limit: float, unit: str) -> Curve:
    kind, unit_of = ("torque", "N m") if unit == "rad" else ("force", "N")
    hint = f"{name}: {kind} u_a divided by its limit of {limit:g} {unit_of}, −1 to 1, (26)"
    return Curve(f"{i + 1}", lambda s: s.u_a[i] / limit, _series(i), hint)


def _avoidance(i: int, axis: Axis, colour: str) -> Curve:
    unit = "rad/s²" if axis.angular else "m/s²"
    label = f"{'turn' if axis.angular else axis.way} {acceleration_symbol(axis)} [{unit}]"
    return Curve(label, lambda s: float(s.avoidance_acceleration[i]), colour, _MOVES)


def _soft(low: float, high: float) -> dict[str, dict[str, float]]:
    """Return a range for uPlot: `low` to `high`, extended to all data with a margin of 10 %."""
    return {end: {"pad": 0.1, "soft": x, "mode": 1} for end, x in (("min", low), ("max", high))}
