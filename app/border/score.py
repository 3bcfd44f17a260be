"""§2.3: the score of a point near the base, from the base's singularity and the arm's reach.

Points stand in the base's frame: origin on the floor under the base's centre, x forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.compiled import compiled
from app.errors import DescriptionError
from app.robot.model import RobotModel

Array = np.ndarray

FLOOR = 0.05
"""[-] share of C below which the reachability of (9) is bent to stay positive."""


def control_point_jacobian(x: float, y: float, phi: float, r: float, b: float) -> Array:
    """J_c, from the wheels' speeds to the velocity of the control point, ṗ_c = J_c q̇_b.

    Paper: Eq. (5), (6).

    Args:
        x: [m] from the base's centre to the control point, along the world's x axis.
        y: [m] the same along the world's y axis.
        phi: [rad] heading of the base.
        r: [m] radius of the wheels.
        b: [m] distance between a wheel and the base's centre.

    Returns:
        (2, 2) [m/rad], columns right and left wheel.
    """
    c = r / (2 * b)
    cos, sin = np.cos(phi), np.sin(phi)
    return c * np.array([[b * cos - y, b * cos + y], [b * sin + x, b * sin - x]])


def singularity_measure(p: Array, r: float, b: float) -> Array:
    """det(J_c J_cᵀ) at q_c = (x, y, 0): zero on the wheels' axis.

    Paper: Eq. (7), (8).

    Args:
        p: (…, 3) [m] points in the base's frame.
        r: [m] radius of the wheels.
        b: [m] distance between a wheel and the base's centre.

    Returns:
        (…) [m⁴/rad⁴].
    """
    c = r / (2 * b)
    return 4 * b**2 * c**4 * np.asarray(p)[..., 0] ** 2


def reachability(p: Array, p_base: Array, A: float, B: float, C: float) -> Array:
    """R, how many ways the arm has to reach a point, as a parabola of the distance from its mount.

    Paper: Eq. (9).
    Departs from the print: (9) turns negative far from B and would turn the score's sign. Below
    R_1 = 0.05 C it goes on as R_1² / (2 R_1 − R), with the same value and slope at R_1: positive
    everywhere, and its gradient never vanishes.

    Args:
        p: (…, 3) [m] points in the base's frame.
        p_base: (3,) [m] the arm's mount in the base's frame.
        A: [1/m²] curvature.
        B: [m] distance of the best reach.
        C: [-] the best reach.

    Returns:
        (…) [-], above zero.
    """
    rho = np.linalg.norm(np.asarray(p) - p_base, axis=-1)
    return _bend(C - A * (rho - B) ** 2, FLOOR * C)[0]


def score(p: Array, r: float, b: float, p_base: Array, A: float, B: float, C: float) -> Array:
    """S, positive in front of the wheels' axis and negative behind it.

    Paper: Eq. (10).
    Paper: Eq. (11).

    Args and units as `singularity_measure` and `reachability`.

    Returns:
        (…) [m⁴/rad⁴].
    """
    return (
        _sign(np.asarray(p)[..., 0])
        * singularity_measure(p, r, b)
        * reachability(p, p_base, A, B, C)
    )


def score_gradient(
    p: Array, r: float, b: float, p_base: Array, A: float, B: float, C: float
) -> Array:
    """∇S, the gradient of (10) by the point; zero on the wheels' axis.

    Args and units as `score`.

    Returns:
        (…, 3) [m³/rad⁴].
    """
    p = np.asarray(p, dtype=float)
    x = p[..., 0]
    out = p - p_base
    rho = np.linalg.norm(out, axis=-1)
    R, slope = _bend(C - A * (rho - B) ** 2, FLOOR * C)
    # At the mount itself the distance has no direction; out = 0 there makes the term vanish.
    along = -2 * A * (rho - B) * slope / np.where(rho > 0, rho, 1.0)
    signed = _sign(x) * singularity_measure(p, r, b)
    gradient = (signed * along)[..., None] * out
    gradient[..., 0] += 8 * b**2 * (r / (2 * b)) ** 4 * np.abs(x) * R
    return gradient


@compiled("f8[::1](f8[:])")
def uphill(gradient: Array) -> Array:
    """(3,) ∇S/‖∇S‖ from ∇S (3,); where ∇S = 0, on the wheels' axis, its limit e_x."""
    norm = math.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    direction = np.zeros(3)
    if norm > 0.0:
        direction[:] = gradient / norm
    else:
        direction[0] = 1.0
    return direction


@compiled("Tuple((f8, f8[::1]))(f8[:], f8, f8, f8[:], f8, f8, f8)")
def _score_at(
    p: Array, r: float, b: float, p_base: Array, A: float, B: float, C: float
) -> tuple[float, Array]:
    """`score` and `score_gradient` of one point (3,) together."""
    gradient = np.empty(3)
    gradient[:] = p[0] - p_base[0], p[1] - p_base[1], p[2] - p_base[2]
    rho = math.sqrt(gradient[0] ** 2 + gradient[1] ** 2 + gradient[2] ** 2)
    R, slope = C - A * (rho - B) ** 2, 1.0
    R_1 = FLOOR * C
    if R < R_1:  # bent as in `reachability`
        low = R_1 / (2 * R_1 - R)
        R, slope = R_1 * low, low**2
    per_x = 4 * b**2 * (r / (2 * b)) ** 4  # det(J_c J_cᵀ) = per_x x²
    x = p[0]
    signed = per_x * x * abs(x)
    gradient *= signed * (-2 * A * (rho - B) * slope / rho if rho > 0.0 else 0.0)
    gradient[0] += 2 * per_x * abs(x) * R
    return signed * R, gradient


@dataclass(frozen=True)
class ScoreField:
    """The score for one robot and one of its bodies.

    Attributes:
        r, b: [m] of (6).
        p_base: (3,) [m] of (9).
        A: [1/m²], B: [m], C: [-] of (9).
    """

    r: float
    b: float
    p_base: Array
    A: float
    B: float
    C: float

    @classmethod
    def of(cls, model: RobotModel, body: str) -> ScoreField:
        """The field for a body of the arm.

        Raises:
            DescriptionError: The description has no A, B, C of (9) for that body.
        """
        base, reach = model.description.base, model.description.reachability.get(body)
        if reach is None:
            raise DescriptionError(
                f"{model.description.name}/robot.toml: reachability.{body}: missing; "
                "the body can meet the mobile robot"
            )
        return cls(
            base.wheel_radius_m, base.half_track_m, model.p_base(),
            reach.A_per_m2, reach.B_m, reach.C,
        )  # fmt: skip

    def singularity(self, p: Array) -> Array:
        """(…) det(J_c J_cᵀ) of (7) at points (…, 3)."""
        return singularity_measure(p, self.r, self.b)

    def reachability(self, p: Array) -> Array:
        """(…) R of (9) at points (…, 3)."""
        return reachability(p, self.p_base, self.A, self.B, self.C)

    def score(self, p: Array) -> Array:
        """(…) S of (10) at points (…, 3)."""
        return score(p, self.r, self.b, self.p_base, self.A, self.B, self.C)

    def gradient(self, p: Array) -> Array:
        """(…, 3) ∇S at points (…, 3)."""
        return score_gradient(p, self.r, self.b, self.p_base, self.A, self.B, self.C)

    def at_point(self, p: Array) -> tuple[float, Array]:
        """S and ∇S (3,) at one point (3,): `score` and `gradient` together, at little cost."""
        return _score_at(p, self.r, self.b, self.p_base, self.A, self.B, self.C)

    def direction(self, p: Array) -> Array:
        """(3,) ∇S/‖∇S‖ at a point (3,); on the wheels' axis its limit from both sides, e_x."""
        return uphill(self.gradient(p))


def _sign(x: Array) -> Array:
    return np.where(x >= 0, 1.0, -1.0)


def _bend(R: Array, R_1: float) -> tuple[Array, Array]:
    """R bent at R_1 so that it stays above zero, and the derivative of the bent one by R."""
    low = R_1 / (2 * R_1 - np.minimum(R, R_1))
    return np.where(R >= R_1, R, R_1 * low), np.where(R >= R_1, 1.0, low**2)
