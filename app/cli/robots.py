"""`dbb robots`, `new-robot`, `check-robot`: list all robots, make a new robot, check a robot."""

from __future__ import annotations

import os
import sys
from contextlib import ExitStack
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from app.cli import options
from app.cli.common import print_json, say, show
from app.cli.options import Flag, Given, Json, from_record
from app.errors import DbbError
from app.jobs.progress import OnProgress, progress_bar
from app.onboarding import helpers
from app.onboarding.request import Request, check_request
from app.simulation.trace.words import number_text

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.onboarding.record import NewRobot

_NAMES = {"d_b": "buffer_distance"}
_GEOMETRY = ("wheel_radius_m", "half_track_m", "wheelbase_m", "steering_limit_rad")
_MARKS = {"passed": "✓", "warned": "!", "failed": "✗", "nothing to show": "-"}


def robots(json: Json = False) -> None:
    """List all robots, with the errors of invalid descriptions."""
    from app.robot.assets import hidden_robot, robot_names, wrong_folders
    from app.robot.description import load_robot

    if wrong := wrong_folders():
        say(wrong)
    rows, broken = [], {}
    for name in robot_names():
        if hidden := hidden_robot(name):
            say(hidden)
        try:
            d = load_robot(name)
        except DbbError as error:
            broken[name] = str(error)
            continue
        row = {"name": d.name, "title": d.title, "base": d.base.kind}
        row |= {"arm_joints": len(d.arm.joints), "bodies": [body.name for body in d.bodies]}
        rows.append(row)
    if json:
        print_json({"robots": rows, "broken": broken})
        return
    for row in rows:
        base, joints = f"{row['base']} base", f"arm of {row['arm_joints']} joints"
        show(f"{row['name']:20} {row['title']}: {base}, {joints}")
    for name, problem in broken.items():
        show(f"{name:20} cannot be used: {problem}")


def check_robot(
    name: Annotated[options.Robot, tyro.conf.Positional, tyro.conf.arg(metavar="NAME")],
    parameters: Annotated[Given, options.parameter_options({"buffer_distance": "border.d_b"})],
    *,
    runs: Annotated[bool, tyro.conf.arg(help_behavior_hint="(default: yes)")] = True,
    quick: Flag = False,
    json: Json = False,
) -> None:
    """Check a robot against its URDF, meshes and physics engines.

    The command compares pinocchio's results with those of pybullet and MuJoCo, and the bodies with
    the meshes. It checks limits, pairs, border and guiding runs, and prints warnings. The exit
    status is 0 if no check fails, otherwise 1.

    Args:
        runs: Simulate the guiding runs: a person pulls the end-effector towards the base. They take
            most of the time.
        quick: Sample a coarse border in seconds, as `dbb new-robot --quick` does, instead of the
            complete border.
    """
    from app.border.sampling import QUICK
    from app.robot.description import load_robot

    config = options.configured(name, None, parameters)
    description = load_robot(name).model_copy(update={"config": config})
    from app.onboarding import check

    coarse: dict[str, Any] = {"sampling": QUICK, "processes": 1} if quick else {}
    rows = []
    for row in check.check_robot(description, runs=runs, tell=say, **coarse):
        rows.append(row._asdict())
        if not json:  # at once, so that an interrupted check has shown its results
            show(f"{_MARKS[row.outcome]} {row.name:16} {row.outcome}: {row.text}")
            sys.stdout.flush()
    failed = any(row["outcome"] == "failed" for row in rows)
    if json:
        print_json({"robot": name, "passed": not failed, "checks": rows})
    if failed:
        sys.exit(1)


def new_robot(
    request: Annotated[
        Given, from_record(Request, leave=("source",), names=_NAMES, positional="urdf")
    ],
    quick: Flag = False,
    json: Json = False,
) -> None:
    """Make a robot's description and border from its URDF or xacro.

    The command finds the wheels, groups the arm's links into bodies, fits convex shapes to them,
    samples the pairs, chooses a ready posture, computes the reachability, and writes each number
    with its source. It writes all files or none.

    Args:
        quick: Sample a coarse border in seconds. The first `dbb serve` uses this border, and
            refines it in the background for the next start. Other commands that need a border
            start by sampling the full one, in minutes; `dbb check-robot --quick` does not.
    """
    asked = Request(**request)
    check_request(asked)
    from app.onboarding.whole import whole_robot

    begin = perf_counter()
    whole = None if asked.zipped else whole_robot(asked)  # refuses a wrong file before slow imports
    from app.border.sampling import QUICK
    from app.onboarding.new_robot import finish

    sampling = QUICK if quick else None
    with ExitStack() as step:
        bar: OnProgress = lambda _: None  # noqa: E731

        def tell(text: str) -> None:
            nonlocal bar
            step.close()
            say(text)
            bar = step.enter_context(progress_bar(text, 1.0))

        robot, data = finish(
            asked, helpers, whole=whole, tell=tell, sampling=sampling, on_progress=lambda x: bar(x)
        )
    result = _figures(robot, data) | {"elapsed_s": perf_counter() - begin}
    print_json(result) if json else _print_made(result)


def _print_made(made: dict[str, Any]) -> None:
    from app.robot.assets import robot_folder

    name, folder = made["robot"], made["folder"]
    show(f"{name}: {folder}/robot.toml and {folder}/report.html, in {made['elapsed_s']:.0f} s")
    geometry = (f"{key} {number_text(made[key])}" for key in _GEOMETRY if key in made)
    base = f"{made['base']}, {made['mass_kg']:.4g} kg"
    show(f"  base          {', '.join([base, *geometry])}")
    bodies = (f"{body} ({', '.join(each['links'])})" for body, each in made["bodies"].items())
    show(f"  arm           {made['arm_joints']} joints; {', '.join(bodies)}")
    rates = made["collision_rate"]
    pairs = (f"{pair} ({rates[pair]:.1%} of all postures)" for pair in made["pairs"])
    show(f"  can collide   {', '.join(pairs) or 'no pair'}")
    reach = (
        f"{body} A {each['A_per_m2']:.4g} /m², B {each['B_m']:.3g} m, C {each['C']:.3g}"
        + ("" if each.get("r_squared") is None else f" (R² {each['r_squared']:.2f})")
        for body, each in made["reachability"].items()
    )
    show(f"  reachability  {'; '.join(reach)}")
    for warning in made["warnings"]:
        show(f"  warning: {warning}")
    print("next:")
    if robot_folder(name).resolve() != Path(folder).resolve():
        own = f"$DBB_ROBOTS{os.pathsep}{Path(folder).resolve().parent}"
        show(f"  export DBB_ROBOTS={own}   so that dbb finds it")
    show(f"  open {folder}/report.html, and check that the bodies enclose the links")
    show(f"  dbb check-robot {name}")
    show(f"  dbb serve --robot {name}")


def _figures(robot: NewRobot, data: BorderData) -> dict[str, Any]:
    base = robot.content["base"]
    return {
        "robot": robot.request.name,
        "folder": str(robot.request.out),
        "buffer_distance_m": robot.request.buffer,
        "arm_joints": len(robot.parsed.arm.joints),
        "base": base["kind"],
        **{key: base[key] for key in _GEOMETRY if key in base},
        "mass_kg": base["mass_kg"],
        "bodies": {
            body.name: {
                "links": list(body.links),
                "shapes": [fit.shape.type for fit in body.fits],
                "over_cover": [fit.over_cover for fit in body.fits],
                "protrusion_m": max(fit.protrusion for fit in body.fits),
            }
            for body in robot.bodies
        },
        "pairs": [pair.name for pair in data.pairs.all],
        "collision_rate": data.pairs.rates,
        "least_distance_m": data.pairs.least_distance_m,
        "missed_collisions": robot.detection.share,
        "false_collisions": robot.verdict.false,
        "reachability": {
            name: {
                "A_per_m2": r.A,
                "B_m": r.B,
                "C": r.C,
                "counted": r.counted is not None,
                "r_squared": None if r.fit is None else r.fit.r_squared,
            }
            for name, r in robot.reach.items()
        },
        "ready_position": robot.ready.q_m.tolist(),
        "ready_clearance_m": robot.ready.beyond_buffer if data.pairs.all else None,
        "lines": {name: list(place.start) for name, place in robot.places.items()},
        "border_points": {name: len(cloud) for name, cloud in data.clouds.items()},
        "warnings": robot.warnings,
    }
