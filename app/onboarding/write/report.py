"""The report of a new robot: one page with pictures, tables and warnings."""

from __future__ import annotations

from app.border.cache import BorderData
from app.onboarding.new_robot import NewRobot
from app.onboarding.write.pictures import bodies_png, border_png, reach_png
from app.robot.model import RobotModel
from app.studies.page import Grid, Part, page_html


def report_html(robot: NewRobot, model: RobotModel, data: BorderData) -> str:
    """The page; it needs nothing else.

    Args:
        robot: What was made.
        model: The compiled robot.
        data: Its border.
    """
    pictures = (
        ("Border", "border", border_png(robot, model, data)),
        ("Reachability", "reachability", reach_png(robot)),
    )
    parts = [
        Part("Warnings", points=robot.warnings or ["none"]),
        Part(
            "Bodies over meshes, in the ready pose",
            "bodies",
            png=bodies_png(robot),
            tables=[_bodies(robot)],
        ),
        Part("Pairs", "pairs", tables=[_pairs(robot, data)], points=_verdict(robot)),
        *(Part(title, name, png=png) for title, name, png in pictures if png is not None),
        Part("Coefficients of (9)", tables=[_reach(robot)]),
        Part("Base and arm", "numbers", tables=[_numbers(robot)]),
    ]
    lead = f"Made by dbb new-robot from {_sources(robot)}."
    return page_html(f"New robot: {robot.content['title']}", lead, parts)


def _sources(robot: NewRobot) -> str:
    arm = robot.request.arm_urdf
    return robot.request.told + (f" and its arm from {arm}" if arm else "")


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
        ("body", "frame", "links", "shape", "volume [l]", "over hull's", "protrusion [m]"), rows
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
        ("pair", "set", "in collision", "least distance [m]", f"within {robot.request.d_b:g} m"),
        rows,
    )


def _verdict(robot: NewRobot) -> list[str]:
    verdict, ready = robot.verdict, robot.ready
    return [
        f"collisions of links that no pair sees: {verdict.missed:.1%} of those in random poses",
        f"random poses without a collision in which bodies meet: {verdict.false:.1%}",
        f"ready pose: {ready.nearest} is nearest, {ready.clearance:+.3f} m from its buffer",
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
