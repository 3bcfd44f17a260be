"""All steps from a URDF to a robot: a folder (description, new URDF, report) and its border."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from app.border.cache import BorderData, load_border_data
from app.border.sampling import SamplingConfig
from app.errors import RobotFileError
from app.jobs.bounded import BudgetError, within_budget
from app.jobs.pool import ALONE, Workers
from app.jobs.progress import OnProgress
from app.onboarding import SIDES, numbers, warn, write
from app.onboarding.check import push_row
from app.onboarding.fit.grouping import detection_of, find_grouping
from app.onboarding.fit.meetings import ENOUGH, sample_meetings, watching_buffer, with_stops
from app.onboarding.fit.postures import RULE, Place, find_ready, judge_ready, line_from
from app.onboarding.fit.travel import filled
from app.onboarding.fit.units import Unit, make_units
from app.onboarding.read.links import read_geometry, read_inertias
from app.onboarding.read.package import FOLDER, open_package
from app.onboarding.read.source import locate
from app.onboarding.read.tree import find_arm
from app.onboarding.read.wheels import find_drive, stands_on_floor, with_rigid_suspensions
from app.onboarding.record import Fitted, NewRobot, Parsed
from app.onboarding.request import Request
from app.onboarding.whole import Whole, one_message, whole_robot
from app.robot.model import RobotModel
from app.robot.urdf import mesh_bytes
from app.system import whole_folder, write_whole

MEETING_SAMPLES = 6000  # [-] smallest number of random postures for the distances between hulls
_MAX_FITS = 3  # [-] largest number of fits of bodies; each fit uses other random postures
_URDF = "robot.urdf"  # name of the new URDF in the robot's folder
_LIGHT = "smaller for a light joint, so that steps of 1 ms are stable"
_DAMPING = f"chosen: as for the paper's robot, but {_LIGHT}"


class _Work(NamedTuple):
    """The workers of `finish`, and the functions that its parts call."""

    workers: Workers
    tell: Callable[[str], None]  # called with the name of each step
    on_progress: OnProgress  # called with the finished share of a long step
    border: Callable[[RobotModel], BorderData]  # samples or loads the border


def finish(
    request: Request,
    helpers: Callable[[], AbstractContextManager[Workers]] = lambda: nullcontext(ALONE),
    *,
    whole: Whole | None = None,
    tell: Callable[[str], None] = lambda _: None,
    processes: int | None = None,
    sampling: SamplingConfig | None = None,
    on_progress: OnProgress = lambda _: None,
) -> tuple[NewRobot, BorderData]:
    """Create a robot and its border, and write the complete folder or nothing.

    `helpers` starts the workers for all parallel work except the border; by default there are none.
    `processes` is the number of processes that sample the border (default: one for each usable
    core). `sampling` has parameters of a coarser border, which one process samples. `whole` is the
    result of `whole_robot`, if it is known. `tell` is called with the name of each step before it
    begins, `on_progress` with the finished share, 0 to 1, of a long step.

    Raises:
        RobotFileError: The zip or the URDF cannot become a robot, a library refuses it, or the name
            of the robot is invalid.
        AssetError, UnknownNameError: As for `whole_robot`.
        DescriptionError: The result is not a valid robot.
        OutputError: The folder exists and is not empty, or cannot be written.
    """
    request.name  # noqa: B018 - reports a wrong name before any work
    doing = ""

    def say(what: str) -> None:
        nonlocal doing
        doing = what
        tell(what)

    with whole_folder(request.out) as folder, one_message(lambda: doing):
        if request.zipped:
            say("unpacking the zip")
            path = open_package(locate(request.urdf), folder, request.file)
            name = f"{Path(request.urdf).name}: {path.relative_to((folder / FOLDER).resolve())}"
            request = replace(request, urdf=str(path), source=name)
        border = partial(
            load_border_data,
            sampling=sampling,
            processes=processes if sampling is None else 1,
            progress=False,
            on_progress=on_progress,
        )
        say("reading the URDF")
        whole = whole or whole_robot(request)
        size = mesh_bytes(whole.tree.links.values())
        try:
            parsed, urdf = within_budget(_read, request, whole, folder, size=size)
        except BudgetError as error:
            raise RobotFileError(f"{request.shown_source}: its meshes: {error}") from None
        with helpers() as workers:
            work = _Work(workers, say, on_progress, border)
            robot, data = _make_robot(request, parsed, urdf, folder, work)
            return _written(robot, data, folder, work), data


def _make_robot(
    request: Request, parsed: Parsed, urdf: str, folder: Path, work: _Work
) -> tuple[NewRobot, BorderData]:
    """Write the URDF; make the border and the robot, still without warnings and guiding lines."""
    path = folder / _URDF
    urdf, pieces = write.in_pieces_urdf(urdf, parsed.geometry, folder)
    parsed = replace(parsed, geometry=pieces)
    write_whole(path, urdf)
    bare = write.compiled(write.description(request, parsed), path)
    parsed = replace(parsed, limits=numbers.completed(parsed.limits, parsed.arm, bare))
    fitted = _embodied(request, parsed, bare, path, work)
    request, parsed, model = fitted.request, fitted.parsed, fitted.model
    counted = numbers.find_reach(model, work.workers)
    work.tell("sampling the border")
    data = work.border(model)
    work.tell("choosing the ready posture")
    if request.ready is None:
        ready, rule = find_ready(model, data.pairs, seed=request.seed), RULE
    else:
        ready, rule = judge_ready(model, data.pairs, np.array(request.ready, float)), "from --ready"
    q_m, b = ready.q_m, request.half_track
    base = numbers.base_numbers(model, parsed.wheels, parsed.inertias, q_m, b)
    arm = {
        "ready_position": (tuple(q_m.tolist()), rule),
        "joint_damping": (numbers.damping(parsed.limits, parsed.arm, model), _DAMPING),
    }
    unwatched = fitted.verdict.unwatched
    content = write.description(request, parsed, fitted.bodies, (base, arm), unwatched)
    work.tell("counting the reachability")
    near = {pair.b for pair in data.pairs.mobile}
    reach = {body: each for body, each in counted if body in near}
    content["reachability"] = {name: each.content() for name, each in reach.items()}
    model = write.compiled(content, path)
    held, fit = warn.holding_warning(warn.carried_ee(model)), vars(replace(fitted, model=model))
    return NewRobot(**fit, urdf=urdf, content=content, ready=ready, reach=reach, held=held), data


def _written(robot: NewRobot, data: BorderData, folder: Path, work: _Work) -> NewRobot:
    """Add warnings and guiding lines to a robot; write all files except URDF and meshes."""
    work.tell("searching lines for guiding")
    # An arm that cannot hold its end-effector avoids the base by itself: a fault is acceptable.
    anyway, names = bool(robot.held), SIDES if data.pairs.mobile else ()
    jobs = [(name, robot.model, data, anyway) for name in names]
    lines = work.workers.map(line_from, jobs, work.on_progress, tells=True)
    # Imported here: matplotlib would delay the start of the workers, which import this module.
    from app.onboarding.report import VIEW, draw, report_html

    pictures = work.workers.map(draw, [(robot, data)])  # in a worker that has finished its line
    found = dict(zip(names, lines, strict=True))
    places = {name: each for name, each in found.items() if isinstance(each, Place)}
    lacking = {name: each for name, each in found.items() if isinstance(each, str)}
    content = {name: place.content() for name, place in places.items()}
    content = robot.content | {"lines": content, "without_line": lacking}
    model = write.compiled(content, folder / _URDF)
    robot = replace(robot, content=content, model=model, places=places, lacking=lacking)
    push = push_row(model, data)
    weak = [push.text] if push.outcome == "warned" else []
    robot = replace(robot, warnings=[*weak, *warn.warnings_of(robot)])
    work.tell("writing the report")
    write.write_robot(robot, folder)
    drawn = next(pictures)
    write_whole(folder / "report.html", report_html(robot, data, drawn))
    write_whole(folder / VIEW, drawn.view)
    return robot


def _embodied(
    request: Request, parsed: Parsed, bare: RobotModel, path: Path, work: _Work
) -> Fitted:
    """Fit bodies around groups of links; while `Detection.fails`, fit again, at most twice.

    The result is the fit with the fewest pairs in `Detection.blind` and, among such fits, the
    smallest `Detection.undetected`. It has the joint limits of `with_stops` and, if `request.d_b`
    is None, the buffer distance of `watching_buffer`.

    A RobotFileError is raised if all fits have `blind` pairs, or as for the called functions.
    """
    work.tell("sampling random postures")
    geometry = filled(parsed.tree, parsed.geometry, parsed.arm.joints)
    units = make_units(bare, parsed.arm, geometry)
    found: list[Fitted] = []
    while not found or (found[-1].detection.fails and len(found) < _MAX_FITS):
        if found:
            work.tell("sampling other random postures")
        seed, d_b, workers = request.seed + len(found), request.buffer, work.workers
        meetings = sample_meetings(
            bare, units, samples=MEETING_SAMPLES, seed=seed, d_b=d_b, enough=ENOUGH, workers=workers
        )
        limits = with_stops(parsed.limits, bare, parsed.arm, meetings, request.ready)
        smaller, why = watching_buffer(limits, meetings, d_b)
        if why and request.d_b is None:
            request = replace(request, d_b=smaller)
            said = f"the buffer distance is {request.d_b:g} m, because {why} (--buffer-distance)"
            parsed = replace(parsed, changes=(*parsed.changes, said))
            continue
        work.tell("fitting bodies")
        count = _count(request, units, [len(each.bodies) for each in found])
        separate = [links for each in found for links in each.detection.unseen]
        grouping = find_grouping(bare, meetings, d_b, count, work.on_progress, separate)
        limited = replace(parsed, limits=limits)
        unwatched = grouping.verdict.unwatched
        content = write.description(request, limited, grouping.bodies, unwatched=unwatched)
        model = write.compiled(content, path)
        detection = detection_of(model, parsed.tree, geometry, d_b, workers)
        found.append(Fitted(request, limited, model, meetings, *grouping, detection))
    best = min(found, key=lambda each: (len(each.detection.blind), each.detection.undetected))
    if best.detection.blind:
        tried = sorted({len(each.bodies) - 1 for each in found})
        why = f"the bodies of {', '.join(best.detection.blind)} do not enclose their links"
        helps = f"choose a number of --bodies other than {' and '.join(map(str, tried))}"
        raise RobotFileError(f"{why}; {helps}, or a different --seed")
    return best


def _count(request: Request, units: Sequence[Unit], found: Sequence[int]) -> int | None:
    """The number of bodies of the arm for the next fit; None lets `find_grouping` choose it.

    Without --bodies, the third fit has one body more than the larger of the first two, if the arm
    has enough moving units with shapes. `found` has the number of bodies, with l_m, of each fit.
    """
    if request.bodies or len(found) < _MAX_FITS - 1:
        return request.bodies
    movable = sum(bool(unit.parts) for unit in units[2:])
    return max(max(found) - 1, min(max(found), movable))


def parse(request: Request, whole: Whole | None = None) -> Parsed:
    """Read and check the URDF; `whole` is the result of `whole_robot`, if it is known.

    Raises:
        RobotFileError: The URDF cannot become a robot; the message names the reason and a remedy.
        AssetError, UnknownNameError: As for `whole_robot`.
    """
    tree, arm, changes = whole or whole_robot(request)
    limits = numbers.read_limits(tree, arm)
    if request.ready is not None:
        if (count := len(request.ready)) != len(arm.joints):
            why = f"it has {count} numbers, but the arm has {len(arm.joints)} joints"
            raise RobotFileError(f"--ready: {why}: {', '.join(arm.names)}")
        ranges = zip(arm.names, request.ready, limits.lower, limits.upper, strict=True)
        for name, q, low, high in ranges:
            if not low <= q <= high:
                why = f"{name} at {q:g} is outside of its limits, {low:g} to {high:g}"
                raise RobotFileError(f"--ready: {why}")
    geometry = read_geometry(tree)
    if not any(geometry[name].shapes for part in arm.segments for name in part):
        why = f"no link between {arm.base!r} and {arm.tip!r} has a shape"
        helps = "add a <collision> or <visual> to the arm's links, or choose another --tip"
        raise RobotFileError(f"{why}; {helps}")
    if request.mount is None and stands_on_floor(tree, arm, geometry):
        arm = find_arm(tree, arm.base, arm.tip, arm.joints[0].child)
    arm = with_rigid_suspensions(tree, arm, geometry)
    wheels = find_drive(request, tree, arm, geometry)
    inertias = read_inertias(tree, arm, geometry, assume=request.assume_inertia)
    inertias = numbers.with_plausible_base(inertias, arm.base_links)
    return Parsed(tree, arm, geometry, wheels, inertias, limits, changes)


def _read(request: Request, whole: Whole, folder: Path) -> tuple[Parsed, str]:
    """Checked robot and text of its new URDF; each `is_foreign` mesh becomes an STL in `folder`."""
    parsed, source = parse(request, whole), request.shown_source
    header = f"Made by dbb new-robot from {source}; its sources and licences: SOURCES.md"
    return parsed, write.rebased_urdf(parsed, name=request.name, header=header, home=folder)
