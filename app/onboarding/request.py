"""What is asked of `dbb new-robot`, and whether it goes together before anything is read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from app.config import Config, parameter
from app.errors import ConfigError, RobotFileError, UnknownNameError
from app.strict import MOST_SEEDS, Vector3, check_range

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""What a robot's name matches as a whole."""


@dataclass(frozen=True)
class Request:
    """A robot to be made; without a number or a name, it is found."""

    urdf: str
    """The URDF or xacro, package://PACKAGE/PATH for one of an installed package, or a zip with a
    URDF and its meshes, of which nothing is executed."""
    base: str
    """Link that moves with the base, z up."""
    tip: str
    """Link that carries the end-effector."""
    out: Path
    """Folder of the new description, such as robot_assets/NAME; its name is the robot's."""
    wheels: tuple[str, str] | None = None
    """Joints (or links) of a left and a right driven wheel, of a car-like base the rear ones; by
    default found."""
    arm_urdf: str | None = None
    """Another URDF with the arm, to be fixed to --base; --tip is in it then."""
    mount_xyz: Vector3 = (0.0, 0.0, 0.0)
    """[m] where the root of --arm-urdf stands in --base."""
    mount_rpy: Vector3 = (0.0, 0.0, 0.0)
    """[rad] how it is turned there."""
    mount: str | None = None
    """Link at whose origin the arm stands; by default the one that carries its first joint."""
    tip_xyz: Vector3 = (0.0, 0.0, 0.0)
    """[m] the end-effector's origin in --tip."""
    tip_rpy: Vector3 = (0.0, 0.0, 0.0)
    """[rad] how it is turned there; its z points out of the hand."""
    half_track: float | None = None
    """[m] effective half track of the base; by default measured between the wheels."""
    wheel_radius: float | None = None
    """[m] of a base whose URDF has no wheels; needs --half-track too."""
    kind: str = "differential"
    """Of the base: differential, holonomic (which needs no wheels) or car-like."""
    wheelbase: float | None = None
    """[m] of a car-like base; by default measured to its steered wheels."""
    steering_limit: float | None = None
    """[rad] of its steering to either side; by default the URDF's."""
    steering_rate: float | None = None
    """[rad/s] how fast it steers; by default the URDF's, or 1.5."""
    ready: tuple[float, ...] | None = None
    """(n_m,) [rad or m] the ready pose; by default chosen among random poses."""
    bodies: int | None = None
    """How many bodies the arm gets; by default four, others where four do not do."""
    assume_inertia: bool = False
    """Take masses from volumes where the arm's URDF states none at all."""
    title: str | None = None
    """What people read; by default the name."""
    licence: str | None = None
    """Licences of the files that the URDF refers to."""
    seed: int = 0
    """Of all random poses."""
    d_b: float = Config().border.d_b
    """[m] d_b of this robot, which its bodies and ready pose have to suit."""
    file: str | None = None
    """Path of the URDF in a zip that holds several."""
    source: str | None = None
    """What people read as the robot's source where it is not `urdf`, or None."""
    package: tuple[str, ...] = ()
    """Folders of ROS packages, NAME=FOLDER each, before those that are found: folders of that name
    from the URDF upwards, in ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, or installed."""
    xacro: tuple[str, ...] = ()
    """Arguments of a xacro, NAME=VALUE each, such as ur_type=ur20."""

    @property
    def told(self) -> str:
        """What people read as the robot's source: the URDF, or the zip that it came in."""
        return self.source or self.urdf

    @property
    def name(self) -> str:
        """The robot's name.

        Raises:
            RobotFileError: The folder's name cannot be one.
        """
        name = self.out.resolve().name
        if not NAME.fullmatch(name):
            raise RobotFileError(
                f"--out: the folder's name {name!r} becomes the robot's: letters, digits and _ only"
            )
        return name


class Bounds(NamedTuple):
    """Of a number that may be given, in its unit, and the one kind of base that has it, if any."""

    low: float
    high: float
    unit: str = ""
    kind: str = ""


BOUNDS = {
    "half_track": Bounds(0.02, 3.0, "m", "differential"),
    "wheel_radius": Bounds(0.01, 1.0, "m", "differential"),
    "wheelbase": Bounds(0.05, 10.0, "m", "car-like"),
    "steering_limit": Bounds(0.02, 1.5, "rad", "car-like"),
    "steering_rate": Bounds(0.01, 20.0, "rad/s", "car-like"),
    "bodies": Bounds(1, 8),
}
"""By the field of `Request`."""
_FARTHEST = 10.0  # [m] or [rad] of a place or a turn; more is a slip of the keys


def option(field: str) -> str:
    """The option of `dbb new-robot` that sets a field of `Request`."""
    return "--" + field.replace("_", "-")


def check_request(request: Request) -> None:
    """Refuse numbers out of bounds, those of another kind of base, and packages without a folder.

    Raises:
        UnknownNameError: There is no such kind of base.
        ConfigError: Names the option and what would be right.
    """
    known = parameter("border.d_b")
    check_range("--buffer-distance", request.d_b, known.low, known.high, known.unit)
    check_range("--seed", request.seed, 0, MOST_SEEDS)
    for field in ("mount_xyz", "mount_rpy", "tip_xyz", "tip_rpy"):
        for coordinate in getattr(request, field):
            check_range(option(field), coordinate, -_FARTHEST, _FARTHEST)
    for field in ("mount_xyz", "mount_rpy"):
        if request.arm_urdf is None and any(getattr(request, field)):
            raise ConfigError(
                f"{option(field)}: is for an arm of a file of its own; give --arm-urdf, or leave "
                "it out: in one URDF the joint of the arm's mount says where it stands"
            )
    # Imported here: coal and pinocchio would make `dbb --help` start later.
    from app.robot.description import KINDS

    kind = request.kind
    if kind not in KINDS:
        raise UnknownNameError("kind of base", kind, KINDS)
    for field, bounds in BOUNDS.items():
        value = getattr(request, field)
        if value is None:
            continue
        check_range(option(field), value, *bounds[:3])
        if bounds.kind not in ("", kind):
            raise ConfigError(
                f"{option(field)}: a {kind} base has none; leave it out, or give "
                f"--kind {bounds.kind}"
            )
    package_folders(request.package)
    named("--xacro", request.xacro, "VALUE")
    if kind == "holonomic" and request.wheels is not None:
        raise ConfigError("--wheels: a holonomic base is described without them; leave them out")
    if request.wheel_radius is not None and (
        request.half_track is None or request.wheels is not None
    ):
        raise ConfigError("--wheel-radius: needs --half-track, and no --wheels")


def package_folders(given: Sequence[str]) -> dict[str, Path]:
    """The folders of packages by their names, from `NAME=FOLDER` each.

    Raises:
        ConfigError: One is of another form, or is no folder.
    """
    folders = named("--package", given, "FOLDER")
    if lost := [folder for folder in folders.values() if not Path(folder).is_dir()]:
        raise ConfigError(f"--package: there is no folder {lost[0]}")
    return {name: Path(folder).resolve() for name, folder in folders.items()}


def named(option: str, given: Sequence[str], what: str) -> dict[str, str]:
    """What an option gives by name, from `NAME=…` each.

    Raises:
        ConfigError: One is of another form.
    """
    found = {}
    for each in given:
        name, _, value = each.partition("=")
        if not (name and value):
            raise ConfigError(f"{option}: {each!r} is not of the form NAME={what}")
        found[name] = value
    return found
