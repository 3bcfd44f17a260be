"""§4.2.1 and §4.2.2: the hand tracks, or is led along, a line towards the base (Figures 11-15)."""

from __future__ import annotations

import numpy as np

from app.studies.paper.drawing import (
    Drawing,
    Strip,
    Table,
    method_lines,
    snapshot_figure,
    stacked,
)
from app.studies.paper.experiments import (
    FRONT,
    GUIDING,
    LATERAL,
    TRACKING,
    TRACKING_REPULSIVE,
    Experiment,
    Run,
    Sources,
)
from app.studies.style import (
    METHOD_NAMES,
    PAIR_COLOURS,
    PAIR_NAMES,
    level,
    new_figure,
    panel_title,
    time_axis,
)

METHODS = {"dbb": TRACKING, "repulsive": TRACKING_REPULSIVE}
DIRECTIONS = GUIDING["dbb"]
COMPARED = tuple(each for by_direction in GUIDING.values() for each in by_direction.values())
"""Figure 15's experiments."""

_TIMES = (0.0, 10.0, 20.0, 30.0)  # [s] of the snapshots of tracking
_SHARES = (0.0, 0.3, 0.6, 1.0)  # [-] of the run at which those of guiding are taken
_VIEWS = {LATERAL: (0.85, 0.45), FRONT: (0.70, 0.45)}  # [rad] from the left front, from above
_PAIRS = ("lm-lEE", "lm-l3")
_MOTION = ("base_displacement_m", "base_yaw_rad", "contacts", "ee_error_final_m")
_BUFFER = "buffer distance $d_b$"


def figure_11(sources: Sources) -> Drawing:
    """Snapshots of the proposed method and of the repulsive one."""
    strips = [
        Strip(name, METHOD_NAMES[name], sources.runs[e], _TIMES, _VIEWS[LATERAL], e.aim())
        for name, e in METHODS.items()
    ]
    return Drawing(
        "Figure 11: the hand tracks a line towards the base",
        "With the proposed method a force moves the base back, and the hand reaches its target "
        "without a collision. The repulsive method pushes the arm away from the base: it avoids "
        "the collision, but the hand cannot reach the target.",
        snapshot_figure(sources.model, strips, aim="target and desired motion"),
        {"": stacked({strip.name: strip.paths() for strip in strips}, "controller")},
        sources.figures(METHODS, _MOTION),
    )


def figure_12(sources: Sources) -> Drawing:
    """Distances of the pairs of L_m, and the norm of the position error."""
    distances = [f"d_{pair}_m" for pair in _PAIRS]
    parts = _columns(sources, METHODS, "t_s", *distances, "ee_error_m")
    table = stacked(parts, "controller")
    figure = new_figure(6.4)
    grid = figure.subplots(2, 2, sharex=True)
    grid[0][0].sharey(grid[0][1])
    for k, (ax, column) in enumerate(zip(grid[0], distances, strict=True)):
        method_lines(ax, parts, column)
        level(ax, sources.config.border.d_b, _BUFFER)
        ax.set_ylabel("distance [m]")
        panel_title(ax, f"a{k + 1}", PAIR_NAMES[_PAIRS[k]])
    shown = np.concatenate([table[column] for column in distances])
    grid[0][0].set_ylim(min(0.0, float(shown.min())), 1.1 * float(shown.max()))
    error, detail = grid[1]
    for k, ax in enumerate((error, detail)):
        method_lines(ax, parts, "ee_error_m")
        ax.set_ylabel("position error [m]")
        text = ("norm of the position error", "the same on a logarithmic scale")[k]
        panel_title(ax, f"b{k + 1}", text)
    error.set_ylim(-0.02 * error.get_ylim()[1], None)  # a line at 0 stands clear of the axis
    detail.set_yscale("log")
    detail.set_ylim(max(1e-9, detail.get_ylim()[0]), None)
    for ax in grid.flat:
        time_axis(ax, TRACKING.full().duration)
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
        sources.figures(METHODS, ("min_clearance_m", "ee_error_max_m", "ee_error_final_m")),
        [
            "The repulsive method's task takes all three directions of the closest point, so the "
            "hand hardly goes on from where the buffer begins."
        ],
    )


def figure_13(sources: Sources) -> Drawing:
    """Snapshots of both directions of guiding."""
    strips = []
    for name, e in DIRECTIONS.items():
        times = [round(share * e.full().duration, 1) for share in _SHARES]
        text = f"guided from the {name} direction"
        strips.append(Strip(name, text, sources.runs[e], times, _VIEWS[e], e.aim()))
    return Drawing(
        "Figure 13: a person leads the hand towards the base",
        "(a) From the lateral direction the collision is avoided by a force on the base. (b) From "
        "the front the base moves back as the arm approaches.",
        snapshot_figure(sources.model, strips, aim="guiding direction and its end"),
        {"": stacked({strip.name: strip.paths() for strip in strips}, "direction")},
        sources.figures(DIRECTIONS, _MOTION),
    )


def figure_14(sources: Sources) -> Drawing:
    """Distances of the pairs of L_m and their activations."""
    columns = ("t_s", *(f"d_{p}_m" for p in _PAIRS), *(f"beta_{p}" for p in _PAIRS))
    parts = _columns(sources, DIRECTIONS, *columns)
    figure = new_figure(6.2)
    grid = figure.subplots(2, 2, sharex="col", sharey="row")
    for k, (name, part) in enumerate(parts.items()):
        distance, activation = grid[:, k]
        for pair in _PAIRS:
            style = {"color": PAIR_COLOURS[pair], "label": PAIR_NAMES[pair]}
            distance.plot(part["t_s"], part[f"d_{pair}_m"], **style)
            activation.plot(part["t_s"], part[f"beta_{pair}"], **style)
        level(distance, sources.config.border.d_b, _BUFFER)
        panel_title(distance, f"a{k + 1}", f"distances, {name} direction")
        panel_title(activation, f"b{k + 1}", f"activation, {name} direction")
        time_axis(activation, DIRECTIONS[name].full().duration)
    grid[0][0].set_ylabel("distance [m]")
    grid[0][0].set_ylim(0.0, None)
    grid[1][0].set_ylabel(r"activation $\beta$ [–]")
    grid[1][0].set_ylim(-0.02, 1.02)
    lines = grid[0][0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=len(_PAIRS))
    keys = ("min_clearance_m", "contacts", "activation_max", "ee_error_final_m")
    return Drawing(
        "Figure 14: distances and activation while guiding",
        "As a distance falls below the buffer distance of 0.15 m its activation rises, and the "
        "avoidance task is inserted continuously.",
        figure,
        {"": stacked(parts, "direction")},
        sources.figures(DIRECTIONS, keys),
    )


def figure_15(sources: Sources) -> Drawing:
    """Desired accelerations of the base times the activation; what the repulsive method asks."""
    figure = new_figure(6.2)
    grid = figure.subplots(2, 2, sharex="col", sharey="row")
    for k, name in enumerate(DIRECTIONS):
        parts = {m: _asked(sources.runs[GUIDING[m][name]], m) for m in reversed(GUIDING)}
        for ax, letter, kind in zip(grid[:, k], "ab", ("linear", "angular"), strict=True):
            unit = "mps2" if kind == "linear" else "radps2"
            method_lines(ax, parts, f"{kind}_{unit}", linewidth=1.6)
            panel_title(ax, f"{letter}{k + 1}", f"{kind}, {name} direction")
        time_axis(grid[1][k], DIRECTIONS[name].full().duration)
    grid[0][0].set_ylabel(r"$\beta_m\,\dot v_d$ [m/s²]")
    grid[1][0].set_ylabel(r"$\beta_m\,\dot\omega_d$ [rad/s²]")
    lines = grid[0][0].get_legend_handles_labels()
    figure.legend(*lines, loc="outside lower center", ncols=len(GUIDING))
    runs = {
        f"{name}, {method}": (sources.runs[experiment], method)
        for method, by_direction in GUIDING.items()
        for name, experiment in by_direction.items()
    }
    return Drawing(
        "Figure 15: desired accelerations of the base while guiding",
        "The desired linear (a) and angular (b) accelerations of the base, times the activation, "
        "are smooth: no chattering or vibration, because the task transition is continuous.",
        figure,
        {"": stacked({n: _asked(*run) for n, run in runs.items()}, "direction and controller")},
        {name: _smoothness(*run) for name, run in runs.items()},
        [
            "With the border as the paper's points the acting point jumps from point to point, "
            "and the accelerations with it. The controller here uses a surface through them.",
            "The repulsive method pushes the arm alone; its line is all that it asks of the base.",
        ],
    )


def _smoothness(run: Run, method: str) -> dict[str, object]:
    """Largest changes per control step, and sign changes of what avoidance asks of the base.

    The repulsive method inserts nothing for the base: of it only what the base is asked counts.
    """
    inserted = ("avoidance_acceleration_jump_max", "avoidance_acceleration_sign_changes")
    asked = (
        "base_acceleration_jump_max",
        "base_acceleration_sign_changes",
        "torque_jump_max_nm",
        "torque_rate_sign_changes",
    )
    keys = asked if method == "repulsive" else (*inserted, *asked)
    return {key: run.figures[key] for key in keys}


def _asked(run: Run, method: str) -> Table:
    """What avoidance asks of the base; for the repulsive method, all that is asked of it."""
    kind = "base" if method == "repulsive" else "avoidance"
    return {
        "t_s": run.log["t_s"],
        "linear_mps2": run.log[f"{kind}_a_mps2"],
        "angular_radps2": run.log[f"{kind}_aw_radps2"],
    }


def _columns(sources: Sources, by_name: dict[str, Experiment], *columns: str) -> dict[str, Table]:
    return {name: {c: sources.runs[e].log[c] for c in columns} for name, e in by_name.items()}
