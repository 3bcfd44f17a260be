"""What a kind of mobile base says of itself: all that the method needs to know of it.

A base has velocity axes ν (n_b,). `T` makes its twist (v_x, v_y, ω_z) of them, in its own frame:
origin on the floor, x forward. `J_m` makes ν of the reduced coordinates q̇_b (n_b,), the wheels'
speeds or whatever moves it. The method knows no kind from another; onboarding does, which reads
wheels, and so do the plant with wheels in contact and the dashboard's words.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import ClassVar, Literal, NamedTuple

import numpy as np

from app.strict import Positive, Sourced

Array = np.ndarray


class Axis(NamedTuple):
    """One of the velocity axes ν."""

    symbol: str
    """As people read it, such as "v"."""
    angular: bool
    """Whether it turns the base; its unit is rad/s then, else m/s."""
    way: Literal["forward", "left"] = "forward"
    """Along which the base moves by it in its own frame, if it is not angular."""


FORWARD = Axis("v", False)
TURN = Axis("ω", True)


def acceleration_symbol(axis: Axis) -> str:
    """As in v̇, v̇_x, ω̇: the dot stands over the first letter."""
    return axis.symbol[:1] + "\u0307" + axis.symbol[1:]


class Planar(NamedTuple):
    """A motion of the base in its own frame: forward, to the left, and turning left."""

    forward: float
    left: float
    turn: float


def planar(axes: Sequence[Axis], values: Sequence[float] | Array) -> Planar:
    """What values along the axes (n_b,) come to in the base's frame."""
    return Planar(*(twist_map(axes) @ np.asarray(values, dtype=float)).tolist())


def twist_map(axes: Sequence[Axis]) -> Array:
    """(3, n_b) from values along the axes to forward, left and turn; each axis has one of them."""
    rows = ("forward", "left", "turn")
    columns = [rows.index("turn" if axis.angular else axis.way) for axis in axes]
    return np.eye(3)[:, columns]


class BaseForce(NamedTuple):
    """What acts on a base in the plane, in its own frame."""

    x: float
    """[N] sum of the forces."""
    y: float
    """[N]"""
    torque: float
    """[N m] about the vertical through the frame's origin."""


class Measure(NamedTuple):
    """How well a base moves a point at x ahead of its centre: constant + per_square_metre x |x|."""

    constant: float
    """[-] where every point is moved equally well."""
    per_square_metre: float
    """[1/m², times the measure's unit]"""


PAPERS_MEASURE = 4 * 0.51**2 * (0.165 / (2 * 0.51)) ** 4
"""[m²/rad⁴] (7) of the paper's robot 1 m ahead of its axis: what the gain of (13) goes with."""


class Channel(NamedTuple):
    """One of the motions by which a base gives way, independent of those beside it."""

    twist: tuple[float, float, float]
    """v_x, v_y [m/s] and ω [rad/s] at unit speed."""
    a_max: float
    """[m/s² or rad/s²] its largest acceleration."""
    v_max: float
    """[m/s or rad/s] its largest speed."""
    delay: float = 0.0
    """[s] until it can begin."""


class Wheels(NamedTuple):
    """Wheels that turn by one angle; drawn only."""

    name: str
    """Which ones."""
    field: str
    """Of the description, that names the joints."""
    joints: tuple[str, ...]
    """Of the URDF."""


Follower = Callable[[list[float], Array, list[float]], tuple[list[float], Array]]
"""From the velocity (n_b,) so far, the drive as `BaseKind.drive_at_rest` and the velocity command
(n_b,) to velocity and drive one period later; it changes neither of those given."""


class BaseKind(Sourced, ABC):
    """A base: its numbers, its limits and its drive; a kind derives from it.

    A kind states `axes`, its fields and the abstract methods; the others suit a base whose axes
    follow their commands independently of each other.
    """

    axes: ClassVar[tuple[Axis, ...]]
    """The velocity axes ν, in order."""

    kind: str
    """Which kind it is."""
    link: str
    """URDF link that moves with the base and in whose frame the base is described, x forward."""
    mass_kg: Positive
    """[kg] m of (17)."""
    inertia_kgm2: Positive
    """[kg m²] I of (18), about the frame's origin."""
    max_linear_velocity_mps: Positive
    """[m/s]"""
    max_linear_acceleration_mps2: Positive
    """[m/s²]"""
    traction_limit_n: Positive
    """[N] largest force of the wheels on the floor."""
    drive_time_constant_s: Positive
    """[s] of the drive's first-order response to a velocity command."""

    @property
    def n_b(self) -> int:
        """How many velocity axes it has."""
        return len(self.axes)

    @property
    def T(self) -> Array:
        """(3, n_b) from ν to the twist (v_x, v_y, ω_z) in the base's frame; TᵀT = I."""
        return twist_map(self.axes)

    @property
    @abstractmethod
    def J_m(self) -> Array:
        """(n_b, n_b) from q̇_b to ν, invertible and constant."""

    @property
    @abstractmethod
    def max_velocity(self) -> tuple[float, ...]:
        """(n_b,) [m/s or rad/s] the largest of each axis."""

    @property
    @abstractmethod
    def max_acceleration(self) -> tuple[float, ...]:
        """(n_b,) [m/s² or rad/s²] the largest of each axis."""

    @property
    @abstractmethod
    def yaw_limit_nm(self) -> float:
        """[N m] largest torque of the wheels about the frame's origin."""

    @property
    def wheels(self) -> tuple[Wheels, ...]:
        """What is drawn turning, in the order of the angles."""
        return ()

    @property
    def score_unit(self) -> float:
        """Unit of `measure` in (13): it makes the measure as large as that of the paper's robot."""
        return 1.0

    @property
    @abstractmethod
    def measure(self) -> Measure:
        """How well the base moves a point: what stands for the determinant of (7)."""

    def singularity(self, p: Array) -> tuple[Array, Array]:
        """The measure at points, with the sign of the side that is better.

        It stands in (10) in the place of sign(x) det(J_c J_cᵀ).

        Args:
            p: (…, 3) [m] points in the base's frame.

        Returns:
            (…) the measure and (…, 3) its gradient by the point.
        """
        constant, quadratic = self.measure
        x = np.asarray(p, dtype=float)[..., 0]
        gradient = np.zeros(np.shape(p))
        gradient[..., 0] = 2 * quadratic * np.abs(x)
        return constant + quadratic * x * np.abs(x), gradient

    @abstractmethod
    def acceleration(self, force: BaseForce) -> Array:
        """ẍ_m: what a force does to the base as it can move, (n_b,) [m/s² or rad/s²].

        It stands in the place of (17) and (18), and is linear in the force.
        """

    @property
    def A_b(self) -> Array:
        """(n_b, 3) the matrix of `acceleration`."""
        return np.column_stack([self.acceleration(BaseForce(*e)) for e in np.eye(3).tolist()])

    def retreats(self) -> tuple[tuple[Channel, ...], ...]:
        """Ways to give way, one of which is taken; each is made of independent channels."""
        limits = zip(self.T.T.tolist(), self.max_acceleration, self.max_velocity, strict=True)
        return (tuple(Channel((x, y, w), a, v) for (x, y, w), a, v in limits),)

    def admissible(self, wanted: Array, before: Array) -> Array:
        """The velocity nearest to the wanted one that the base can have.

        Args:
            wanted: (n_b,) within the limits of each axis.
            before: (n_b,) the velocity command so far.
        """
        del before
        return wanted

    def drive_at_rest(self) -> Array:
        """(n_d,) what the drive has beside its velocity, such as a steering angle, at a reset."""
        return np.zeros(0)

    def follower(self, dt: float) -> Follower:
        """How the drive follows a command, which it clamps to the limits, for one period dt [s]."""
        # Exact for a command held over the step, so that any dt is stable.
        gain = -math.expm1(-dt / self.drive_time_constant_s)
        limits = list(zip(self.max_velocity, (a * dt for a in self.max_acceleration), strict=True))

        def follow(v: list[float], drive: Array, v_cmd: list[float]) -> tuple[list[float], Array]:
            axes = zip(v, v_cmd, limits, strict=True)
            return [
                now + clamp((clamp(cmd, top) - now) * gain, most) for now, cmd, (top, most) in axes
            ], drive

        return follow

    def drive_acceleration(
        self, v: Sequence[float] | Array, drive: Array, v_cmd: Sequence[float] | Array
    ) -> Array:
        """What the drive does now with a command, (n_b,): clip((v_cmd - v)/τ, ±limits)."""
        del drive
        gain, velocities = 1.0 / self.drive_time_constant_s, (np.asarray(v), np.asarray(v_cmd))
        limits = self.max_velocity, self.max_acceleration
        axes = zip(*(each.tolist() for each in velocities), *limits, strict=True)
        return np.array(
            [clamp((clamp(cmd, top) - now) * gain, a_max) for now, cmd, top, a_max in axes]
        )

    def turned(self, angles: Array, qd_b: Array, drive: Array, dt: float) -> Array:
        """The angles [rad] of `wheels` after a step with reduced velocities q̇_b (n_b,)."""
        del qd_b, drive, dt
        return angles


class TurningBase(BaseKind):
    """A base that turns independently of how it moves; a kind derives from it."""

    max_angular_velocity_radps: Positive
    """[rad/s]"""
    max_angular_acceleration_radps2: Positive
    """[rad/s²]"""

    @property
    def max_velocity(self) -> tuple[float, ...]:
        """Largest speed [m/s] or turning speed [rad/s], by the axis."""
        v, w = self.max_linear_velocity_mps, self.max_angular_velocity_radps
        return tuple(w if axis.angular else v for axis in self.axes)

    @property
    def max_acceleration(self) -> tuple[float, ...]:
        """Largest acceleration [m/s²] or angular acceleration [rad/s²], by the axis."""
        v, w = self.max_linear_acceleration_mps2, self.max_angular_acceleration_radps2
        return tuple(w if axis.angular else v for axis in self.axes)


def clamp(value: float, limit: float) -> float:
    """The value within ±limit; `min` and `max` cost several times as much."""
    return limit if value > limit else -limit if value < -limit else value
