"""§4.3: jumps of the acting point, and time of its search, on borders of points and a surface."""

from dataclasses import replace
from functools import cache
from time import perf_counter
from typing import Any, TypeVar

import numpy as np
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
FINER = 10  # [-] refinement of the path, which distinguishes a jump from a motion
LONGEST = 4.0  # [s] longest path for the comparison of points and surface
_COLOURS = {"points": "#D55E00", "surface": style.METHOD_COLOURS["dbb"]}
_NAMES = {"points": f"border of {PAPERS_COUNT:,} points", "surface": "border as a surface"}
_MEASURED = ("jump_max_m", "jump_p99_m", "find_p50_us")
Points = TypeVar("Points", Border, Cloud)


@style.picture("density", "§4.3: density of the border", LATERAL)
def figure_density(sources: Sources) -> drawing.Drawing:
    """In a denser border the search of the acting point takes longer, and the jumps of the acting
    point are smaller. About 50,000 points are suitable for a control rate of 1 kHz.
    """
    table = trade_off(sources)
    counts = table["points"][:-1]
    figure, (jump, cost) = style.new_panels(3.6, 1, 2)
    look = {"color": style.METHOD_COLOURS["points"], "label": "border of points (paper)"}
    name = "continuous surface (default)"
    for ax, column, label in (
        (jump, "jump_max_m", "largest jump in a control step [m]"),
        (cost, "find_p50_us", "median time of a search [µs]"),
    ):
        *values, surface = table[column].tolist()
        ax.plot(counts, values, "o-", **look)
        if ax is jump:
            style.level(ax, surface, name)
        else:
            ax.axhline(surface, color="grey", linestyle=":", label=name)
        ax.set(xscale="log", ylim=(0.0, None), xlabel="points of the border [–]", ylabel=label)
        ax.set_xticks(counts, [f"{n / 1000:.0f}k" for n in counts])
        ax.minorticks_off()
    style.panel_title(jump, "", "jumps of the acting point")
    style.panel_title(cost, "", "computing time of the acting point")
    jump.legend(loc="upper right")
    cost.legend(loc="upper left")
    names = [*(f"{n} points" for n in counts), "surface"]
    rows = {name: {x: float(table[x][k]) for x in _MEASURED} for k, name in enumerate(names)}
    remark = "All rows have the path of the lateral guiding, at the control rate."
    return drawing.Drawing(figure, {"": table}, rows, [remark])


@cache
def trade_off(sources: Sources) -> drawing.Table:
    """Results of `jump_and_cost` for each number of points and, last, for the surface."""
    run, whole, d_b = sources.runs[LATERAL].trace, len(sources.border), sources.config.border.d_b
    t = np.arange(run.t[0], run.t[-1], DT)  # each control step
    q_m = np.column_stack([np.interp(t, run.t, q) for q in run.of("q_m").T])
    path = [closest for closest in sources.closest_points(q_m) if closest.d < d_b]
    counts = [n for n in (5_000, 10_000, 20_000, PAPERS_COUNT) if n < whole] + [whole]
    finders = [("points", n, sources.finder(thinned(sources.border, n))) for n in counts]
    finders.append(("surface", whole, sources.finder()))
    rows = [(kind, n, *jump_and_cost(sources, finder, path)) for kind, n, finder in finders]
    return drawing.table_of(("border", "points", *_MEASURED), rows)


@cache
def run_at_50_000(sources: Sources) -> dict[str, Any]:
    """Results of the lateral guiding with thinned borders of at most about 50,000 points each."""
    experiment = GUIDING["points"]["lateral"]
    clouds = {}
    for pair in sources.data.pairs.mobile:
        cloud = sources.data.clouds[pair.name]
        share = min(1.0, PAPERS_COUNT / len(sources.border_of(pair)))
        clouds[pair.name] = thinned(cloud, round(share * len(cloud)))
    return run_from_spec(experiment, sources.model, replace(sources.data, clouds=clouds)).figures


def thinned(whole: Points, count: int) -> Points:
    """A border or cloud with `count` of its points, always the same random choice."""
    chosen = np.sort(np.random.default_rng(0).choice(len(whole), count, replace=False))
    if isinstance(whole, Cloud):
        return replace(whole, points=whole.points[chosen], distances=whole.distances[chosen])
    return replace(whole, points=whole.points[chosen])


def jump_and_cost(
    sources: Sources, finder: ActingPointFinder, path: list[ClosestPoints]
) -> tuple[float, float, float]:
    """Largest and 99th percentile step [m] of p_act along a path; median time [µs] of a search."""
    found, times = [], []
    for closest in path:
        begin = perf_counter()
        found.append(finder.find_acting_point(closest.p_b, closest.d, sources.config.force))
        times.append(perf_counter() - begin)
    jumps = step_sizes(np.array([acting.p_act for acting in found if acting is not None]))
    return float(jumps.max()), float(np.percentile(jumps, 99)), 1e6 * float(np.median(times))


@style.picture("continuity", "§4.3: a continuous border", LATERAL)
def figure_continuity(sources: Sources) -> drawing.Drawing:
    """On a border of points, the acting point jumps while the end-effector moves."""
    points = thinned(sources.border, min(PAPERS_COUNT, len(sources.border)))
    finders = {"points": sources.finder(points), "surface": sources.finder()}
    coarse, fine = (smooth_path_in_buffer(sources, dt) for dt in (DT, DT / FINER))
    found, finer = (
        {kind: acting_path(sources, finder, *path) for kind, finder in finders.items()}
        for path in (coarse, fine)
    )
    figure, (plan, steps) = style.new_panels(4.6, 1, 2, width_ratios=(1, 1.35))
    style.panel_title(plan, "", "the acting point from above")
    style.panel_title(steps, "", "motion of the acting point in each control step")
    for kind, along in found.items():
        mark = "." if kind == "points" else "-"
        look: dict[str, Any] = {"color": _COLOURS[kind], "label": _NAMES[kind]}
        x, y = along["p_act_x_m"], along["p_act_y_m"]
        plan.plot(x, y, mark, markersize=4, linewidth=2.2, **look)
        change = np.maximum(along["p_act_step_m"][1:], 1e-9)  # the axis is logarithmic
        steps.plot(along["t_s"][1:], change, linewidth=0.9, **look)
    drawing.base_in_plan(plan, sources.model)
    text = "closest point of the end-effector"
    line = {"linestyle": (0, (3, 2)), "linewidth": 1.6, "label": text}
    smooth = found["surface"]
    plan.plot(smooth["p_b_x_m"], smooth["p_b_y_m"], color=style.PAIR_COLOURS["lm-lEE"], **line)
    x, y = (np.concatenate([smooth[f"{p}_{axis}_m"] for p in ("p_b", "p_act")]) for axis in "xy")
    drawing.square_around(plan, np.column_stack([x, y]), 0.03)
    plan.legend(loc="upper right", fontsize=9)
    steps.set(xlabel="time [s]", ylabel="change of the acting point in 1 ms [m]", yscale="log")
    steps.set_xlim(coarse[0][0], coarse[0][-1])
    steps.legend(loc="lower right", fontsize=9)
    return drawing.Drawing(
        figure,
        {"": drawing.stacked(found, "border")},
        _measured(found, finer),
        [
            "Both borders have the same path, a cubic spline through the closest points of the "
            "lateral guiding within the buffer.",
            f"If the path is sampled {FINER} times finer, the steps of a continuous motion are "
            f"{FINER} times smaller, but a jump keeps its size.",
        ],
    )


def smooth_path_in_buffer(sources: Sources, dt: float) -> tuple[Array, list[ClosestPoints]]:
    """Times (N,) [s], `dt` [s] apart, in the longest stay of the lateral guiding in the base's
    buffer, cut to `LONGEST`; and the closest points of base and end-effector at these times.
    """
    # The errors of the collision library, about 0.3 mm, are larger than the motion in a step.
    # Therefore the points are on a spline through those of the recorded rows.
    run = sources.runs[LATERAL].trace
    outside = sources.distances(LATERAL) >= sources.config.border.d_b
    stays = np.ma.clump_unmasked(np.ma.masked_array(run.t, outside))
    begin, end = max((run.t[stay] for stay in stays), key=len)[[0, -1]]
    t = np.arange(begin, min(end, begin + LONGEST), dt)
    rows, names = sources.closest_points(run.of("q_m")), ("d", "p_a", "p_b", "n")
    recorded = ([getattr(closest, name) for closest in rows] for name in names)
    d, p_a, p_b, n = (CubicSpline(run.t, values)(t) for values in recorded)
    n /= np.linalg.norm(n, axis=1)[:, None]
    smooth = zip(d, p_a, p_b, n, p_b, strict=True)
    return t, [ClosestPoints(sources.pair, *row) for row in smooth]


def acting_path(
    sources: Sources, finder: ActingPointFinder, t: Array, path: list[ClosestPoints]
) -> drawing.Table:
    """A table by times t (N,) [s]: p_b, p_act, step of p_act from the row before, ẍ_m of (16)."""
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
    """The largest changes between successive rows for each border, and ratios of both borders."""
    result: dict[str, Any] = {}
    linear, angular = "acceleration_step_max_mps2", "acceleration_step_max_radps2"
    for kind, along in found.items():
        largest, shrunk = (float(np.nanmax(p["p_act_step_m"])) for p in (along, finer[kind]))
        sizes = {"step_max_m": largest, "step_max_finer_m": shrunk, "finer_ratio": largest / shrunk}
        for key, column in ((linear, "base_a_mps2"), (angular, "base_aw_radps2")):
            sizes[key] = float(np.abs(np.diff(along[column])).max())
        result[kind] = sizes
    points, surface = result["points"], result["surface"]
    ratios = {"linear_ratio": points[linear] / surface[linear]}
    ratios["angular_ratio"] = points[angular] / surface[angular]
    return {**result, "points_over_surface": ratios}
