"""The report of a new robot: a page with warnings, pictures and tables, and a 3D view."""

from collections.abc import Iterator, Mapping, Sequence
from itertools import cycle
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
from matplotlib.axes import Axes
from matplotlib.collections import PolyCollection
from matplotlib.patches import Patch
from scipy.spatial import ConvexHull
from trimesh.viewer.notebook import scene_to_html

from app.border.cache import BorderData
from app.border.dbb import construct_dbb
from app.border.offset import offset_contours
from app.border.score import radial_profile
from app.onboarding.fit.units import moved, placements
from app.onboarding.record import NewRobot
from app.onboarding.warn import outside
from app.strict import Array
from app.studies.page import Grid, Part, page_html
from app.studies.style import INK, SOFT, new_figure, png_of, styled

Bare = Literal["design", "mistake"]
"""Why a link extends beyond its body: by design, because only links of neighbouring bodies can
reach these parts; or by mistake, because a link of a more distant body can reach them."""

COLOURS: dict[Bare | None, str] = {None: "#9AA5B1", "design": "#E6C229", "mistake": "#D7263D"}
"""Colours of links: None for links inside of their bodies."""
_ORIGIN = (0.0, 0.0, 0.0)  # pose of the base


class Pictures(NamedTuple):
    """Pictures for the report of a new robot: PNG images as bytes, and the page of a 3D view."""

    bodies: bytes
    border: bytes | None  # None for a robot without a border
    reach: bytes | None  # None without a counted reachability
    view: str  # HTML text of the page `VIEW`
    bare: dict[str, Bare]  # links that extend beyond their bodies, by name


def draw(_: object, job: tuple[NewRobot, BorderData]) -> Pictures:
    """Draw a robot and its border; the robot may still have no warnings and no guiding lines."""
    robot, data = job
    placed = placements(robot.model, robot.ready.q_m)
    bare = bare_links(robot, placed)
    pngs = bodies_png(robot, bare), border_png(robot, data), reach_png(robot)
    return Pictures(*pngs, view_html(robot, placed, bare), bare)


def report_html(robot: NewRobot, data: BorderData, pictures: Pictures) -> str:
    """The HTML text of the report; the page needs no other file."""
    more = (("Border", pictures.border), ("Reachability", pictures.reach))
    parts = [
        Part("Warnings", points=robot.warnings or ["none"]),
        Part(
            "Bodies over the hulls of the links, in the ready posture",
            png=pictures.bodies,
            tables=[_bodies(robot)],
            points=[*_bare(pictures.bare)],
            note=f"The file {VIEW} in the same folder shows links and bodies in three dimensions.",
        ),
        Part("Pairs", tables=[_pairs(robot, data)], points=_verdict(robot)),
        *(Part(title, png=png) for title, png in more if png is not None),
        Part("Coefficients of (9)", tables=[_reach(robot)]),
        Part("Base and arm", tables=[_numbers(robot)]),
    ]
    arm = f" and its arm from {robot.request.arm_urdf}" if robot.request.arm_urdf else ""
    lead = f"Made by dbb new-robot from {robot.request.shown_source}{arm}."
    return page_html(f"New robot: {robot.content['title']}", lead, parts)


VIEW = "bodies.html"  # name of the file that shows links and bodies in three dimensions


def _bare(bare: dict[str, Bare]) -> Iterator[str]:
    whys = {"design": "only links of neighbouring bodies", "mistake": "links of distant bodies"}
    for why, reaching in whys.items():
        if links := ", ".join(link for link, each in bare.items() if each == why):
            beyond = f"extending beyond their bodies by {why}"
            yield f"{beyond}, because {reaching} can reach these parts: {links}"


def _bodies(robot: NewRobot) -> Grid:
    rows = []
    for body in robot.bodies:
        for fit in body.fits:
            sizes = f"{1e3 * fit.volume:.2f}", f"{fit.over_cover:.2f}", f"{fit.protrusion:.3f}"
            rows.append((body.name, body.frame, ", ".join(body.links), fit.shape.type, *sizes))
    head = ("body", "frame", "links", "shape", "volume [l]", "volume / hull", "protrusion [m]")
    return Grid(head, rows)


def _pairs(robot: NewRobot, data: BorderData) -> Grid:
    pairs, verdict, rows = data.pairs, robot.verdict, []
    sets = {"L_m": pairs.mobile, "L_m^c": pairs.manipulator, "never": pairs.never}
    for group, pair in ((group, pair) for group, each in sets.items() for pair in each):
        overlap = f"{pairs.rates[pair.name]:.3%}"
        least = f"{pairs.least_distance_m[pair.name]:+.3f}"
        shares = (f"{each.get(pair.name, 0.0):.1%}" for each in (verdict.overlap, verdict.near))
        rows.append((pair.name, group, overlap, least, *shares))
    inside = f"within {robot.request.buffer:g} m in free postures"
    head = ("pair", "set", "overlap", "smallest distance [m]", "overlap in free postures", inside)
    return Grid(head, rows)


def _verdict(robot: NewRobot) -> list[str]:
    ready, share = robot.ready, robot.detection.share
    points = [
        f"links collide, but no pair of bodies overlaps: {share:.1%} of the colliding random "
        "postures",
        f"a pair of bodies overlaps, but no links collide: {robot.verdict.false:.1%} of the free "
        "random postures",
    ]
    if ready.nearest:
        where = "outside of" if ready.beyond_buffer >= 0.0 else "inside"
        place = f"{abs(ready.beyond_buffer):.3f} m {where} its buffer"
        points.append(f"in the ready posture, the nearest pair {ready.nearest} is {place}")
    return points


def _reach(robot: NewRobot) -> Grid:
    rows = []
    for name, r in robot.reach.items():
        fitted = "" if r.fit is None else f"{r.fit.r_squared:.3f}"
        rows.append((name, f"{r.A:.1f}", f"{r.B:.3f}", f"{r.C:.1f}", fitted, r.source))
    return Grid(("body", "A [1/m²]", "B [m]", "C", "R²", "source"), rows)


def _numbers(robot: NewRobot) -> Grid:
    rows = [
        (part, key, _text(robot.content[part][key]), source)
        for part in ("base", "arm")
        for key, source in robot.content[part]["source"].items()
    ]
    for name, place in robot.places.items():
        line = f"{_text(place.start)}; {_text(place.move)}"
        rows.append((name, "start_m, move_m", line, place.source))
    return Grid(("part", "number", "value", "source"), rows)


def _text(value: object) -> str:
    if isinstance(value, (tuple, list)):
        return ", ".join(_text(each) for each in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


BODY_COLOURS = (
    *("#0072B2", "#E69F00", "#009E73", "#CC79A7", "#D55E00", "#56B4E9"),
    *("#332288", "#882255", "#999933"),
)
"""Nine colours: one for the base, and one for each body of the arm, up to eight (--bodies)."""
_VIEWS = (("side", 0, 2), ("front", 1, 2), ("above", 0, 1))


def bodies_png(robot: NewRobot, bare: dict[str, Bare]) -> bytes:
    """PNG of the links' hulls and the bodies in the ready posture, from three sides."""
    hulls = _hulls(robot, placements(robot.model, robot.ready.q_m), bare)
    bodies = robot.model.placed_meshes(_ORIGIN, robot.ready.q_m)
    colours = dict(zip(robot.model.body_names, cycle(BODY_COLOURS), strict=False))
    with styled():
        figure = new_figure(4.6)
        spans = np.ptp(np.vstack([corners for corners, _ in hulls]), axis=0)
        panels = figure.subplots(1, 3, width_ratios=[spans[x] for _, x, _ in _VIEWS])
        for axes, (title, x, y) in zip(panels, _VIEWS, strict=True):
            for corners, colour in hulls:
                fill(axes, corners, x, y, colour, 0.55)
            for name, mesh in bodies:
                fill(axes, np.asarray(mesh.vertices), x, y, colours[name], 0.25)
            axes.autoscale()
            across, up = (f"{'xyz'[k]} [m]" for k in (x, y))
            axes.set(aspect="equal", adjustable="datalim", title=title, xlabel=across, ylabel=up)
            axes.locator_params(nbins=4)
        handles = [Patch(color=colour, alpha=0.5, label=name) for name, colour in colours.items()]
        for kind, colour in COLOURS.items():
            text = f"beyond their body by {kind}" if kind else "enclosed links"
            handles.append(Patch(color=colour, label=text))
        figure.legend(handles=handles, loc="outside lower center", ncols=-(-len(handles) // 2))
        return png_of(figure)


def border_png(robot: NewRobot, data: BorderData) -> bytes | None:
    """PNG of the borders at half the height of l_m, and d_b/2 above l_m; None without a border."""
    model, d_b = robot.model, robot.request.buffer
    eps = model.description.config.border.eps
    if not (clouds := [cloud for cloud in data.clouds.values() if len(cloud)]):
        return None
    offset = offset_contours(model, d_b)
    meshes = model.placed_meshes(_ORIGIN, robot.ready.q_m)
    base = [np.asarray(mesh.vertices) for name, mesh in meshes if name == model.body_names[0]]
    top = max(float(corners[:, 2].max()) for corners in base)
    with styled():
        figure = new_figure(5.2)
        for axes, z in zip(figure.subplots(1, 2), (0.5 * top, top + 0.5 * d_b), strict=True):
            for corners in base:
                fill(axes, corners, 0, 1, SOFT, 0.5)
            for k, piece in enumerate(offset.contours(z)):
                label = "exact offset" if k == 0 else None
                axes.plot(*piece.T, color=INK, linewidth=1.0, label=label)
            for k, cloud in enumerate(clouds):
                points = construct_dbb(cloud, d_b, eps).same_height(z)
                x, y, colour = *points[:, :2].T, BODY_COLOURS[(k + 2) % len(BODY_COLOURS)]
                axes.plot(x, y, ".", markersize=3, label=cloud.pair, color=colour)
            title = f"z = {z:.2f} m, d_b = {d_b:g} m"
            axes.set(aspect="equal", title=title, xlabel="x [m]", ylabel="y [m]")
            axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=2)
        return png_of(figure)


def reach_png(robot: NewRobot) -> bytes | None:
    """PNG of counted reachabilities (means over spherical shells) with their fits (9), or None."""
    counted = [(name, r.counted, r.fit) for name, r in robot.reach.items() if r.counted and r.fit]
    if not counted:
        return None
    with styled():
        figure = new_figure(3.6)
        panels = np.atleast_1d(figure.subplots(1, len(counted)))
        for axes, (name, reach_map, fit) in zip(panels, counted, strict=True):
            profile = radial_profile(reach_map.rho, reach_map.reach)
            axes.plot(profile.rho_m, profile.mean, "o", color=INK, label="counted")
            rho = np.linspace(fit.rho_min_m, fit.rho_max_m, 100)
            axes.plot(rho, fit.at(rho), color=BODY_COLOURS[0], label="(9)")
            title = f"{name}: R² {fit.r_squared:.2f}"
            axes.set(title=title, xlabel="distance from the mount [m]", ylabel="reachability [-]")
            axes.legend()
        return png_of(figure)


def _hulls(
    robot: NewRobot, placed: Sequence[pin.SE3], bare: Mapping[str, Bare]
) -> list[tuple[Array, str]]:
    """Corners (N, 3) [m] of the hulls of all links, each with the colour of its link."""
    return [
        (moved(part.corners, placed[unit.joint]), COLOURS[bare.get(part.link)])
        for unit in robot.meetings.units
        for part in unit.parts
    ]


def fill(axes: Axes, points: Array, x: int, y: int, colour: str, alpha: float) -> None:
    """Draw the hull of points (N, 3) [m], projected to the coordinates with the indices x, y."""
    flat = points[:, [x, y]]
    ring = flat[ConvexHull(flat, qhull_options="QJ").vertices]  # QJ: a plate can become a line
    style: dict[str, Any] = {"facecolor": colour, "edgecolor": colour, "alpha": alpha}
    axes.add_collection(PolyCollection([ring], linewidth=1.0, **style))


def bare_links(robot: NewRobot, placed: Sequence[pin.SE3]) -> dict[str, Bare]:
    """`Bare` of each link that extends beyond its body by more than 5 mm, by the link's name;
    `placed` are the poses of the joint frames (`placements`) in the ready posture.
    """
    found: dict[str, Bare] = {}
    for k, body in enumerate(robot.bodies):
        others = [u for j, far in enumerate(robot.bodies) if abs(j - k) > 1 for u in far.units]
        joint = robot.model.body_joints[body.name]
        for unit in (robot.meetings.units[u] for u in body.units):
            points = moved(unit.surface, placed[joint].actInv(placed[unit.joint]))
            out = outside(robot.model, body.name, points) > 0.005
            met = out & robot.meetings.needed(unit.index, others)
            links = np.array(unit.links)[unit.owners]
            found |= dict.fromkeys(links[out].tolist(), "design")
            found |= dict.fromkeys(links[met].tolist(), "mistake")
    return found


def view_html(robot: NewRobot, placed: Sequence[pin.SE3], bare: Mapping[str, Bare]) -> str:
    """A page with a 3D view of the links and bodies, in the poses `placed` of the joint frames."""
    hulls, bodies = _hulls(robot, placed, bare), robot.model.placed_meshes(_ORIGIN, robot.ready.q_m)
    links = [(trimesh.convex.convex_hull(points), colour, 1.0) for points, colour in hulls]
    scene = trimesh.Scene()
    for mesh, colour, alpha in (*links, *((mesh, "#0072B2", 0.3) for _, mesh in bodies)):
        material = trimesh.visual.material.PBRMaterial(
            baseColorFactor=[*bytes.fromhex(colour[1:]), int(255 * alpha)],
            alphaMode="BLEND" if alpha < 1 else "OPAQUE",
            doubleSided=True,
        )
        mesh.visual = trimesh.visual.TextureVisuals(material=material)
        scene.add_geometry(mesh)
    return scene_to_html(scene)
