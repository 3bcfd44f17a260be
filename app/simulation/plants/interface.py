"""The common interface of all plants."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import NamedTuple

from typing_extensions import Self

from app.robot.state import Measurement
from app.strict import Array


class Contacts(NamedTuple):
    """Contacts in the last step: of `body_contact_pairs`, and of a door that the robot holds."""

    arm_base: bool = False
    """Whether arm and base touch."""
    arm_arm: bool = False
    """Whether two parts of the arm touch that are not neighbours."""
    arm_floor: bool = False
    """Whether arm and floor touch."""
    door_base: bool = False
    """Whether the base and a door that the end-effector holds touch."""

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
    """A plant with a velocity-controlled base and a torque-controlled arm.

    The world's floor is z = 0. Implementations: the module `planar` with pybullet (the default if
    pybullet is installed) or with MuJoCo, `mujoco_wheels`, and `kinematic` (a simple plant for
    tests).
    """

    dt: float
    """[s] duration of one step."""
    door: HeldDoor | None
    """The door that the end-effector holds; None in a plant without a door."""

    @abstractmethod
    def reset(self, base_pose: Array, q_m: Array) -> None:
        """Put the robot at rest; the end-effector grasps the door, if there is one.

        Args:
            base_pose: (3,) x, y [m] and heading [rad] of the base.
            q_m: (n_m,) [rad or m] joint positions of the arm.
        """

    @abstractmethod
    def measure(self) -> Measurement:
        """The robot's present state, as exact sensors measure it."""

    @abstractmethod
    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """Advance by `dt`.

        Args:
            u_a: (n_m,) [N m or N] torques of the arm, constant during the step.
            base_velocity: (n_b,) [m/s or rad/s] command along the base's axes; the drive follows
                with the description's time constant and limits.
            hand_force: (3,) [N] force of people on the end-effector's origin, in the world.
            pushes: Forces on other points of the arm.
        """

    @abstractmethod
    def contacts(self) -> Contacts:
        """Contacts in the last step."""

    def close(self) -> None:  # noqa: B027 - most plants have no resources
        """Release the plant's resources."""


class PlanarWorld(ABC):
    """A robot on planar joints in an engine.

    Positions q and velocities v (3 + n_m,) are those of x, y and yaw in the world, then of the
    arm's joints. `door` is as in `Physics`.
    """

    door: HeldDoor | None

    @abstractmethod
    def reset(self, q: Array) -> None:
        """Put the robot at rest at q (3 + n_m,) [m, rad]; the end-effector grasps any `door`."""

    @abstractmethod
    def read(self) -> tuple[Array, list[float], Array, Array]:
        """Copies of position (3,) and velocity (3,) of x, y and yaw, and of q_m and q̇_m (n_m,)."""

    @abstractmethod
    def step(
        self, u_a: Array, speeds: Sequence[float], hand_force: Array, pushes: Sequence[Push]
    ) -> None:
        """Advance by one step.

        `speeds` (3,) [m/s, m/s, rad/s] are the commanded speeds of x, y and yaw in the world; the
        other arguments are those of `Physics.step`.
        """

    @abstractmethod
    def contacts(self) -> Contacts:
        """Contacts in the last step."""

    @abstractmethod
    def depths(self) -> dict[str, float]:
        """[m] depth of the deepest contact of each present kind, by the fields of `Contacts`."""

    @abstractmethod
    def seen(self, begins: Array, ends: Array) -> Array:
        """(n,) [m] distance from the start of each ray to the first hit of any body or the floor.

        The rays go from `begins` (n, 3) to `ends` (n, 3) [m]; infinite for a ray without a hit.
        """

    @abstractmethod
    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """The engine's mass matrix (3 + n_m, 3 + n_m) and bias forces (3 + n_m,) at q and v."""

    def close(self) -> None:  # noqa: B027 - most engines have no resources
        """Release the engine's resources."""
