"""A base with a driven rear axle and steered front wheels (Ackermann): it moves along arcs.

The frame's origin is the middle of the rear axle on the floor; the front axle is L ahead. The
velocity (w_x, w_y) of the front axle's middle, in the base's frame, gives v = w_x and ω = w_y / L.
The front wheels point along this velocity, so it is in the double cone |w_y| ≤ tan δ_max |w_x|: the
curvature κ = ω / v is within ±κ_max, κ_max = tan δ_max / L. The base cannot turn on the spot.
"""

import math
from collections.abc import Sequence
from typing import Annotated, ClassVar, Literal

import numpy as np
from pydantic import Field

from app.robot.bases.kind import (
    FORWARD,
    PAPERS_MEASURE,
    TURN,
    Axis,
    BaseKind,
    Channel,
    Follower,
    Measure,
    Wheels,
    clamp,
)
from app.strict import Array, Positive

_STEADY = 1.5  # [-] energy ratio from which the base reverses its direction
_HELD = 0.005  # [m/s] commanded speed of the front axle below which the steering does not change


def nearest_in_cone(
    v: float, w: float, kappa: float, radius: float, before: float
) -> tuple[float, float]:
    """The velocity [m/s, rad/s] in the cone |ω| ≤ κ_max |v| nearest to (v, w).

    The norm √(v² + ρ² ω²) is that of kinetic energy. `kappa` [1/m] is κ_max, `radius` [m] is
    ρ = √(I/m), and `before` [m/s] is the present speed or speed command. A velocity outside of the
    cone is replaced by one on an edge, κ = ±κ_max, with the speed (v + ρ² κ ω) / (1 + ρ² κ²). If
    both edges are about equally near, a moving base keeps its direction. If both are equally near,
    a base at rest moves backwards: the arm comes ahead of the rear axle, where the score is better.
    """
    if abs(w) <= kappa * abs(v):
        return v, w
    side = math.copysign(kappa, w)  # curvature of a motion ahead; backwards it is -side
    inertia = 1.0 + (radius * kappa) ** 2
    ahead = max((v + radius**2 * side * w) / inertia, 0.0)
    back = min((v - radius**2 * side * w) / inertia, 0.0)
    favour = _STEADY if before > 0.0 else 1.0 / _STEADY if before < 0.0 else 1.0
    if favour * ahead**2 > back**2:
        return ahead, side * ahead
    return back, -side * back


class CarLikeBase(BaseKind):
    """An Ackermann base: ν = (v, ω) is the motion of the rear axle's middle, q̇_b = (w_x, w_y)
    [m/s] that of the front axle's middle.

    The measure in (10) is sign(x) (2 κ_max x)²: the velocities of a point on the two tightest arcs,
    at unit speed, span the area 2 κ_max |x|. It is 0 on the rear axle line, where all arcs move a
    point in the same direction.

    The drive has a speed v and a steering angle δ. δ approaches the angle of the command's arc, and
    v approaches the speed that is nearest to the command along the arc of the present δ.
    """

    axes: ClassVar[tuple[Axis, ...]] = (FORWARD, TURN)

    kind: Literal["car-like"]
    wheelbase_m: Positive  # [m] L, wheelbase
    steering_limit_rad: Annotated[Positive, Field(lt=math.pi / 2)]
    """[rad] δ_max of a wheel at the middle of the front axle."""
    steering_rate_radps: Positive  # [rad/s] largest steering rate, also at standstill
    wheel_radius_m: Positive  # [m] radius of the wheels; for drawing only
    wheel_joints: tuple[str, ...]  # joints of the URDF that roll; for drawing only
    steering_joints: tuple[str, ...]  # joints of the URDF that steer; for drawing only

    @property
    def J_m(self) -> Array:
        return np.diag([1.0, 1.0 / self.wheelbase_m])

    @property
    def curvature_max(self) -> float:
        """[1/m] κ_max, the curvature of the tightest arc."""
        return math.tan(self.steering_limit_rad) / self.wheelbase_m

    @property
    def max_velocity(self) -> tuple[float, float]:
        v = self.max_linear_velocity_mps
        return v, v * self.curvature_max

    @property
    def max_acceleration(self) -> tuple[float, float]:
        """Largest v̇ [m/s²], and ω̇ [rad/s²] at this v̇, top speed, full steering and full rate."""
        turning = self.steering_rate_radps / math.cos(self.steering_limit_rad) ** 2
        a, v = self.max_linear_acceleration_mps2, self.max_linear_velocity_mps
        return a, a * self.curvature_max + v * turning / self.wheelbase_m

    @property
    def yaw_limit_nm(self) -> float:
        return self.traction_limit_n * self.wheelbase_m

    @property
    def wheels(self) -> tuple[Wheels, ...]:
        """The joints that roll, then those that steer."""
        return (
            Wheels("rolling", "wheel_joints", self.wheel_joints),
            Wheels("steering", "steering_joints", self.steering_joints),
        )

    @property
    def score_unit(self) -> float:
        return 4.0 * self.curvature_max**2 / PAPERS_MEASURE

    @property
    def measure(self) -> Measure:
        """sign(x) (2 κ_max x)² [-]."""
        return Measure(0.0, 4.0 * self.curvature_max**2)

    def retreats(self) -> tuple[tuple[Channel, ...], ...]:
        """Straight, or along one of the two tightest arcs after the delay of the steering."""
        kappa = self.curvature_max
        a, v = self.max_linear_acceleration_mps2, self.max_linear_velocity_mps
        late = self.steering_limit_rad / self.steering_rate_radps
        arcs = ((Channel((1.0, 0.0, side), a, v, late),) for side in (kappa, -kappa))
        return ((Channel((1.0, 0.0, 0.0), a, v),), *arcs)

    def admissible(self, wanted: Array, before: Array) -> Array:
        (v, w), kappa = wanted.tolist(), self.curvature_max
        return np.array(nearest_in_cone(v, w, kappa, self._radius, float(before[0])))

    def drive_at_rest(self) -> Array:
        """(1,) [rad] the steering angle δ = 0: straight ahead."""
        return np.zeros(1)

    def follower(self, dt: float) -> Follower:
        gain = -math.expm1(-dt / self.drive_time_constant_s)

        def follow(v: list[float], drive: Array, v_cmd: list[float]) -> tuple[list[float], Array]:
            speed, angle = v[0], drive.item(0)
            speed_to, angle_to = self._goal(speed, angle, v_cmd)
            angle += clamp((angle_to - angle) * gain, self.steering_rate_radps * dt)
            speed += clamp((speed_to - speed) * gain, self.max_linear_acceleration_mps2 * dt)
            return [speed, speed * math.tan(angle) / self.wheelbase_m], np.array([angle])

        return follow

    def drive_acceleration(
        self, v: Sequence[float] | Array, drive: Array, v_cmd: Sequence[float] | Array
    ) -> Array:
        """(2,) v̇ [m/s²], and ω̇ = v̇ tan δ / L + v δ̇ / (L cos² δ) [rad/s²]."""
        speed, angle, tau = float(v[0]), float(drive[0]), self.drive_time_constant_s
        speed_to, angle_to = self._goal(speed, angle, v_cmd)
        a = clamp((speed_to - speed) / tau, self.max_linear_acceleration_mps2)
        rate = clamp((angle_to - angle) / tau, self.steering_rate_radps)
        slope = math.tan(angle)
        return np.array([a, (a * slope + speed * rate * (1.0 + slope**2)) / self.wheelbase_m])

    def turned(
        self, angles: list[float], qd_b: list[float], drive: Array, dt: float
    ) -> list[float]:
        return [angles[0] + qd_b[0] / self.wheel_radius_m * dt, drive.item(0)]

    @property
    def _radius(self) -> float:
        return math.sqrt(self.inertia_kgm2 / self.mass_kg)

    def _goal(
        self, speed: float, angle: float, v_cmd: Sequence[float] | Array
    ) -> tuple[float, float]:
        """Speed [m/s] and steering angle [rad] that the drive approaches for a command (v, ω). The
        speed is that along the present arc nearest to the command, smaller if this arc and the
        arc of the command bend to opposite sides, and 0 if it would oppose the command.
        """
        top = self.max_linear_velocity_mps
        wanted, kappa = (clamp(float(v_cmd[0]), top), float(v_cmd[1])), self.curvature_max
        v, w = nearest_in_cone(*wanted, kappa, self._radius, speed)
        angle_to, L = angle, self.wheelbase_m
        if math.hypot(v, L * w) > _HELD:
            angle_to = clamp(math.atan(L * w / v), self.steering_limit_rad)
        turn = self._radius**2 * math.tan(angle) / L  # ρ² κ
        along = (v + turn * w) / (1.0 + turn * math.tan(angle) / L)
        against = max(-math.tan(angle) * math.tan(angle_to), 0.0) / (L * kappa) ** 2
        return clamp(along * (1.0 - against) if along * v > 0.0 else 0.0, top), angle_to
