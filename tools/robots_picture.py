"""The picture of the robots: bodies over the hulls of their links, and their borders.

python tools/robots_picture.py docs/pictures/robots.png husky_panda tiago …
DBB_ROBOTS=out/gallery python tools/robots_picture.py docs/pictures/gallery.png new_tiago …

The picture of more than six robots has only the views from the side.
"""

import sys
from itertools import cycle
from pathlib import Path

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes

from app.border.mobile import MobileBody
from app.border.offset import offset_contours
from app.onboarding.fit.units import moved, placements, units_of_links
from app.onboarding.read.links import read_geometry
from app.onboarding.read.source import read_robot
from app.onboarding.read.tree import make_tree
from app.onboarding.report import BODY_COLOURS, fill
from app.robot.assets import urdf_path
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.studies.style import SOFT, new_figure, png_of, styled

D_B = 0.15  # [m]
ALONG, ACROSS, UP = (-0.7, 1.25), (-0.85, 0.65), (-0.05, 2.0)  # [m] visible range
HEIGHTS = 9  # [-] number of contours
IN_A_ROW = 6  # [-] largest number of robots in a row


def draw(axes: Axes, model: RobotModel, x: int, y: int) -> None:
    """Draw the ready posture, projected on coordinates number x and y: bodies over grey hulls."""
    ready = np.array(model.description.arm.ready_position)
    placed = placements(model, ready)
    path = urdf_path(model.description)
    geometry = read_geometry(make_tree(read_robot(path)[0]))
    for units in units_of_links(model, geometry).values():
        for unit in units:
            for part in unit.parts:
                fill(axes, moved(part.corners, placed[unit.joint]), x, y, SOFT, 0.5)
    colours = dict(zip(model.body_names, cycle(BODY_COLOURS), strict=False))
    for name, mesh in model.placed_meshes((0.0, 0.0, 0.0), ready):
        fill(axes, np.asarray(mesh.vertices), x, y, colours[name], 0.3)
    axes.set_aspect("equal")
    axes.autoscale()


def draw_border(axes: Axes, model: RobotModel) -> None:
    """Draw the contours of l_m's exact offset in colours by height."""
    offset, top = offset_contours(model, D_B), float(MobileBody(model).upper[2]) + D_B
    for k, z in enumerate(np.linspace(0.02, top - 0.005, HEIGHTS)):
        for piece in offset.contours(float(z)):
            axes.plot(*piece.T, color=colormaps["viridis"](k / (HEIGHTS - 1)), linewidth=1.2)
    axes.autoscale()


def main(out: Path, names: list[str]) -> None:
    """Draw each robot from the side and, if there are at most `IN_A_ROW` robots, from above."""
    models = [RobotModel(load_robot(name)) for name in names]
    with styled():
        if len(models) <= IN_A_ROW:
            figure = new_figure(5.4)
            above, below = figure.subplots(2, len(models))
        else:
            rows = -(-len(models) // IN_A_ROW)
            figure = new_figure(2.3 * rows)
            above, below = figure.subplots(rows, IN_A_ROW, sharey=True).ravel(), []
        for axes, model in zip(above, models, strict=False):
            draw(axes, model, 0, 2)
            title = model.description.title.removeprefix("new ").replace(" (", "\n(")
            axes.set_title(title, fontsize=10)
            axes.set(xlim=ALONG, ylim=UP)
        for axes, model in zip(below, models, strict=False):
            draw(axes, model, 0, 1)
            draw_border(axes, model)
            axes.set(xlim=ALONG, ylim=ACROSS, xlabel="x [m]")
        for axes in above[len(models) :]:
            axes.set_axis_off()
        out.write_bytes(png_of(figure))


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
