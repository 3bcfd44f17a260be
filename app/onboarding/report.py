"""The report of a new robot: a page with pictures, tables and warnings."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import cycle
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pinocchio as pin
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from scipy.spatial import ConvexHull

from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.offset import offset_contours
from app.border.score import radial_profile
from app.onboarding.fit.units import moved
from app.onboarding.preview import COLOURS, Bare, bare_links, view_html
from app.robot.model import RobotModel, body_meshes
from app.studies.page import Grid, Part, page_html
from app.studies.style import INK, SOFT, new_figure, png_of, styled

if TYPE_CHECKING:
    from app.onboarding.record import NewRobot

Array = np.ndarray


class Pictures(NamedTuple):
    """Pictures of a new robot in PNG format."""

    bodies: bytes
    border: bytes | None
    """The border, or None for a robot without a border."""
    reach: bytes | None
    """The reachability, or None without a counted reachability."""
    view: str
    """Text of a separate page, which shows the bodies in three dimensions."""
    bare: dict[str, Bare]
    """Links that extend beyond their bodies, by design or by mistake."""


def draw(_: object, job: tuple[NewRobot, BorderData]) -> Pictures:
    """The pictures of a robot and its border; they do not depend on the lines for guiding."""
    robot, data = job
    placed = _placements(robot.model, robot.ready.q_m)
    bare = bare_links(robot, placed)
    pngs = bodies_png(robot, bare), border_png(robot, data), reach_png(robot)
    return Pictures(*pngs, view_html(robot, placed, bare), bare)


def report_html(robot: NewRobot, data: BorderData, pictures: Pictures) -> str:
    """The report of a robot and its border, as a page without external files."""
    more = (("Border", pictures.border), ("Reachability", pictures.reach))
    parts = [
        Part("Warnings", points=robot.warnings or ["none"]),
        Part(
            "Bodies over meshes, in the ready pose",
            png=pictures.bodies,
            tables=[_bodies(robot)],
            points=_bare(pictures.bare),
            note=f"The file {VIEW} in the same folder shows the bodies in three dimensions.",
        ),
        Part("Pairs", tables=[_pairs(robot, data)], points=_verdict(robot)),
        *(Part(title, png=png) for title, png in more if png is not None),
        Part("Coefficients of (9)", tables=[_reach(robot)]),
        Part("Base and arm", tables=[_numbers(robot)]),
    ]
    arm = f" and its arm from {robot.request.arm_urdf}" if robot.request.arm_urdf else ""
    lead = f"Made by dbb new-robot from {robot.request.told}{arm}."
    return page_html(f"New robot: {robot.content['title']}", lead, parts)


VIEW = "bodies.html"
"""Name of the page that shows the bodies in three dimensions."""


def _bare(bare: dict[str, Bare]) -> list[str]:
    """Sentences on the links that extend beyond their bodies."""
    whys = {
        "design": "extend beyond their bodies by design: no monitored body can reach these parts",
        "mistake": "extend beyond their bodies by mistake: a monitored body can reach these parts",
    }
    links = {why: [link for link, each in bare.items() if each == why] for why in whys}
    return [f"{', '.join(links[why])} {text}" for why, text in whys.items() if links[why]]


def _bodies(robot: NewRobot) -> Grid:
    rows = [
        (
            body.name,
            body.frame,
            ", ".join(body.links),
            fit.shape.type,
            f"{1e3 * fit.volume:.2f}",
            f"{fit.over_cover:.2f}",
            f"{fit.protrusion:.3f}",
        )
        for body in robot.bodies
        for fit in body.fits
    ]
    return Grid(
        ("body", "frame", "links", "shape", "volume [l]", "volume / hull", "protrusion [m]"), rows
    )


def _pairs(robot: NewRobot, data: BorderData) -> Grid:
    pairs, near = data.pairs, robot.verdict.near
    rows = [
        (
            pair.name,
            group,
            f"{pairs.rates[pair.name]:.3%}",
            f"{pairs.least_distance_m[pair.name]:+.3f}",
            f"{near.get(pair.name, 0.0):.0%}",
        )
        for group, each in (
            ("L_m", pairs.mobile),
            ("L_m^c", pairs.manipulator),
            ("never", pairs.never),
        )
        for pair in each
    ]
    return Grid(
        ("pair", "set", "in collision", "smallest distance [m]", f"within {robot.request.d_b:g} m"),
        rows,
    )


def _verdict(robot: NewRobot) -> list[str]:
    verdict, ready, share = robot.verdict, robot.ready, robot.unseen.share
    return [
        f"share of the colliding random poses that no pair sees: {share:.1%}",
        f"share of the free random poses in which bodies of a pair overlap: {verdict.false:.1%}",
        f"ready pose: the nearest pair {ready.nearest} is {ready.clearance:+.3f} m from its buffer",
    ]


def _reach(robot: NewRobot) -> Grid:
    rows = [
        (
            name,
            f"{r.A:.1f}",
            f"{r.B:.3f}",
            f"{r.C:.1f}",
            "" if r.fit is None else f"{r.fit.r_squared:.3f}",
            r.source,
        )
        for name, r in robot.reach.items()
    ]
    return Grid(("body", "A [1/m²]", "B [m]", "C", "R²", "source"), rows)


def _numbers(robot: NewRobot) -> Grid:
    rows = []
    for part in ("base", "arm"):
        record = robot.content[part]
        for key, source in record["source"].items():
            rows.append((part, key, _text(record[key]), source))
    for name, place in robot.places.items():
        rows.append(
            (name, "start_m, move_m", f"{_text(place.start)}; {_text(place.move)}", place.source)
        )
    return Grid(("", "number", "value", "source"), rows)


def _text(value: object) -> str:
    if isinstance(value, (tuple, list)):
        return ", ".join(_text(each) for each in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


BODY_COLOURS = ("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9")
_VIEWS = (("side", 0, 2), ("front", 1, 2), ("above", 0, 1))


def bodies_png(robot: NewRobot, bare: dict[str, Bare]) -> bytes:
    """The bodies over the hulls of the links in the ready pose, from three sides.

    Links that extend beyond their bodies have the colours of `COLOURS`.
    """
    model = robot.model
    placed, units = _placements(model, robot.ready.q_m), robot.meetings.units
    bodies = body_meshes(model, (0.0, 0.0, 0.0), robot.ready.q_m)
    colours = dict(zip(model.body_names, cycle(BODY_COLOURS), strict=False))
    with styled():
        figure = new_figure(4.6)
        spans = np.ptp(
            np.vstack([moved(p.corners, placed[u.joint]) for u in units for p in u.parts]), axis=0
        )
        panels = figure.subplots(1, 3, width_ratios=[spans[x] for _, x, _ in _VIEWS])
        for axes, (title, x, y) in zip(panels, _VIEWS, strict=True):
            for unit in units:
                for part in unit.parts:
                    corners, colour = moved(part.corners, placed[unit.joint]), bare.get(part.link)
                    _fill(axes, corners, x, y, COLOURS[colour], 0.55)
            for name, mesh in bodies:
                _fill(axes, np.asarray(mesh.vertices), x, y, colours[name], 0.25)
            axes.autoscale()
            across, up = (f"{'xyz'[k]} [m]" for k in (x, y))
            axes.set(aspect="equal", title=title, xlabel=across, ylabel=up)
            axes.locator_params(nbins=4)
        _legend(figure, colours)
        return png_of(figure)


def border_png(robot: NewRobot, data: BorderData) -> bytes | None:
    """The border of each pair of L_m at half the base's height and above its top, or None."""
    model, d_b = robot.model, robot.request.d_b
    eps = model.description.config.border.eps
    clouds = [cloud for cloud in data.clouds.values() if len(cloud)]
    if not clouds:
        return None
    offset = offset_contours(model, d_b)
    meshes = body_meshes(model, (0.0, 0.0, 0.0), robot.ready.q_m)
    base = [np.asarray(mesh.vertices) for name, mesh in meshes if name == model.body_names[0]]
    top = max(float(corners[:, 2].max()) for corners in base)
    heights = (0.5 * top, top + 0.5 * d_b)
    with styled():
        figure = new_figure(5.2)
        for axes, z in zip(figure.subplots(1, 2), heights, strict=True):
            for corners in base:
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
            title = f"z = {z:.2f} m, d_b = {d_b:g} m"
            axes.set(aspect="equal", title=title, xlabel="x [m]", ylabel="y [m]")
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
        return png_of(figure)


def reach_png(robot: NewRobot) -> bytes | None:
    """The counted reachability as means over shells, with the fit of (9), or None."""
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
            title = f"{name}: R² {reach.fit.r_squared:.2f}"
            axes.set(title=title, xlabel="distance from the mount [m]", ylabel="reachability [-]")
            axes.legend()
        return png_of(figure)


def _placements(model: RobotModel, q_m: Array) -> list[pin.SE3]:
    data = model.pin.createData()
    pin.forwardKinematics(model.pin, data, model.configuration((0.0, 0.0, 0.0), q_m))
    return [T.copy() for T in data.oMi]


def _fill(axes: Axes, points: Array, x: int, y: int, colour: str, alpha: float) -> None:
    """Draw the projection of a convex body on the axes x and y."""
    flat = points[:, [x, y]]
    # The projection of a plate can be a line.
    ring = flat[ConvexHull(flat, qhull_options="QJ").vertices]
    style: dict[str, Any] = {"facecolor": colour, "edgecolor": colour, "alpha": alpha}
    axes.add_collection(PolyCollection([ring], linewidth=1.0, **style))


def _legend(figure: Figure, colours: Mapping[str, str]) -> None:
    patches = [Patch(color=colour, alpha=0.5, label=name) for name, colour in colours.items()]
    kinds = {
        None: "enclosed links",
        "design": "beyond their body by design",
        "mistake": "beyond their body by mistake",
    }
    links = [Patch(color=COLOURS[kind], label=text) for kind, text in kinds.items()]
    handles = [*patches, *links]
    figure.legend(handles=handles, loc="outside lower center", ncols=-(-len(handles) // 2))
