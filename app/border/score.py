"""§2.3, (9) to (11): the score of a point near the base, from base and arm.

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


@dataclass(frozen=True)
class ScoreField:
    """The score for one robot and one of its bodies; points are (…, 3) [m].

    Attributes:
        base: What stands in for the determinant of (7), with its sign.
        p_base: (3,) [m] of (9), the arm's mount.
        A: [1/m²] of (9), the curvature.
        B: [m] of (9), the distance of the best reach.
        C: [-] of (9), the best reach.
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
        """(…) det(J_c J_cᵀ) of (7), or what stands in for it; without a sign."""
        return np.abs(self.base.singularity(p)[0])

    def reachability(self, p: Array) -> Array:
        """(…) [-] R, how many ways the arm has to reach a point, by the distance from its mount.

        Paper: Eq. (9).
        Departs from the print: (9) turns negative far from B and would turn the score's sign. Below
        R_1 = 0.05 C it goes on as R_1² / (2 R_1 − R), with the same value and slope at R_1:
        positive everywhere, and its gradient never vanishes.
        """
        return self._fields(p)[..., 0]

    def score(self, p: Array) -> Array:
        """(…) [unit of the base's measure; m⁴/rad⁴ of a differential one] S, the sign with it.

        Positive where the base moves the point well; for the paper's base in front of the axis.

        Paper: Eq. (10).
        Paper: Eq. (11).
        """
        return self._fields(p)[..., 1]

    def gradient(self, p: Array) -> Array:
        """(…, 3) ∇S by the point; zero on the axis of a differential base's wheels."""
        return self._fields(p)[..., 2:]

    def at_point(self, p: Array) -> tuple[float, Array]:
        """S and ∇S (3,) at one point (3,): `score` and `gradient` together, at little cost."""
        measure = np.array([self.base.singularity_at(p)])
        field = _fields(p[None], measure, self.p_base, self.A, self.B, self.C)[0]
        return field[1], field[2:]

    def direction(self, p: Array) -> Array:
        """(3,) ∇S/‖∇S‖ at a point (3,); on the wheels' axis its limit from both sides, e_x."""
        return uphill(self.gradient(p))

    def _fields(self, p: Array) -> Array:
        """(…, 5) R, S and ∇S."""
        p = np.asarray(p, dtype=float)
        signed, by_point = self.base.singularity(p)
        measures = np.column_stack([signed.ravel(), by_point.reshape(-1, 3)[:, :2]])
        found = _fields(p.reshape(-1, 3), measures, self.p_base, self.A, self.B, self.C)
        return found.reshape(*p.shape[:-1], 5)


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


@compiled("f8[:,::1](f8[:,:], f8[:,:], f8[:], f8, f8, f8)")
def _fields(points: Array, measures: Array, p_base: Array, A: float, B: float, C: float) -> Array:
    """(N, 5) R, S and ∇S at points (N, 3), from the base's measures and their derivatives (N, 3).

    At the mount itself the distance has no direction: there R adds nothing to the gradient.
    """
    found, R_1 = np.empty((len(points), 5)), FLOOR * C
    for k in range(len(points)):
        way = points[k] - p_base
        rho = math.sqrt(way[0] ** 2 + way[1] ** 2 + way[2] ** 2)
        R, slope = C - A * (rho - B) ** 2, -2 * A * (rho - B)
        if R < R_1:
            low = R_1 / (2 * R_1 - R)
            R, slope = R_1 * low, slope * low**2
        signed, by_x, by_y = measures[k]
        found[k, 0], found[k, 1] = R, signed * R
        found[k, 2:] = way * (signed * (slope / rho if rho > 0.0 else 0.0))
        found[k, 2] += by_x * R
        found[k, 3] += by_y * R
    return found
