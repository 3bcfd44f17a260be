"""The common interface of all plants, real physics or stand-in."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from typing_extensions import Self

from app.robot.state import Measurement
from app.strict import Array


class Contacts(NamedTuple):
    """Contacts of the last step."""

    arm_base: bool = False
    """Arm and base."""
    arm_arm: bool = False
    """Two parts of the arm that are not neighbours."""
    arm_floor: bool = False
    """Arm and floor."""
    door_base: bool = False
    """A door that the end-effector holds, and the base."""

    @classmethod
    def of(cls, groups: Iterable[str]) -> Self:
        """The contacts of some fields, by their names."""
        return cls(**dict.fromkeys(groups, True))


class Wrench(NamedTuple):
    """Force (3,) [N] and torque (3,) [N m] about the end-effector's origin, in the world."""

    force: Array
    torque: Array


class Push(NamedTuple):
    """A force on some point of the arm."""

    joint: str
    """Name of the joint that carries the point."""
    p: Array
    """(3,) [m] the point in that joint's frame."""
    force: Array
    """(3,) [N] in the world."""


class HeldDoor(ABC):
    """A door that the end-effector holds since the plant's reset."""

    @abstractmethod
    def angle(self) -> float:
        """[rad] opening angle."""

    @abstractmethod
    def wrench(self) -> Wrench:
        """Wrench on the door in the last step, as a force-torque sensor measures it."""


class Physics(ABC):
    """A plant with a velocity-controlled base and a torque-controlled arm, stepped by `dt`.

    The world's floor is z = 0. Implementations: `planar` in pybullet (default) or in MuJoCo,
    `mujoco_wheels`, `kinematic` (a stand-in for tests).
    """

    dt: float
    """[s] one step."""
    door: HeldDoor | None
    """The door that the end-effector holds; None in a plant without one."""

    @abstractmethod
    def reset(self, base_pose: Array, q_m: Array) -> None:
        """Put the robot at rest at base pose (x, y, φ) [m, rad] and joint positions `q_m`."""

    @abstractmethod
    def measure(self) -> Measurement:
        """The sensors' readings now."""

    @abstractmethod
    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """Advance by `dt`.

        Args:
            u_a: (n_m,) [N m or N] torques of the arm, constant during the step.
            base_velocity: (n_b,) [m/s or rad/s] commanded along the base's axes; the drive
                follows with the description's time constant and limits.
            hand_force: (3,) [N] force of the person on the end-effector's origin, in the world.
            pushes: Forces on other points of the arm.
        """

    @abstractmethod
    def contacts(self) -> Contacts:
        """Contacts of the last step."""

    def close(self) -> None:  # noqa: B027 - most have nothing to release
        """Release the plant's resources."""


class PlanarWorld(ABC):
    """A robot on planar joints in an engine; q and v are x, y, yaw in the world and the arm's."""

    door: HeldDoor | None

    @abstractmethod
    def reset(self, q: Array) -> None:
        """At rest at q (3 + n_m,) [m, rad]; the end-effector grasps the door."""

    @abstractmethod
    def read(self) -> tuple[Array, list[float], Array, Array]:
        """Position (3,) and velocity of x, y and yaw, then q_m and q̇_m of the arm, as copies."""

    @abstractmethod
    def step(
        self, u_a: Array, speeds: Sequence[float], hand_force: Array, pushes: Sequence[Push]
    ) -> None:
        """As `Physics.step`, with the speeds of x, y and yaw [m/s, rad/s] in the world."""

    @abstractmethod
    def contacts(self) -> Contacts:
        """Contacts of the last step."""

    @abstractmethod
    def depths(self) -> dict[str, float]:
        """[m] depth of the contacts, by the fields of `Contacts`."""

    @abstractmethod
    def seen(self, begins: Array, ends: Array) -> Array:
        """(n,) [m] from each start (n, 3) to the robot or the floor, towards its end; or inf."""

    @abstractmethod
    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """Mass matrix and bias forces of the engine."""

    def close(self) -> None:  # noqa: B027 - most have nothing to release
        """Release the engine's resources."""
