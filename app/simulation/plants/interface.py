"""The common interface of all plants, the drive of the base, and a load."""

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from typing_extensions import Self

from app.robot.bases.kind import BaseKind
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.plants.door import Door
from app.strict import Array

GRAVITY = 9.81  # [m/s²]
PYBULLET_MISSING = (
    "needs pybullet, which is not installed; there are no wheels of pybullet for some versions of "
    "Python (docs/install.md)"
)


class Contacts(NamedTuple):
    """Whether parts touched in the last step: a pair of `ContactPairs`, or base and door."""

    arm_base: bool = False
    arm_arm: bool = False  # two parts of the arm that are not neighbours
    arm_floor: bool = False
    door_base: bool = False  # the base, and a door that the end-effector holds

    @classmethod
    def of(cls, groups: Iterable[str]) -> Self:
        """The contacts in which the fields with these names are True, and all others False."""
        return cls(**dict.fromkeys(groups, True))


class Wrench(NamedTuple):
    force: Array  # (3,) [N] in the world
    torque: Array  # (3,) [N m] about the end-effector's origin, in the world


class Push(NamedTuple):
    joint: str  # name of the joint of the arm that carries the point
    p: Array  # (3,) [m] the point in the joint's frame
    force: Array  # (3,) [N] in the world


class HeldDoor(ABC):
    """A door in a plant; the end-effector holds the door from each reset of the plant on."""

    door: Door  # constant geometry of the door

    @abstractmethod
    def angle(self) -> float:
        """[rad] present opening angle."""

    @abstractmethod
    def wrench(self) -> Wrench:
        """Wrench of the end-effector on the door in the last step; zero before a step."""


class Physics(ABC):
    """A plant with a velocity-controlled base and a torque-controlled arm, on the floor z = 0."""

    dt: float  # [s] duration of one step
    door: HeldDoor | None  # the door that the end-effector holds, or None

    @abstractmethod
    def reset(self, base_pose: Array, q_m: Array) -> None:
        """Put the robot at rest; the end-effector grasps the door, if there is one. `base_pose`
        (3,) is x, y [m] and heading [rad], `q_m` (n_m,) [rad or m] the joint positions.
        """

    @abstractmethod
    def measure(self) -> Measurement:
        """The robot's present state, as exact sensors measure it."""

    @abstractmethod
    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """Advance by `dt` with constant torques `u_a` (n_m,) [N m or N] of the arm. The drive
        follows the command `base_velocity` (n_b,) [m/s or rad/s] with the description's time
        constant and limits. `hand_force` (3,) [N], in the world, acts on the end-effector's origin,
        each of the `pushes` on its own point of the arm.
        """

    @abstractmethod
    def contacts(self) -> Contacts:
        """Contacts in the last step."""

    def close(self) -> None:  # noqa: B027 - most plants have no resources
        """Release the plant's resources."""


class PointLoad:
    """A point mass fixed to the end-effector; its weight and inertia act on the arm as a force.
    A force m (g - a) with the last acceleration a would be unstable for a load heavier than the
    arm's effective mass. Therefore the computation includes the effect of the force on a.
    """

    def __init__(self, model: RobotModel, mass: float, centre: Array, dt: float) -> None:
        """`mass` [kg] at `centre` (3,) [m] in the end-effector's frame; steps last `dt` [s]."""
        self._model, self._mass, self._centre, self._dt = model, mass, centre, dt
        self._joint = model.pin.njoints - 1
        self._at = model.pin.frames[model.ee_frame].placement.act(centre)
        self._data = model.pin.createData()
        self._effect, self._v = np.zeros(3), np.full(3, np.nan)

    def push(self, state: RobotState) -> Push:
        """The load's force on the arm in the next step, from the true state; call once a step."""
        model, n_b = self._model, self._model.n_b
        p = state.p_ee + state.R_ee @ self._centre
        q = model.configuration(state.base_pose, state.q_m)
        M = model.mass_matrix(q, self._data)[3:, 3:]
        J = state.point_jacobian(self._joint, p)[:, n_b:]
        mobility = J @ np.linalg.solve(M, J.T)  # [1/kg] of the arm without the load
        v = state.point_velocity(self._joint, p)
        a = (v - self._v) / self._dt if np.isfinite(self._v).all() else self._effect
        free = a - self._effect  # [m/s²] acceleration without the load
        gravity = model.pin.gravity.linear
        force = np.linalg.solve(np.eye(3) / self._mass + mobility, gravity - free)
        self._effect, self._v = mobility @ force, v
        return Push(model.pin.names[self._joint], self._at, force)


class Drive:
    """The drive of a base; the kind of base defines the response to commands."""

    def __init__(self, base: BaseKind, dt: float) -> None:
        """A drive at rest; `dt` [s] is the duration of one `step`."""
        self._base, self._follow = base, base.follower(dt)
        self.reset()

    def reset(self) -> None:
        self.velocity = [0.0] * self._base.n_b  # (n_b,) [m/s or rad/s] along the base's axes
        self.state = self._base.drive_at_rest()  # (n_d,) other states, such as steering [rad]

    def step(self, v_cmd: Sequence[float] | Array) -> list[float]:
        """Execute one step with the command (n_b,) [m/s or rad/s], and return the new velocity."""
        command = np.asarray(v_cmd).tolist()
        self.velocity, self.state = self._follow(self.velocity, self.state, command)
        return self.velocity
