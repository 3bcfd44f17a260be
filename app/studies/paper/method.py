"""§2, §3: border, score, reachability (Figures 3, 5, 6), acting point, activation (7, 8, 10)."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.patches import Polygon
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from scipy import ndimage
from scipy.spatial import ConvexHull

from app.avoidance.acting_point import ActingPoint
from app.border import reach as maps
from app.border.score import radial_profile
from app.config import ForceConfig
from app.control.tasks import activation, rise_length
from app.robot.link_pairs import ClosestPoints
from app.robot.model import RobotModel
from app.strict import Array
from app.studies import style
from app.studies.paper import drawing
from app.studies.paper.experiments import LATERAL, WHEEL_AXIS, Experiment, Sources

TOO_LARGE = ForceConfig().model_copy(update={"alpha_min": 0.4, "alpha_max": 0.4})
"""Parameters with which the step size α is always 0.4 m, the largest valid `alpha_max`."""
_ZOOM = 0.30  # [m] smallest side of the square around the points of Algorithm 3
_SCORE = r"score $\mathcal{S}$ [m⁴/rad⁴]"
_SHOWN = 12_000  # [-] largest number of points in a picture; more points would hide each other
_FACES = ((0, 1, 2, 3), (4, 5, 6, 7), (0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (3, 0, 4, 7))
_SMOOTH = 1.0  # [-] standard deviation of the Gaussian filter, in steps of the lattice


@style.picture("fig3", "Figure 3: sampled points and distance buffer borders")
def figure_3(sources: Sources) -> drawing.Drawing:
    """(a) The sampled points of the arm's links are around the mobile base. (b) The points at the
    buffer distance, 0.15 m, from the base, with a tolerance of 0.01 m, are the borders (DBB).
    """
    rng, config = np.random.default_rng(0), sources.config.border
    parts: dict[str, drawing.Table] = {}
    measured: dict[str, Any] = {"buffer_distance_m": config.d_b, "tolerance_m": config.eps}
    figure = style.new_figure(7.6)
    for k, pair in enumerate(sources.data.pairs.mobile, start=1):
        cloud, border = sources.data.clouds[pair.name].points_m, sources.border_of(pair).points
        measured[pair.name] = {"points_P": len(cloud), "points_DBB": len(border)}
        for kind, letter, points, place, alpha in (
            ("P", "a", cloud, k, 0.25),
            ("DBB", "b", border, k + 2, 0.5),
        ):
            part = drawing.points_table(points[_some(len(points), rng)])
            parts[f"{kind} {pair.name}"] = part
            ax = figure.add_subplot(2, 2, place, projection="3d")
            _view(ax, sources.model, next(iter(parts.values())), 1.05)
            _scatter(ax, part, color=style.PAIR_COLOURS[pair.name], alpha=alpha)
            text = rf"$\mathcal{{{kind}}}_i$ of {style.PAIR_NAMES[pair.name]}"
            style.panel_title(ax, f"{letter}{k}", text)
    remark = f"The picture and the CSV have at most {_SHOWN} points of each set."
    return drawing.Drawing(figure, {"": drawing.stacked(parts, "set")}, measured, [remark])


@style.picture("fig5", "Figure 5: score of the end-effector's border")
def figure_5(sources: Sources) -> drawing.Drawing:
    """(a) The determinant is symmetric about the X-axis and is zero on the wheel axis. (b) The
    reachability depends only on the distance from the arm's mount. (c) The score is the product of
    both, with the sign of x. It has one global maximum, in front of the base.
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
    titles = ("determinant", "reachability", "score")
    figure, grid = style.new_panels(4.8, 1, 3, subplot_kw={"projection": "3d"})
    for ax, letter, title, column, label in zip(grid, "abc", titles, values, labels, strict=True):
        _view(ax, sources.model, table, 0.9)
        shown = _scatter(ax, table, c=table[column], cmap=style.SCORE_MAP)
        style.panel_title(ax, letter, title)
        bar = figure.colorbar(shown, ax=ax, label=label, orientation="horizontal", shrink=0.75)
        bar.ax.locator_params(nbins=4)
    score = values["score_m4prad4"]
    measured = {
        "points": len(border),
        "determinant_max_m4prad4": float(values["determinant_m4prad4"].max()),
        "score_max_m4prad4": float(score.max()),
        "best_point_m": points[int(score.argmax())].tolist(),
    }
    return drawing.Drawing(figure, {"": table}, measured)


@style.picture("fig6", "Figure 6: reachability of the end-effector")
def figure_6(sources: Sources) -> drawing.Drawing:
    """The scaled mean number of inverse kinematics solutions first increases, then decreases with
    the distance from the mount. A parabola with A = 525.9 /m², B = 0.575 m and C = 100 fits it.
    """
    fine = {"samples": maps.FINE_SAMPLES, "spacing": maps.FINE_SPACING}
    reach_map = maps.sample_reach_map(sources.model, sources.pair.b, **fine)
    fit, field = maps.fit_reachability(reach_map), sources.field
    figure = style.new_figure(4.2)
    half = figure.add_subplot(1, 3, 1, projection="3d")
    cut, curve = figure.add_subplot(1, 3, 2), figure.add_subplot(1, 3, 3)
    reach, off = _smoothed(reach_map), reach_map.points - reach_map.p_base
    reached = reach > 0.02 * maps.PEAK
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
    cut.set(aspect="equal", xlabel="x of the base [m]", ylabel="y of the base [m]")
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
    _draw_fit(curve, fit_table, (rho >= fit.rho_min_m) & (rho <= fit.rho_max_m))
    fitted = {key: getattr(fit, key) for key in ("A_per_m2", "B_m", "C", "r_squared", "rms")}
    return drawing.Drawing(
        figure,
        {"": fit_table, "half": half_table, "cut": cut_table},
        {**fitted, "samples": reach_map.samples, "positions": len(reach_map.points)},
        [
            "The controller uses the paper's coefficients.",
            "In (a) and (b) a Gaussian filter with a standard deviation of "
            f"{_SMOOTH * reach_map.spacing_m:g} m reduces the noise of the random sampling.",
        ],
    )


def _smoothed(reach_map: maps.ReachMap) -> Array:
    """(N,) the reachability at the map's positions, after a Gaussian filter over the map."""
    steps = np.rint((reach_map.points - reach_map.p_base) / reach_map.spacing_m).astype(int)
    at = tuple((steps - steps.min(axis=0)).T)
    values = np.zeros(np.ptp(steps, axis=0) + 1)
    inside = np.zeros_like(values)
    values[at], inside[at] = reach_map.reach, 1.0
    values, inside = (ndimage.gaussian_filter(each, _SMOOTH) for each in (values, inside))
    return values[at] / inside[at]


def _draw_fit(ax: Any, table: drawing.Table, fitted: Array) -> None:
    """Draw (9); `fitted` (N,) marks the rows of the table whose distances the fit includes."""
    mean, rho, colours = table["reachability_mean"], table["rho_m"], style.METHOD_COLOURS
    ax.plot(rho, mean, "o", color="#52606D", markersize=4, label="mean over shells")
    ax.plot(rho[fitted], table["fit"][fitted], color=colours["dbb"], label="fit of (9)")
    text = "(9) with the paper's A, B, C"
    ax.plot(rho, table["paper"], "--", color=colours["repulsive"], label=text)
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
    """Draw the box around l_m; the equally scaled axes just contain the points and the origin."""
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


class Force(NamedTuple):
    """The avoidance force due to the end-effector at one instant of a run, in the base's frame."""

    t: float  # [s] time
    q_m: Array  # (n_m,) [rad or m] joint positions of the arm
    closest: ClosestPoints
    acting: ActingPoint  # the result of Algorithm 3
    f: Array  # (3,) [N] the force

    @property
    def components(self) -> tuple[Array, Array]:
        """(3,) [N] each: the force along the line from p_n to p_b and across it (Figure 7a)."""
        line = self.closest.p_b - self.acting.p_n
        line = line / np.linalg.norm(line)
        along = float(self.f @ line) * line
        return along, self.f - along

    @property
    def points(self) -> dict[str, Array]:
        """The points of Algorithm 3, (3,) [m] each, by their names."""
        a = self.acting
        return {"p_b": self.closest.p_b, "p_n": a.p_n, "p_t": a.p_t, "p_act": a.p_act}

    def measured(self) -> dict[str, float]:
        """Distance, step size α, and magnitudes of the force and of its components."""
        f, along, across = (float(np.linalg.norm(v)) for v in (self.f, *self.components))
        found = {"distance_m": self.closest.d, "alpha_m": self.acting.alpha, "force_n": f}
        parts = {"force_along_line_n": along, "force_tangential_n": across}
        return {**found, **parts, "share_along_line": along / max(f, 1e-9)}


def force_at(
    sources: Sources, experiment: Experiment, k: int, config: ForceConfig | None = None
) -> Force:
    """The force in row k of a run, on the surface; by default with `sources.config.force`."""
    run = sources.runs[experiment].trace
    q_m = run.of("q_m")[k]
    (closest,) = sources.closest_points([q_m])
    return Force(float(run.t[k]), q_m, closest, *sources.force(sources.finder(), closest, config))


def turning(sources: Sources) -> Force:
    """Of every 20th force of WHEEL_AXIS in the buffer, that with the largest smaller component."""
    distance = sources.distances(WHEEL_AXIS)
    inside = np.flatnonzero(distance < sources.config.border.d_b)[::20]
    return max(
        (force_at(sources, WHEEL_AXIS, int(k)) for k in inside),
        key=lambda force: min(np.linalg.norm(v) for v in force.components),
    )


@style.picture("fig7", "Figure 7: the direction of the force", WHEEL_AXIS)
def figure_7(sources: Sources) -> drawing.Drawing:
    """The force starts at the acting point and points to the closest point of the end-effector. It
    has two orthogonal components. One component moves the base away from the end-effector; the
    other brings the part of the border with a high score closer to the end-effector.
    """
    force = turning(sources)
    along, across = force.components
    p_b, p_act = force.closest.p_b, force.acting.p_act
    table = _slice(sources, force)
    figure, (whole, near) = style.new_panels(5.4, 1, 2)
    for ax in (whole, near):
        shown = _plan(ax, sources, force, table)
    style.panel_title(whole, "", "the border at the height of $p_b$")
    _points(whole, force, "p_b", "p_act")
    whole.set(xlim=(-0.70, 0.80), ylim=(-0.75, 0.75))
    figure.colorbar(shown, ax=whole, label=_SCORE, shrink=0.8)
    style.panel_title(near, "a", "the force and its two components")
    drawing.square_around(near, np.array(list(force.points.values())), 0.06, _ZOOM)
    length = float(np.linalg.norm(p_b - p_act) / max(np.linalg.norm(force.f), 1e-9))
    for vector, colour, text in (
        (across, "#E69F00", "towards a better score"),
        (along, "#56B4E9", "away from the end-effector"),
        (force.f, style.ACTING, "force $f_{m,1}$"),
    ):
        drawing.arrow(near, p_act, p_act + length * vector, colour)
        near.plot([], [], color=colour, label=text)
    _points(near, force)
    near.legend(loc="lower left", fontsize=9)
    tables = {"": table, "points": _point_table({"chosen": force})}
    remark = "The end-effector approaches along the wheel axis; the base has started to turn."
    return drawing.Drawing(figure, tables, {"t_s": force.t, **force.measured()}, [remark])


@style.picture("fig8", "Figure 8: finding the acting point", LATERAL)
def figure_8(sources: Sources) -> drawing.Drawing:
    """(a) The method starts at p_n, the border point nearest to the end-effector, and steps along
    the tangent towards a better score, to p_t. The acting point is the border point nearest to p_t.
    (b) If the step is too large, the acting point can be so far away that the force has no
    component along the line between the end-effector and the border. Therefore the step is bounded.
    """
    configs = {"chosen": sources.config.force, "too large": TOO_LARGE}
    k = int(sources.distances(LATERAL).argmin())
    found = {name: force_at(sources, LATERAL, k, config) for name, config in configs.items()}
    table = _slice(sources, found["chosen"])
    figure, grid = style.new_panels(5.4, 1, 2, sharex=True, sharey=True)
    for ax, letter, force in zip(grid, "ab", found.values(), strict=True):
        shown = _plan(ax, sources, force, table)
        drawing.arrow(ax, force.acting.p_n, force.acting.p_t, style.INK)
        _points(ax, force)
        text = "the step along the tangent" if letter == "a" else "too large a step"
        style.panel_title(ax, letter, rf"{text}, $\alpha$ = {force.acting.alpha:.3f} m")
    points = [point for force in found.values() for point in force.points.values()]
    drawing.square_around(grid[0], np.array(points), 0.06, _ZOOM)
    figure.colorbar(shown, ax=grid, label=_SCORE, shrink=0.8)
    measured = {name: force.measured() for name, force in found.items()}
    return drawing.Drawing(figure, {"": table, "points": _point_table(found)}, measured)


@style.picture("fig10", "Figure 10: activation by distance")
def figure_10(sources: Sources) -> drawing.Drawing:
    """The activation is 0 at distances of at least 0.15 m, the buffer distance, and 1 at distances
    of at most 0.05 m. Between these distances it is a cubic polynomial.
    """
    d_b, d_full = sources.config.border.d_b, sources.config.activation.d_full
    d = np.linspace(0.0, 0.2, 201)
    table = {"d_m": d, "beta": np.array([activation(x, d_b, d_full) for x in d])}
    figure, ax = style.new_panels(3.6, width=6.4)
    ax.plot(table["d_m"], table["beta"], color=style.METHOD_COLOURS["dbb"], linewidth=2.4)
    for at, text in ((d_full, "task fully active"), (d_b, "buffer distance $d_b$")):
        ax.axvline(at, color=style.SOFT, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
        look: dict[str, Any] = {"va": "center", "fontsize": 9, "color": "#616E7C", "rotation": 90}
        ax.annotate(text, (at, 0.5), xytext=(4, 0), textcoords="offset points", **look)
    ax.set(xlim=(0.0, 0.2), ylim=(-0.02, 1.05), xlabel="distance of the pair [m]")
    ax.set_ylabel(r"activation $\beta$ [–]")
    slope = 1.5 / rise_length(d_b, d_full)
    measured = {"full_at_m": d_full, "zero_from_m": d_b, "largest_slope_per_m": slope}
    return drawing.Drawing(figure, {"": table}, measured)


def _slice(sources: Sources, force: Force) -> drawing.Table:
    """The border's points at the height of p_b, with their scores."""
    points = sources.border.same_height(float(force.closest.p_b[2]))
    return drawing.points_table(points, score_m4prad4=sources.field.score(points))


def _plan(ax: Axes, sources: Sources, force: Force, border: drawing.Table) -> PathCollection:
    """Draw base, border, end-effector and force from above; return the border's points."""
    drawing.base_in_plan(ax, sources.model)
    score = border["score_m4prad4"]
    shown = ax.scatter(border["x_m"], border["y_m"], c=score, s=7, cmap=style.SCORE_MAP, zorder=2)
    colour = style.PAIR_COLOURS["lm-lEE"]
    for name, mesh in sources.model.placed_meshes((0.0, 0.0, 0.0), force.q_m):
        if name == sources.pair.b:
            corners = mesh.vertices[:, :2]
            outline = corners[ConvexHull(corners).vertices]
            ax.add_patch(Polygon(outline, facecolor=colour, alpha=0.18, linewidth=0, zorder=1))
    drawing.arrow(ax, force.acting.p_act, force.closest.p_b, style.ACTING)
    return shown


def _points(ax: Axes, force: Force, *names: str) -> None:
    """Draw the named points of Algorithm 3 with their symbols; all points if none is named."""
    for name, text, colour, offset in (
        ("p_n", "$p_n$", style.INK, (-18, 8)),
        ("p_t", "$p_t$", style.SOFT, (8, 8)),
        ("p_act", "$p_{act}$", style.ACTING, (8, -14)),
        ("p_b", "$p_b$", style.PAIR_COLOURS["lm-lEE"], (6, -14)),
    ):
        if not names or name in names:
            x, y, _ = force.points[name]
            ax.plot(x, y, **style.marker_style(colour, size=8))
            place: dict[str, Any] = {"xytext": offset, "textcoords": "offset points"}
            ax.annotate(text, (x, y), fontsize=12, zorder=7, **place).set_in_layout(False)


def _point_table(found: dict[str, Force]) -> drawing.Table:
    rows = [
        (step, name, *point, force.acting.alpha)
        for step, force in found.items()
        for name, point in force.points.items()
    ]
    return drawing.table_of(("step", "point", "x_m", "y_m", "z_m", "alpha_m"), rows)
