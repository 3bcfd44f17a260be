"""§3.1 and §3.4: the acting point (Figures 7 and 8) and the activation (Figure 10)."""

from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from app.avoidance.acting_point import ActingPoint
from app.config import ForceConfig
from app.control.tasks import activation, rise_length
from app.robot.link_pairs import ClosestPoints
from app.strict import Array
from app.studies import style
from app.studies.paper import drawing
from app.studies.paper.experiments import LATERAL, WHEEL_AXIS, Experiment, Sources

TOO_LARGE = ForceConfig().model_copy(update={"alpha_min": 0.4, "alpha_max": 0.4})
"""Parameters with which the step size α is always 0.4 m, the largest valid bound."""

_NORMAL, _TANGENT = "#56B4E9", "#E69F00"
_EVERY = 20  # [-] number of rows from one evaluation of the force to the next
_ZOOM = 0.30  # [m] smallest side of the square around the points of Algorithm 3
_SCORE = r"score $\mathcal{S}$ [m⁴/rad⁴]"


class Force(NamedTuple):
    """The avoidance force due to the end-effector at one instant of a run, in the base's frame."""

    t: float
    """[s] time."""
    q_m: Array
    """(n_m,) [rad or m] joint positions of the arm."""
    closest: ClosestPoints
    acting: ActingPoint
    """The result of Algorithm 3."""
    f: Array
    """(3,) [N] the force."""

    @property
    def components(self) -> tuple[Array, Array]:
        """The components of the force along the line from p_n to p_b and across it, (3,) [N] each.

        Paper: §3.1, Figure 7a.
        """
        line = self.closest.p_b - self.acting.p_n
        line = line / np.linalg.norm(line)
        along = float(self.f @ line) * line
        return along, self.f - along

    @property
    def points(self) -> dict[str, Array]:
        """The points of Algorithm 3, (3,) [m] each, by their names."""
        others = {name: getattr(self.acting, name) for name in ("p_n", "p_t", "p_act")}
        return {"p_b": self.closest.p_b, **others}

    def measured(self) -> dict[str, float]:
        """Distance, step size α, and magnitudes of the force and of its components, by key."""
        f, along, across = (float(np.linalg.norm(v)) for v in (self.f, *self.components))
        return {
            "distance_m": self.closest.d,
            "alpha_m": self.acting.alpha,
            "force_n": f,
            "force_along_line_n": along,
            "force_tangential_n": across,
            "share_along_line": along / max(f, 1e-9),
        }


def force_at(
    sources: Sources, experiment: Experiment, k: int, config: ForceConfig | None = None
) -> Force:
    """Compute the force in row k of an experiment, with the border as a surface.

    `config` has the parameters of the force; default: those of `sources`.
    """
    run = sources.runs[experiment].trace
    q_m = run.of("q_m")[k]
    (closest,) = sources.closest_points([q_m])
    acting, f = sources.force(sources.surface, closest, config)
    return Force(float(run.t[k]), q_m, closest, acting, f)


def deepest(sources: Sources) -> int:
    """Index of the row of the lateral guiding in which the end-effector is nearest to the base."""
    return int(sources.distances(LATERAL).argmin())


def turning(sources: Sources) -> Force:
    """The force in a row of the run along the wheel axis in which both its components are large.

    Every 20th row in the buffer is evaluated. In the chosen row, the smaller component is largest.
    """
    distance = sources.distances(WHEEL_AXIS)
    inside = np.flatnonzero(distance < sources.config.border.d_b)[::_EVERY]
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
    figure = style.new_figure(5.4)
    whole, near = figure.subplots(1, 2)
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
        (across, _TANGENT, "towards a better score"),
        (along, _NORMAL, "away from the end-effector"),
        (force.f, style.ACTING, "force $f_{m,1}$"),
    ):
        drawing.arrow(near, p_act, p_act + length * vector, colour)
        near.plot([], [], color=colour, label=text)
    _points(near, force)
    near.legend(loc="lower left", fontsize=9)
    return drawing.Drawing(
        figure,
        {"": table, "points": _point_table({"chosen": force})},
        {"t_s": force.t, **force.measured()},
        ["The end-effector approaches along the wheel axis; the base has started to turn."],
    )


@style.picture("fig8", "Figure 8: finding the acting point", LATERAL)
def figure_8(sources: Sources) -> drawing.Drawing:
    """(a) The method starts at p_n, the border point nearest to the end-effector, and steps along
    the tangent towards a better score, to p_t. The acting point is the border point nearest to p_t.
    (b) If the step is too large, the acting point can be so far away that the force has no
    component along the line between the end-effector and the border. Therefore the step is bounded.
    """
    configs, k = {"chosen": sources.config.force, "too large": TOO_LARGE}, deepest(sources)
    found = {name: force_at(sources, LATERAL, k, config) for name, config in configs.items()}
    table = _slice(sources, found["chosen"])
    figure = style.new_figure(5.4)
    grid = figure.subplots(1, 2, sharex=True, sharey=True)
    for ax, letter, force in zip(grid, "ab", found.values(), strict=True):
        shown = _plan(ax, sources, force, table)
        drawing.arrow(ax, force.acting.p_n, force.acting.p_t, style.INK)
        _points(ax, force)
        text = "the step along the tangent" if letter == "a" else "too large a step"
        style.panel_title(ax, letter, rf"{text}, $\alpha$ = {force.acting.alpha:.3f} m")
    points = [point for force in found.values() for point in force.points.values()]
    drawing.square_around(grid[0], np.array(points), 0.06, _ZOOM)
    figure.colorbar(shown, ax=grid, label=_SCORE, shrink=0.8)
    return drawing.Drawing(
        figure,
        {"": table, "points": _point_table(found)},
        {name: force.measured() for name, force in found.items()},
    )


@style.picture("fig10", "Figure 10: activation by distance")
def figure_10(sources: Sources) -> drawing.Drawing:
    """The activation is 0 at distances of at least 0.15 m, the buffer distance, and 1 at distances
    of at most 0.05 m. Between these distances it is a cubic polynomial.
    """
    d_b, d_full = sources.config.border.d_b, sources.config.activation.d_full
    d = np.linspace(0.0, 0.2, 201)
    table = {"d_m": d, "beta": np.array([activation(x, d_b, d_full) for x in d])}
    figure = style.new_figure(3.6, 6.4)
    ax = figure.subplots()
    ax.plot(table["d_m"], table["beta"], color=style.METHOD_COLOURS["dbb"], linewidth=2.4)
    for at, text in ((d_full, "task fully active"), (d_b, "buffer distance $d_b$")):
        ax.axvline(at, color=style.SOFT, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
        place: dict[str, Any] = {"xytext": (4, 0), "textcoords": "offset points", "rotation": 90}
        ax.annotate(text, (at, 0.5), va="center", fontsize=9, color="#616E7C", **place)
    ax.set(xlim=(0.0, 0.2), ylim=(-0.02, 1.05), xlabel="distance of the pair [m]")
    ax.set_ylabel(r"activation $\beta$ [–]")
    return drawing.Drawing(
        figure,
        {"": table},
        {
            "full_at_m": d_full,
            "zero_from_m": d_b,
            "largest_slope_per_m": 1.5 / rise_length(d_b, d_full),
        },
    )


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
    looks: dict[str, tuple[str, str, tuple[float, float]]] = {
        "p_n": ("$p_n$", style.INK, (-18, 8)),
        "p_t": ("$p_t$", style.SOFT, (8, 8)),
        "p_act": ("$p_{act}$", style.ACTING, (8, -14)),
        "p_b": ("$p_b$", style.PAIR_COLOURS["lm-lEE"], (6, -14)),
    }
    for name, (text, colour, offset) in looks.items():
        if name in (names or looks):
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
