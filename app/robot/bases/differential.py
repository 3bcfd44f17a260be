"""The paper's base: two sides of wheels with separate speeds, no motion sideways."""

from typing import ClassVar, Literal

import numpy as np

from app.robot.bases.kind import FORWARD, TURN, Axis, Measure, TurningBase, Wheels
from app.strict import Array, Positive


def mobile_jacobian(r: float, b: float) -> Array:
    """(2, 2) J_m of the differential base, rows in m/rad and 1: (v, ω) = J_m (θ̇_r, θ̇_l), from the
    wheels' radius r [m] and half the track width b [m].

    Paper: Eq. (19), with r/2 instead of −r/2 in the second column: the printed matrix has rank 1.
    """
    return np.array([[r / 2, r / 2], [r / (2 * b), -r / (2 * b)]])


def control_point_jacobian(x: float, y: float, phi: float, r: float, b: float) -> Array:
    """(2, 2) [m/rad] J_c of a point that moves with the base: ṗ_c = J_c (θ̇_r, θ̇_l).

    The point is at x, y [m] from the base's centre along the axes of the world; phi [rad] is the
    heading of the base; r and b are as in `mobile_jacobian`.

    Paper: Eq. (5), (6).
    """
    cos, sin = np.cos(phi), np.sin(phi)
    return r / (2 * b) * np.array([[b * cos - y, b * cos + y], [b * sin + x, b * sin - x]])


class DifferentialBase(TurningBase):
    """The differentially driven base: r, b, m, I of the paper, its limits and its drive.

    Paper: Eq. (4).
    """

    axes: ClassVar[tuple[Axis, ...]] = (FORWARD, TURN)

    kind: Literal["differential"]
    wheel_radius_m: Positive  # [m] r of (6)
    half_track_m: Positive  # [m] b of (6), distance between a wheel and the base's centre
    left_wheel_joints: tuple[str, ...]  # joints of the URDF, for drawing and `mujoco-contact`
    right_wheel_joints: tuple[str, ...]  # joints of the URDF, for drawing and `mujoco-contact`

    @property
    def J_m(self) -> Array:
        """(2, 2) map from the wheel speeds q̇_b = (θ̇_r, θ̇_l) [rad/s] to ν = (v, ω)."""
        return mobile_jacobian(self.wheel_radius_m, self.half_track_m)

    @property
    def yaw_limit_nm(self) -> float:
        return self.traction_limit_n * self.half_track_m

    @property
    def wheels(self) -> tuple[Wheels, ...]:
        """The wheels on the right side, then those on the left, in the order of q̇_b."""
        return (
            Wheels("right", "right_wheel_joints", self.right_wheel_joints),
            Wheels("left", "left_wheel_joints", self.left_wheel_joints),
        )

    @property
    def measure(self) -> Measure:
        """sign(x) det(J_c J_cᵀ) [m⁴/rad⁴], which is 0 on the wheel axis.

        Paper: Eq. (7), (8).
        """
        r, b = self.wheel_radius_m, self.half_track_m
        return Measure(0.0, 4 * b**2 * (r / (2 * b)) ** 4)

    def turned(
        self, angles: list[float], qd_b: list[float], drive: Array, dt: float
    ) -> list[float]:
        del drive
        return [angles[0] + qd_b[0] * dt, angles[1] + qd_b[1] * dt]
