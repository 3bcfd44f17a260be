"""Rows of snapshots: the robot at some times, and over it where base and hand have been."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib import patheffects
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from app.robot.model import RobotModel
from app.simulation.snapshots import Camera, Photographer, Picture, Solid
from app.studies.drawing import Table
from app.studies.paper.experiments import Run
from app.studies.paper.motion import base_corners, extent, hand_path, row_at, to_world
from app.studies.style import HAND, PATH, SOFT, TARGET, WIDTH, marker_style, new_figure

Array = np.ndarray

COLUMNS = 4
_PIXELS = 460, 420
_TALL = 1.35  # [m]
_CASING = [patheffects.withStroke(linewidth=3.6, foreground="white")]


@dataclass(frozen=True)
class Strip:
    """One row of snapshots.

    Attributes:
        letter: Of the panel in the paper.
        text: What it shows.
        run: The run.
        times: [s] of the snapshots.
        yaw, pitch: [rad] direction from which they are taken.
        aim: (2, 3) [m] where the hand is led from and to, in the world, or None.
        solids: What stands beside the robot, for a row of the log.
        marks: (N, 3) [m] a line on the floor, such as a door's arc, or None.
    """

    letter: str
    text: str
    run: Run
    times: Sequence[float]
    yaw: float
    pitch: float = 0.45
    aim: Array | None = None
    solids: Callable[[int], Sequence[Solid]] = lambda _: ()
    marks: Array | None = None


def path_columns(model: RobotModel, run: Run, every: int = 10) -> dict[str, Array]:
    """Columns of where base and hand were, each `every` rows of the log."""
    hand = hand_path(model, run)[::every]
    names = ("t_s", "base_x_m", "base_y_m", "base_yaw_rad")
    columns = {name: run.log[name][::every] for name in names}
    return columns | {f"hand_{axis}_m": hand[:, i] for i, axis in enumerate("xyz")}


def snapshot_figure(
    model: RobotModel, strips: Sequence[Strip], paths: dict[str, Table], legend: Sequence[Line2D]
) -> Figure:
    """The figure of some rows of snapshots.

    Args:
        model: The robot.
        strips: The rows.
        paths: For each row by its letter what `path_columns` gives.
        legend: What stands below the figure.
    """
    cell = WIDTH / COLUMNS
    height = len(strips) * (cell * _PIXELS[1] / _PIXELS[0] + 0.5) + 0.35
    figure = new_figure(height)
    rows = figure.subfigures(len(strips), 1, squeeze=False)[:, 0]
    with Photographer(model) as photographer:
        for part, strip in zip(rows, strips, strict=True):
            part.suptitle(f"({strip.letter}) {strip.text}", x=0.01, ha="left", weight="bold")
            axes = part.subplots(1, COLUMNS)
            view = strip.yaw, strip.pitch
            camera = _camera(model, [s for s in strips if (s.yaw, s.pitch) == view])
            for ax, t in zip(axes, strip.times, strict=True):
                _panel(ax, model, strip, paths[strip.letter], camera, photographer, t)
    figure.legend(
        handles=list(legend),
        loc="outside lower center",
        ncols=len(legend),
        fontsize=10,
        handlelength=2.2,
    )
    return figure


def legend_of(*, aim: str | None = None, marks: str | None = None) -> list[Line2D]:
    """Keys of the lines over the pictures; `aim` and `marks` say what the red ones are."""
    keys = [
        Line2D([], [], color=SOFT, linestyle="--", label="where the base began"),
        Line2D([], [], color=PATH, label="path of the base's centre"),
        Line2D([], [], color=HAND, label="path of the hand"),
    ]
    if aim is not None:
        keys.append(Line2D([], [], label=aim, **marker_style(TARGET)))
    if marks is not None:
        keys.append(Line2D([], [], color=TARGET, linestyle=":", label=marks))
    return keys


def _camera(model: RobotModel, strips: Sequence[Strip]) -> Camera:
    """One camera for rows that are seen from the same side, that sees all that happens in them."""
    points = np.concatenate([_seen(model, strip) for strip in strips])
    start = Camera(points.mean(axis=0), 6.0, strips[0].yaw, strips[0].pitch, *_PIXELS)
    return start.framing(points, 0.05)


def _seen(model: RobotModel, strip: Strip) -> Array:
    """(N, 3) [m] what the pictures of a row have to show."""
    rows = [row_at(strip.run, t) for t in strip.times]
    seen = [extent(model, strip.run.base_poses[k], strip.run.q_m[k]) for k in rows]
    seen += [solid.mesh.bounding_box.vertices for k in rows for solid in strip.solids(k)]
    if strip.aim is not None:
        seen.append(strip.aim)
    points = np.concatenate(seen)
    # What stands higher than the arm may be cut off: the robot would be small beside it.
    return points * [1.0, 1.0, 0.0] + np.minimum(points[:, 2:], _TALL) * [0.0, 0.0, 1.0]


def _panel(
    ax: Axes,
    model: RobotModel,
    strip: Strip,
    path: Table,
    camera: Camera,
    photographer: Photographer,
    t: float,
) -> None:
    k = row_at(strip.run, t)
    poses = strip.run.base_poses
    picture = photographer.take(poses[k], strip.run.q_m[k], camera, strip.solids(k))
    ax.imshow(picture.rgb, interpolation="antialiased")
    ax.set_axis_off()
    ax.set_title(f"t = {t:g} s", fontsize=11, weight="normal", loc="center", pad=3)
    corners = base_corners(model)
    footprint = to_world(poses[0], corners[[0, 1, 2, 3, 0]])
    _on_floor(ax, picture, footprint, color="#616E7C", linewidth=1.2, linestyle="--")
    if strip.marks is not None:
        _on_floor(ax, picture, strip.marks, color=TARGET, linewidth=1.6, linestyle=":")
    past = path["t_s"] <= t + 1e-6
    top = np.full(past.sum(), corners[:, 2].max())
    centre = np.column_stack([path["base_x_m"][past], path["base_y_m"][past], top])
    _over(ax, picture, centre, color=PATH, linewidth=2.2)
    ax.plot(*picture.pixels(centre[-1:]).T, **marker_style(PATH, size=5))
    hand = np.column_stack([path[f"hand_{axis}_m"][past] for axis in "xyz"])
    _over(ax, picture, hand, color=HAND, linewidth=2.2)
    if strip.aim is not None:
        _aim(ax, picture, strip.aim)
    ax.set_xlim(-0.5, _PIXELS[0] - 0.5)
    ax.set_ylim(_PIXELS[1] - 0.5, -0.5)


def _aim(ax: Axes, picture: Picture, aim: Array) -> None:
    start, end = picture.pixels(aim)
    ax.annotate(
        "",
        end,
        start,
        zorder=5,
        arrowprops={
            "arrowstyle": "-|>",
            "color": TARGET,
            "linewidth": 1.6,
            "shrinkA": 0,
            "shrinkB": 3,
            "mutation_scale": 11,
        },
    )
    ax.plot(*end, **marker_style(TARGET, size=7))


def _over(ax: Axes, picture: Picture, points: Array, **line: object) -> None:
    """A line over all else, with a light casing."""
    ax.plot(*picture.pixels(points).T, path_effects=_CASING, zorder=4, **line)  # type: ignore


def _on_floor(ax: Axes, picture: Picture, corners: Array, **line: object) -> None:
    """A line on the floor, hidden by what stands before it."""
    share = np.linspace(0.0, len(corners) - 1.0, 40 * len(corners))
    at = np.arange(len(corners))
    points = np.column_stack([np.interp(share, at, column) for column in corners.T])
    pixels = picture.pixels(points)
    pixels[~picture.unhidden(points)] = np.nan
    ax.plot(*pixels.T, zorder=3, **line)  # type: ignore[arg-type]
