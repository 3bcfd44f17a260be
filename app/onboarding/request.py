"""What is asked of `dbb new-robot`."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from app.config import Config
from app.errors import RobotFileError
from app.strict import Vector3

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
    """[m] d_b that the bodies and the ready pose have to suit."""
    file: str | None = None
    """Path of the URDF in a zip that holds several."""
    source: str | None = None
    """What people read as the robot's source where it is not `urdf`, or None."""

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
