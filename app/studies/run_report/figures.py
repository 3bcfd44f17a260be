"""Figures of one run, from its log."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.simulation.trace.trace import Trace
from app.studies.style import (
    ACTING,
    HAND,
    INK,
    PAIR_COLOURS,
    PATH,
    SOFT,
    TARGET,
    level,
    marker_style,
    new_figure,
)

Array = np.ndarray

_OTHERS = ("#0072B2", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442", "#7A7F87")
"""Colours of what has none of its own, such as joints and further pairs."""
_JOINTS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#1F2933")


def distances_figure(run: Trace) -> Figure:
    """Distances of all pairs over their activations."""
    figure = new_figure(6.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    colours = _pair_colours(run.meta.pairs)
    for k, pair in enumerate(run.meta.pairs):
        mobile = pair in run.meta.mobile_pairs
        style = {"color": colours[pair], "linestyle": "-" if mobile else (0, (5, 2))}
        above.plot(run.t, run.distances[:, k], label=pair, **style)
        below.plot(run.t, run.betas[:, k], **style)
    d_b = [s.config.border.d_b for s in run.snapshots]
    if len(set(d_b)) == 1:
        level(above, d_b[0], "buffer distance $d_b$")
    else:  # it was changed while the run went on
        times = [s.t for s in run.snapshots]
        above.step(times, d_b, where="post", color=SOFT, linestyle=(0, (4, 3)), label="$d_b$")
    above.axhline(0.0, color=TARGET, linewidth=1.0)
    above.set_ylabel("distance [m]")
    below.set_ylabel(r"activation $\beta$ [–]")
    below.set_ylim(-0.03, 1.05)
    _legend_right(above)
    _over_time((above, below), run)
    return figure


def base_figure(run: Trace) -> Figure:
    """What is asked of the base, and what it does."""
    figure = new_figure(6.4)
    linear = run.of("base_acceleration").shape[1] - 1  # the last axis turns
    grid = figure.subplots(2, linear + 1, sharex=True)
    names = {1: ["v"], 2: ["v_x", "v_y"]}.get(linear, [f"v_{i}" for i in range(linear)])
    rates = [(rf"\dot {name}", "m/s²") for name in names] + [(r"\dot\omega", "rad/s²")]
    for k, (rate, unit) in enumerate(rates):
        ax = grid[0][k]
        ax.plot(run.t, run.of("base_acceleration")[:, k], color=PATH, label="asked by the HQP")
        ax.plot(
            run.t,
            run.of("avoidance_acceleration")[:, k],
            color=ACTING,
            label=r"avoidance, $\beta\,\ddot x$",
        )
        ax.set_ylabel(f"${rate}$ [{unit}]")
    speeds = [(name, "m/s") for name in names] + [(r"\omega", "rad/s")]
    for k, (speed, unit) in enumerate(speeds):
        ax = grid[1][k]
        ax.step(
            run.t,
            run.of("base_velocity_command")[:, k],
            where="post",
            color=SOFT,
            label="commanded",
        )
        ax.plot(run.t, run.of("base_velocity")[:, k], color=PATH, label="measured")
        ax.set_ylabel(f"${speed}$ [{unit}]")
    for row in grid:
        _legend_above(row[0])
    _over_time(grid.ravel(), run, bottom=grid[1])
    return figure


def hand_figure(run: Trace) -> Figure:
    """How far the hand is off, and with what force it is pulled."""
    figure = new_figure(4.6)
    error, force = figure.subplots(2, 1, sharex=True)
    error.plot(run.t, 1000.0 * run.of("ee_error"), color=HAND)
    error.set_ylabel("hand off its target [mm]")
    force.plot(run.t, np.linalg.norm(run.of("hand_force"), axis=1), color=ACTING)
    force.set_ylabel("force on the hand [N]")
    for ax in (error, force):
        ax.set_ylim(bottom=0.0)
    _over_time((error, force), run)
    return figure


def torques_figure(run: Trace) -> Figure:
    """Torques of the arm's joints."""
    figure = new_figure(3.6)
    ax = figure.subplots()
    for k, joint in enumerate(run.meta.joints):
        ax.plot(run.t, run.of("u_a")[:, k], color=_JOINTS[k % len(_JOINTS)], label=joint)
    ax.set_ylabel("torque [N m]" if "m" not in run.meta.joint_units else "torque [N m], force [N]")
    _legend_right(ax)
    _over_time((ax,), run)
    return figure


def plan_figure(run: Trace) -> Figure:
    """Where the base and the hand went, from above; a square where they began."""
    figure = new_figure(5.0)
    ax = figure.subplots()
    for points, colour, text in (
        (run.of("base_pose"), PATH, "base"),
        (run.of("p_ee"), HAND, "hand"),
    ):
        ax.plot(points[:, 0], points[:, 1], color=colour, label=text)
        ax.plot(*points[0, :2], **marker_style(colour, "s", 7.0))
        ax.plot(*points[-1, :2], **marker_style(colour))
    for k, filled in ((0, False), (-1, True)):
        x, y, phi = run.of("base_pose")[k].tolist()
        ax.annotate(
            "",
            (x + 0.2 * math.cos(phi), y + 0.2 * math.sin(phi)),
            (x, y),
            arrowprops={"arrowstyle": "-|>", "color": PATH if filled else SOFT, "linewidth": 1.6},
        )
    targets = np.array([s.hand_target for s in run.snapshots if s.hand_target is not None])
    if len(targets):
        ax.plot(targets[:, 0], targets[:, 1], ":", color=TARGET, linewidth=1.4, label="pulled to")
    ax.set_aspect("equal", adjustable="datalim")
    ax.set_xlabel("x [m]")
    ax.set_ylabel("y [m]")
    _legend_right(ax)
    return figure


def _pair_colours(pairs: Sequence[str]) -> dict[str, str]:
    others = iter(_OTHERS * (1 + len(pairs)))
    return {pair: PAIR_COLOURS.get(pair) or next(others) for pair in pairs}


def _legend_right(ax: Axes) -> None:
    ax.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), borderaxespad=0.0)


def _legend_above(ax: Axes) -> None:
    ax.legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=2, borderaxespad=0.1)


def _over_time(axes: Sequence[Axes], run: Trace, bottom: Sequence[Axes] | None = None) -> None:
    """Time from the log's begin to its end; contact is shaded."""
    touched = spans(run.of("in_contact") + run.of("arm_in_contact") > 0.0, run.t)
    for ax in axes:
        if run.t[-1] > run.t[0]:
            ax.set_xlim(run.t[0], run.t[-1])
        for begin, end in touched:
            ax.axvspan(begin, end, color=TARGET, alpha=0.12, linewidth=0.0)
    for ax in axes[-1:] if bottom is None else bottom:
        ax.set_xlabel("time [s]" + (", in contact where shaded" if touched else ""), color=INK)


def spans(flags: Array, t: Array) -> list[tuple[float, float]]:
    """Begin and end [s] of the stretches in which a flag (N,) holds, at times t (N,)."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], flags.astype(int), [0]])))
    return [
        (float(t[a]), float(t[min(b, len(t) - 1)]))
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
