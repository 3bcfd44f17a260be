"""§2.3: the score of a point near the base, from the base's singularity and the arm's reach.

Points stand in the base's frame: origin on the floor under the base's centre, x forward.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from app.compiled import compiled
from app.errors import DescriptionError
from app.robot.bases.kind import BaseKind
from app.robot.model import RobotModel

Array = np.ndarray

FLOOR = 0.05
"""[-] share of C below which the reachability of (9) is bent to stay positive."""


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
    p = np.asarray(p, dtype=float)
    return _reach_of(p.reshape(-1, 3), p_base, A, B, C).reshape(p.shape[:-1])


def score(p: Array, base: BaseKind, p_base: Array, A: float, B: float, C: float) -> Array:
    """S, positive where the base moves the point well; for the paper's base in front of the axis.

    Paper: Eq. (10).
    Paper: Eq. (11).

    Args:
        p: (…, 3) [m] points in the base's frame.
        base: What stands in for the determinant of (7), with its sign.
        p_base: As `reachability`.
        A: As `reachability`.
        B: As `reachability`.
        C: As `reachability`.

    Returns:
        (…) [unit of the base's measure; m⁴/rad⁴ of a differential one].
    """
    return base.singularity(p)[0] * reachability(p, p_base, A, B, C)


def score_gradient(p: Array, base: BaseKind, p_base: Array, A: float, B: float, C: float) -> Array:
    """∇S, the gradient of (10) by the point; zero on the axis of a differential base's wheels.

    Args as `score`.

    Returns:
        (…, 3) [unit of the score per metre].
    """
    p = np.asarray(p, dtype=float)
    signed, by_point = base.singularity(p)
    measures = np.column_stack([signed.ravel(), by_point.reshape(-1, 3)[:, :2]])
    return _gradients(p.reshape(-1, 3), measures, p_base, A, B, C).reshape(p.shape)


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


@compiled()
def _reach(p: Array, p_base: Array, A: float, B: float, C: float) -> tuple[float, float, float]:
    """ρ [m], R of (9) bent as in `reachability`, and dR/dρ [1/m] at one point (3,)."""
    rho = math.sqrt((p[0] - p_base[0]) ** 2 + (p[1] - p_base[1]) ** 2 + (p[2] - p_base[2]) ** 2)
    R, by_rho, R_1 = C - A * (rho - B) ** 2, -2 * A * (rho - B), FLOOR * C
    if R < R_1:
        low = R_1 / (2 * R_1 - R)
        return rho, R_1 * low, by_rho * low**2
    return rho, R, by_rho


@compiled("Tuple((f8, f8[::1]))(f8[:], UniTuple(f8, 3), f8[:], f8, f8, f8)")
def _score_at(
    p: Array, measure: tuple[float, float, float], p_base: Array, A: float, B: float, C: float
) -> tuple[float, Array]:
    """S of (10) and ∇S (3,) at one point (3,), from the base's measure and its derivatives there.

    At the mount itself the distance has no direction: there R adds nothing to the gradient.
    """
    rho, R, by_rho = _reach(p, p_base, A, B, C)
    signed, by_x, by_y = measure
    gradient = np.empty(3)
    gradient[:] = p[0] - p_base[0], p[1] - p_base[1], p[2] - p_base[2]
    gradient *= signed * (by_rho / rho if rho > 0.0 else 0.0)
    gradient[0] += by_x * R
    gradient[1] += by_y * R
    return signed * R, gradient


@compiled("f8[::1](f8[:,:], f8[:], f8, f8, f8)")
def _reach_of(points: Array, p_base: Array, A: float, B: float, C: float) -> Array:
    """(N,) R at points (N, 3)."""
    found = np.empty(len(points))
    for k in range(len(points)):
        found[k] = _reach(points[k], p_base, A, B, C)[1]
    return found


@compiled("f8[:,::1](f8[:,:], f8[:,:], f8[:], f8, f8, f8)")
def _gradients(
    points: Array, measures: Array, p_base: Array, A: float, B: float, C: float
) -> Array:
    """(N, 3) ∇S at points (N, 3), from the base's measures and their derivatives (N, 3)."""
    found = np.empty(points.shape)
    for k in range(len(points)):
        measure = (measures[k, 0], measures[k, 1], measures[k, 2])
        found[k] = _score_at(points[k], measure, p_base, A, B, C)[1]
    return found


@dataclass(frozen=True)
class ScoreField:
    """The score for one robot and one of its bodies.

    Attributes:
        base: What stands in for the determinant of (7).
        p_base: (3,) [m] of (9).
        A: [1/m²], B: [m], C: [-] of (9).
    """

    base: BaseKind
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
        return cls(base, model.p_base(), reach.A_per_m2, reach.B_m, reach.C)

    def singularity(self, p: Array) -> Array:
        """(…) det(J_c J_cᵀ) of (7), or what stands in for it, at points (…, 3); without a sign."""
        return np.abs(self.base.singularity(p)[0])

    def reachability(self, p: Array) -> Array:
        """(…) R of (9) at points (…, 3)."""
        return reachability(p, self.p_base, self.A, self.B, self.C)

    def score(self, p: Array) -> Array:
        """(…) S of (10) at points (…, 3)."""
        return score(p, self.base, self.p_base, self.A, self.B, self.C)

    def gradient(self, p: Array) -> Array:
        """(…, 3) ∇S at points (…, 3)."""
        return score_gradient(p, self.base, self.p_base, self.A, self.B, self.C)

    def at_point(self, p: Array) -> tuple[float, Array]:
        """S and ∇S (3,) at one point (3,): `score` and `gradient` together, at little cost."""
        return _score_at(p, self.base.singularity_at(p), self.p_base, self.A, self.B, self.C)

    def direction(self, p: Array) -> Array:
        """(3,) ∇S/‖∇S‖ at a point (3,); on the wheels' axis its limit from both sides, e_x."""
        return uphill(self.gradient(p))
