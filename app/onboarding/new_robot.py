"""From a URDF to a description: every step in order, each number with where it comes from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from app.onboarding.fit.bodies import ArmFitter, FittedBody, fit_base
from app.onboarding.fit.collision_sampling import Meetings, sample_meetings
from app.onboarding.fit.grouping import Verdict, find_grouping
from app.onboarding.fit.guiding_lines import Place, find_places
from app.onboarding.fit.reach import Reach, find_reach
from app.onboarding.fit.ready import RULE, Ready, find_ready, judge_ready
from app.onboarding.fit.rigid_groups import make_units
from app.onboarding.read.drive_numbers import base_numbers
from app.onboarding.read.drives import drive_fields
from app.onboarding.read.limits import Limits, completed, damping
from app.onboarding.read.parse import Parsed, parse
from app.onboarding.request import Request
from app.onboarding.write.urdf_text import ROOT, rebased_urdf
from app.onboarding.write.warn import warnings_of
from app.robot.description import KINDS, RobotDescription
from app.robot.link_pairs import LinkPairs, find_link_pairs
from app.robot.model import RobotModel

Array = np.ndarray

MEETING_SAMPLES = 6000
"""[-] random poses in which the links' hulls are compared."""
PAIR_SAMPLES = 20_000
"""[-] random poses for the pairs of the report."""


@dataclass(frozen=True)
class NewRobot:
    """A robot that was made, before anything is written.

    Attributes:
        request: What was asked.
        parsed: What its URDF says.
        urdf: Text of the new URDF.
        content: The description, as `RobotDescription` takes it, its URDF by name.
        model: The compiled robot.
        meetings: Of its links.
        bodies: With what they over-cover.
        verdict: Of the grouping.
        pairs: Sampled.
        ready: The ready pose.
        reach: By the name of the body.
        places: By the name of the scenario.
        warnings: One sentence each.
    """

    request: Request
    parsed: Parsed
    urdf: str
    content: dict[str, Any]
    model: RobotModel
    meetings: Meetings
    bodies: list[FittedBody]
    verdict: Verdict
    pairs: LinkPairs
    ready: Ready
    reach: dict[str, Reach]
    places: dict[str, Place]
    warnings: list[str]


def make_robot(
    request: Request,
    folder: Path,
    *,
    tell: Callable[[str], None] = lambda _: None,
    processes: int | None = None,
    on_progress: Callable[[float], None] = lambda _: None,
) -> NewRobot:
    """Everything but the border and the report.

    Args:
        request: What is asked.
        folder: A temporary one; the URDF is written into it.
        tell: Called with what is being done.
        processes: For the reachability.
        on_progress: Called with the share of the step that takes long, 0 to 1.

    Raises:
        RobotFileError: The URDF cannot become a robot.
        DescriptionError: What came out is no robot that the core takes.
    """
    tell("reading the URDF")
    parsed = parse(request)
    arm = parsed.arm
    header = f"Made by dbb new-robot from {request.told}; its sources and licences: SOURCES.md"
    urdf = rebased_urdf(
        parsed.tree,
        arm,
        parsed.wheels.T_base_floor,
        parsed.geometry,
        parsed.inertias,
        name=request.name,
        header=header,
        home=folder,
    )
    path = folder / "robot.urdf"
    path.write_text(urdf, encoding="utf-8")
    bare = _compiled(_bare(request, parsed, parsed.limits), path)
    parsed = replace(parsed, limits=completed(parsed.limits, arm, bare))
    tell(f"looking at {MEETING_SAMPLES:,} random poses")
    units = make_units(bare, arm, parsed.geometry)
    meetings = sample_meetings(
        bare, units, samples=MEETING_SAMPLES, seed=request.seed, d_b=request.d_b
    )
    tell("fitting bodies")
    base = fit_base(units[0])
    fitter = ArmFitter(bare, meetings)
    grouping = find_grouping(bare, base, meetings, fitter, d_b=request.d_b, count=request.bodies)
    content = _bare(request, parsed, parsed.limits)
    content["bodies"] = [_body_content(body) for body in grouping.bodies]
    model = _compiled(content, path)
    pairs = find_link_pairs(model, samples=PAIR_SAMPLES, seed=request.seed)
    tell("choosing the ready pose")
    ready = (
        find_ready(model, pairs, d_b=request.d_b, seed=request.seed)
        if request.ready is None
        else judge_ready(model, pairs, np.array(request.ready), d_b=request.d_b)
    )
    _fill(content, request, parsed, model, ready)
    model = _compiled(content, path)
    tell("counting the reachability")
    reach = find_reach(model, pairs, processes=processes)
    content["reachability"] = {name: each.content() for name, each in reach.items()}
    model = _compiled(content, path)
    tell("looking for places to guide the hand")
    places = find_places(model, pairs, request.d_b, on_progress=on_progress)
    content["lines"] = {
        name: {
            "start_m": p.start,
            "move_m": p.move,
            "source": {"start_m": p.source, "move_m": p.source},
        }
        for name, p in places.items()
    }
    robot = NewRobot(
        request,
        parsed,
        urdf,
        content,
        _compiled(content, path),
        meetings,
        grouping.bodies,
        grouping.verdict,
        pairs,
        ready,
        reach,
        places,
        [],
    )
    return replace(robot, warnings=warnings_of(robot))


def _bare(request: Request, parsed: Parsed, limits: Limits) -> dict[str, Any]:
    """A description with the joints alone, good for kinematics and dynamics."""
    arm, wheels = parsed.arm, parsed.wheels
    n = len(arm.joints)
    middle = tuple((a + b) / 2 for a, b in zip(limits.lower, limits.upper, strict=True))
    joints = drive_fields(request.kind, wheels, parsed.steering)
    fields = KINDS[request.kind].model_fields.keys() - {"source", "kind", "link", *joints}
    ones = dict.fromkeys(sorted(fields), 1.0)
    dot = {"type": "sphere", "radius_m": 0.01}
    sourced = dict.fromkeys(
        (
            "end_effector_xyz_m",
            "end_effector_rpy_rad",
            "position_lower",
            "position_upper",
            "max_velocity",
            "max_effort",
            "ready_position",
            "joint_damping",
        ),
        "assumed",
    )
    return {
        "name": request.name,
        "title": request.title or request.name.replace("_", " "),
        "urdf": "robot.urdf",
        "licence": request.licence or "Of the files that the URDF refers to: see SOURCES.md.",
        "base": {
            "kind": request.kind,
            "link": ROOT,
            **ones,
            **joints,
            "source": dict.fromkeys(ones, "assumed"),
        },
        "arm": {
            "mount_link": arm.mount,
            "joints": tuple(j.name for j in arm.joints),
            "end_effector_link": arm.tip,
            "end_effector_xyz_m": request.tip_xyz,
            "end_effector_rpy_rad": request.tip_rpy,
            "position_lower": limits.lower,
            "position_upper": limits.upper,
            "max_velocity": limits.velocity,
            "max_effort": tuple(e or 1.0 for e in limits.effort),
            "ready_position": middle,
            "joint_damping": (0.0,) * n,
            "source": sourced,
        },
        "bodies": [
            {"name": name, "source": "none", "frame": ROOT, "covers": (ROOT,), "shapes": [dot]}
            for name in ("lm", "l1")
        ],
        "reachability": {},
    }


def _fill(
    content: dict[str, Any], request: Request, parsed: Parsed, model: RobotModel, ready: Ready
) -> None:
    """Put the real numbers of base and arm in place."""
    values, sources = base_numbers(
        model, parsed.wheels, ready.q_m, request.half_track, parsed.steering
    )
    old = content["base"]
    joints = drive_fields(request.kind, parsed.wheels, parsed.steering)
    content["base"] = {"kind": old["kind"], "link": old["link"], **values, **joints}
    content["base"]["source"] = sources
    tip = (
        "given: --tip-xyz, --tip-rpy"
        if any((*request.tip_xyz, *request.tip_rpy))
        else ("from the URDF: the origin of --tip")
    )
    content["arm"] |= {
        "ready_position": tuple(float(q) for q in ready.q_m),
        "joint_damping": damping(parsed.limits, parsed.arm, model),
        "source": {
            "end_effector_xyz_m": tip,
            "end_effector_rpy_rad": tip,
            **parsed.limits.source,
            "ready_position": RULE if request.ready is None else "given: --ready",
            "joint_damping": "chosen: as the paper's robot, less where a light joint would not be "
            "damped stably in steps of 1 ms",
        },
    }


def _body_content(body: FittedBody) -> dict[str, Any]:
    over = ", ".join(f"{fit.over_cover:.2f}" for fit in body.fits)
    out = max(fit.protrusion for fit in body.fits)
    return {
        "name": body.name,
        "source": f"fitted around the hulls of the covered links where they can meet others: "
        f"{over} times their volume, at most {out:.3f} m outside of them",
        "frame": body.frame,
        "covers": body.links,
        "shapes": [_shape_content(fit.shape) for fit in body.fits],
    }


def _shape_content(shape: Any) -> dict[str, Any]:
    content = shape.model_dump()
    return {k: v for k, v in content.items() if k != "rpy_rad" or any(v)}


def _compiled(content: Mapping[str, Any], urdf: Path) -> RobotModel:
    return RobotModel(RobotDescription.model_validate({**content, "urdf": str(urdf)}))
