"""§4.3: a denser border of points causes smaller jumps at a higher cost; a surface has no jumps."""

from dataclasses import replace
from functools import cache
from time import perf_counter
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from scipy.interpolate import CubicSpline

from app.avoidance.acting_point import ActingPointFinder, resultant_force
from app.border.dbb import Border, Cloud
from app.robot.link_pairs import ClosestPoints
from app.simulation.run import run_from_spec
from app.simulation.session import DT
from app.strict import Array
from app.studies import style
from app.studies.paper import drawing
from app.studies.paper.experiments import GUIDING, LATERAL, Sources

PAPERS_COUNT = 50_000  # [-] points of a border that the paper recommends
COUNTS = (5_000, 10_000, 20_000, PAPERS_COUNT)
"""Numbers of points of the thinned borders; the full border is added at the end."""
FINER = 10  # [-] refinement of the path, which distinguishes jumps from motion
LONGEST = 4.0  # [s] longest path for the comparison of points and surface
_COLOURS = {"points": "#D55E00", "surface": style.METHOD_COLOURS["dbb"]}
_NAMES = {"points": f"border of {PAPERS_COUNT:,} points", "surface": "border as a surface"}
_MIN_CHANGE = 1e-9  # [m] lower end of the logarithmic axis; smaller steps are drawn there
_ZOOM = 0.03  # [m] margin around the paths in plan

_MEASURED = ("jump_max_m", "jump_p99_m", "find_p50_us")


@style.picture("density", "§4.3: density of the border", LATERAL)
def figure_density(sources: Sources) -> drawing.Drawing:
    """A denser border makes the search more costly and the jumps of the acting point smaller; about
    50,000 points suit a control rate of 1 kHz.
    """
    table = trade_off(sources)
    figure = style.new_figure(3.6)
    jump, cost = figure.subplots(1, 2)
    look = {"color": style.METHOD_COLOURS["points"]}
    for ax, column, label in (
        (jump, "jump_max_m", "largest jump in a control step [m]"),
        (cost, "find_p50_us", "median time of a search [µs]"),
    ):
        values = {kind: table[column][table["border"] == kind] for kind in _NAMES}
        counts = table["points"][table["border"] == "points"]
        ax.plot(
            counts, values["points"], "o-", label="border of points, searched as printed", **look
        )
        surface, name = float(values["surface"][0]), "as a continuous surface (used here)"
        if ax is jump:
            style.level(ax, surface, name)
        else:
            ax.axhline(surface, color="grey", linestyle=":", label=name)
        ax.set_xscale("log")
        ax.set_ylim(0.0, None)
        ax.set(xlabel="points of the border [–]", ylabel=label)
        ax.set_xticks(counts, [f"{n / 1000:.0f}k" for n in counts])
        ax.minorticks_off()
    style.panel_title(jump, "", "jumps of the acting point")
    style.panel_title(cost, "", "cost of the acting point")
    jump.legend(loc="upper right")
    cost.legend(loc="upper left")
    rows = {
        "surface" if kind == "surface" else f"{n} {kind}": {
            x: float(table[x][k]) for x in _MEASURED
        }
        for k, (kind, n) in enumerate(zip(table["border"], table["points"].tolist(), strict=True))
    }
    return drawing.Drawing(
        figure,
        {"": table},
        rows,
        ["All use the path of the lateral guiding, at the control rate."],
    )


@cache
def trade_off(sources: Sources) -> drawing.Table:
    """Jumps of p_act and time of a search, for each number of points and for the surface."""
    path, whole = hand_in_buffer(sources), len(sources.border)
    counts = [n for n in COUNTS if n < whole] + [whole]
    finders = [("points", n, sources.points(thinned(sources.border, n))) for n in counts]
    finders.append(("surface", whole, sources.surface))
    rows = [(kind, n, *jump_and_cost(sources, finder, path)) for kind, n, finder in finders]
    return drawing.table_of(("border", "points", *_MEASURED), rows)


@cache
def run_at_50_000(sources: Sources) -> dict[str, Any]:
    """Figures of the lateral guiding with 50,000 points in each border.

    The run is not in parallel with other runs, because its durations count.
    """
    experiment = GUIDING["points"]["lateral"]
    clouds = {
        pair.name: thinned_cloud(
            sources.data.clouds[pair.name], min(1.0, PAPERS_COUNT / len(sources.border_of(pair)))
        )
        for pair in sources.data.pairs.mobile
    }
    data = replace(sources.data, clouds=clouds)
    return run_from_spec(experiment, sources.model, data).figures


def thinned_cloud(cloud: Cloud, share: float) -> Cloud:
    """A fixed random share of a cloud's points."""
    chosen = _chosen(len(cloud), round(share * len(cloud)))
    return Cloud(cloud.pair, cloud.points[chosen], cloud.distances[chosen])


def thinned(border: Border, count: int) -> Border:
    """A border with `count` of its points, a fixed random choice."""
    chosen = _chosen(len(border), count)
    return replace(border, points=border.points[chosen], heights=border.heights[chosen])


def _chosen(total: int, count: int) -> Array:
    return np.sort(np.random.default_rng(0).choice(total, count, replace=False))


def hand_in_buffer(sources: Sources) -> list[ClosestPoints]:
    """The closest points of the end-effector at each control step in its buffer."""
    run = sources.runs[LATERAL]
    fine = np.arange(run.trace.t[0], run.trace.t[-1], DT)
    q_m = np.column_stack([np.interp(fine, run.trace.t, q) for q in run.trace.of("q_m").T])
    d_b = sources.config.border.d_b
    return [closest for closest in sources.closest_points(q_m) if closest.d < d_b]


def jump_and_cost(
    sources: Sources, finder: ActingPointFinder, path: list[ClosestPoints]
) -> tuple[float, float, float]:
    """Largest jump [m], 99th percentile of the jumps [m], and median time [µs] of a search."""
    points, times = [], []
    for closest in path:
        begin = perf_counter()
        acting = finder.find_acting_point(closest.p_b, closest.d, sources.config.force)
        times.append(perf_counter() - begin)
        if acting is not None:
            points.append(acting.p_act)
    jumps = step_sizes(np.array(points))
    return float(jumps.max()), float(np.percentile(jumps, 99)), 1e6 * float(np.median(times))


@style.picture("continuity", "§4.3: a continuous border", LATERAL)
def figure_continuity(sources: Sources) -> drawing.Drawing:
    """With a border of points, the acting point jumps from point to point as the end-effector
    moves. More points reduce the jumps and increase the cost.
    """
    points = thinned(sources.border, min(PAPERS_COUNT, len(sources.border)))
    finders = {
        "points": sources.points(points),
        "surface": sources.surface,
    }
    coarse, fine = (hand_path_in_buffer(sources, dt) for dt in (DT, DT / FINER))
    found = {kind: acting_path(sources, finder, *coarse) for kind, finder in finders.items()}
    finer = {kind: acting_path(sources, finder, *fine) for kind, finder in finders.items()}
    figure = style.new_figure(4.6)
    plan, steps = figure.subplots(1, 2, width_ratios=(1, 1.35))
    style.panel_title(plan, "", "the acting point in plan")
    style.panel_title(steps, "", "its motion in each control step")
    for kind, along in found.items():
        mark = "." if kind == "points" else "-"
        look: dict[str, Any] = {"color": _COLOURS[kind], "label": _NAMES[kind]}
        place = along["p_act_x_m"], along["p_act_y_m"]
        plan.plot(*place, mark, markersize=4, linewidth=2.2, **look)
        change = np.maximum(along["p_act_step_m"][1:], _MIN_CHANGE)
        steps.plot(along["t_s"][1:], change, linewidth=0.9, **look)
    _base_and_hand(plan, sources, found["surface"])
    plan.legend(loc="upper right", fontsize=9)
    steps.set_yscale("log")
    steps.set(xlabel="time [s]", ylabel="change of the acting point in 1 ms [m]")
    steps.set_xlim(float(coarse[0][0]), float(coarse[0][-1]))
    steps.legend(loc="lower right", fontsize=9)
    return drawing.Drawing(
        figure,
        {"": drawing.stacked(found, "border")},
        _measured(found, finer),
        [
            "All use the path of the lateral guiding within the buffer, "
            "a cubic spline through the logged closest points.",
            f"On a path sampled {FINER} times finer, motion has {FINER} times smaller steps; "
            "a jump has not.",
        ],
    )


def hand_path_in_buffer(sources: Sources, dt: float) -> tuple[Array, list[ClosestPoints]]:
    """Times (N,) [s] and closest points during the end-effector's longest stay in the buffer.

    The stay is cut to `LONGEST` [s]. A spline through the log's rows gives the points: at each step
    the collision library would add errors of about 0.3 mm, more than the motion in a step.
    """
    log = sources.runs[LATERAL].trace
    outside = log[f"d_{sources.pair.name}_m"] >= sources.config.border.d_b
    stretches = np.ma.clump_unmasked(np.ma.masked_array(log.t, outside))
    longest = max((log.t[stretch] for stretch in stretches), key=len)
    begin, end = longest[[0, -1]]
    t = np.arange(begin, min(end, begin + LONGEST), dt)
    logged = sources.closest_points(log.of("q_m"))
    d, p_a, p_b, n = (
        CubicSpline(log.t, [getattr(closest, name) for closest in logged])(t)
        for name in ("d", "p_a", "p_b", "n")
    )
    n /= np.linalg.norm(n, axis=1)[:, None]
    path = zip(d, p_a, p_b, n, p_b, strict=True)
    return t, [ClosestPoints(sources.pair, *values) for values in path]


def acting_path(
    sources: Sources, finder: ActingPointFinder, t: Array, path: list[ClosestPoints]
) -> drawing.Table:
    """A table of the acting point along the end-effector's path, with a row for each time (N,) [s].

    The columns are the time, the closest point p_b on the end-effector, the acting point, its
    motion in the previous step, and the base acceleration that the force causes.
    """
    base = sources.model.description.base
    forces = [sources.force(finder, closest) for closest in path]
    xdd_m = [base.A_b @ resultant_force(f[None], acting.p_act[None]) for acting, f in forces]
    p_act = np.array([acting.p_act for acting, _ in forces])
    linear, angular = np.array(xdd_m).T
    return {
        "t_s": t,
        **drawing.points_table(np.array([closest.p_b for closest in path]), "p_b_"),
        **drawing.points_table(p_act, "p_act_"),
        "p_act_step_m": np.concatenate([[np.nan], step_sizes(p_act)]),
        "base_a_mps2": linear,
        "base_aw_radps2": angular,
    }


def step_sizes(values: Array) -> Array:
    """(N - 1,) length of each step of a path (N, k)."""
    return np.linalg.norm(np.diff(values, axis=0), axis=1)


def _measured(found: dict[str, drawing.Table], finer: dict[str, drawing.Table]) -> dict[str, Any]:
    """Largest steps of the acting point, their ratio to the finer path, largest changes of
    acceleration.
    """
    result: dict[str, Any] = {}
    for kind, along in found.items():
        largest, shrunk = (float(np.nanmax(p["p_act_step_m"])) for p in (along, finer[kind]))
        linear, angular = (
            float(np.abs(np.diff(along[axis])).max()) for axis in ("base_a_mps2", "base_aw_radps2")
        )
        result[kind] = {
            "step_max_m": largest,
            "step_max_finer_m": shrunk,
            "finer_ratio": largest / shrunk,
            "acceleration_step_max_mps2": linear,
            "acceleration_step_max_radps2": angular,
        }
    points, surface = result["points"], result["surface"]
    result["points_over_surface"] = {
        f"{name}_ratio": points[key] / surface[key]
        for name, key in (
            ("linear", "acceleration_step_max_mps2"),
            ("angular", "acceleration_step_max_radps2"),
        )
    }
    return result


def _base_and_hand(ax: Axes, sources: Sources, along: drawing.Table) -> None:
    """Draw the base's outline and the closest point's path, and limit the axes to both paths."""
    drawing.base_in_plan(ax, sources.model)
    ax.plot(
        along["p_b_x_m"],
        along["p_b_y_m"],
        color=style.PAIR_COLOURS["lm-lEE"],
        linewidth=1.6,
        linestyle=(0, (3, 2)),
        label="closest point of the end-effector",
    )
    x, y = (np.concatenate([along[f"{p}_{axis}_m"] for p in ("p_b", "p_act")]) for axis in "xy")
    drawing.square_around(ax, np.column_stack([x, y]), _ZOOM)
