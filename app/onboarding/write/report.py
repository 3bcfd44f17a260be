"""The report of a new robot: one page with pictures, tables and warnings."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from app.border.cache import BorderData
from app.onboarding.new_robot import NewRobot
from app.onboarding.write.pictures import bodies_png, border_png, reach_png
from app.robot.model import RobotModel
from app.studies.page import document, picture_html


def report_html(robot: NewRobot, model: RobotModel, data: BorderData) -> str:
    """The page; it needs nothing else.

    Args:
        robot: What was made.
        model: The compiled robot.
        data: Its border.
    """
    parts = [f"<p class='lead'>Made by dbb new-robot from {escape(_sources(robot))}.</p>"]
    parts += ["<h2>Warnings</h2>", _list(robot.warnings or ["none"])]
    parts += [
        "<h2>Bodies over meshes, in the ready pose</h2>",
        picture_html("bodies over meshes", bodies_png(robot)),
        _bodies(robot),
    ]
    parts += ["<h2>Pairs</h2>", _pairs(robot, data), _verdict(robot)]
    if (png := border_png(robot, model, data)) is not None:
        parts += ["<h2>Border</h2>", picture_html("border at two heights", png)]
    if (png := reach_png(robot)) is not None:
        parts += ["<h2>Reachability</h2>", picture_html("reachability over distance", png)]
    parts += [_reach(robot), "<h2>Base and arm</h2>", _numbers(robot)]
    return document(f"New robot: {robot.content['title']}", "\n".join(parts))


def _sources(robot: NewRobot) -> str:
    arm = robot.request.arm_urdf
    return robot.request.told + (f" and its arm from {arm}" if arm else "")


def _bodies(robot: NewRobot) -> str:
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
    return _table(
        ("body", "frame", "links", "shape", "volume [l]", "over hull's", "protrusion [m]"), rows
    )


def _pairs(robot: NewRobot, data: BorderData) -> str:
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
    return _table(
        ("pair", "set", "in collision", "least distance [m]", f"within {robot.request.d_b:g} m"),
        rows,
    )


def _verdict(robot: NewRobot) -> str:
    verdict, ready = robot.verdict, robot.ready
    return _list(
        [
            f"collisions of links that no pair sees: {verdict.missed:.1%} of those in random poses",
            f"random poses without a collision in which bodies meet: {verdict.false:.1%}",
            f"ready pose: {ready.nearest} is nearest, {ready.clearance:+.3f} m from its buffer",
        ]
    )


def _reach(robot: NewRobot) -> str:
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
    return _table(("body", "A [1/m²]", "B [m]", "C", "R²", "source"), rows)


def _numbers(robot: NewRobot) -> str:
    rows = []
    for part in ("base", "arm"):
        record = robot.content[part]
        for key, source in record["source"].items():
            rows.append((part, key, _text(record[key]), source))
    for name, place in robot.places.items():
        rows.append(
            (name, "start_m, move_m", f"{_text(place.start)}; {_text(place.move)}", place.source)
        )
    return _table(("", "number", "value", "source"), rows)


def _text(value: object) -> str:
    if isinstance(value, (tuple, list)):
        return ", ".join(_text(each) for each in value)
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    titles = "".join(f"<th>{escape(title)}</th>" for title in head)
    body = "".join(
        "<tr>" + "".join(f"<td>{escape(cell)}</td>" for cell in row) + "</tr>\n" for row in rows
    )
    return f'<div class="scroll"><table><tr>{titles}</tr>\n{body}</table></div>'


def _list(lines: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(line)}</li>" for line in lines) + "</ul>"
