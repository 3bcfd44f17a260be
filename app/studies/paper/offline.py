"""§2: sampled points and border (Figure 3), its score (Figure 5), reachability (Figure 6)."""

from typing import Any

import numpy as np
from matplotlib.collections import PathCollection
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from scipy import ndimage

from app.border.reach import (
    FINE_SAMPLES,
    FINE_SPACING,
    PEAK,
    ReachMap,
    fit_reachability,
    sample_reach_map,
)
from app.border.score import radial_profile
from app.robot.model import RobotModel
from app.strict import Array
from app.studies import style
from app.studies.paper import drawing
from app.studies.paper.experiments import Sources

_SHOWN = 12_000  # [-] largest number of points in a picture; more points would hide each other
_FACES = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
_MIN_SHARE = 0.02  # [-] share of the peak above which a position counts as reached
_SMOOTH = 1.0  # [-] standard deviation of the Gaussian filter, in steps of the lattice


@style.picture("fig3", "Figure 3: sampled points and distance buffer borders")
def figure_3(sources: Sources) -> drawing.Drawing:
    """(a) The sampled points of the arm's links are around the mobile base. (b) The points whose
    distance from the mobile base is 0.15 m, the buffer distance, within a tolerance of 0.01 m are
    the distance buffer borders.
    """
    rng = np.random.default_rng(0)
    parts: dict[str, drawing.Table] = {}
    counts: dict[str, object] = {}
    for pair in sources.data.pairs.mobile:
        cloud, border = sources.data.clouds[pair.name], sources.border_of(pair)
        parts[f"P {pair.name}"] = drawing.points_table(cloud.points_m[_some(len(cloud), rng)])
        parts[f"DBB {pair.name}"] = drawing.points_table(border.points[_some(len(border), rng)])
        counts[pair.name] = {"points_P": len(cloud), "points_DBB": len(border)}
    figure = style.new_figure(7.6)
    for k, (name, part) in enumerate(parts.items()):
        kind, pair_name = name.split()
        place = 2, 2, 1 + 2 * (k % 2) + k // 2
        ax = figure.add_subplot(*place, projection="3d")
        _view(ax, sources.model, parts["P lm-lEE"], 1.05)
        _scatter(ax, part, color=style.PAIR_COLOURS[pair_name], alpha=0.25 if kind == "P" else 0.5)
        letter, symbol = {"P": ("a", r"$\mathcal{P}_i$"), "DBB": ("b", r"$\mathcal{DBB}_i$")}[kind]
        style.panel_title(ax, f"{letter}{k // 2 + 1}", f"{symbol} of {style.PAIR_NAMES[pair_name]}")
    return drawing.Drawing(
        figure,
        {"": drawing.stacked(parts, "set")},
        {
            "buffer_distance_m": sources.config.border.d_b,
            "tolerance_m": sources.config.border.eps,
            **counts,
        },
        [f"The picture and the CSV have at most {_SHOWN} points of each set."],
    )


@style.picture("fig5", "Figure 5: score of the end-effector's border")
def figure_5(sources: Sources) -> drawing.Drawing:
    """(a) The determinant is symmetric about the X-axis and is zero on the wheel axis. (b) The
    reachability depends only on the distance from the arm's mount. (c) The score is the product of
    determinant and reachability, with the sign of x. It has one global maximum, in front of the
    base.
    """
    border, field = sources.border, sources.field
    points = border.points[_some(len(border), np.random.default_rng(0))]
    values = {
        "determinant_m4prad4": field.singularity(points),
        "reachability": field.reachability(points),
        "score_m4prad4": field.score(points),
    }
    table = drawing.points_table(points) | values
    labels = (r"$\det(J_c J_c^T)$ [m⁴/rad⁴]", r"$\mathcal{R}$ [–]", r"$\mathcal{S}$ [m⁴/rad⁴]")
    figure = style.new_figure(4.8)
    for k, (column, label) in enumerate(zip(values, labels, strict=True)):
        ax = figure.add_subplot(1, 3, k + 1, projection="3d")
        _view(ax, sources.model, table, 0.9)
        shown = _scatter(ax, table, c=table[column], cmap=style.SCORE_MAP)
        style.panel_title(ax, "abc"[k], ("determinant", "reachability", "score")[k])
        bar = figure.colorbar(shown, ax=ax, label=label, orientation="horizontal", shrink=0.75)
        bar.ax.locator_params(nbins=4)
    best = points[int(values["score_m4prad4"].argmax())]
    return drawing.Drawing(
        figure,
        {"": table},
        {
            "points": len(border),
            "determinant_max_m4prad4": float(values["determinant_m4prad4"].max()),
            "score_max_m4prad4": float(values["score_m4prad4"].max()),
            "best_point_m": best.tolist(),
        },
    )


@style.picture("fig6", "Figure 6: reachability of the end-effector")
def figure_6(sources: Sources) -> drawing.Drawing:
    """The mean number of inverse kinematics solutions first increases and then decreases with the
    distance from the arm's mount. A parabola with A = 525.9 /m², B = 0.575 m and C = 100
    approximates the scaled number.
    """
    reach_map = sample_reach_map(
        sources.model, sources.pair.b, samples=FINE_SAMPLES, spacing=FINE_SPACING
    )
    fit, field = fit_reachability(reach_map), sources.field
    figure = style.new_figure(4.2)
    half = figure.add_subplot(1, 3, 1, projection="3d")
    cut, curve = figure.add_subplot(1, 3, 2), figure.add_subplot(1, 3, 3)
    reach, off = _smoothed(reach_map), reach_map.points - reach_map.p_base
    reached = reach > _MIN_SHARE * PEAK
    half_table, cut_table = (
        drawing.points_table(reach_map.points[shown], reachability=reach[shown])
        for shown in (reached & (off[:, 1] >= 0), reached & (np.abs(off[:, 2]) < 1e-9))
    )
    _view(half, sources.model, half_table, 0.9)
    _scatter(half, half_table, c=half_table["reachability"], cmap=style.SCORE_MAP, s=6)
    half.view_init(16, -68)
    style.panel_title(half, "a", "its left half")
    look: dict[str, Any] = {"cmap": style.SCORE_MAP, "s": 36, "marker": "s", "linewidth": 0}
    shown = cut.scatter(cut_table["x_m"], cut_table["y_m"], c=cut_table["reachability"], **look)
    drawing.plan_axes(cut)
    style.panel_title(cut, "b", "cut at the mount's height")
    figure.colorbar(shown, ax=cut, orientation="horizontal", label="reachability [–]", shrink=0.8)
    profile = radial_profile(reach_map.rho, reach_map.reach)
    rho = profile.rho_m
    fit_table = {
        "rho_m": rho,
        "reachability_mean": profile.mean,
        "reachability_spread": profile.spread,
        "fit": fit.at(rho),
        "paper": field.C - field.A * (rho - field.B) ** 2,
    }
    _draw_fit(curve, fit_table, fit.rho_min_m, fit.rho_max_m)
    return drawing.Drawing(
        figure,
        {"": fit_table, "half": half_table, "cut": cut_table},
        {
            "A_per_m2": fit.A_per_m2,
            "B_m": fit.B_m,
            "C": fit.C,
            "r_squared": fit.r_squared,
            "rms": fit.rms,
            "samples": reach_map.samples,
            "positions": len(reach_map.points),
        },
        [
            "The controller uses the paper's coefficients.",
            "In (a) and (b) a Gaussian filter with a standard deviation of "
            f"{_SMOOTH * reach_map.spacing_m:g} m reduces the noise of the random sampling.",
        ],
    )


def _smoothed(reach_map: ReachMap) -> Array:
    """(N,) the reachability at the map's positions, after a Gaussian filter over the map."""
    steps = np.rint((reach_map.points - reach_map.p_base) / reach_map.spacing_m).astype(int)
    at = tuple((steps - steps.min(axis=0)).T)
    values = np.zeros(np.ptp(steps, axis=0) + 1)
    inside = np.zeros_like(values)
    values[at], inside[at] = reach_map.reach, 1.0
    values, inside = (ndimage.gaussian_filter(each, _SMOOTH) for each in (values, inside))
    return values[at] / inside[at]


def _draw_fit(ax: Any, table: drawing.Table, low: float, high: float) -> None:
    mean, rho = table["reachability_mean"], table["rho_m"]
    ax.plot(rho, mean, "o", color="#52606D", markersize=4, label="mean over shells")
    inside = (rho >= low) & (rho <= high)
    fitted, printed = style.METHOD_COLOURS["dbb"], style.METHOD_COLOURS["repulsive"]
    ax.plot(rho[inside], table["fit"][inside], color=fitted, label="fit of (9)")
    ax.plot(rho, table["paper"], "--", color=printed, label="(9) with the paper's A, B, C")
    ax.set(xlabel=r"distance from the mount $\rho$ [m]", ylabel="reachability [–]")
    ax.set(xlim=(0.0, None), ylim=(0.0, 1.25 * float(np.nanmax(mean))))
    ax.legend(fontsize=8, loc="upper right")
    style.panel_title(ax, "", "by distance from the mount")


def _some(count: int, rng: np.random.Generator) -> Array:
    """Ascending random indices of at most `_SHOWN` of `count` points."""
    return np.sort(rng.choice(count, min(count, _SHOWN), replace=False))


def _scatter(ax: Any, points: dict[str, Array], **look: Any) -> PathCollection:
    look = {"s": 2, "linewidth": 0, "depthshade": False, **look}
    return ax.scatter(points["x_m"], points["y_m"], points["z_m"], **look)


def _view(ax: Any, model: RobotModel, points: drawing.Table, zoom: float) -> None:
    """Draw the box around l_m; scale all axes equally, and limit them to the points and the origin.

    `zoom` enlarges the drawing within its place; 1 is matplotlib's default.
    """
    faces = drawing.base_corners(model)[list(_FACES)]
    look: dict[str, Any] = {"facecolor": "#CBD2D9", "edgecolor": "#616E7C", "linewidth": 0.6}
    ax.add_collection3d(Poly3DCollection(list(faces), **look, alpha=0.5))
    sides = []
    for axis in "xyz":
        low, high = min(points[f"{axis}_m"].min(), 0.0), max(points[f"{axis}_m"].max(), 0.0)
        sides.append(high - low)
        ax.set(**{f"{axis}lim": (low, high), f"{axis}label": f"{axis} [m]"})
        getattr(ax, f"{axis}axis").set_pane_color((1.0, 1.0, 1.0, 0.0))
    ax.locator_params(nbins=3)
    ax.tick_params(labelsize=8, pad=0)
    ax.set_box_aspect(sides, zoom=zoom)
    ax.view_init(26, 35)
