"""Pictures of a new robot: bodies over meshes, its border at one height, its reachability."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.offset import OffsetContours
from app.border.reach.radial import radial_profile
from app.onboarding.fit.rigid_groups import make_units
from app.onboarding.new_robot import NewRobot
from app.robot.meshes import shape_mesh
from app.robot.model import RobotModel
from app.studies.style import INK, SOFT, new_figure, png_of, styled

Array = np.ndarray

BODY_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
_VIEWS = (("side", 0, 2), ("front", 1, 2), ("above", 0, 1))


def bodies_png(robot: NewRobot) -> bytes:
    """The ready pose from three sides: hulls of the links in grey, bodies over them."""
    model = robot.model
    placed = _placements(model, robot.ready.q_m)
    units = make_units(model, robot.parsed.arm, robot.parsed.geometry)
    with styled():
        figure = new_figure(4.6)
        spans = np.ptp(
            np.vstack([_seen(placed[u.joint], p.corners) for u in units for p in u.parts]), axis=0
        )
        panels = figure.subplots(1, 3, width_ratios=[spans[x] for _, x, _ in _VIEWS])
        for axes, (title, x, y) in zip(panels, _VIEWS, strict=True):
            for unit in units:
                for part in unit.parts:
                    _fill(axes, _seen(placed[unit.joint], part.corners), x, y, SOFT, 0.55)
            for k, name in enumerate(model.body_names):
                for corners in body_corners(model, placed, name):
                    colour = BODY_COLOURS[k % len(BODY_COLOURS)]
                    _fill(axes, corners, x, y, colour, 0.25, name if x == 0 and y == 2 else None)
            axes.set_aspect("equal")
            axes.autoscale()
            axes.set_title(title)
            axes.set_xlabel(f"{'xyz'[x]} [m]")
            axes.set_ylabel(f"{'xyz'[y]} [m]")
        _legend(figure, model.body_names)
        return png_of(figure)


def border_png(robot: NewRobot, model: RobotModel, data: BorderData) -> bytes | None:
    """The border of each pair of L_m at half the base's height and above its top; None if none."""
    d_b, eps = robot.request.d_b, 0.01
    clouds = [cloud for cloud in data.clouds.values() if len(cloud)]
    if not clouds:
        return None
    offset = OffsetContours(model, d_b)
    placed = _placements(model, robot.ready.q_m)
    top = max(float(c[:, 2].max()) for c in body_corners(model, placed, model.body_names[0]))
    heights = (0.5 * top, top + 0.5 * d_b)
    with styled():
        figure = new_figure(5.2)
        for axes, z in zip(figure.subplots(1, 2), heights, strict=True):
            for corners in body_corners(model, placed, model.body_names[0]):
                _fill(axes, corners, 0, 1, SOFT, 0.5)
            for k, piece in enumerate(offset.contours(z)):
                label = "exact offset" if k == 0 else None
                axes.plot(*piece.T, color=INK, linewidth=1.0, label=label)
            for k, cloud in enumerate(clouds):
                points = construct_dbb(cloud, d_b, eps).same_height(z)
                axes.plot(
                    points[:, 0],
                    points[:, 1],
                    ".",
                    markersize=3,
                    label=cloud.pair,
                    color=BODY_COLOURS[(k + 2) % len(BODY_COLOURS)],
                )
            axes.set_aspect("equal")
            axes.set_title(f"z = {z:.2f} m, d_b = {d_b:g} m")
            axes.set_xlabel("x [m]")
            axes.set_ylabel("y [m]")
            axes.legend(loc="center")
        return png_of(figure)


def reach_png(robot: NewRobot) -> bytes | None:
    """Means of the reachability over shells, and (9); None if nothing was counted."""
    counted = {name: r for name, r in robot.reach.items() if r.counted is not None}
    if not counted:
        return None
    with styled():
        figure = new_figure(3.6)
        panels = np.atleast_1d(figure.subplots(1, len(counted)))
        for axes, (name, reach) in zip(panels, counted.items(), strict=True):
            assert reach.counted is not None
            assert reach.fit is not None
            profile = radial_profile(reach.counted.rho, reach.counted.reach)
            axes.plot(profile.rho_m, profile.mean, "o", color=INK, label="counted")
            rho = np.linspace(reach.fit.rho_min_m, reach.fit.rho_max_m, 100)
            axes.plot(rho, reach.fit.at(rho), color=BODY_COLOURS[0], label="(9)")
            axes.set_title(f"{name}: R² {reach.fit.r_squared:.2f}")
            axes.set_xlabel("distance from the mount [m]")
            axes.set_ylabel("reachability [-]")
            axes.legend()
        return png_of(figure)


def body_corners(model: RobotModel, placed: Sequence[pin.SE3], name: str) -> list[Array]:
    """Corners (N, 3) [m] of each shape of a body, the base at the origin."""
    corners = []
    for shape, k in zip(model.description.body(name).shapes, model.shape_ids[name], strict=True):
        item = model.geometry.geometryObjects[k]
        T = placed[item.parentJoint] * item.placement
        corners.append(_seen(T, np.asarray(shape_mesh(shape).vertices)))
    return corners


def _placements(model: RobotModel, q_m: Array) -> list[pin.SE3]:
    data = model.pin.createData()
    pin.forwardKinematics(model.pin, data, model.configuration((0.0, 0.0, 0.0), q_m))
    return [T.copy() for T in data.oMi]


def _seen(T: pin.SE3, points: Array) -> Array:
    return points @ T.rotation.T + T.translation


def _fill(
    axes: Axes, points: Array, x: int, y: int, colour: str, alpha: float, label: str | None = None
) -> None:
    """The outline of a convex body seen along an axis."""
    flat = points[:, [x, y]]
    ring = flat[_hull_order(flat)]
    style: dict[str, Any] = {"facecolor": colour, "edgecolor": colour, "alpha": alpha}
    axes.add_collection(PolyCollection([ring], label=label, linewidth=1.0, **style))


def _hull_order(flat: Array) -> Array:
    from scipy.spatial import ConvexHull

    return ConvexHull(flat).vertices


def _legend(figure: Figure, names: Sequence[str]) -> None:
    from matplotlib.patches import Patch

    patches = [
        Patch(color=BODY_COLOURS[k % len(BODY_COLOURS)], alpha=0.5, label=name)
        for k, name in enumerate(names)
    ]
    handles = [*patches, Patch(color=SOFT, label="hulls of the links")]
    figure.legend(handles=handles, loc="outside lower center", ncols=len(handles))
