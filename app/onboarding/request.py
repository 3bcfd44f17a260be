"""What is asked of `dbb new-robot`, and whether it goes together before anything is read."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from app.config import Config
from app.errors import ConfigError, RobotFileError, UnknownNameError
from app.robot.description import KINDS
from app.strict import check_range

NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*")
"""What a robot's name matches as a whole."""


@dataclass(frozen=True)
class Request:
    """A robot to be made.

    Attributes:
        urdf: Path or `package://…` address of its URDF or xacro, or of a zip with it.
        file: The URDF's path in a zip, or None if it is the only one there.
        base: Link that moves with the base.
        tip: Link that carries the end-effector.
        out: Folder of the new description; its name is the robot's.
        wheels: Joints of a left and a right wheel, or None to find them.
        arm_urdf: Another file with the arm, to be put on the base, or None.
        mount_xyz: (3,) [m] where the arm's root stands in the base's link.
        mount_rpy: (3,) [rad] how it is turned there.
        mount: Link at whose origin the arm stands, or None for the one with its first joint.
        tip_xyz: (3,) [m] the end-effector in the tip's frame.
        tip_rpy: (3,) [rad] how it is turned there; z points out of the hand.
        half_track: [m] b, or None to measure it between the wheels.
        wheel_radius: [m] r of a base whose URDF has no wheels, with its half track; else None.
        kind: Of the base: differential, holonomic or car-like.
        wheelbase: [m] of a car-like base, or None to measure it.
        steering_limit: [rad] of its steering, or None for the URDF's.
        steering_rate: [rad/s] of it, or None for the URDF's.
        ready: (n_m,) [rad or m] the ready pose, or None to choose one.
        bodies: How many bodies the arm gets, or None for the best number.
        assume_inertia: Whether an arm without masses gets assumed ones.
        title, licence: As the description has them, or None.
        seed: Of all random poses.
        d_b: [m] buffer distance.
        package: `NAME=FOLDER` of each ROS package that is found nowhere else.
        source: What people read as the robot's source where it is not `urdf`, or None.
    """

    urdf: str
    base: str
    tip: str
    out: Path
    wheels: tuple[str, str] | None = None
    arm_urdf: str | None = None
    mount_xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    mount: str | None = None
    tip_xyz: tuple[float, float, float] = (0.0, 0.0, 0.0)
    tip_rpy: tuple[float, float, float] = (0.0, 0.0, 0.0)
    half_track: float | None = None
    wheel_radius: float | None = None
    kind: str = "differential"
    wheelbase: float | None = None
    steering_limit: float | None = None
    steering_rate: float | None = None
    ready: tuple[float, ...] | None = None
    bodies: int | None = None
    assume_inertia: bool = False
    title: str | None = None
    licence: str | None = None
    seed: int = 0
    d_b: float = Config().border.d_b
    file: str | None = None
    source: str | None = None
    package: tuple[str, ...] = ()

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
    """Of a number that may be given.

    Attributes:
        low, high: The least and the largest.
        unit: Of them.
    """

    low: float
    high: float
    unit: str = ""


BOUNDS = {
    "half_track": Bounds(0.02, 3.0, "m"),
    "wheel_radius": Bounds(0.01, 1.0, "m"),
    "wheelbase": Bounds(0.05, 10.0, "m"),
    "steering_limit": Bounds(0.02, 1.5, "rad"),
    "steering_rate": Bounds(0.01, 20.0, "rad/s"),
    "bodies": Bounds(1, 8),
}
"""By the field of `Request`."""
OF_KIND = {
    "half_track": "differential",
    "wheel_radius": "differential",
    "wheelbase": "car-like",
    "steering_limit": "car-like",
    "steering_rate": "car-like",
}
"""Kind of base that a number belongs to."""


def option(field: str) -> str:
    """The option of `dbb new-robot` that sets a field of `Request`."""
    return "--" + field.replace("_", "-")


def check_request(request: Request) -> None:
    """Refuse numbers out of bounds, those of another kind of base, and packages without a folder.

    Raises:
        UnknownNameError: There is no such kind of base.
        ConfigError: Names the option and what would be right.
    """
    kind = request.kind
    if kind not in KINDS:
        raise UnknownNameError("kind of base", kind, KINDS)
    for field, bounds in BOUNDS.items():
        value = getattr(request, field)
        if value is None:
            continue
        check_range(option(field), value, *bounds)
        if OF_KIND.get(field, kind) != kind:
            raise ConfigError(
                f"{option(field)}: a {kind} base has none; leave it out, or give "
                f"--kind {OF_KIND[field]}"
            )
    package_folders(request.package)
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
    found = {}
    for each in given:
        name, equals, folder = each.partition("=")
        if not (name and equals and folder):
            raise ConfigError(f"--package: {each!r} is not of the form NAME=FOLDER")
        if not Path(folder).is_dir():
            raise ConfigError(f"--package: there is no folder {folder}")
        found[name] = Path(folder).resolve()
    return found
