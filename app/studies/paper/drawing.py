"""The figures of the paper: their files, and parts that several figures have in common."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon

from app.border.mobile import MobileBody
from app.robot.model import RobotModel
from app.simulation.photographer import Camera, Photographer, Picture, Solid
from app.simulation.run import RunResult
from app.strict import Array
from app.studies import style
from app.studies.runs import write_table
from app.system import write_whole

Table = dict[str, Array]
"""The data of a figure: columns of equal length, whose names end in the unit, if any."""
_COLUMNS = 4  # [-] number of snapshots in a row
_PIXELS = 460, 420  # width and height of a snapshot
_TALL = 1.35  # [m] height of the visible part of objects; higher parts may be outside the picture
_GRID, _AROUND = 0.25, 2.0  # [m] spacing of the lines on the floor, half of their length


class Drawing(NamedTuple):
    """A reproduced figure of the paper."""

    figure: Figure
    tables: dict[str, Table]  # the plotted data, by the suffix of the CSV file's name or ""
    measured: Mapping[str, Any]
    """Results by key, and mappings of such results by the name of a run, pair or border."""
    remarks: Sequence[str] = ()

    def write(self, folder: Path, name: str, title: str) -> list[Path]:
        """Write a PNG and one CSV file for each table; return the paths, the PNG first."""
        picture = folder / f"{name}.png"
        self.figure.suptitle(title, x=0.01, ha="left", fontsize=13)
        write_whole(picture, style.png_of(self.figure))
        paths = [picture]
        for suffix, table in self.tables.items():
            paths.append(folder / (f"{name}_{suffix}.csv" if suffix else f"{name}.csv"))
            write_table(paths[-1], table)
        return paths


def stacked(parts: dict[str, Table], kind: str) -> Table:
    """One table from tables with the same columns, with the tables' names in the column `kind`."""
    names = np.repeat([*parts], [len(next(iter(part.values()))) for part in parts.values()])
    columns = next(iter(parts.values()))
    return {kind: names} | {c: np.concatenate([p[c] for p in parts.values()]) for c in columns}


def points_table(points: Array, prefix: str = "", **columns: Array) -> Table:
    """A table of points (N, 3) [m] with further columns; `prefix` is before x, y and z."""
    return {f"{prefix}{axis}_m": points[:, i] for i, axis in enumerate("xyz")} | columns


def table_of(names: Sequence[str], rows: Iterable[Sequence[Any]]) -> Table:
    """A table from the names of its columns and at least one row of cells."""
    return dict(zip(names, map(np.array, zip(*rows, strict=True)), strict=True))


def method_lines(ax: Axes, parts: dict[str, Table], column: str, **line: Any) -> None:
    """Plot a column over time for each method; `line` are options of `plot`."""
    for name, part in parts.items():
        look = {"color": style.METHOD_COLOURS[name], "label": style.METHOD_NAMES[name], **line}
        ax.plot(part["t_s"], part[column], **look)


def base_corners(model: RobotModel) -> Array:
    """(8, 3) [m] corners of a box around l_m in the base's frame, first the four on the floor."""
    body = MobileBody(model)
    return trimesh.bounds.corners([[*body.lower[:2], 0.0], body.upper])


def base_in_plan(ax: Axes, model: RobotModel) -> None:
    """Draw the base and its wheel axis from above, in the base's frame."""
    ax.add_patch(Polygon(base_corners(model)[:4, :2], facecolor="#EEF1F4", edgecolor=style.SOFT))
    ax.axvline(0.0, color=style.SOFT, linewidth=1.0, linestyle=(0, (1, 2)), zorder=1)
    ax.set(aspect="equal", xlabel="x of the base [m]", ylabel="y of the base [m]")


def square_around(ax: Axes, points: Array, margin: float, smallest: float = 0.0) -> None:
    """Limit axes in plan to a square around points (N, 2) or (N, 3) [m], with a margin [m]; without
    the margin, the side of the square is at least `smallest` [m].
    """
    low, high = points[:, :2].min(axis=0), points[:, :2].max(axis=0)
    half = max(smallest, float((high - low).max())) / 2 + margin
    x, y = (low + high) / 2
    ax.set(xlim=(x - half, x + half), ylim=(y - half, y + half))


def framed(
    camera: Camera, meshes: list[trimesh.Trimesh], points: Iterable[Array] = (), top: float = np.inf
) -> Camera:
    """The camera, moved to show meshes and points, (N, 3) [m] each, up to the height `top` [m]."""
    shown = np.concatenate([*(mesh.vertices for mesh in meshes), *points])
    shown[:, 2] = np.minimum(shown[:, 2], top)
    return camera._replace(target=shown.mean(axis=0)).framing(shown, 0.05)


class Strip(NamedTuple):
    """A row of snapshots of one run, with the paths of base and end-effector."""

    name: str  # name of the run in the CSV file
    text: str
    run: RunResult
    times: Sequence[float]  # [s] times of the snapshots
    view: tuple[float, float]  # [rad] yaw and pitch of the camera
    aim: Array | None = None  # (2, 3) [m] ends of the end-effector's desired path, in the world
    solids: Callable[[int], Sequence[Solid]] = lambda _: ()  # further objects, at a row of `run`
    marks: Array | None = None  # (N, 3) [m] a line on the floor, such as a door's arc

    def paths(self, *columns: str) -> Table:
        """Every tenth row: time, pose of the base, position of the end-effector, and `columns`."""
        run = self.run.trace
        table = {name: run[name] for name in ("t_s", "base_x_m", "base_y_m", "base_yaw_rad")}
        table |= points_table(run.of("p_ee"), "hand_") | {name: run[name] for name in columns}
        return {name: column[::10] for name, column in table.items()}


def snapshot_drawing(
    model: RobotModel, strips: list[Strip], kind: str, text: str, keys: Sequence[str], *columns: str
) -> Drawing:
    """A drawing with four snapshots of each strip, a table of `Strip.paths`, and results by `keys`.

    The table also has a column `kind` with the strips' names, and `columns` from the traces.
    `text` is the legend's text for `Strip.marks` or, if the strips have none, for `Strip.aim`.
    """
    height = len(strips) * (style.WIDTH / _COLUMNS * _PIXELS[1] / _PIXELS[0] + 0.5) + 0.35
    figure = style.new_figure(height)
    rows = figure.subfigures(len(strips), 1, squeeze=False)[:, 0]
    cameras = {s.view: _camera(model, [x for x in strips if x.view == s.view]) for s in strips}
    with closing(Photographer(model)) as photographer:
        for letter, part, strip in zip("abcdef", rows, strips, strict=False):
            part.suptitle(f"({letter}) {strip.text}", x=0.01, ha="left", weight="bold")
            for ax, t in zip(part.subplots(1, _COLUMNS), strip.times, strict=True):
                _panel(ax, model, strip, cameras[strip.view], photographer, t)
    look: dict[str, Any] = {"color": style.TARGET, "linestyle": ":"}
    if strips[0].marks is None:
        look = style.marker_style(style.TARGET)
    handles = [
        Line2D([], [], color=style.SOFT, linestyle="--", label="start of the base"),
        Line2D([], [], color=style.PATH, label="path of the base's centre"),
        Line2D([], [], color=style.EE, label="path of the end-effector"),
        Line2D([], [], label=text, **look),
    ]
    place = {"loc": "outside lower center", "ncols": len(handles), "handlelength": 2.2}
    figure.legend(handles=handles, fontsize=10, **place)
    paths = {strip.name: strip.paths(*columns) for strip in strips}
    measured = {strip.name: {key: strip.run.figures[key] for key in keys} for strip in strips}
    return Drawing(figure, {"": stacked(paths, kind)}, measured)


def _camera(model: RobotModel, strips: Sequence[Strip]) -> Camera:
    """A camera that shows all snapshots of some strips, which have the same `view`."""
    meshes: list[trimesh.Trimesh] = []
    for strip in strips:
        run = strip.run.trace
        for k in map(run.row_at, strip.times):
            bodies = model.placed_meshes(run.of("base_pose")[k], run.of("q_m")[k])
            meshes += [mesh for _, mesh in bodies] + [solid.mesh for solid in strip.solids(k)]
    aims = [strip.aim for strip in strips if strip.aim is not None]
    return framed(Camera(np.zeros(3), 6.0, *strips[0].view, *_PIXELS), meshes, aims, _TALL)


def _panel(
    ax: Axes, model: RobotModel, strip: Strip, camera: Camera, photographer: Photographer, t: float
) -> None:
    run, poses = strip.run.trace, strip.run.trace.of("base_pose")
    k, past = run.row_at(t), run.t <= t + 1e-6
    picture = photographer.take(poses[k], run.of("q_m")[k], camera, strip.solids(k))
    show_picture(ax, picture, camera)
    ax.set_title(f"t = {t:g} s", fontsize=11, weight="normal", loc="center", pad=3)
    corners, (x, y, yaw) = base_corners(model), poses[0]
    begin = corners[[0, 1, 2, 3, 0]] @ pin.utils.rotate("z", yaw).T + [x, y, 0.0]
    _on_floor(ax, picture, begin, color="#616E7C", linewidth=1.2, linestyle="--")
    if strip.marks is not None:
        _on_floor(ax, picture, strip.marks, color=style.TARGET, linewidth=1.6, linestyle=":")
    centre = np.column_stack([poses[past, :2], np.full(past.sum(), corners[:, 2].max())])
    casing = [patheffects.withStroke(linewidth=3.6, foreground="white")]
    for points, colour in ((centre, style.PATH), (run.of("p_ee")[past], style.EE)):
        line = {"color": colour, "linewidth": 2.2, "path_effects": casing, "zorder": 4}
        ax.plot(*picture.pixels(points).T, **line)
    ax.plot(*picture.pixels(centre[-1:]).T, **style.marker_style(style.PATH, size=5))
    if strip.aim is not None:
        start, end = picture.pixels(strip.aim)
        arrow(ax, start, end, style.TARGET, linewidth=1.6, shrinkB=3, mutation_scale=11)
        ax.plot(*end, **style.marker_style(style.TARGET, size=7))


def show_picture(ax: Axes, picture: Picture, camera: Camera) -> None:
    """Draw a picture that fills the axes, with a grid on the floor around the camera's target."""
    ax.imshow(picture.rgb, interpolation="antialiased")
    ax.set(xlim=(-0.5, camera.width - 0.5), ylim=(camera.height - 0.5, -0.5))
    ax.set_axis_off()
    x, y = _GRID * np.round(camera.target[:2] / _GRID)
    for at in np.arange(-_AROUND, _AROUND + _GRID / 2, _GRID):
        for ends in (((at, -_AROUND), (at, _AROUND)), ((-_AROUND, at), (_AROUND, at))):
            line = np.array([[x + u, y + v, 0.0] for u, v in ends])
            _on_floor(ax, picture, line, color="#DDE1E6", linewidth=0.6)


def arrow(ax: Axes, start: Array, end: Array, colour: str, **look: float) -> None:
    """Draw an arrow, which the layout ignores, from x and y of one point to x and y of another."""
    look = {"linewidth": 2.2, "shrinkA": 0, "shrinkB": 0, "mutation_scale": 14, **look}
    head: dict[str, Any] = {"arrowstyle": "-|>", "color": colour, **look}
    ends: Any = end[:2], start[:2]
    ax.annotate("", *ends, zorder=5, arrowprops=head).set_in_layout(False)


def _on_floor(ax: Axes, picture: Picture, corners: Array, **line: Any) -> None:
    """Draw a line through `corners` (N, 3) [m] on the floor, without the parts behind objects."""
    share = np.linspace(0.0, len(corners) - 1.0, 60 * len(corners))
    points = np.column_stack([np.interp(share, np.arange(len(corners)), x) for x in corners.T])
    pixels = picture.pixels(points)
    pixels[~picture.unhidden(points)] = np.nan
    ax.plot(*pixels.T, zorder=3, **line)
