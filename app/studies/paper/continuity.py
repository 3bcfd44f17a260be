"""The border as a surface: along one hand path the acting point moves, on points it jumps."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Polygon
from scipy.interpolate import CubicSpline

from app.avoidance.acting_point import ActingPointFinder
from app.avoidance.mobile_acceleration import PairForce, avoidance_force, generate_mob_acc
from app.border.dbb import construct_dbb
from app.border.offset import OffsetContours
from app.border.points import BorderPoints
from app.border.score import ScoreField
from app.border.surface import BorderSurface
from app.robot.link_pairs import Closest
from app.simulation.session import DT
from app.studies.drawing import Drawing, stacked
from app.studies.paper.density import PAPERS_COUNT, thinned
from app.studies.paper.experiments import Sources
from app.studies.paper.guiding import LATERAL
from app.studies.paper.motion import base_corners, closest_points
from app.studies.style import INK, METHOD_COLOURS, PAIR_COLOURS, SOFT, new_figure, panel_title

Array = np.ndarray

NEEDS = (LATERAL,)
FINER = 10
"""[-] how much finer the path is sampled for the ratio that tells a jump from a motion."""
LONGEST = 4.0
"""[s] of the path."""
_COLOURS = {"points": "#D55E00", "surface": METHOD_COLOURS["dbb"]}
_NAMES = {"points": f"border of {PAPERS_COUNT:,} points", "surface": "border as a surface"}
_LEAST = 1e-9  # [m] where the logarithmic axis ends; smaller steps are drawn there
_ZOOM = 0.03  # [m] around what is drawn in plan


class Path(NamedTuple):
    """The acting point along the hand's path.

    Attributes:
        t: (N,) [s] times, equally spaced.
        p_b: (N, 3) [m] closest point on the hand.
        p_act: (N, 3) [m] acting point.
        xdd_m: (N, 2) [m/s², rad/s²] acceleration that the force asks of the base.
    """

    t: Array
    p_b: Array
    p_act: Array
    xdd_m: Array


def figure_continuity(sources: Sources) -> Drawing:
    """Where the acting point goes in plan, and how far in each control step."""
    t, path = hand_path_in_buffer(sources, DT)
    fine_t, fine_path = hand_path_in_buffer(sources, DT / FINER)
    finders = finders_of(sources)
    found = {kind: acting_path(sources, finder, t, path) for kind, finder in finders.items()}
    fine = {k: acting_path(sources, finder, fine_t, fine_path) for k, finder in finders.items()}
    figure = new_figure(4.6)
    plan, steps = figure.subplots(1, 2, width_ratios=(1, 1.35))
    panel_title(plan, "", "the acting point in plan")
    panel_title(steps, "", "its motion in each control step")
    for kind, along in found.items():
        style = "." if kind == "points" else "-"
        look: dict[str, Any] = {"color": _COLOURS[kind], "label": _NAMES[kind]}
        x, y = along.p_act[:, :2].T
        plan.plot(x, y, style, markersize=4, linewidth=2.2, **look)
        change = np.maximum(step_sizes(along.p_act), _LEAST)
        steps.plot(along.t[1:], change, linewidth=0.9, **look)
    _base_and_hand(plan, sources, found["surface"])
    plan.legend(loc="upper right", fontsize=9)
    steps.set_yscale("log")
    steps.set(xlabel="time [s]", ylabel="change of the acting point in 1 ms [m]")
    steps.set_xlim(float(t[0]), float(t[-1]))
    steps.legend(loc="lower right", fontsize=9)
    return Drawing(
        "§4.3: a continuous border",
        "Among points the acting point jumps from one to the next as the hand moves, a trade-off "
        "against the cost of more points.",
        figure,
        {"": stacked({kind: _columns(along) for kind, along in found.items()}, "border")},
        measured(found, fine),
        [
            "The same hand path each time, that of the lateral guiding while the hand is in its "
            "buffer, a cubic spline through the logged closest points.",
            f"A motion becomes {FINER} times smaller on a path sampled {FINER} times finer; a jump "
            "does not.",
        ],
    )


def hand_path_in_buffer(sources: Sources, dt: float) -> tuple[Array, list[Closest]]:
    """Times (N,) [s] and the hand's closest points, while the hand is in its buffer.

    The longest stretch without leaving it, at most `LONGEST`; a spline through the log's rows. The
    closest points computed at each step would have the collision library's tolerance in them, some
    0.3 mm along an edge: more than the hand moves in a step.
    """
    pair, run = sources.data.pairs.mobile[0], sources.runs[LATERAL]
    begin, end = _stretch(run.log["t_s"], run.log[f"d_{pair.name}_m"] < sources.config.border.d_b)
    t = np.arange(begin, min(end, begin + LONGEST), dt)
    logged = closest_points(sources.model, pair, run.q_m)
    d, p_a, p_b, normal = (
        CubicSpline(run.log["t_s"], [getattr(closest, name) for closest in logged])(t)
        for name in Closest._fields
    )
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    return t, [Closest(*values) for values in zip(d, p_a, p_b, normal, strict=True)]


def _stretch(t: Array, inside: Array) -> tuple[float, float]:
    """Begin and end [s] of the longest stretch in which `inside` (N,) holds."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], inside.astype(int), [0]])))
    begins, ends = edges[::2], edges[1::2]
    k = int(np.argmax(ends - begins))
    return float(t[begins[k]]), float(t[ends[k] - 1])


def finders_of(sources: Sources) -> dict[str, ActingPointFinder]:
    """Algorithm 3 on the paper's number of points, and on the surface."""
    pair, config = sources.data.pairs.mobile[0], sources.config.border
    border = construct_dbb(sources.data.clouds[pair.name], config.d_b, config.eps)
    offset = OffsetContours(sources.model, config.d_b)
    field = ScoreField.of(sources.model, pair.b)
    points = thinned(border, min(PAPERS_COUNT, len(border)))
    return {
        "points": ActingPointFinder(BorderPoints(points, offset), field),
        "surface": ActingPointFinder(BorderSurface(border, offset), field),
    }


def acting_path(sources: Sources, finder: ActingPointFinder, t: Array, path: list[Closest]) -> Path:
    """The acting point at each of the hand's closest points, and what its force asks."""
    force, d_b = sources.config.force, sources.config.border.d_b
    base = sources.model.description.base
    p_act, xdd_m = [], []
    for closest in path:
        acting = finder.find_acting_point(closest.p_b, closest.d, force)
        assert acting is not None  # the paper's robot has a border at every height in the buffer
        f = avoidance_force(
            closest.p_b, acting.p_act, closest.d, closest.normal, f_max=force.f_max, d_b=d_b
        )
        p_act.append(acting.p_act)
        xdd_m.append(generate_mob_acc([PairForce(f, acting.p_act)], base))
    p_b = np.array([closest.p_b for closest in path])
    return Path(t, p_b, np.array(p_act), np.array(xdd_m))


def step_sizes(values: Array) -> Array:
    """(N - 1,) length of each step of a path (N, k)."""
    return np.linalg.norm(np.diff(values, axis=0), axis=1)


def measured(found: dict[str, Path], fine: dict[str, Path]) -> dict[str, object]:
    """Largest steps of the acting point, how they shrink on the finer path, and accelerations."""
    result: dict[str, object] = {}
    jumps = {
        kind: np.abs(np.diff(along.xdd_m, axis=0)).max(axis=0) for kind, along in found.items()
    }
    for kind, along in found.items():
        largest, finer = (float(step_sizes(p.p_act).max()) for p in (along, fine[kind]))
        linear, angular = jumps[kind].tolist()
        result[kind] = {
            "step_max_m": largest,
            "step_max_finer_m": finer,
            "finer_ratio": largest / finer,
            "acceleration_step_max_mps2": linear,
            "acceleration_step_max_radps2": angular,
        }
    linear, angular = (jumps["points"] / jumps["surface"]).tolist()
    result["points_over_surface"] = {"linear_ratio": linear, "angular_ratio": angular}
    return result


def _columns(along: Path) -> dict[str, Array]:
    steps = np.concatenate([[np.nan], step_sizes(along.p_act)])
    names = ("p_b_x_m", "p_b_y_m", "p_b_z_m", "p_act_x_m", "p_act_y_m", "p_act_z_m")
    columns = dict(zip(names, np.column_stack([along.p_b, along.p_act]).T, strict=True))
    linear, angular = along.xdd_m.T
    return {
        "t_s": along.t,
        **columns,
        "p_act_step_m": steps,
        "base_a_mps2": linear,
        "base_aw_radps2": angular,
    }


def _base_and_hand(ax: Axes, sources: Sources, along: Path) -> None:
    """The base's outline, the closest point's path, and the window around both paths."""
    ax.add_patch(Polygon(base_corners(sources.model)[:4, :2], facecolor="#EEF1F4", edgecolor=SOFT))
    ax.plot(
        *along.p_b[:, :2].T,
        color=PAIR_COLOURS["lm-lEE"],
        linewidth=1.6,
        linestyle=(0, (3, 2)),
        label="closest point of the hand",
    )
    ax.axvline(0.0, color=INK, linewidth=0.9, linestyle=(0, (1, 2)), zorder=1)
    shown = np.concatenate([along.p_b, along.p_act])[:, :2]
    low, high = shown.min(axis=0), shown.max(axis=0)
    middle, half = (low + high) / 2, float(np.max(high - low)) / 2 + _ZOOM
    ax.set_aspect("equal")
    ax.set(xlim=(middle[0] - half, middle[0] + half), ylim=(middle[1] - half, middle[1] + half))
    ax.set(xlabel="x of the base [m]", ylabel="y of the base [m]")
