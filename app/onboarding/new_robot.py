"""From a URDF to a robot's folder: every step in order, each number with where it comes from."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from app.border.cache import BorderData, load_border_data
from app.border.config import SamplingConfig
from app.errors import DbbError, RobotFileError
from app.onboarding.fit.bodies import FittedBody
from app.onboarding.fit.collision_sampling import Meetings, make_units, sample_meetings
from app.onboarding.fit.grouping import Grouping, Unseen, Verdict, find_grouping, unseen_collisions
from app.onboarding.fit.postures import RULE, Place, Ready, find_places, find_ready, judge_ready
from app.onboarding.numbers import (
    Reach,
    Sourced,
    base_numbers,
    completed,
    damping,
    find_reach,
    wheel_fields,
    with_source,
)
from app.onboarding.read.package import FOLDER, open_package
from app.onboarding.read.parse import Parsed, parse
from app.onboarding.report import report_html
from app.onboarding.request import Request
from app.onboarding.warn import warnings_of
from app.onboarding.write import ROOT, rebased_urdf, whole_folder, write_robot
from app.robot.description import KINDS, RobotDescription
from app.robot.link_pairs import LinkPairs, find_link_pairs
from app.robot.model import RobotModel
from app.system import write_whole

_log = logging.getLogger(__name__)

MEETING_SAMPLES = 6000
"""[-] random poses in which the links' hulls are compared."""
PAIR_SAMPLES = 20_000
"""[-] random poses for the pairs of the report."""


@dataclass(frozen=True)
class NewRobot:
    """A robot that was made, before anything is written.

    Attributes:
        urdf: Text of the new URDF.
        content: The description, as `RobotDescription` takes it, its URDF by name.
        verdict: Of the grouping.
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
    unseen: Unseen
    pairs: LinkPairs
    ready: Ready
    reach: dict[str, Reach]
    places: dict[str, Place]
    warnings: list[str]


def finish(
    request: Request,
    *,
    tell: Callable[[str], None] = lambda _: None,
    processes: int | None = None,
    sampling: SamplingConfig | None = None,
    on_progress: Callable[[float], None] = lambda _: None,
) -> tuple[NewRobot, BorderData]:
    """Make a robot and its border, and only then put its folder in its place.

    Args:
        request: What is asked.
        tell: Called with what is being done.
        processes: How many to sample with; all cores if not given.
        sampling: Of the border; by default as every command samples it.
        on_progress: Called with the share of a long step that is done, 0 to 1: of the places that
            are searched, then of the border.

    Raises:
        RobotFileError: The URDF cannot become a robot, or a library cannot take it.
        AssetError: A package is not installed.
        DescriptionError: What came out is no robot that the core takes.
        OutputError: The folder is there already or cannot be written.
    """
    request.name  # noqa: B018 - a wrong name is told before any work
    doing = ""

    def say(what: str) -> None:
        nonlocal doing
        doing = what
        tell(what)

    with whole_folder(request.out) as folder, _one_message(lambda: doing):
        if request.urdf.lower().endswith(".zip"):
            say("unpacking the zip")
            path = open_package(Path(request.urdf), folder, request.file)
            name = f"{Path(request.urdf).name}: {path.relative_to((folder / FOLDER).resolve())}"
            request = replace(request, urdf=str(path), source=name)
        robot = make_robot(request, folder, tell=say, on_progress=on_progress)
        say("sampling the border")
        data = load_border_data(
            robot.model,
            sampling=sampling,
            processes=processes,
            progress=False,
            on_progress=on_progress,
        )
        say("writing the report")
        write_robot(robot, folder)
        page = report_html(robot, data)
        write_whole(folder / "report.html", page)
    return robot, data


@contextmanager
def _one_message(doing: Callable[[], str]) -> Iterator[None]:
    """Whatever a library raises becomes one line that names the step; its trace goes to the log."""
    try:
        yield
    except DbbError:
        raise
    except Exception as error:  # pinocchio, coal, qhull, trimesh: they have no common base
        _log.debug("%s", doing(), exc_info=True)
        why = " ".join(str(error).split())[:300] or "no reason given"
        raise RobotFileError(
            f"{doing()}: a library cannot take this robot: {type(error).__name__}: {why}; "
            "look whether check_urdf takes the file, then report it with the URDF"
        ) from error


_UNWATCHED = "chosen: links of them are nearer than d_b as they are built"
"""Why a pair is not watched."""


def make_robot(
    request: Request,
    folder: Path,
    *,
    tell: Callable[[str], None] = lambda _: None,
    on_progress: Callable[[float], None] = lambda _: None,
) -> NewRobot:
    """Everything but the border and the report, which `finish` adds; its arguments and errors.

    The URDF is written into the folder, a temporary one.
    """
    tell("reading the URDF")
    parsed = parse(request)
    header = f"Made by dbb new-robot from {request.told}; its sources and licences: SOURCES.md"
    urdf = rebased_urdf(parsed, name=request.name, header=header, home=folder)
    path = folder / "robot.urdf"
    write_whole(path, urdf)
    bare = compiled(description(request, parsed), path)
    parsed = replace(parsed, limits=completed(parsed.limits, parsed.arm, bare))
    meetings, (bodies, verdict) = _fitted(request, parsed, bare, tell)
    d_b, unwatched = request.d_b, dict.fromkeys(verdict.unwatched, _UNWATCHED)
    model = compiled(description(request, parsed, bodies, unwatched=unwatched), path)
    pairs = find_link_pairs(model, samples=PAIR_SAMPLES, seed=request.seed)
    unseen = unseen_collisions(model, parsed.geometry, d_b)
    if unseen.blind:
        raise RobotFileError(
            f"the bodies {', '.join(unseen.blind)} do not hold the links with which they meet; "
            f"give another number of --bodies than {len(bodies) - 1}, or another --seed"
        )
    tell("choosing the ready pose")
    if request.ready is None:
        ready = find_ready(model, pairs, d_b=d_b, seed=request.seed)
    else:
        ready = judge_ready(model, pairs, np.array(request.ready), d_b=d_b)
    moving = _moving(request, parsed, model, ready)
    content = description(request, parsed, bodies, moving, unwatched)
    tell("counting the reachability")
    reach = find_reach(compiled(content, path), pairs)
    content["reachability"] = {name: each.content() for name, each in reach.items()}
    tell("looking for places to guide the hand")
    places = find_places(compiled(content, path), pairs, d_b, on_progress=on_progress)
    content["lines"] = {name: place.content() for name, place in places.items()}
    robot = NewRobot(
        request,
        parsed,
        urdf,
        content,
        compiled(content, path),
        meetings,
        bodies,
        verdict,
        unseen,
        pairs,
        ready,
        reach,
        places,
        warnings=[],
    )
    return replace(robot, warnings=warnings_of(robot))


def _fitted(
    request: Request, parsed: Parsed, bare: RobotModel, tell: Callable[[str], None]
) -> tuple[Meetings, Grouping]:
    """Which links meet, and the bodies around groups of them."""
    d_b = request.d_b
    tell(f"looking at {MEETING_SAMPLES:,} random poses")
    units = make_units(bare, parsed.arm, parsed.geometry)
    meetings = sample_meetings(bare, units, samples=MEETING_SAMPLES, seed=request.seed, d_b=d_b)
    tell("fitting bodies")
    return meetings, find_grouping(bare, meetings, d_b=d_b, count=request.bodies)


def _moving(
    request: Request, parsed: Parsed, model: RobotModel, ready: Ready
) -> tuple[Sourced, Sourced]:
    """Numbers of the base, and those of the arm that follow from its bodies and masses."""
    base = base_numbers(model, parsed.wheels, ready.q_m, request.half_track, parsed.steering)
    why = "chosen: as the paper's robot, less where a light joint would not be damped stably in "
    return base, {
        "ready_position": (
            tuple(float(q) for q in ready.q_m),
            RULE if request.ready is None else "given: --ready",
        ),
        "joint_damping": (damping(parsed.limits, parsed.arm, model), why + "steps of 1 ms"),
    }


def description(
    request: Request,
    parsed: Parsed,
    bodies: Sequence[FittedBody] = (),
    moving: tuple[Sourced, Sourced] | None = None,
    unwatched: Mapping[str, str] = MappingProxyType({}),
) -> dict[str, Any]:
    """A description, its URDF by name; without numbers and bodies, for kinematics and dynamics.

    Args:
        request: What was asked.
        parsed: What the URDF says.
        bodies: Of the robot; dots stand for them.
        moving: Of the base and the arm; ones stand for them, and the middle of the joints.
        unwatched: Why a pair of bodies is not watched, by its name.
    """
    arm, limits = parsed.arm, parsed.limits
    wheels = wheel_fields(request.kind, parsed.wheels, parsed.steering)
    if moving is None:
        fields = KINDS[request.kind].model_fields.keys() - {"source", "kind", "link", *wheels}
        middle = tuple((a + b) / 2 for a, b in zip(limits.lower, limits.upper, strict=True))
        limits = limits._replace(effort=tuple(e or 1.0 for e in limits.effort))
        moving = (
            dict.fromkeys(sorted(fields), (1.0, "assumed")),
            {
                "ready_position": (middle, "assumed"),
                "joint_damping": ((0.0,) * len(middle), "assumed"),
            },
        )
    given = any((*request.tip_xyz, *request.tip_rpy))
    tip = "given: --tip-xyz, --tip-rpy" if given else "from the URDF: the origin of --tip"
    hand = {
        "end_effector_xyz_m": (request.tip_xyz, tip),
        "end_effector_rpy_rad": (request.tip_rpy, tip),
    }
    chain = {
        "mount_link": arm.mount,
        "joints": tuple(joint.name for joint in arm.joints),
        "end_effector_link": arm.tip,
    }
    dot = {"source": "none", "frame": ROOT, "covers": (ROOT,)}
    dot["shapes"] = [{"type": "sphere", "radius_m": 0.01}]
    return {
        "name": request.name,
        "title": request.title or request.name.replace("_", " "),
        "urdf": "robot.urdf",
        "licence": request.licence or "Of the files that the URDF refers to: see SOURCES.md.",
        "base": with_source({"kind": request.kind, "link": ROOT}, moving[0], wheels),
        "arm": with_source(chain, {**hand, **limits.numbers, **moving[1]}),
        "bodies": [_body(body) for body in bodies] or [{"name": n, **dot} for n in ("lm", "l1")],
        "reachability": {},
        "unwatched": dict(unwatched),
    }


def _body(body: FittedBody) -> dict[str, Any]:
    over = ", ".join(f"{fit.over_cover:.2f}" for fit in body.fits)
    out = max(fit.protrusion for fit in body.fits)
    shapes = [fit.shape.model_dump() for fit in body.fits]
    return {
        "name": body.name,
        "source": f"fitted around the hulls of the covered links where they can meet others: "
        f"{over} times their volume, at most {out:.3f} m outside of them",
        "frame": body.frame,
        "covers": body.links,
        "shapes": [{k: v for k, v in s.items() if k != "rpy_rad" or any(v)} for s in shapes],
    }


def compiled(content: Mapping[str, Any], urdf: Path) -> RobotModel:
    """The robot of a description and a URDF.

    Raises:
        DescriptionError: It is no robot that the core takes.
    """
    return RobotModel(RobotDescription.model_validate({**content, "urdf": str(urdf)}))
