"""The common interface of all plants."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from typing_extensions import Self

from app.robot.state import Measurement
from app.strict import Array


class Contacts(NamedTuple):
    """Whether parts touched in the last step: those of `body_contact_pairs`, or a held door."""

    arm_base: bool = False
    arm_arm: bool = False
    """Two parts of the arm that are not neighbours."""
    arm_floor: bool = False
    door_base: bool = False
    """The base, and a door that the end-effector holds."""

    @classmethod
    def of(cls, groups: Iterable[str]) -> Self:
        """The contacts with the fields of these names true."""
        return cls(**dict.fromkeys(groups, True))


NO_CONTACTS = Contacts()


class Wrench(NamedTuple):
    """A force and a torque about the end-effector's origin, in the world."""

    force: Array
    """(3,) [N] force."""
    torque: Array
    """(3,) [N m] torque."""


class Push(NamedTuple):
    """A force on a point of the arm."""

    joint: str
    """Name of the joint that carries the point."""
    p: Array
    """(3,) [m] the point in the joint's frame."""
    force: Array
    """(3,) [N] force in the world."""


class HeldDoor(ABC):
    """A door in a plant, which the end-effector holds after the plant's reset."""

    @abstractmethod
    def angle(self) -> float:
        """[rad] present opening angle."""

    @abstractmethod
    def wrench(self) -> Wrench:
        """Wrench of the end-effector on the door in the last step, as a sensor measures it."""


class Physics(ABC):
    """A plant with a velocity-controlled base and a torque-controlled arm, on the floor z = 0."""

    dt: float
    """[s] duration of one step."""
    door: HeldDoor | None
    """The door that the end-effector holds; None in a plant without a door."""

    @abstractmethod
    def reset(self, base_pose: Array, q_m: Array) -> None:
        """Put the robot at rest; the end-effector grasps the door, if there is one.

        `base_pose` (3,) has x, y [m] and heading [rad], `q_m` (n_m,) [rad or m] the joint
        positions.
        """

    @abstractmethod
    def measure(self) -> Measurement:
        """The robot's present state, as exact sensors measure it."""

    @abstractmethod
    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """Advance by `dt`.

        The torques `u_a` (n_m,) [N m or N] of the arm are constant meanwhile. The drive follows the
        command `base_velocity` (n_b,) [m/s or rad/s] with the description's time constant and
        limits. `hand_force` (3,) [N] acts on the end-effector's origin, in the world, `pushes` on
        other points of the arm.
        """

    @abstractmethod
    def contacts(self) -> Contacts:
        """Contacts in the last step."""

    def close(self) -> None:  # noqa: B027 - most plants have no resources
        """Release the plant's resources."""
