"""§3.1 and §3.4: the acting point (Figures 7 and 8) and the activation (Figure 10)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.collections import PathCollection
from matplotlib.patches import Polygon
from scipy.spatial import ConvexHull

from app.avoidance.acting_point import ActingPoint, ActingPointFinder
from app.avoidance.activation import activation
from app.avoidance.mobile_acceleration import avoidance_force
from app.avoidance.self_collision import BORDERS
from app.border.dbb import construct_dbb
from app.border.offset import OffsetContours
from app.border.score import ScoreField
from app.config import ForceConfig
from app.robot.link_pairs import Closest
from app.robot.meshes import shape_mesh
from app.robot.model import RobotModel
from app.studies.drawing import Drawing, Table
from app.studies.paper.experiments import Run, Sources
from app.studies.paper.guiding import LATERAL
from app.studies.paper.motion import base_corners, closest_points
from app.studies.paper.tracking import WHEEL_AXIS
from app.studies.style import (
    ACTING,
    INK,
    METHOD_COLOURS,
    PAIR_COLOURS,
    SCORE_MAP,
    SOFT,
    marker_style,
    new_figure,
    panel_title,
)

Array = np.ndarray

NEEDS_7, NEEDS = (WHEEL_AXIS,), (LATERAL,)
TOO_LARGE = ForceConfig(alpha_gain=0.1, alpha_max=0.4)
"""A step size that almost always stands at its upper bound, as large as the bound can be."""

_NORMAL, _TANGENT = "#56B4E9", "#E69F00"
_EVERY = 20  # rows of a log between two looks at the force
_ZOOM = 0.30  # [m] around the acting point


class Moment(NamedTuple):
    """One instant of a run: the hand inside the buffer, and the border at its height.

    Attributes:
        t: [s]
        q_m: (n_m,) [rad or m] the arm's joints.
        closest: Of the first pair of L_m, in the base's frame.
        slice: (M, 3) [m] the border's points at p_b's height.
        score: (M,) [m⁴/rad⁴] their scores.
        finder: Algorithm 3 on that border.
    """

    t: float
    q_m: Array
    closest: Closest
    slice: Array
    score: Array
    finder: ActingPointFinder


def moment(sources: Sources) -> Moment:
    """The instant of the lateral guiding at which the hand is deepest in its buffer."""
    run = sources.runs[LATERAL]
    deepest = int(run.log[f"d_{sources.data.pairs.mobile[0].name}_m"].argmin())
    return _moments(sources, run, [deepest])[0]


def turning(sources: Sources) -> Moment:
    """The instant near the wheel axis at which the smaller component of the force is largest."""
    run, d_b = sources.runs[WHEEL_AXIS], sources.config.border.d_b
    inside = np.flatnonzero(run.log[f"d_{sources.data.pairs.mobile[0].name}_m"] < d_b)[::_EVERY]

    def smaller(now: Moment) -> float:
        acting, f = _found(sources, now, sources.config.force)
        return min(float(np.linalg.norm(v)) for v in components(now.closest.p_b, acting.p_n, f))

    return max(_moments(sources, run, inside.tolist()), key=smaller)


def _moments(sources: Sources, run: Run, rows: Sequence[int]) -> list[Moment]:
    pair, config = sources.data.pairs.mobile[0], sources.config.border
    border = construct_dbb(sources.data.clouds[pair.name], config.d_b, config.eps)
    field = ScoreField.of(sources.model, pair.b)
    shape = BORDERS[config.kind](border, OffsetContours(sources.model, config.d_b))
    finder = ActingPointFinder(shape, field)
    found = []
    for k, closest in zip(rows, closest_points(sources.model, pair, run.q_m[rows]), strict=True):
        same_height = border.same_height(float(closest.p_b[2]))
        found.append(
            Moment(
                float(run.log["t_s"][k]),
                run.q_m[k],
                closest,
                same_height,
                field.score(same_height),
                finder,
            )
        )
    return found


def figure_7(sources: Sources) -> Drawing:
    """The force at the acting point and its two orthogonal components."""
    now = turning(sources)
    acting, f = _found(sources, now, sources.config.force)
    along, across = components(now.closest.p_b, acting.p_n, f)
    figure = new_figure(5.4)
    whole, near = figure.subplots(1, 2)
    for ax in (whole, near):
        shown = _slice(ax, sources.model, now)
        _hand(ax, sources.model, now)
    panel_title(whole, "", "the border at the hand's height")
    _arrow(whole, acting.p_act, now.closest.p_b, ACTING)
    _points(whole, now, acting, names=False)
    whole.set(xlim=(-0.70, 0.80), ylim=(-0.75, 0.75))
    figure.colorbar(shown, ax=whole, label=r"score $\mathcal{S}$ [m⁴/rad⁴]", shrink=0.8)
    panel_title(near, "a", "its two orthogonal components")
    _zoom(near, now, acting)
    length = float(np.linalg.norm(now.closest.p_b - acting.p_act) / max(np.linalg.norm(f), 1e-9))
    _arrow(near, acting.p_act, acting.p_act + length * across, _TANGENT, "towards a better score")
    _arrow(near, acting.p_act, acting.p_act + length * along, _NORMAL, "away from the hand's link")
    _arrow(near, acting.p_act, now.closest.p_b, ACTING, "force $f_{m,1}$")
    _points(near, now, acting)
    near.legend(loc="lower left", fontsize=9)
    return Drawing(
        "Figure 7: the direction of the force",
        "The force starts at the acting point and points to the closest point of the hand. One of "
        "its two orthogonal components moves the base away from the hand, the other brings the "
        "part of the border with a high score closer to it.",
        figure,
        {"": _slice_table(now), "points": _point_table(now, {"chosen": acting})},
        {"t_s": now.t, **_shares(now, acting, f)},
        ["Taken from a hand that comes along the wheel axis, once the base has begun to turn."],
    )


def figure_8(sources: Sources) -> Drawing:
    """How the acting point is found, and a step size that is too large."""
    now = moment(sources)
    cases = {"chosen": sources.config.force, "too large": TOO_LARGE}
    found = {name: _found(sources, now, force) for name, force in cases.items()}
    figure = new_figure(5.4)
    grid = figure.subplots(1, 2, sharex=True, sharey=True)
    for ax, letter, (acting, _) in zip(grid, "ab", found.values(), strict=True):
        shown = _slice(ax, sources.model, now)
        _hand(ax, sources.model, now)
        _arrow(ax, acting.p_n, acting.p_t, INK)
        _arrow(ax, acting.p_act, now.closest.p_b, ACTING)
        _points(ax, now, acting)
        text = "the step along the tangent" if letter == "a" else "too large a step"
        panel_title(ax, letter, rf"{text}, $\alpha$ = {acting.alpha:.3f} m")
    _zoom(grid[0], now, found["too large"][0], found["chosen"][0])
    figure.colorbar(shown, ax=grid, label=r"score $\mathcal{S}$ [m⁴/rad⁴]", shrink=0.8)
    return Drawing(
        "Figure 8: finding the acting point",
        "(a) From the border's point nearest to the hand a step along the tangent leads towards a "
        "better score; the acting point is the border's point nearest to that. (b) With too large "
        "a step the force may have no component along the line between the hand and the border: "
        "the step is bounded.",
        figure,
        {"": _slice_table(now), "points": _point_table(now, {n: a for n, (a, _) in found.items()})},
        {name: _shares(now, acting, f) for name, (acting, f) in found.items()},
    )


def figure_10(sources: Sources) -> Drawing:
    """The activation by the distance of a pair."""
    d_b, d_full = sources.config.border.d_b, sources.config.activation.d_full
    d = np.linspace(0.0, 0.2, 201)
    table = Table({"d_m": d, "beta": np.array([activation(x, d_b, d_full) for x in d])})
    figure = new_figure(3.6, 6.4)
    ax = figure.subplots()
    ax.plot(table["d_m"], table["beta"], color=METHOD_COLOURS["dbb"], linewidth=2.4)
    for at, text in ((d_full, "task in full force"), (d_b, "buffer distance $d_b$")):
        ax.axvline(at, color=SOFT, linewidth=1.2, linestyle=(0, (4, 3)), zorder=1)
        ax.annotate(
            text,
            (at, 0.5),
            xytext=(4, 0),
            textcoords="offset points",
            rotation=90,
            va="center",
            fontsize=9,
            color="#616E7C",
        )
    ax.set(xlim=(0.0, 0.2), ylim=(-0.02, 1.05), xlabel="distance of the pair [m]")
    ax.set_ylabel(r"activation $\beta$ [–]")
    return Drawing(
        "Figure 10: activation by distance",
        "0 from the buffer distance of 0.15 m outwards, 1 at 0.05 m and nearer, a cubic between.",
        figure,
        {"": table},
        {"full_at_m": d_full, "zero_from_m": d_b, "largest_slope_per_m": 1.5 / (d_b - d_full)},
    )


def components(p_b: Array, p_n: Array, f: Array) -> tuple[Array, Array]:
    """A force (3,) split along the line from p_n to p_b and at right angles to it, both (3,).

    Paper: §3.1, Figure 7a.
    """
    line = p_b - p_n
    line = line / np.linalg.norm(line)
    along = float(f @ line) * line
    return along, f - along


def _found(sources: Sources, now: Moment, force: ForceConfig) -> tuple[ActingPoint, Array]:
    """Acting point and force of the moment, from the controller's own functions."""
    p_b, d = now.closest.p_b, now.closest.d
    acting = now.finder.find_acting_point(p_b, d, force)
    assert acting is not None  # the paper's robot has a border at every height in the buffer
    f = avoidance_force(
        p_b, acting.p_act, d, now.closest.normal, f_max=force.f_max, d_b=sources.config.border.d_b
    )
    return acting, f


def _shares(now: Moment, acting: ActingPoint, f: Array) -> dict[str, object]:
    along, across = components(now.closest.p_b, acting.p_n, f)
    return {
        "distance_m": now.closest.d,
        "alpha_m": acting.alpha,
        "force_n": float(np.linalg.norm(f)),
        "force_along_line_n": float(np.linalg.norm(along)),
        "force_tangential_n": float(np.linalg.norm(across)),
        "share_along_line": float(np.linalg.norm(along) / max(np.linalg.norm(f), 1e-9)),
    }


def _slice(ax: Axes, model: RobotModel, now: Moment) -> PathCollection:
    """The base in plan and the border around it, by score; returns what a colour bar shows."""
    ax.add_patch(Polygon(base_corners(model)[:4, :2], facecolor="#EEF1F4", edgecolor=SOFT))
    ax.plot([0, 0], [-0.6, 0.6], color=SOFT, linewidth=1, linestyle=(0, (1, 2)), zorder=1)
    shown = ax.scatter(now.slice[:, 0], now.slice[:, 1], c=now.score, s=7, cmap=SCORE_MAP, zorder=2)
    ax.set_aspect("equal")
    ax.set(xlabel="x of the base [m]", ylabel="y of the base [m]")
    return shown


def _hand(ax: Axes, model: RobotModel, now: Moment) -> None:
    """The hand's convex body in plan."""
    name = model.description.bodies[-1].name
    data, placed = model.pin.createData(), pin.GeometryData(model.geometry)
    q = model.configuration((0.0, 0.0, 0.0), now.q_m)
    pin.updateGeometryPlacements(model.pin, data, model.geometry, placed, q)
    for i, shape in zip(model.shape_ids[name], model.description.body(name).shapes, strict=True):
        corners = shape_mesh(shape).apply_transform(placed.oMg[i].homogeneous).vertices[:, :2]
        outline = corners[ConvexHull(corners).vertices]
        ax.add_patch(
            Polygon(outline, facecolor=PAIR_COLOURS["lm-lEE"], alpha=0.18, linewidth=0, zorder=1)
        )


def _zoom(ax: Axes, now: Moment, *acting: ActingPoint) -> None:
    points = np.array([now.closest.p_b, *(p for a in acting for p in (a.p_n, a.p_t, a.p_act))])
    middle = (points.max(axis=0) + points.min(axis=0)) / 2
    half = max(_ZOOM, float(np.ptp(points[:, :2], axis=0).max())) / 2 + 0.06
    ax.set_xlim(middle[0] - half, middle[0] + half)
    ax.set_ylim(middle[1] - half, middle[1] + half)


def _points(ax: Axes, now: Moment, acting: ActingPoint, names: bool = True) -> None:
    for point, text, colour, offset in (
        (acting.p_n, "$p_n$", INK, (-18, 8)),
        (acting.p_t, "$p_t$", SOFT, (8, 8)),
        (acting.p_act, "$p_{act}$", ACTING, (8, -14)),
        (now.closest.p_b, "$p_b$", PAIR_COLOURS["lm-lEE"], (6, -14)),
    ):
        if names or text in ("$p_b$", "$p_{act}$"):
            ax.plot(*point[:2], **marker_style(colour, size=8))
            label = ax.annotate(
                text, _plan(point), xytext=offset, textcoords="offset points", fontsize=12, zorder=7
            )
            label.set_in_layout(False)


def _arrow(ax: Axes, start: Array, end: Array, colour: str, text: str | None = None) -> None:
    arrow = ax.annotate(
        "",
        _plan(end),
        _plan(start),
        zorder=5,
        arrowprops={
            "arrowstyle": "-|>",
            "color": colour,
            "linewidth": 2.2,
            "shrinkA": 0,
            "shrinkB": 0,
            "mutation_scale": 14,
        },
    )
    arrow.set_in_layout(False)
    if text is not None:
        ax.plot([], [], color=colour, label=text)


def _plan(point: Array) -> tuple[float, float]:
    return float(point[0]), float(point[1])


def _slice_table(now: Moment) -> Table:
    x, y, z = now.slice.T
    return Table({"x_m": x, "y_m": y, "z_m": z, "score_m4prad4": now.score})


def _point_table(now: Moment, found: dict[str, ActingPoint]) -> Table:
    rows = [
        (step, name, *point, acting.alpha)
        for step, acting in found.items()
        for name, point in (
            ("p_b", now.closest.p_b),
            ("p_n", acting.p_n),
            ("p_t", acting.p_t),
            ("p_act", acting.p_act),
        )
    ]
    columns = zip(*rows, strict=True)
    names = ("step", "point", "x_m", "y_m", "z_m", "alpha_m")
    return Table({name: np.array(column) for name, column in zip(names, columns, strict=True)})
