"""The polar map of a sweep: around the base, how the paths from each direction ended."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle, Wedge

from app.border.mobile import MobileBody
from app.robot.model import RobotModel
from app.studies.style import INK, METHOD_NAMES, SOFT, TARGET, new_figure
from app.studies.sweep.polar_quantities import NEVER, UNREACHABLE, Quantity, quantities
from app.studies.sweep.result import Row

Array = np.ndarray

_INNER, _OUTER = 0.80, 1.60  # [-] radii between which the bars stand; the footprint is within
_LEAST = 0.06  # [-] length of a bar for a value at the scale's begin
_AXIS_RADIUS, _AXIS_STEP = 1.78, 4.5  # [-] and [deg] of the dots of paths along the wheel axis
_EDGE = 2.15  # [-] half width of a panel
_PANEL = 3.35  # [in] side of a panel
_MARKS_FROM, _MARKS_STEP = 158.0, 22.0  # [deg] where the texts of the scale stand: behind the base
_HATCH = "////"


class Plan(NamedTuple):
    """What is drawn in the middle of each panel.

    Attributes:
        lower, upper: (2,) [m] corners of the base's footprint.
        mount: (2,) [m] where the arm stands.
    """

    lower: Array
    upper: Array
    mount: Array

    @classmethod
    def of(cls, model: RobotModel) -> Plan:
        """The plan of a robot."""
        body = MobileBody(model)
        return cls(body.lower[:2], body.upper[:2], model.p_base()[:2])


def polar_map(result: Row, height: float, speed: float, plan: Plan) -> Figure:
    """One figure: a column per controller; final error, least clearance and time below each other.

    A single controller has them side by side.

    Args:
        result: What `sweep` gave.
        height: [m] of the hand.
        speed: [m/s] of the hand.
        plan: The base.
    """
    names = result["controllers"]
    shown = [_at(result[key], height, speed) for key in ("paths", "wheel_axis")]
    closed = [row for row in result["unreachable"] if row.get("height_m") == height]
    rows = quantities([row for rows in shown for row in rows])
    figure = map_figure(
        f"sweep, {result['mode']}: hand at {height:g} m, {1000 * speed:.3g} mm/s on its way, "
        f"{result['length_m']:g} m towards the base",
        names,
    )
    for ax, name, quantity in map_panels(figure, names, rows):
        _frame(ax, plan, quantity)
        paths, axis = ([r for r in rows if r["controller"] == name] for rows in shown)
        for row in paths:
            _bar(ax, row, quantity, result["step_deg"])
        for row in axis:
            _dot(ax, row, _mark_colour(row, quantity), INK)
        for row in closed:
            if row["kind"] == "side":
                _closed(ax, row["direction_deg"], result["step_deg"])
            else:
                _dot(ax, row, "white", SOFT)
    map_legend(figure, axis=bool(shown[1]) or any(r["kind"] == "wheel_axis" for r in closed))
    return figure


def map_figure(title: str, names: list[str], *, panel: float = _PANEL) -> Figure:
    """An empty figure for these controllers with its title; a panel is so many inches high."""
    wide, high = (3, 1) if len(names) == 1 else (len(names), 3)
    figure = new_figure(panel * high + 1.3, max(_PANEL * wide, 7.4))
    if len(names) == 1:
        title = f"{METHOD_NAMES.get(names[0], names[0])}: {title}"
    title = title[0].upper() + title[1:]
    figure.suptitle(title, x=0.01, ha="left", fontsize=13)
    return figure


def map_panels(
    figure: Figure, names: list[str], rows: Iterable[Quantity]
) -> Iterable[tuple[Axes, str, Quantity]]:
    """Each panel with its controller and quantity, titles set."""
    rows = tuple(rows)
    single = len(names) == 1
    grid = figure.subplots(
        1 if single else len(rows), len(rows) if single else len(names), squeeze=False
    )
    for i, quantity in enumerate(rows):
        for j, name in enumerate(names):
            ax = grid[0, i] if single else grid[i, j]
            label = METHOD_NAMES.get(name, name)
            if single:
                ax.set_title(f"{quantity.title}\n{label}", fontsize=11)
            else:
                ax.set_title(
                    f"{label}\n{quantity.title}" if i == 0 else quantity.title, fontsize=11
                )
            yield ax, name, quantity


def map_legend(figure: Figure, *, axis: bool) -> None:
    """What the colours mean, below all panels."""
    blue, red = "#2171B5", "#FC4E2A"
    handles: list[Patch | Line2D] = [
        Patch(facecolor=blue, label="within the limit"),
        Patch(facecolor=red, label="beyond the limit"),
        Patch(facecolor="white", edgecolor=NEVER, hatch=_HATCH, label="never within 1 mm"),
        Patch(facecolor="white", edgecolor=UNREACHABLE, hatch=_HATCH, label="no clear start"),
        Line2D([], [], color=INK, marker="x", linestyle="none", label="contact"),
    ]
    if axis:
        handles.append(
            Line2D(
                [],
                [],
                color=blue,
                marker="o",
                markeredgecolor=INK,
                linestyle="none",
                label="along the wheel axis, $p_b$ at 0, ±1, ±10, ±50 mm",
            )
        )
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9.5)


def _at(rows: list[Row], height: float, speed: float) -> list[Row]:
    return [row for row in rows if row["height_m"] == height and row["speed_mps"] == speed]


def _frame(ax: Axes, plan: Plan, quantity: Quantity) -> None:
    """The base, its wheel axis, and circles at the marks of the scale."""
    ax.set_aspect("equal")
    ax.set_axis_off()
    ax.set(xlim=(-_EDGE, _EDGE), ylim=(-_EDGE, _EDGE))
    ax.add_patch(Circle((0, 0), _OUTER, fill=False, color=SOFT, linewidth=0.5, zorder=4))
    for k, (value, text) in enumerate(quantity.marks):
        limit = value == quantity.limit
        radius = _INNER + (_OUTER - _INNER) * quantity.share(value)
        ax.add_patch(
            Circle(
                (0, 0),
                radius,
                fill=False,
                color=TARGET if limit else SOFT,
                zorder=4,
                linewidth=1.4 if limit else 0.7,
                linestyle=(0, (4, 2)) if limit else "-",
            )
        )
        angle = math.radians(_MARKS_FROM + _MARKS_STEP * k)
        ax.annotate(
            text,
            (radius * math.cos(angle), radius * math.sin(angle)),
            ha="center",
            va="center",
            fontsize=7.5,
            color=TARGET if limit else "#52606D",
            zorder=8,
            path_effects=[patheffects.withStroke(linewidth=2.5, foreground="white")],
        )
    size = plan.upper - plan.lower
    ax.add_patch(
        Rectangle(
            (plan.lower[0], plan.lower[1]),
            size[0],
            size[1],
            facecolor="#EEF1F4",
            edgecolor=INK,
            linewidth=1.2,
            zorder=3,
        )
    )
    ax.plot([0, 0], [-1.7, 1.7], color=INK, linewidth=0.9, linestyle=(0, (1, 2)), zorder=5)
    ax.add_patch(Circle((plan.mount[0], plan.mount[1]), 0.07, color=SOFT, zorder=4))
    tip = plan.upper[0]
    nose = [(tip, 0.09), (tip + 0.12, 0.0), (tip, -0.09)]
    ax.add_patch(Polygon(nose, closed=True, color=INK, zorder=4))
    for degrees, text in ((0, "0° front"), (90, "90°"), (180, "180°"), (270, "270°")):
        angle = math.radians(degrees)
        far = 2.02 if degrees % 180 else 1.86
        ax.annotate(
            text,
            (far * math.cos(angle), far * math.sin(angle)),
            ha="center",
            va="center",
            fontsize=8.5,
            color=INK,
            rotation=-90 if degrees == 0 else 90 if degrees == 180 else 0,
        )


def _radius(quantity: Quantity, value: float) -> float:
    return _INNER + (_OUTER - _INNER) * max(quantity.length(value), _LEAST)


def _bar(ax: Axes, row: Row, quantity: Quantity, step: float) -> None:
    value, middle = row[quantity.key], row["direction_deg"]
    ends = middle - 0.46 * step, middle + 0.46 * step
    if value is None:
        ax.add_patch(
            Wedge(
                (0, 0),
                _OUTER,
                *ends,
                width=_OUTER - _INNER,
                facecolor="white",
                edgecolor=NEVER,
                hatch=_HATCH,
                linewidth=0.6,
                zorder=2,
            )
        )
    else:
        radius = _radius(quantity, value)
        ax.add_patch(
            Wedge(
                (0, 0),
                radius,
                *ends,
                width=radius - _INNER,
                facecolor=quantity.colour(value),
                linewidth=0,
                zorder=2,
            )
        )
    if row["contacts"] or row["arm_contacts"]:
        angle = math.radians(middle)
        ax.plot(
            0.72 * math.cos(angle),
            0.72 * math.sin(angle),
            marker="x",
            color=INK,
            markersize=4.5,
            zorder=7,
        )


def _closed(ax: Axes, middle: float, step: float) -> None:
    """A direction without a clear start."""
    ax.add_patch(
        Wedge(
            (0, 0),
            _OUTER,
            middle - step / 2,
            middle + step / 2,
            width=_OUTER - _INNER,
            facecolor="white",
            edgecolor=UNREACHABLE,
            hatch=_HATCH,
            linewidth=0,
            zorder=1,
        )
    )


def _dot(ax: Axes, row: Row, face: object, edge: str) -> None:
    """A path along the wheel axis; in the order of p_b's place, not to scale."""
    order = {0.0: 0, 0.001: 1, 0.010: 2, 0.050: 3}
    rank = math.copysign(order[abs(row["offset_m"])], row["offset_m"])
    turn = -rank if row["direction_deg"] < 180.0 else rank  # positive x is to the right
    angle = math.radians(row["direction_deg"] + _AXIS_STEP * turn)
    ax.plot(
        _AXIS_RADIUS * math.cos(angle),
        _AXIS_RADIUS * math.sin(angle),
        marker="o",
        markersize=6.5,
        markerfacecolor=face,
        markeredgecolor=edge,
        markeredgewidth=0.8,
        linestyle="none",
        zorder=6,
    )
    if row.get("contacts") or row.get("arm_contacts"):
        ax.plot(1.9 * math.cos(angle), 1.9 * math.sin(angle), marker="x", color=INK, markersize=4)


def _mark_colour(row: Row, quantity: Quantity) -> object:
    value = row[quantity.key]
    return NEVER if value is None else quantity.colour(value)
