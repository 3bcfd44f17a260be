"""The map of a sweep from above: the base in plan, and how each path down onto it ended."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise
from typing import Any

from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Rectangle

from app.studies.style import INK, SOFT
from app.studies.sweep.polar import Plan, map_figure, map_legend, map_panels
from app.studies.sweep.polar_quantities import NEVER, UNREACHABLE, Quantity, quantities
from app.studies.sweep.result import Row


def above_map(result: Row, speed: float, plan: Plan) -> Figure:
    """One figure: the base in plan, a square per place; panels as in the polar map.

    Args:
        result: What `sweep` gave, with paths from above.
        speed: [m/s] of the hand.
        plan: The base.
    """
    rows = [row for row in result["above"] if row["speed_mps"] == speed]
    closed = [row for row in result["unreachable"] if row["kind"] == "above"]
    side = _spacing([*rows, *closed])
    figure = map_figure(
        f"sweep from above, {result['mode']}: {1000 * speed:.3g} mm/s, "
        f"{result['length_m']:g} m down",
        result["controllers"],
        panel=2.6,
    )
    for ax, name, quantity in map_panels(figure, result["controllers"], quantities(rows)):
        _frame(ax, plan)
        for row in closed:
            _square(ax, row, side, facecolor="white", edgecolor=UNREACHABLE, hatch="////")
        for row in rows:
            if row["controller"] == name:
                _path(ax, row, quantity, side)
    map_legend(figure, axis=False)
    return figure


def _frame(ax: Axes, plan: Plan) -> None:
    ax.set_aspect("equal")
    size = plan.upper - plan.lower
    ax.add_patch(
        Rectangle(
            (plan.lower[0], plan.lower[1]),
            size[0],
            size[1],
            fill=False,
            edgecolor=INK,
            linewidth=1.2,
            zorder=3,
        )
    )
    ax.plot(
        [0, 0],
        [plan.lower[1] - 0.1, plan.upper[1] + 0.1],
        color=INK,
        linewidth=0.9,
        linestyle=(0, (1, 2)),
        zorder=4,
    )
    ax.add_patch(Circle((plan.mount[0], plan.mount[1]), 0.05, color=SOFT, zorder=4))
    ax.set(xlabel="x of the base [m]", ylabel="y of the base [m]")
    ax.set(xlim=(plan.lower[0] - 0.15, plan.upper[0] + 0.15))
    ax.set(ylim=(plan.lower[1] - 0.15, plan.upper[1] + 0.15))


def _path(ax: Axes, row: Row, quantity: Quantity, side: tuple[float, float]) -> None:
    value = row[quantity.key]
    if value is None:
        _square(ax, row, side, facecolor="white", edgecolor=NEVER, hatch="////")
    else:
        _square(ax, row, side, facecolor=quantity.colour(value), edgecolor="white")
    if row["contacts"] or row["arm_contacts"]:
        ax.plot(row["place_x_m"], row["place_y_m"], marker="x", color=INK, markersize=6, zorder=5)


def _square(ax: Axes, row: Row, side: tuple[float, float], **style: Any) -> None:
    corner = row["place_x_m"] - side[0] / 2, row["place_y_m"] - side[1] / 2
    ax.add_patch(Rectangle(corner, *side, linewidth=0.8, zorder=2, **style))


def _spacing(rows: Sequence[Row]) -> tuple[float, float]:
    """[m] between two places along x and along y."""
    return _least_step(rows, "place_x_m"), _least_step(rows, "place_y_m")


def _least_step(rows: Sequence[Row], key: str) -> float:
    values = sorted({float(row[key]) for row in rows})
    return min((b - a for a, b in pairwise(values)), default=1.0)
