"""Figures of one run, from its log."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.simulation.trace.log import Log
from app.studies.run_report.numbers import Track, spans
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


def distances_figure(log: Log, track: Track) -> Figure:
    """Distances of all pairs over their activations."""
    figure = new_figure(6.0)
    above, below = figure.subplots(2, 1, sharex=True, height_ratios=[3, 2])
    colours = _pair_colours(log.meta.pairs)
    for k, pair in enumerate(log.meta.pairs):
        mobile = pair in log.meta.mobile_pairs
        style = {"color": colours[pair], "linestyle": "-" if mobile else (0, (5, 2))}
        above.plot(track.t, track.d[:, k], label=pair, **style)
        below.plot(track.t, track.beta[:, k], **style)
    d_b = [s.config.border.d_b for s in log.snapshots]
    if len(set(d_b)) == 1:
        level(above, d_b[0], "buffer distance $d_b$")
    else:  # it was changed while the run went on
        above.step(track.t, d_b, where="post", color=SOFT, linestyle=(0, (4, 3)), label="$d_b$")
    above.axhline(0.0, color=TARGET, linewidth=1.0)
    above.set_ylabel("distance [m]")
    below.set_ylabel(r"activation $\beta$ [–]")
    below.set_ylim(-0.03, 1.05)
    _legend_right(above)
    _over_time((above, below), track)
    return figure


def base_figure(track: Track) -> Figure:
    """What is asked of the base, and what it does."""
    figure = new_figure(6.4)
    linear = track.asked.shape[1] - 1  # the last axis turns
    grid = figure.subplots(2, linear + 1, sharex=True)
    names = {1: ["v"], 2: ["v_x", "v_y"]}.get(linear, [f"v_{i}" for i in range(linear)])
    rates = [(rf"\dot {name}", "m/s²") for name in names] + [(r"\dot\omega", "rad/s²")]
    for k, (rate, unit) in enumerate(rates):
        ax = grid[0][k]
        ax.plot(track.t, track.asked[:, k], color=PATH, label="asked by the HQP")
        ax.plot(track.t, track.avoidance[:, k], color=ACTING, label=r"avoidance, $\beta\,\ddot x$")
        ax.set_ylabel(f"${rate}$ [{unit}]")
    speeds = [(name, "m/s") for name in names] + [(r"\omega", "rad/s")]
    for k, (speed, unit) in enumerate(speeds):
        ax = grid[1][k]
        ax.step(track.t, track.command[:, k], where="post", color=SOFT, label="commanded")
        ax.plot(track.t, track.velocity[:, k], color=PATH, label="measured")
        ax.set_ylabel(f"${speed}$ [{unit}]")
    for row in grid:
        _legend_above(row[0])
    _over_time(grid.ravel(), track, bottom=grid[1])
    return figure


def hand_figure(track: Track) -> Figure:
    """How far the hand is off, and with what force it is pulled."""
    figure = new_figure(4.6)
    error, force = figure.subplots(2, 1, sharex=True)
    error.plot(track.t, 1000.0 * track.error, color=HAND)
    error.set_ylabel("hand off its target [mm]")
    force.plot(track.t, track.force, color=ACTING)
    force.set_ylabel("force on the hand [N]")
    for ax in (error, force):
        ax.set_ylim(bottom=0.0)
    _over_time((error, force), track)
    return figure


def torques_figure(log: Log, track: Track) -> Figure:
    """Torques of the arm's joints."""
    figure = new_figure(3.6)
    ax = figure.subplots()
    for k, joint in enumerate(log.meta.joints):
        ax.plot(track.t, track.u_a[:, k], color=_JOINTS[k % len(_JOINTS)], label=joint)
    ax.set_ylabel("torque [N m]" if "m" not in log.meta.joint_units else "torque [N m], force [N]")
    _legend_right(ax)
    _over_time((ax,), track)
    return figure


def plan_figure(log: Log, track: Track) -> Figure:
    """Where the base and the hand went, from above; a square where they began."""
    figure = new_figure(5.0)
    ax = figure.subplots()
    for points, colour, text in ((track.base, PATH, "base"), (track.p_ee, HAND, "hand")):
        ax.plot(points[:, 0], points[:, 1], color=colour, label=text)
        ax.plot(*points[0, :2], **marker_style(colour, "s", 7.0))
        ax.plot(*points[-1, :2], **marker_style(colour))
    for k, filled in ((0, False), (-1, True)):
        x, y, phi = track.base[k].tolist()
        ax.annotate(
            "",
            (x + 0.2 * math.cos(phi), y + 0.2 * math.sin(phi)),
            (x, y),
            arrowprops={"arrowstyle": "-|>", "color": PATH if filled else SOFT, "linewidth": 1.6},
        )
    targets = np.array([s.hand_target for s in log.snapshots if s.hand_target is not None])
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


def _over_time(axes: Sequence[Axes], track: Track, bottom: Sequence[Axes] | None = None) -> None:
    """Time from the log's begin to its end; contact is shaded."""
    touched = spans(track.contact, track.t)
    for ax in axes:
        if track.t[-1] > track.t[0]:
            ax.set_xlim(track.t[0], track.t[-1])
        for begin, end in touched:
            ax.axvspan(begin, end, color=TARGET, alpha=0.12, linewidth=0.0)
    for ax in axes[-1:] if bottom is None else bottom:
        ax.set_xlabel("time [s]" + (", in contact where shaded" if touched else ""), color=INK)
