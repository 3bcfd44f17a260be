"""The input of `dbb new-robot`, and its checks before any file is read."""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from os.path import isfile  # False also for a name that is too long for a file
from pathlib import Path
from typing import NamedTuple

from app.config import Config, parameter
from app.errors import ConfigError, RobotFileError, check_name
from app.robot.assets import robot_folder
from app.strict import MAX_SEEDS, Vector3, check_range
from app.system import home_expanded

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")  # pattern of a robot's name


@dataclass(frozen=True)
class Request:
    """Input for a new robot; the program determines a number, a mount or wheels that are None."""

    urdf: str
    """A URDF or xacro file, package://PACKAGE/PATH for a file of an installed package, or a zip
    with a URDF and its meshes; nothing in a zip is executed."""
    base: str
    """Link that moves with the base; its z axis points up."""
    tip: str
    """Link that carries the end-effector."""
    out: Path
    """Folder of the new description, such as robot_assets/NAME; NAME becomes the robot's name."""
    wheels: tuple[str, str] | None = None
    """Joints (or links) of a left and a right driven wheel; for a car-like base, of the rear
    wheels. Default: detected in the URDF."""
    arm_urdf: str | None = None
    """A separate URDF of the arm, which is fixed to --base; --tip is then a link of the arm."""
    mount_xyz: Vector3 = (0.0, 0.0, 0.0)
    """[m] position of the root link of --arm-urdf in the frame of --base."""
    mount_rpy: Vector3 = (0.0, 0.0, 0.0)
    """[rad] rotation of the root link of --arm-urdf in the frame of --base."""
    mount: str | None = None
    """Link whose origin is the arm's mounting point; default: the parent link of the arm's first
    joint, or the joint's child link if the parent is --base or stands on the floor."""
    tip_xyz: Vector3 = (0.0, 0.0, 0.0)
    """[m] position of the end-effector's frame in the frame of --tip."""
    tip_rpy: Vector3 = (0.0, 0.0, 0.0)
    """[rad] rotation of the end-effector's frame in the frame of --tip. The z axis of the
    end-effector's frame must point out of the gripper."""
    half_track: float | None = None
    """[m] effective half track of the base; default: half of the distance between the
    wheels. Only for a differential base."""
    wheel_radius: float | None = None
    """[m] wheel radius of a URDF without wheels; needs --half-track, and excludes --wheels."""
    kind: str = "differential"
    """Kind of the base: differential, holonomic or car-like; a holonomic base needs no wheels."""
    wheelbase: float | None = None
    """[m] wheelbase of a car-like base; default: measured from the rear to the steered wheels."""
    steering_limit: float | None = None
    """[rad] steering limit to either side; default: from the URDF."""
    steering_rate: float | None = None
    """[rad/s] steering rate; default: from the URDF, or 1.5."""
    ready: tuple[float, ...] | None = None
    """(n_m,) [rad or m] the ready posture; default: the best of random postures."""
    bodies: int | None = None
    """Number of bodies of the arm; default: four or, if four bodies are not sufficient, another
    number from two to seven."""
    assume_inertia: bool = False
    """Accept an arm without any mass in the URDF, and compute it from volumes."""
    title: str | None = None
    """Displayed title of the robot; default: its name."""
    licence: str | None = None
    """Licences of the files that the URDF refers to."""
    seed: int = 0
    """Seed of the random postures for the bodies and the ready posture."""
    d_b: float | None = None
    """[m] buffer distance d_b of this robot; the bodies and the ready posture depend on it.
    Default: 0.15. It is smaller if a link of the arm is nearer than 0.15 m to the base in most
    postures, and no joint limit prevents their contact."""
    file: str | None = None
    """Path of the URDF within the zip, if the zip contains several URDFs."""
    source: str | None = None
    """Displayed source of the robot; default: the value of `urdf`."""
    package: tuple[str, ...] = ()
    """Folders of ROS packages, as NAME=FOLDER. The program looks for other packages in the URDF's
    folder and its parents, in ROS_PACKAGE_PATH and AMENT_PREFIX_PATH, and in this Python
    environment."""
    xacro: tuple[str, ...] = ()
    """Arguments of a xacro file, as NAME=VALUE or NAME:=VALUE, such as ur_type=ur20."""

    @property
    def zipped(self) -> bool:
        """Whether the robot is in a zip."""
        return self.urdf.lower().endswith(".zip")

    @property
    def buffer(self) -> float:
        """[m] the buffer distance: `d_b`, or the paper's value if `d_b` is None."""
        return Config().border.d_b if self.d_b is None else self.d_b

    @property
    def shown_source(self) -> str:
        """The displayed source of the robot: `source`, or `urdf` if `source` is None."""
        return self.source or self.urdf

    @property
    def name(self) -> str:
        """The robot's name: the name of the folder `out`; a `RobotFileError` if it is invalid."""
        name = self.out.resolve().name
        if not NAME.fullmatch(name):
            why = f"the folder's name {name!r} becomes the robot's name"
            raise RobotFileError(f"--out: {why}: use a letter, then letters, digits and _")
        return name


class Bounds(NamedTuple):
    """Bounds of an optional number of a request, in the unit `unit`."""

    low: float
    high: float
    unit: str = ""
    kind: str = ""
    """The only kind of base with this option; empty for all kinds."""


BOUNDS = {
    "half_track": Bounds(0.02, 3.0, "m", "differential"),
    "wheel_radius": Bounds(0.01, 1.0, "m", "differential"),
    "wheelbase": Bounds(0.05, 10.0, "m", "car-like"),
    "steering_limit": Bounds(0.02, 1.5, "rad", "car-like"),
    "steering_rate": Bounds(0.01, 20.0, "rad/s", "car-like"),
    "bodies": Bounds(1, 8),
}
"""Bounds by the field of `Request`."""
_FARTHEST = 10.0  # [m] or [rad] largest coordinate of a position or rotation


def option(field: str) -> str:
    """The option of `dbb new-robot` for any field of `Request` but `urdf`, `d_b` and `source`."""
    return "--" + field.replace("_", "-")


def check_request(request: Request) -> None:
    """Refuse a request with a wrong option, before any file is read.

    Raises:
        UnknownNameError: The kind of base does not exist.
        ConfigError: A number is out of bounds, an option contradicts another one or the kind of the
            base, a package has no folder, an entry is not of the form NAME=…, or a robot of this
            name exists in another folder.
        RobotFileError: The folder's name is not a valid name of a robot.
    """
    used = robot_folder(request.name)
    if isfile(used / "robot.toml") and used.resolve() != request.out.resolve():
        why = f"the robot {request.name!r} exists in {used}"
        raise ConfigError(f"--out: {why}; choose another name")
    known = parameter("border.d_b")
    check_range("--buffer-distance", request.buffer, known.low, known.high, known.unit)
    check_range("--seed", request.seed, 0, MAX_SEEDS)
    for field in ("mount_xyz", "mount_rpy", "tip_xyz", "tip_rpy"):
        coordinates = getattr(request, field)
        for coordinate in coordinates:
            unit = "radians" if field.endswith("rpy") else "m"
            check_range(option(field), coordinate, -_FARTHEST, _FARTHEST, unit)
        if request.arm_urdf is None and field.startswith("mount") and any(coordinates):
            helps = f"add --arm-urdf, or remove {option(field)}"
            why = "in a single URDF a joint places the arm"
            raise ConfigError(f"{option(field)}: places an arm with its own URDF; {helps}: {why}")
    # Imported here: coal and pinocchio would delay the start of `dbb --help`.
    from app.robot.description import KINDS

    kind = request.kind
    check_name("kind of base", kind, KINDS)
    for field, bounds in BOUNDS.items():
        if (value := getattr(request, field)) is None:
            continue
        check_range(option(field), value, *bounds[:3])
        if bounds.kind not in ("", kind):
            helps = f"remove the option, or set --kind {bounds.kind}"
            raise ConfigError(f"{option(field)}: a {kind} base does not have this; {helps}")
    if request.file is not None and not request.zipped:
        raise ConfigError("--file: names a URDF in a zip; name a zip, or remove the option")
    package_folders(request.package)
    named("--xacro", request.xacro, "VALUE")
    if kind == "holonomic" and request.wheels is not None:
        raise ConfigError("--wheels: a holonomic base's description has no wheels; remove it")
    complete = request.half_track is not None and request.wheels is None
    if request.wheel_radius is not None and not complete:
        raise ConfigError("--wheel-radius: needs --half-track, and excludes --wheels")


def package_folders(entries: Sequence[str]) -> dict[str, Path]:
    """The absolute folders of packages by their names, from entries of the form `NAME=FOLDER`. An
    entry of another form, or with a folder that does not exist, raises a ConfigError.
    """
    entered = named("--package", entries, "FOLDER")
    folders = {name: home_expanded(folder) for name, folder in entered.items()}
    if lost := [folder for folder in folders.values() if not folder.is_dir()]:
        raise ConfigError(f"--package: there is no folder {lost[0]}")
    return {name: folder.resolve() for name, folder in folders.items()}


def named(option: str, entries: Sequence[str], what: str) -> dict[str, str]:
    """Values by name, from an option's entries `NAME=…` or, as in ROS, `NAME:=…`. An entry of
    another form raises a `ConfigError` whose message calls the value `what`.
    """
    found = {}
    for each in entries:
        name, _, value = each.partition("=")
        name = name.removesuffix(":")
        if not (name and value):
            raise ConfigError(f"{option}: {each!r} is not of the form NAME={what}")
        found[name] = value
    return found
