"""§4.2.1: the hand tracks a line towards the base (Figures 11 and 12)."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes

from app.studies.drawing import Drawing, Table, stacked
from app.studies.paper.experiments import Experiment, Run, Sources
from app.studies.paper.panels import Strip, legend_of, path_columns, snapshot_figure
from app.studies.style import (
    METHOD_COLOURS,
    METHOD_NAMES,
    PAIR_NAMES,
    level,
    new_figure,
    panel_title,
    time_axis,
)

Array = np.ndarray

DBB = Experiment("tracking", "dbb")
REPULSIVE = Experiment("tracking", "repulsive")
NONE = Experiment("tracking", "none")
METHODS = (DBB, REPULSIVE)
WHEEL_AXIS = Experiment("tracking", "dbb", start=(0.0, 0.68, 0.30))
"""The hand comes along the wheel axis, along which the base cannot move at once."""

_TIMES = (0.0, 10.0, 20.0, 30.0)  # [s] of the snapshots
_PAIRS = ("lm-lEE", "lm-l3")
_VIEW = 0.85  # [rad] from the left front, where the hand is


def figure_11(sources: Sources) -> Drawing:
    """Snapshots of the proposed method and of the repulsive one."""
    paths, strips = {}, []
    for letter, experiment in zip("ab", METHODS, strict=True):
        run = sources.runs[experiment]
        paths[letter] = Table(path_columns(sources.model, run))
        text = METHOD_NAMES[experiment.controller]
        strips.append(Strip(letter, text, run, _TIMES, _VIEW, aim=experiment.aim()))
    figure = snapshot_figure(
        sources.model, strips, paths, legend_of(aim="target and desired motion")
    )
    parts = {e.controller: paths[x].columns for x, e in zip("ab", METHODS, strict=True)}
    return Drawing(
        "Figure 11: the hand tracks a line towards the base",
        "With the proposed method a force moves the base back, and the hand reaches its target "
        "without a collision. The repulsive method pushes the arm away from the base: it avoids "
        "the collision, but the hand cannot reach the target.",
        figure,
        {"": stacked(parts, "controller")},
        {e.controller: _motion(sources.runs[e]) for e in METHODS},
    )


def figure_12(sources: Sources) -> Drawing:
    """Distances of the pairs of L_m, and the norm of the position error."""
    parts = {e.controller: _columns(sources.runs[e]) for e in METHODS}
    table = stacked(parts, "controller")
    figure = new_figure(6.4)
    grid = figure.subplots(2, 2, sharex=True)
    grid[0][0].sharey(grid[0][1])
    d_b = sources.config.border.d_b
    for ax, pair in zip(grid[0], _PAIRS, strict=True):
        _lines(ax, parts, f"d_{pair}_m")
        level(ax, d_b, "buffer distance $d_b$")
        ax.set_ylabel("distance [m]")
        panel_title(ax, "a", PAIR_NAMES[pair])
    highest = max(float(part[f"d_{pair}_m"].max()) for part in parts.values() for pair in _PAIRS)
    grid[0][0].set_ylim(min(0.0, _lowest(parts)), 1.1 * highest)
    error, detail = grid[1]
    _lines(error, parts, "ee_error_m")
    error.set_ylabel("position error [m]")
    error.set_ylim(-0.02 * error.get_ylim()[1], None)  # a line at 0 stands clear of the axis
    panel_title(error, "b", "norm of the position error")
    for name, columns in parts.items():
        detail.semilogy(
            columns["t_s"],
            np.maximum(columns["ee_error_m"], 1e-9),
            color=METHOD_COLOURS[name],
            label=METHOD_NAMES[name],
        )
    detail.set_ylabel("position error [m]")
    panel_title(detail, "b", "the same on a logarithmic scale")
    for ax in grid.flat:
        time_axis(ax, DBB.full().duration)
    for ax in grid[0]:
        ax.set_xlabel("")
    grid[0][0].legend(loc="lower left")
    return Drawing(
        "Figure 12: distances and error while tracking",
        "(a) The distances fall below the buffer distance of 0.15 m, so that the avoidance task of "
        "each method is inserted continuously with top priority. (b) The repulsive method has a "
        "position error, the proposed one does not.",
        figure,
        {"": table},
        {e.controller: _errors(sources.runs[e]) for e in METHODS},
        [
            "The repulsive method's task takes all three directions of the closest point, so the "
            "hand hardly goes on from where the buffer begins."
        ],
    )


def _columns(run: Run) -> dict[str, Array]:
    names = ("t_s", *(f"d_{pair}_m" for pair in _PAIRS), "ee_error_m")
    return {name: run.log[name] for name in names}


def _lines(ax: Axes, parts: dict[str, dict[str, Array]], column: str) -> None:
    for name, columns in parts.items():
        ax.plot(
            columns["t_s"], columns[column], color=METHOD_COLOURS[name], label=METHOD_NAMES[name]
        )


def _lowest(parts: dict[str, dict[str, Array]]) -> float:
    """[m] least distance among all lines; below zero in contact."""
    return min(float(part[f"d_{pair}_m"].min()) for part in parts.values() for pair in _PAIRS)


def _motion(run: Run) -> dict[str, object]:
    keys = ("base_displacement_m", "base_yaw_rad", "contacts", "ee_error_final_m")
    return {key: run.figures[key] for key in keys}


def _errors(run: Run) -> dict[str, object]:
    keys = ("min_clearance_m", "ee_error_max_m", "ee_error_final_m")
    return {key: run.figures[key] for key in keys}
