"""The maps of a sweep: horizontal paths by their direction, paths from above by their place."""

import math
from typing import Any, NamedTuple

import numpy as np
from matplotlib import colormaps, patheffects
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, PowerNorm
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Circle, Patch, Polygon, Rectangle

from app.border.mobile import MobileBody
from app.robot.model import RobotModel
from app.studies.runs import Row
from app.studies.style import INK, METHOD_NAMES, SOFT, TARGET, new_figure
from app.studies.sweep.plan import CLEARANCE_LIMIT, ERROR_LIMIT

_GOOD, _BAD = colormaps["Blues"], colormaps["YlOrRd"]
_PALE, _DEEP = 0.45, 0.95  # [-] used range of a colour map
_WITHIN, _BEYOND = "#2171B5", "#FC4E2A"  # colours in the legend
_NEVER: dict[str, Any] = {"facecolor": "white", "edgecolor": "#B10026", "hatch": "////"}
_UNREACHABLE: dict[str, Any] = {"facecolor": "white", "edgecolor": "#D5DAE0", "hatch": "////"}
_DOT: dict[str, Any] = {"marker": "o", "linestyle": "none"}
_INNER, _OUTER = 0.80, 1.60  # [m] radii in plan of the bars' scale, which surrounds the base
_MIN_BAR = 0.06  # [-] smallest length of a bar, relative to the scale
_AXIS_RADIUS, _AXIS_STEP = 1.78, 4.5  # [m] radius, [deg] angle between dots for the wheel axis
_AXIS_ORDER = {0.0: 0, 0.001: 1, 0.010: 2, 0.050: 3}  # order of the dots by |x| of p_b [m]
_PANEL = 3.35  # [in] side of a panel
_MARKS_AT = 132.0  # [deg] direction of the texts of the scale, diagonally behind the base


class Quantity(NamedTuple):
    """A quantity that the maps show."""

    key: str  # key in the rows of paths
    title: str
    scale: Normalize  # of the values [m or s]
    limit: float  # [m or s] the worst good value; infinite if all values are good
    marks: tuple[tuple[float, str], ...]  # values that are drawn as circles, with their texts
    more_is_better: bool = False

    def share(self, value: float) -> float:
        """[-] position of a value on the scale, clipped to 0 to 1."""
        return float(self.scale(value))

    def radius(self, value: float) -> float:
        """[m] radius in plan of a bar's end; at least the limit's radius if more is better."""
        shown = max(value, self.limit) if self.more_is_better else value
        return _INNER + (_OUTER - _INNER) * max(self.share(shown), _MIN_BAR)

    def colour(self, value: float) -> tuple[float, float, float, float]:
        """Colour of a value: blue if good, yellow to red if bad; darker farther from the limit."""
        at, limit = self.share(value), self.share(self.limit)
        good = value >= self.limit if self.more_is_better else value <= self.limit
        width = limit if good is not self.more_is_better else 1.0 - limit
        depth = min(abs(at - limit) / width, 1.0) if width > 0.0 else 0.0
        return (_GOOD if good else _BAD)(_PALE + (_DEEP - _PALE) * depth)


def quantities(rows: list[Row]) -> tuple[Quantity, ...]:
    """Final error, smallest distance (0 for an overlap) and time of paths, each with its scale.

    The scales of distance and time end at the largest start distance and longest time, rounded up.
    """
    known = [row["time_s"] for row in rows if row["time_s"] is not None]
    longest = 5.0 * math.ceil(max(known, default=5.0) / 5.0)
    widest = 0.05 * math.ceil(max((row["start_clearance_m"] for row in rows), default=0.2) / 0.05)
    errors = (1e-5, "10 µm"), (ERROR_LIMIT, "1 mm"), (0.1, "100 mm")
    gaps = tuple((gap, f"{gap:.3g} m") for gap in (CLEARANCE_LIMIT, widest / 2, widest))
    times = (longest / 2, f"{longest / 2:g} s"), (longest, f"{longest:g} s")
    log, root = LogNorm(1e-6, 0.3, clip=True), PowerNorm(0.5, 0.0, widest, clip=True)
    linear, title = Normalize(0.0, longest, clip=True), "smallest distance to the base"
    return (
        Quantity("ee_error_final_m", "final error of the end-effector", log, ERROR_LIMIT, errors),
        Quantity("min_clearance_m", title, root, CLEARANCE_LIMIT, gaps, more_is_better=True),
        Quantity("time_s", "time until the error is within 1 mm", linear, math.inf, times),
    )


def polar_map(result: Row, height: float, speed: float, model: RobotModel) -> Figure:
    """Draw the horizontal paths at one height [m] and speed [m/s] by direction, in `_panels`."""
    paths, axis = (
        [r for r in result[key] if r["height_m"] == height and r["speed_mps"] == speed]
        for key in ("paths", "wheel_axis")
    )
    no_start = [row for row in result["unreachable"] if row.get("height_m") == height]
    speed_text, length = f"{1000 * speed:.3g} mm/s", f"{result['length_m']:g} m"
    at = f"end-effector at {height:g} m, {speed_text}"
    title = f"sweep, {result['mode']}: {at}, {length} towards the base"
    names, step = result["controllers"], result["step_deg"]
    figure, panels = _panels(title, names, [*paths, *axis], _PANEL, projection="polar")
    for ax, quantity, rows in panels:
        in_plan = ax.transProjectionAffine + ax.transAxes  # metres in plan on the polar axes
        _base(ax, model, 0.07, (-1.7, 1.7), facecolor="#EEF1F4", transform=in_plan)
        tip = MobileBody(model).upper[0]
        nose = [(tip, 0.09), (tip + 0.12, 0.0), (tip, -0.09)]
        ax.add_patch(Polygon(nose, closed=True, color=INK, zorder=4, transform=in_plan))
        for row in rows:
            value = row[quantity.key]
            colour = _NEVER["edgecolor"] if value is None else quantity.colour(value)
            if "offset_m" in row:
                _dot(ax, row, colour, INK)
                continue
            if value is None:
                _bar(ax, row, 0.92 * step, _OUTER, linewidth=0.6, **_NEVER)
            else:
                _bar(ax, row, 0.92 * step, quantity.radius(value), facecolor=colour)
            _cross(ax, row, (math.radians(row["direction_deg"]), 0.72), 4.5)
        for row in no_start:
            if row["kind"] == "side":
                _bar(ax, row, step, _OUTER, zorder=1, linewidth=0, **_UNREACHABLE)
            else:
                _dot(ax, row, "white", SOFT)
        _scale(ax, quantity)
    _legend(figure, axis=bool(axis) or any(row["kind"] == "wheel_axis" for row in no_start))
    return figure


def above_map(result: Row, speed: float, model: RobotModel) -> Figure:
    """Draw the paths down onto the base at one speed [m/s] as squares in plan, in `_panels`."""
    rows = [row for row in result["above"] if row["speed_mps"] == speed]
    no_start = [row for row in result["unreachable"] if row["kind"] == "above"]
    columns = ([row[key] for row in [*rows, *no_start]] for key in ("place_x_m", "place_y_m"))
    sides = [float(np.diff(np.unique(column)).min(initial=1.0)) for column in columns]
    body = MobileBody(model)
    lower, upper = body.lower, body.upper
    speed_text, length = f"{1000 * speed:.3g} mm/s", f"{result['length_m']:g} m"
    title = f"sweep from above, {result['mode']}: {speed_text}, {length} down"

    def square(ax: Axes, row: Row, **style: Any) -> None:
        corner = row["place_x_m"] - sides[0] / 2, row["place_y_m"] - sides[1] / 2
        ax.add_patch(Rectangle(corner, *sides, linewidth=0.8, zorder=2, **style))

    figure, panels = _panels(title, result["controllers"], rows, 2.6)
    for ax, quantity, own in panels:
        _base(ax, model, 0.05, (lower[1] - 0.1, upper[1] + 0.1), fill=False)
        ax.set(aspect="equal", xlabel="x of the base [m]", ylabel="y of the base [m]")
        ax.set(xlim=(lower[0] - 0.15, upper[0] + 0.15), ylim=(lower[1] - 0.15, upper[1] + 0.15))
        for row in no_start:
            square(ax, row, **_UNREACHABLE)
        for row in own:
            if (value := row[quantity.key]) is None:
                square(ax, row, **_NEVER)
            else:
                square(ax, row, facecolor=quantity.colour(value), edgecolor="white")
            _cross(ax, row, (row["place_x_m"], row["place_y_m"]), 6)
    _legend(figure, axis=False)
    return figure


def _panels(
    title: str, names: list[str], rows: list[Row], panel: float, projection: str = "rectilinear"
) -> tuple[Figure, list[tuple[Axes, Quantity, list[Row]]]]:
    """Make panels of the height `panel` [in], each for one of `quantities` and one controller.

    Each controller has a column of panels; a single controller has a row. The result has the axes,
    the quantity and the controller's rows of each panel.
    """
    single, shown = len(names) == 1, quantities(rows)
    labels = [METHOD_NAMES.get(name, name) for name in names]
    wide, high = (3, 1) if single else (len(names), 3)
    figure = new_figure(panel * high + 1.3, max(_PANEL * wide, 7.4))
    title = f"{labels[0]}: {title}" if single else title
    figure.suptitle(title[0].upper() + title[1:], x=0.01, ha="left", fontsize=13)
    grid = figure.subplots(high, wide, squeeze=False, subplot_kw={"projection": projection})
    panels = []
    for (i, j), ax in np.ndenumerate(grid.T if single else grid):
        text = shown[i].title
        ax.set_title(f"{labels[j]}\n{text}" if i == 0 and not single else text, fontsize=11)
        panels.append((ax, shown[i], [row for row in rows if row["controller"] == names[j]]))
    return figure, panels


def _legend(figure: Figure, *, axis: bool) -> None:
    handles: list[Patch | Line2D] = [
        Patch(facecolor=_WITHIN, label="within the limit, or without limit"),
        Patch(facecolor=_BEYOND, label="beyond the limit"),
        Patch(**_NEVER, label="error never within 1 mm"),
        Patch(**_UNREACHABLE, label="no start found"),
        Line2D([], [], color=INK, marker="x", linestyle="none", label="contact"),
    ]
    if axis:
        text = "along the wheel axis, x of $p_b$ = 0, ±1, ±10, ±50 mm"
        handles.append(Line2D([], [], label=text, color=_WITHIN, markeredgecolor=INK, **_DOT))
    figure.legend(handles=handles, loc="outside lower center", ncols=3, fontsize=9.5)


def _base(
    ax: Axes, model: RobotModel, mount: float, axis: tuple[float, float], **style: Any
) -> None:
    """Draw the base's outline, the wheel axis from y to y in `axis` [m], and the arm's mount."""
    body, (x, y, _) = MobileBody(model), model.p_base()
    (left, low, _), (width, height, _) = body.lower, body.upper - body.lower
    place = {"transform": style.pop("transform", ax.transData)}
    line = {"edgecolor": INK, "linewidth": 1.2, "zorder": 3, "label": "base"}
    ax.add_patch(Rectangle((left, low), width, height, **line, **style, **place))
    ax.plot([0, 0], axis, color=INK, linewidth=0.9, linestyle=(0, (1, 2)), zorder=5, **place)
    ax.add_patch(Circle((x, y), mount, color=SOFT, zorder=4, **place))


def _scale(ax: Any, quantity: Quantity) -> None:
    """Draw circles at a quantity's marks, a dashed one at the limit, and label the directions."""
    marks = {_INNER + (_OUTER - _INNER) * quantity.share(v): text for v, text in quantity.marks}
    marks.setdefault(_OUTER, "")
    ax.set_rgrids(list(marks), list(marks.values()), angle=_MARKS_AT, fontsize=7.5, color="#52606D")
    ax.set_thetagrids((0, 90, 180, 270), ("0° front", "90°", "180°", "270°"), fontsize=8.5)
    ax.grid(visible=False, axis="x")
    ax.grid(color=SOFT, linewidth=0.7, axis="y")
    ax.set_axisbelow(False)
    ax.tick_params(pad=-6)
    ax.spines["polar"].set_visible(False)
    ax.set_rlim(0.0, 1.98)
    halo = patheffects.withStroke(linewidth=2.5, foreground="white")
    lines, labels = ax.yaxis.get_gridlines(), ax.get_yticklabels()
    for (value, _), line, label in zip(quantity.marks, lines, labels, strict=False):
        label.set(path_effects=[halo], zorder=8)
        if value == quantity.limit:
            line.set(color=TARGET, linewidth=1.4, linestyle=(0, (4, 2)))
            label.set_color(TARGET)


def _bar(ax: Axes, row: Row, width: float, radius: float, **style: Any) -> None:
    """Draw a bar in a path's direction, up to a radius [m] in plan, with a width [deg]."""
    middle, style = math.radians(row["direction_deg"]), {"zorder": 2, **style}
    ax.bar(middle, radius - _INNER, math.radians(width), _INNER, **style)


def _dot(ax: Axes, row: Row, face: object, edge: str) -> None:
    """Draw a path along the wheel axis as a dot outside of the scale, ordered by `offset_m`."""
    rank = math.copysign(_AXIS_ORDER[abs(row["offset_m"])], row["offset_m"])
    turn = -rank if row["direction_deg"] < 180.0 else rank  # positive x is to the right
    angle = math.radians(row["direction_deg"] + _AXIS_STEP * turn)
    look = {"markerfacecolor": face, "markeredgecolor": edge, "markeredgewidth": 0.8, "zorder": 6}
    ax.plot(angle, _AXIS_RADIUS, markersize=6.5, **look, **_DOT)
    _cross(ax, row, (angle, 1.9), 4)


def _cross(ax: Axes, row: Row, place: tuple[float, float], size: float) -> None:
    """If the arm touched the base or itself, draw a cross at a place in the axes' coordinates."""
    if row.get("contacts") or row.get("arm_contacts"):
        ax.plot(*place, marker="x", color=INK, markersize=size, zorder=7)
