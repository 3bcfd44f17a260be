"""`dbb new-robot`: a description, a border and a report from a URDF."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

import tyro

from app.cli.common import console, print_json
from app.cli.options import Json, PointOption, check_parameter, check_point, check_seed
from app.config import Config
from app.robot.assets import ASSETS, robot_names, user_robots
from app.robot.description import KINDS

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.onboarding.new_robot import NewRobot


def new_robot(
    urdf: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="URDF")],
    *,
    base: str,
    tip: str,
    out: Path,
    file: str | None = None,
    package: tuple[str, ...] = (),
    wheels: Annotated[tuple[str, str] | None, tyro.conf.arg(metavar="LEFT RIGHT")] = None,
    arm_urdf: str | None = None,
    mount_xyz: PointOption = None,
    mount_rpy: PointOption = None,
    mount: str | None = None,
    tip_xyz: PointOption = None,
    tip_rpy: PointOption = None,
    half_track: float | None = None,
    wheel_radius: float | None = None,
    kind: Annotated[str, tyro.conf.arg(metavar="{" + ",".join(KINDS) + "}")] = "differential",
    wheelbase: float | None = None,
    steering_limit: float | None = None,
    steering_rate: float | None = None,
    ready: Annotated[tuple[float, ...] | None, tyro.conf.arg(metavar="Q1 Q2 …")] = None,
    bodies: int | None = None,
    assume_inertia: bool = False,
    title: str | None = None,
    licence: str | None = None,
    buffer_distance: float = Config().border.d_b,
    seed: int = 0,
    json: Json = False,
) -> None:
    """Make a robot's description from its URDF or xacro, build its border and report on it.

    Finds the wheels, groups the arm's links into bodies, fits convex shapes to them, samples the
    pairs, chooses a ready pose, counts the reachability, and writes each number with its source.
    Nothing is written unless all of it is.

    Args:
        urdf: The file, package://PACKAGE/PATH for one of an installed package, or a zip with a URDF
            and its meshes, of which nothing is executed.
        base: Link that moves with the base, z up.
        tip: Link that carries the end-effector.
        out: Folder of the new description, such as robot_assets/NAME; its name is the robot's.
        file: Path of the URDF in a zip that holds several.
        package: Folders of ROS packages, NAME=FOLDER each, before those that are found: folders of
            that name from the URDF upwards, in ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, or installed.
        wheels: Joints (or links) of a left and a right driven wheel (default: found).
        arm_urdf: Another URDF with the arm, to be fixed to --base; --tip is in it then.
        mount_xyz: [m] where the root of --arm-urdf stands in --base (default: 0 0 0).
        mount_rpy: [rad] how it is turned there (default: 0 0 0).
        mount: Link at whose origin the arm stands (default: the one that carries its first joint).
        tip_xyz: [m] the end-effector's origin in --tip (default: 0 0 0).
        tip_rpy: [rad] how it is turned there; its z points out of the hand (default: 0 0 0).
        half_track: [m] effective half track of the base (default: measured between the wheels).
        wheel_radius: [m] of a base whose URDF has no wheels; needs --half-track too.
        kind: Of the base. A holonomic one needs no wheels; --wheels of a car-like one are the rear
            ones.
        wheelbase: [m] of a car-like base (default: measured to its steered wheels).
        steering_limit: [rad] of its steering to either side (default: the URDF's).
        steering_rate: [rad/s] how fast it steers (default: the URDF's, or 1.5).
        ready: [rad or m] the ready pose, one number a joint (default: chosen among random poses).
        bodies: How many bodies the arm gets (default: four, others where four do not do).
        assume_inertia: Take masses from volumes where the arm's URDF states none at all.
        title: What people read (default: the name).
        licence: Licences of the files that the URDF refers to.
        buffer_distance: [m] d_b that the bodies and the ready pose have to suit.
        seed: Of all random poses.
        json: Print one JSON object on standard output and nothing else there.
    """
    # Imported here: matplotlib, scipy and trimesh would make every other command start later.
    from app.onboarding.request import Request, check_request
    from app.onboarding.write.make import finish

    check_seed(seed)
    check_parameter("--buffer-distance", buffer_distance, "border.d_b")
    for option, point in (
        ("--mount-xyz", mount_xyz),
        ("--mount-rpy", mount_rpy),
        ("--tip-xyz", tip_xyz),
        ("--tip-rpy", tip_rpy),
    ):
        check_point(option, point)
    zero = (0.0, 0.0, 0.0)
    request = Request(
        urdf,
        base,
        tip,
        out,
        wheels=wheels,
        arm_urdf=arm_urdf,
        mount_xyz=mount_xyz or zero,
        mount_rpy=mount_rpy or zero,
        mount=mount,
        tip_xyz=tip_xyz or zero,
        tip_rpy=tip_rpy or zero,
        half_track=half_track,
        wheel_radius=wheel_radius,
        kind=kind,
        wheelbase=wheelbase,
        steering_limit=steering_limit,
        steering_rate=steering_rate,
        ready=ready,
        bodies=bodies,
        assume_inertia=assume_inertia,
        title=title,
        licence=licence,
        seed=seed,
        d_b=buffer_distance,
        file=file,
        package=package,
    )
    check_request(request)
    begin = perf_counter()
    steps = _Steps()
    robot, data = finish(request, tell=steps.say, on_progress=steps.share, progress=False)
    result = _figures(robot, data) | {"elapsed_s": perf_counter() - begin}
    if json:
        print_json(result)
        return
    print("\n".join(_lines(robot, data)))


class _Steps:
    """Says what is being done, and every few seconds how far it is, on a terminal and off it."""

    def __init__(self) -> None:
        self._text, self._last = "", perf_counter()

    def say(self, text: str) -> None:
        """A new step."""
        self._text, self._last = text, perf_counter()
        console.print(f"… {text}")

    def share(self, share: float) -> None:
        """Which share of the step is done, 0 to 1."""
        if perf_counter() - self._last > _EVERY:
            self._last = perf_counter()
            console.print(f"… {self._text}: {share:.0%}")


def _lines(robot: NewRobot, data: BorderData) -> list[str]:
    """What people read of the new robot, and what they may do next."""
    folder, name = robot.request.out, robot.request.name
    lines = [f"{name}: {folder}/robot.toml, robot.urdf, report.html"]
    for body in robot.bodies:
        over = max(fit.over_cover for fit in body.fits)
        shapes = ", ".join(fit.shape.type for fit in body.fits)
        lines.append(
            f"  body {body.name}: {shapes} around {', '.join(body.links)}; {over:.2f} times the "
            "volume of what it holds"
        )
    lines.append(f"  pairs: {', '.join(pair.name for pair in data.pairs.all) or 'none'}")
    for body, reach in robot.reach.items():
        how = "assumed" if reach.fit is None else f"counted, R² {reach.fit.r_squared:.2f}"
        lines.append(
            f"  reachability of {body}: A = {reach.A:.1f} 1/m², B = {reach.B:.3f} m, "
            f"C = {reach.C:.1f}; {how}"
        )
    for line, place in robot.places.items():
        start, move = (", ".join(f"{x:g}" for x in p) for p in (place.start, place.move))
        lines.append(f"  {line}: from ({start}) m by ({move}) m")
    lines += [f"  warning: {warning}" for warning in robot.warnings]
    known = "" if name in robot_names() else f"; it has to lie in {ASSETS} or {user_robots()}"
    return [*lines, f"  next: dbb check-robot {name}, then dbb serve --robot {name}{known}"]


_EVERY = 5.0  # [s] between two lines of one step
_GEOMETRY = ("wheel_radius_m", "half_track_m", "wheelbase_m", "steering_limit_rad")


def _figures(robot: NewRobot, data: BorderData) -> dict[str, Any]:
    base = robot.content["base"]
    return {
        "robot": robot.request.name,
        "folder": str(robot.request.out),
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
        "missed_collisions": robot.verdict.missed,
        "false_collisions": robot.verdict.false,
        "reachability": {
            name: {"A_per_m2": r.A, "B_m": r.B, "C": r.C, "counted": r.counted is not None}
            for name, r in robot.reach.items()
        },
        "ready_position": robot.ready.q_m.tolist(),
        "ready_clearance_m": robot.ready.clearance if data.pairs.all else None,
        "lines": {name: list(place.start) for name, place in robot.places.items()},
        "border_points": {name: len(cloud) for name, cloud in data.clouds.items()},
        "warnings": robot.warnings,
    }
