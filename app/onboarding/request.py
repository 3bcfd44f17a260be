"""The input of `dbb new-robot`, with checks before anything is read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from app.config import Config, parameter
from app.errors import ConfigError, RobotFileError, UnknownNameError
from app.strict import MAX_SEEDS, Vector3, check_range

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""Pattern of a robot's name."""


@dataclass(frozen=True)
class Request:
    """A robot to make; missing numbers and names are determined automatically."""

    urdf: str
    """The URDF or xacro, package://PACKAGE/PATH for one of an installed package, or a zip with a
    URDF and its meshes; nothing in a zip is executed."""
    base: str
    """Link that moves with the base, z up."""
    tip: str
    """Link that carries the end-effector."""
    out: Path
    """Folder of the new description, such as robot_assets/NAME; its name is the robot's."""
    wheels: tuple[str, str] | None = None
    """Joints (or links) of a left and a right driven wheel, for a car-like base the rear ones;
    default: found automatically."""
    arm_urdf: str | None = None
    """Another URDF with the arm, to be fixed to --base; --tip is then a link of it."""
    mount_xyz: Vector3 = (0.0, 0.0, 0.0)
    """[m] position of the root of --arm-urdf in --base."""
    mount_rpy: Vector3 = (0.0, 0.0, 0.0)
    """[rad] its rotation there."""
    mount: str | None = None
    """Link at whose origin the arm starts; default: the parent of its first joint."""
    tip_xyz: Vector3 = (0.0, 0.0, 0.0)
    """[m] the end-effector's origin in --tip."""
    tip_rpy: Vector3 = (0.0, 0.0, 0.0)
    """[rad] its rotation there; its z points out of the gripper."""
    half_track: float | None = None
    """[m] effective half track of the base; default: measured between the wheels."""
    wheel_radius: float | None = None
    """[m] wheel radius of a base whose URDF has no wheels; needs --half-track too."""
    kind: str = "differential"
    """Kind of the base: differential, holonomic (which needs no wheels) or car-like."""
    wheelbase: float | None = None
    """[m] wheelbase of a car-like base; default: measured to its steered wheels."""
    steering_limit: float | None = None
    """[rad] steering limit to either side; default: the URDF's."""
    steering_rate: float | None = None
    """[rad/s] steering rate; default: the URDF's, or 1.5."""
    ready: tuple[float, ...] | None = None
    """(n_m,) [rad or m] ready pose; default: chosen among random poses."""
    bodies: int | None = None
    """Number of bodies of the arm; default: four, or another number if four do not suffice."""
    assume_inertia: bool = False
    """Compute masses from volumes if the arm's URDF states none at all."""
    title: str | None = None
    """Title of the robot; default: its name."""
    licence: str | None = None
    """Licences of the files that the URDF refers to."""
    seed: int = 0
    """Seed of all random poses."""
    d_b: float = Config().border.d_b
    """[m] d_b of this robot, which determines its bodies and ready pose."""
    file: str | None = None
    """Path of the URDF in a zip with several."""
    source: str | None = None
    """Displayed source of the robot if it is not `urdf`, or None."""
    package: tuple[str, ...] = ()
    """Folders of ROS packages, as NAME=FOLDER. Without them, packages are folders of that name
    upwards from the URDF, in ROS_PACKAGE_PATH or AMENT_PREFIX_PATH, or installed."""
    xacro: tuple[str, ...] = ()
    """Arguments of a xacro, as NAME=VALUE, such as ur_type=ur20."""

    @property
    def told(self) -> str:
        """The displayed source of the robot: the URDF, or the zip that contains it."""
        return self.source or self.urdf

    @property
    def name(self) -> str:
        """The robot's name.

        Raises:
            RobotFileError: The folder's name is not a valid name.
        """
        name = self.out.resolve().name
        if not NAME.fullmatch(name):
            raise RobotFileError(
                f"--out: the folder's name {name!r} becomes the robot's: letters, digits and _ only"
            )
        return name


class Bounds(NamedTuple):
    """Bounds of an optional number, in its unit, and the only kind of base that has it, if any."""

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
"""Bounds by the field of `Request`."""
_FARTHEST = 10.0  # [m] or [rad] largest place or rotation; more is a typing error


def option(field: str) -> str:
    """The option of `dbb new-robot` that sets a field of `Request`."""
    return "--" + field.replace("_", "-")


def check_request(request: Request) -> None:
    """Refuse numbers out of bounds, those of another kind of base, and packages without a folder.

    Raises:
        UnknownNameError: The kind of base does not exist.
        ConfigError: Names the option and the valid range.
    """
    known = parameter("border.d_b")
    check_range("--buffer-distance", request.d_b, known.low, known.high, known.unit)
    check_range("--seed", request.seed, 0, MAX_SEEDS)
    for field in ("mount_xyz", "mount_rpy", "tip_xyz", "tip_rpy"):
        for coordinate in getattr(request, field):
            check_range(option(field), coordinate, -_FARTHEST, _FARTHEST)
    for field in ("mount_xyz", "mount_rpy"):
        if request.arm_urdf is None and any(getattr(request, field)):
            raise ConfigError(
                f"{option(field)}: is for an arm in its own file; give --arm-urdf, or leave "
                "it out: in one URDF the joint of the arm's mount has its place"
            )
    # Imported here: coal and pinocchio would delay the start of `dbb --help`.
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
    """The folders of packages by their names, from `NAME=FOLDER`.

    Raises:
        ConfigError: One has another form, or is not a folder.
    """
    folders = named("--package", given, "FOLDER")
    if lost := [folder for folder in folders.values() if not Path(folder).is_dir()]:
        raise ConfigError(f"--package: there is no folder {lost[0]}")
    return {name: Path(folder).resolve() for name, folder in folders.items()}


def named(option: str, given: Sequence[str], what: str) -> dict[str, str]:
    """The values of an option by name, from `NAME=…`.

    Raises:
        ConfigError: One has another form.
    """
    found = {}
    for each in given:
        name, _, value = each.partition("=")
        if not (name and value):
            raise ConfigError(f"{option}: {each!r} is not of the form NAME={what}")
        found[name] = value
    return found
