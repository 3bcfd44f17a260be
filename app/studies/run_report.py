"""The report of a run, as a self-contained page."""

import math
from collections.abc import Sequence
from copy import copy
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from app.config import Config, tunables
from app.errors import DbbError
from app.jobs.progress import OnProgress
from app.robot.description import load_robot
from app.simulation.trace.columns import TraceMeta
from app.simulation.trace.metrics import extremes, metrics, verdict
from app.simulation.trace.trace import Trace
from app.simulation.trace.words import spoken
from app.strict import Array
from app.studies import style
from app.studies.page import Grid, Part, measured_grids, page_html
from app.studies.runs import flattened, plain

_OTHERS = ("#0072B2", "#D55E00", "#CC79A7", "#56B4E9", "#F0E442", "#7A7F87")
"""Colours of the pairs without a colour in `PAIR_COLOURS`, repeated if there are more pairs."""
_JOINTS = ("#0072B2", "#E69F00", "#009E73", "#D55E00", "#CC79A7", "#56B4E9", "#1F2933")
_UNKNOWN = ("duration_us", "force_bound_n", "buffer_needed_m", "buffer_needed_max_m")
"""Columns that can have NaN or infinite values in a complete log, besides the optional ones."""
_LISTED = 5  # [-] largest number of columns with missing values that the report names


def run_report(run: Trace, on_progress: OnProgress = lambda _: None) -> str:
    """Make the HTML page of a trace with snapshots: key numbers, pictures, changed parameters."""
    run, controllers = _without_infinite(run), ", then ".join(run.controllers)
    title = f"{run.meta.scenario or 'Guiding by hand'}, {controllers}"
    numbers, chain = key_numbers(run), _chain(run.meta)
    counts = zip(run.columns, np.isnan(run.table).sum(axis=0).tolist(), strict=True)
    empty = [
        f"{column.name} ({count} of {len(run)} rows)"
        for column, count in counts
        if count and not column.optional and column.name not in _UNKNOWN
    ]
    more = f" and {len(empty) - _LISTED} other columns" if len(empty) > _LISTED else ""
    gaps = f"Values are missing in the log, in {', '.join(empty[:_LISTED])}{more}."
    parts = [Part(text=[verdict(numbers, chain), *([gaps] if empty else [])])]
    if chain:
        named = numbers["min_distance_m"].items()
        numbers["min_distance_m"] = {spoken(pair, chain): d for pair, d in named}
    parts.append(Part("Key numbers", "numbers", tables=measured_grids(flattened(numbers))))
    with style.styled():
        for k, each in enumerate(_PICTURES.values()):
            on_progress(k / len(_PICTURES))
            parts.append(Part(each.title, each.name, [each.caption], style.png_of(each.draw(run))))
    changes = [
        (path, tunables()[path].unit.removeprefix("-"), _value(usual), _value(had))
        for path, usual, had in config_changes([s.config for s in run.snapshots])
    ]
    part = Part("Parameters", "parameters", ["All parameters had the program's defaults."])
    if changes:
        grid = Grid(("changed", "unit", "default", "here"), changes, numbers=True)
        part = Part("Parameters", "parameters", tables=[grid])
    parts.append(part)
    meta, first, last = run.meta, run.snapshots[0], run.snapshots[-1]
    robot = f"Robot {meta.robot}" + (f", plant {meta.physics}" if meta.physics else "")
    robot += "" if meta.seed is None else f", seed {meta.seed}"
    rows = "one for each control step" if run.each_step else "without the steps between them"
    about = f"{robot}; {first.t:.2f} s to {last.t:.2f} s, {len(run)} rows, {rows}."
    return page_html(title, about, parts)


def _chain(meta: TraceMeta) -> tuple[str, ...]:
    """Names of the robot's bodies, base first; empty if this machine has no valid description."""
    try:
        return tuple(body.name for body in load_robot(meta.robot).bodies)
    except DbbError:
        return ()


def key_numbers(run: Trace) -> dict[str, Any]:
    """The results of `extremes` and `metrics`; None replaces values that are not finite."""
    run = _without_infinite(run)
    return plain({**extremes(run), **metrics(run)})


def _without_infinite(run: Trace) -> Trace:
    """The run with NaN in the place of infinite values, which then count as missing."""
    finite = copy(run)
    finite.table = np.where(np.isinf(run.table), np.nan, run.table)
    return finite


def config_changes(configs: Sequence[Config]) -> list[tuple[str, Any, Any]]:
    """Path, program's default and value of each parameter that any configuration changes.

    If the configurations have different values, a list of these values replaces the value.
    """
    changes = []
    for path, about in tunables().items():
        had = list(dict.fromkeys(config.value(path) for config in configs))
        if had != [about.default]:
            changes.append((path, about.default, had[0] if len(had) == 1 else had))
    return changes


def _value(value: Any) -> str:
    values = value if isinstance(value, list) else [value]
    return ", then ".join(f"{x:g}" if isinstance(x, float) else str(x) for x in values)


@style.picture("distances", "Distances and activations")
def distances_figure(run: Trace) -> Figure:
    """Above: distances of all pairs. Below: activations. Dashed curves: pairs within the arm."""
    figure, (above, below) = style.new_panels(6.0, 2, 1, sharex=True, height_ratios=[3, 2])
    chain = _chain(run.meta)
    others = cycle(_OTHERS)
    for k, pair in enumerate(run.meta.pairs):
        mobile = pair in run.meta.mobile_pairs
        colour = style.PAIR_COLOURS.get(pair) or next(others)
        line = {"color": colour, "linestyle": "-" if mobile else (0, (5, 2))}
        above.plot(run.t, run.distances[:, k], label=spoken(pair, chain) if chain else pair, **line)
        below.plot(run.t, run.betas[:, k], **line)
    times, d_b = [s.t for s in run.snapshots], [s.d_b for s in run.snapshots]
    if len(set(d_b)) == 1 and math.isfinite(d_b[0]):
        style.level(above, d_b[0], "buffer distance $d_b$")
    else:  # it changed during the run, or is missing
        above.step(times, d_b, where="post", color=style.SOFT, linestyle=(0, (4, 3)), label="$d_b$")
    above.axhline(0.0, color=style.TARGET, linewidth=1.0)
    above.set_ylabel("distance [m]")
    below.set(ylabel=r"activation $\beta$ [–]", ylim=(-0.03, 1.05))
    _legend_right(above)
    _over_time((above, below), run)
    return figure


@style.picture("base", "Accelerations and velocities of the base")
def base_figure(run: Trace) -> Figure:
    """Above: commanded acceleration of the base, and desired acceleration of the avoidance times
    its activation. Below: commanded and true velocity of the base.
    """
    acceleration, avoidance = run.of("base_acceleration"), run.of("avoidance_acceleration")
    command, velocity = run.of("base_velocity_command"), run.of("base_velocity")
    linear = acceleration.shape[1] - 1  # the last axis is angular
    figure, grid = style.new_panels(6.4, 2, linear + 1, sharex=True)
    names = {1: ["v"], 2: ["v_x", "v_y"]}.get(linear, [f"v_{i}" for i in range(linear)])
    for k, name in enumerate([*names, r"\omega"]):
        (above, below), unit = grid[:, k], "m" if k < linear else "rad"
        above.plot(run.t, acceleration[:, k], color=style.PATH, label="commanded by the QP")
        above.plot(run.t, avoidance[:, k], color=style.ACTING, label=r"avoidance, $\beta\,\ddot x$")
        above.set_ylabel(rf"$\dot {name}$ [{unit}/s²]")
        below.step(run.t, command[:, k], where="post", color=style.SOFT, label="commanded")
        below.plot(run.t, velocity[:, k], color=style.PATH, label="true")
        below.set_ylabel(f"${name}$ [{unit}/s]")
    for row in grid:
        row[0].legend(loc="lower left", bbox_to_anchor=(-0.01, 1.0), ncols=2, borderaxespad=0.1)
    _over_time(grid.ravel(), run, bottom=grid[1])
    return figure


@style.picture("end_effector", "The end-effector")
def end_effector_figure(run: Trace) -> Figure:
    """Above: distance of the end-effector from a person's target, else from its reference, else 0.
    Below: force of people on the end-effector, or of the end-effector on a door.
    """
    figure, (error, force) = style.new_panels(4.6, 2, 1, sharex=True)
    error.plot(run.t, 1000.0 * run.of("ee_error"), color=style.EE)
    force.plot(run.t, np.linalg.norm(run.of("hand_force"), axis=1), color=style.ACTING)
    error.set(ylabel="end-effector error [mm]", ylim=(0.0, None))
    force.set(ylabel="force [N]", ylim=(0.0, None))
    _over_time((error, force), run)
    return figure


@style.picture("torques", "Torques of the arm")
def torques_figure(run: Trace) -> Figure:
    """Commanded torque of each revolute joint of the arm, or force of a prismatic joint."""
    figure, ax = style.new_panels(3.6)
    for k, joint in enumerate(run.meta.joints):
        ax.plot(run.t, run.of("u_a")[:, k], color=_JOINTS[k % len(_JOINTS)], label=joint)
    ax.set_ylabel("torque [N m]" if "m" not in run.meta.joint_units else "torque [N m], force [N]")
    _legend_right(ax)
    _over_time((ax,), run)
    return figure


@style.picture("plan", "From above")
def plan_figure(run: Trace) -> Figure:
    """Paths from above, from squares to circles. Arrows: heading of the base, grey at the start."""
    figure, ax = style.new_panels(5.0)
    shown = ("base_pose", style.PATH, "base"), ("p_ee", style.EE, "end-effector")
    for name, colour, text in shown:
        points = run.of(name)
        ax.plot(points[:, 0], points[:, 1], color=colour, label=text)
        ax.plot(*points[0, :2], **style.marker_style(colour, "s", 7.0))
        ax.plot(*points[-1, :2], **style.marker_style(colour))
    for k, colour in ((0, style.SOFT), (-1, style.PATH)):
        x, y, yaw = run.of("base_pose")[k].tolist()
        tip = x + 0.2 * math.cos(yaw), y + 0.2 * math.sin(yaw)
        head = {"arrowstyle": "-|>", "color": colour, "linewidth": 1.6}
        ax.annotate("", tip, (x, y), arrowprops=head)
    targets = np.array([s.hand_target for s in run.snapshots if s.hand_target is not None])
    if len(targets):
        line = {"color": style.TARGET, "linewidth": 1.4, "label": "target of the pull"}
        ax.plot(targets[:, 0], targets[:, 1], ":", **line)
    ax.set_aspect("equal", adjustable="datalim")
    ax.set(xlabel="x [m]", ylabel="y [m]")
    _legend_right(ax)
    return figure


def _legend_right(ax: Axes) -> None:
    ax.legend(loc="upper left", bbox_to_anchor=(1.005, 1.02), borderaxespad=0.0)


def _over_time(axes: Sequence[Axes], run: Trace, bottom: Sequence[Axes] | None = None) -> None:
    """Limit x to the run's times, shade the arm's contacts, name x of `bottom` or the last axes."""
    touched = spans(run.of("in_contact") + run.of("arm_in_contact") > 0.0, run.t)
    for ax in axes:
        if run.t[-1] > run.t[0]:
            ax.set_xlim(run.t[0], run.t[-1])
        for begin, end in touched:
            ax.axvspan(begin, end, color=style.TARGET, alpha=0.12, linewidth=0.0)
    for ax in axes[-1:] if bottom is None else bottom:
        ax.set_xlabel("time [s]" + (", in contact where shaded" if touched else ""))


def spans(flags: Array, t: Array) -> list[tuple[float, float]]:
    """Start and end [s] of the intervals in which a flag (N,) is true, at times t (N,) [s]."""
    intervals = np.ma.clump_unmasked(np.ma.masked_array(t, ~flags))
    return [(float(t[s.start]), float(t[min(s.stop, len(t) - 1)])) for s in intervals]


_PICTURES = style.pictures_in(globals())
