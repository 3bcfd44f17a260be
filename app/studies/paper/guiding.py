"""§4.2.2: a person leads the hand towards the base (Figures 13 to 15)."""

from __future__ import annotations

import numpy as np

from app.studies.drawing import Drawing, Table, stacked
from app.studies.paper.experiments import Experiment, Run, Sources
from app.studies.paper.panels import Strip, legend_of, path_columns, snapshot_figure
from app.studies.style import (
    METHOD_COLOURS,
    METHOD_NAMES,
    PAIR_COLOURS,
    PAIR_NAMES,
    level,
    new_figure,
    panel_title,
    time_axis,
)

Array = np.ndarray

LATERAL = Experiment("guiding-lateral", "dbb")
FRONT = Experiment("guiding-front", "dbb")
LATERAL_REPULSIVE = Experiment("guiding-lateral", "repulsive")
FRONT_REPULSIVE = Experiment("guiding-front", "repulsive")
LATERAL_POINTS = Experiment("guiding-lateral", "dbb", points=True)
FRONT_POINTS = Experiment("guiding-front", "dbb", points=True)
DIRECTIONS = {"lateral": LATERAL, "front": FRONT}
COMPARED = {
    "dbb": DIRECTIONS,
    "points": {"lateral": LATERAL_POINTS, "front": FRONT_POINTS},
    "repulsive": {"lateral": LATERAL_REPULSIVE, "front": FRONT_REPULSIVE},
}
"""Figure 15's experiments by the method's name and the direction."""
NEEDS = (LATERAL, FRONT)
NEEDS_POINTS = (LATERAL_POINTS, FRONT_POINTS)
NEEDS_COMPARED = tuple(e for each in COMPARED.values() for e in each.values())

_PAIRS = ("lm-lEE", "lm-l3")
_SHARES = (0.0, 0.3, 0.6, 1.0)  # [-] of the run at which snapshots are taken
_VIEWS = {"lateral": 0.85, "front": 0.70}  # [rad] from the left front


def figure_13(sources: Sources) -> Drawing:
    """Snapshots of both directions."""
    paths, strips = {}, []
    for letter, (name, experiment) in zip("ab", DIRECTIONS.items(), strict=True):
        run, scenario = sources.runs[experiment], experiment.full()
        paths[letter] = Table(path_columns(sources.model, run))
        times = [round(share * scenario.duration, 1) for share in _SHARES]
        text = f"guided from the {name} direction"
        strips.append(Strip(letter, text, run, times, _VIEWS[name], aim=experiment.aim()))
    legend = legend_of(aim="guiding direction and its end")
    figure = snapshot_figure(sources.model, strips, paths, legend)
    parts = {name: paths[x].columns for x, name in zip("ab", DIRECTIONS, strict=True)}
    keys = ("base_displacement_m", "base_yaw_rad", "contacts", "ee_error_final_m")
    return Drawing(
        "Figure 13: a person leads the hand towards the base",
        "(a) From the lateral direction the collision is avoided by a force on the base. (b) From "
        "the front the base moves back as the arm approaches.",
        figure,
        {"": stacked(parts, "direction")},
        _figures(sources, DIRECTIONS, keys),
    )


def figure_14(sources: Sources) -> Drawing:
    """Distances of the pairs of L_m and their activations."""
    columns = ("t_s", *(f"d_{p}_m" for p in _PAIRS), *(f"beta_{p}" for p in _PAIRS))
    parts = _parts(sources, DIRECTIONS, columns)
    figure = new_figure(6.2)
    grid = figure.subplots(2, 2, sharex="col", sharey="row")
    for k, (name, part) in enumerate(parts.items()):
        distance, activation = grid[:, k]
        for pair in _PAIRS:
            style = {"color": PAIR_COLOURS[pair], "label": PAIR_NAMES[pair]}
            distance.plot(part["t_s"], part[f"d_{pair}_m"], **style)
            activation.plot(part["t_s"], part[f"beta_{pair}"], **style)
        level(distance, sources.config.border.d_b, "buffer distance $d_b$")
        panel_title(distance, "a", f"distances, {name} direction")
        panel_title(activation, "b", f"activation, {name} direction")
        time_axis(activation, DIRECTIONS[name].full().duration)
    grid[0][0].set_ylabel("distance [m]")
    grid[0][0].set_ylim(0.0, None)
    grid[1][0].set_ylabel(r"activation $\beta$ [–]")
    grid[1][0].set_ylim(-0.02, 1.02)
    figure.legend(
        *grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=len(_PAIRS)
    )
    keys = ("min_clearance_m", "contacts", "activation_max", "ee_error_final_m")
    return Drawing(
        "Figure 14: distances and activation while guiding",
        "As a distance falls below the buffer distance of 0.15 m its activation rises, and the "
        "avoidance task is inserted continuously.",
        figure,
        {"": stacked(parts, "direction")},
        _figures(sources, DIRECTIONS, keys),
    )


def figure_15(sources: Sources) -> Drawing:
    """Desired accelerations of the base times the activation; what the repulsive method asks."""
    parts = {
        f"{name}, {method}": _asked(sources.runs[experiment], method)
        for method, experiments in COMPARED.items()
        for name, experiment in experiments.items()
    }
    figure = new_figure(6.2)
    grid = figure.subplots(2, 2, sharex="col", sharey="row")
    for k, name in enumerate(DIRECTIONS):
        for method in reversed(COMPARED):
            part = parts[f"{name}, {method}"]
            style = {"color": METHOD_COLOURS[method], "label": METHOD_NAMES[method]}
            for ax, column in zip(grid[:, k], ("linear_mps2", "angular_radps2"), strict=True):
                ax.plot(part["t_s"], part[column], linewidth=1.6, **style)
        panel_title(grid[0][k], "a", f"linear, {name} direction")
        panel_title(grid[1][k], "b", f"angular, {name} direction")
        time_axis(grid[1][k], DIRECTIONS[name].full().duration)
    grid[0][0].set_ylabel(r"$\beta_m\,\dot v_d$ [m/s²]")
    grid[1][0].set_ylabel(r"$\beta_m\,\dot\omega_d$ [rad/s²]")
    figure.legend(
        *grid[0][0].get_legend_handles_labels(), loc="outside lower center", ncols=len(COMPARED)
    )
    return Drawing(
        "Figure 15: desired accelerations of the base while guiding",
        "The desired linear (a) and angular (b) accelerations of the base, times the activation, "
        "are smooth: no chattering or vibration, because the task transition is continuous.",
        figure,
        {"": stacked(parts, "direction and controller")},
        {
            f"{name}, {method}": smoothness(sources.runs[experiment], method)
            for method, experiments in COMPARED.items()
            for name, experiment in experiments.items()
        },
        [
            "With the border as the paper's points the acting point jumps from point to point, "
            "and the accelerations with it. The controller here uses a surface through them.",
            "The repulsive method pushes the arm alone; its line is all that it asks of the base.",
        ],
    )


def smoothness(run: Run, method: str) -> dict[str, object]:
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


def _asked(run: Run, method: str) -> dict[str, Array]:
    """What avoidance asks of the base; for the repulsive method, all that is asked of it."""
    kind = "base" if method == "repulsive" else "avoidance"
    return {
        "t_s": run.log["t_s"],
        "linear_mps2": run.log[f"{kind}_a_mps2"],
        "angular_radps2": run.log[f"{kind}_aw_radps2"],
    }


def _parts(
    sources: Sources, experiments: dict[str, Experiment], columns: tuple[str, ...]
) -> dict[str, dict[str, Array]]:
    return {
        name: {column: sources.runs[experiment].log[column] for column in columns}
        for name, experiment in experiments.items()
    }


def _figures(
    sources: Sources, experiments: dict[str, Experiment], keys: tuple[str, ...]
) -> dict[str, object]:
    return {
        name: {key: sources.runs[experiment].figures[key] for key in keys}
        for name, experiment in experiments.items()
    }
