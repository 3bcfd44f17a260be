"""§2.3, (9) to (11): the score of a point, by the base's singularity and the arm's reachability.

Points are in the base's frame: the origin is on the floor under the base's centre, x is forward.
The coefficients of (9) are a least-squares fit to a reachability map (§2.3.2).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from app.compiled import compiled
from app.errors import DescriptionError
from app.robot.bases.kind import BaseKind
from app.robot.model import RobotModel
from app.strict import Array

FLOOR = 0.05  # [-] share of C below which the reachability of (9) is modified to stay positive
SHELL = 0.05  # [m] thickness of a shell around the mount
ROUNDING = 1e-6  # [-] tolerance of a shell's inner border, relative to the shell's thickness
_FEWEST = 20  # [-] smallest number of values in a shell whose mean can be the peak


@dataclass(frozen=True)
class ScoreField:
    """The score 𝒮 of points (…, 3) [m] in the base's frame, for one body of a robot's arm."""

    base: BaseKind  # the base, whose signed measure replaces the determinant of (7)
    p_base: Array  # (3,) [m] p_base of (9), the arm's mount
    A: float  # [1/m²] A of (9), half of the curvature at the peak
    B: float  # [m] B of (9), the distance of the best reachability
    C: float  # [-] C of (9), the best reachability

    @classmethod
    def of(cls, model: RobotModel, body: str) -> ScoreField:
        """The score for a body of the arm; raises a DescriptionError if A, B and C are missing."""
        robot = model.description
        if (reach := robot.reachability.get(body)) is None:
            why = f"{robot.name}/robot.toml: reachability.{body}: missing"
            raise DescriptionError(f"{why}; it is required because the body can meet the base")
        return cls(robot.base, model.p_base(), reach.A_per_m2, reach.B_m, reach.C)

    def singularity(self, p: Array) -> Array:
        """(…) |measure| at p (…, 3) [m]; for a differential base, this is det(J_c J_cᵀ) of (7)."""
        return np.abs(self.base.measure.at(np.asarray(p, dtype=float)[..., 0]))

    def reachability(self, p: Array) -> Array:
        """(…) [-] R at p (…, 3) [m], a function of the distance from the mount.

        Paper: Eq. (9).
        Departure: at distances that differ much from B, (9) is negative and would change the
        score's sign. Where (9) is below R_1 = 0.05 C, R_1² / (2 R_1 − R) replaces it, with the same
        value and slope at R_1. Thus R is positive everywhere, and its gradient is zero only at B.
        """
        return self._fields(p)[..., 0]

    def score(self, p: Array) -> Array:
        """(…) S at p (…, 3) [m], with the sign and in the unit of the base's measure.

        Paper: Eq. (10), (11).
        """
        return self._fields(p)[..., 1]

    def gradient(self, p: Array) -> Array:
        """(…, 3) ∇S, the gradient with respect to the points p (…, 3) [m]."""
        return self._fields(p)[..., 2:]

    def coefficients(self) -> Array:
        """(9,) the argument of `field_at`: the base's measure, its score unit, p_base, A, B, C."""
        measure, unit = self.base.measure, self.base.score_unit
        return np.array([*measure, unit, *self.p_base.tolist(), self.A, self.B, self.C])

    def _fields(self, p: Array) -> Array:
        p = np.asarray(p, dtype=float)
        return _fields_at(self.coefficients(), p.reshape(-1, 3)).reshape(*p.shape[:-1], 5)


@compiled()
def field_at(coefficients: Array, p: Array) -> tuple[float, float, Array]:
    """R of (9), S of (10) and (11), and ∇S (3,), at p (3,) [m], from `ScoreField.coefficients`.
    Low R is modified as in `ScoreField.reachability`; ∇R, undefined at the mount, is 0 there.
    """
    constant, quadratic, p_base = coefficients[0], coefficients[1], coefficients[3:6]
    A, B, C = coefficients[6], coefficients[7], coefficients[8]
    signed, by_x = constant + quadratic * p[0] * abs(p[0]), 2 * quadratic * abs(p[0])
    x, y, z = p[0] - p_base[0], p[1] - p_base[1], p[2] - p_base[2]
    rho, R_1 = math.sqrt(x * x + y * y + z * z), FLOOR * C
    R, slope = C - A * (rho - B) ** 2, -2 * A * (rho - B)
    if R < R_1:
        low = R_1 / (2 * R_1 - R)
        R, slope = R_1 * low, slope * low**2
    by_way = signed * (slope / rho if rho > 0.0 else 0.0)
    # The sum with 0 turns −0 into 0.
    return R, signed * R, np.array([x * by_way + by_x * R, y * by_way + 0.0, z * by_way])


@compiled("f8[:,::1](f8[:], f8[:,:])")
def _fields_at(coefficients: Array, points: Array) -> Array:
    """(N, 5) R, S and ∇S at points (N, 3)."""
    found = np.empty((len(points), 5))
    for k in range(len(points)):
        found[k, 0], found[k, 1], found[k, 2:] = field_at(coefficients, points[k])
    return found


@dataclass(frozen=True)
class RadialProfile:
    """Values as a function of the distance from the arm's mount, for K shells around the mount."""

    rho_m: Array  # (K,) [m] middle of each shell
    mean: Array  # (K,) mean of the values in each shell, NaN without values
    spread: Array  # (K,) standard deviation of the values in each shell
    count: Array  # (K,) number of values in each shell

    def peak(self) -> int:
        """Index of the shell with the largest mean. Only shells with at least 20 values count or,
        if there are none, those with the most values. A ValueError if all shells are empty.
        """
        if not self.count.any():
            raise ValueError("there are no values")
        enough = self.count >= min(_FEWEST, self.count.max())
        return int(np.argmax(np.where(enough, self.mean, -np.inf)))

    def band(self, share: float) -> tuple[float, float]:
        """The range [m] around the peak in which each mean is at least `share` times the peak's."""
        peak = self.peak()
        low = np.flatnonzero(~(self.mean >= share * self.mean[peak]))  # also shells without values
        first = low[low < peak].max(initial=-1) + 1
        last = low[low > peak].min(initial=len(self.mean)) - 1
        half = (self.rho_m[1] - self.rho_m[0]) / 2 if len(self.rho_m) > 1 else self.rho_m[0]
        return float(max(self.rho_m[first] - half, 0.0)), float(self.rho_m[last] + half)


def radial_profile(rho: Array, reach: Array, shell: float = SHELL) -> RadialProfile:
    """The profile of values `reach` (N,) at distances rho (N,) [m], in shells `shell` [m] thick."""
    # A lattice has positions on the border of two shells; their shell must not depend on rounding.
    index = np.floor(np.asarray(rho) / shell + ROUNDING).astype(int)
    size = int(index.max(initial=-1)) + 1
    count = np.bincount(index, minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(index, reach, size) / count
        square = np.bincount(index, (reach - mean[index]) ** 2, size) / count
    return RadialProfile((np.arange(size) + 0.5) * shell, mean, np.sqrt(square), count)


class ReachFit(NamedTuple):
    """A, B, C of (9) and the quality of the fit."""

    A_per_m2: float
    B_m: float
    C: float
    r_squared: float
    """[-] share of the variance of the shells' means that (9) explains; the number of positions in
    a shell is the weight of its mean."""
    rms: float  # [-] root mean square of the residuals of the shells' means, with the same weights
    r_squared_positions: float  # [-] share of the variance of single positions that (9) explains
    rho_min_m: float  # [m] smallest fitted distance
    rho_max_m: float  # [m] largest fitted distance
    points: int  # number of fitted positions

    def at(self, rho: Array) -> Array:
        """(9) as printed, at distances rho [m]; the value can be negative."""
        return self.C - self.A_per_m2 * (np.asarray(rho) - self.B_m) ** 2


def fit_parabola(rho: Array, reach: Array, share: float = FLOOR) -> ReachFit:
    """Fit (9) by least squares to positions at distances rho (N,) [m] from the arm's mount.

    `reach` (N,) [-] is the reachability of each position. The fit uses the positions in the best
    shell and, on both sides of it, in all shells before the first one with a mean below `share` [-]
    of the best mean. Raises a ValueError if these positions have fewer than four different
    distances, or if the parabola has no maximum at a positive distance.

    Paper: Eq. (9).
    """
    rho, reach = np.asarray(rho, dtype=float), np.asarray(reach, dtype=float)
    low, high = radial_profile(rho, reach).band(share)
    slack = ROUNDING * SHELL
    chosen = (rho >= low - slack) & (rho < high - slack)
    x, y = rho[chosen], reach[chosen]
    if len(np.unique(x)) < 4:
        raise ValueError("the reachability is above zero at too few distances")
    polynomial = np.polynomial.Polynomial.fit(x, y, 2)
    c, b, a = polynomial.convert().coef
    if not a < 0 < b:
        raise ValueError("the reachability does not decrease on both sides of a best distance")
    B, left = -b / (2 * a), y - polynomial(x)
    values, rest = radial_profile(x, y), radial_profile(x, left)
    there = values.count > 0
    mean, missed, weight = values.mean[there], rest.mean[there], values.count[there]
    return ReachFit(
        A_per_m2=float(-a),
        B_m=float(B),
        C=float(c - a * B**2),
        r_squared=_explained(mean, missed, weight),
        rms=float(np.sqrt(np.average(missed**2, weights=weight))),
        r_squared_positions=_explained(y, left),
        rho_min_m=float(x.min()),
        rho_max_m=float(x.max()),
        points=len(x),
    )


def _explained(y: Array, left: Array, weight: Array | None = None) -> float:
    """[-] R²: 1 − mean square of the residuals `left` / variance of y; 1 for a constant y."""
    total = np.average((y - np.average(y, weights=weight)) ** 2, weights=weight)
    return float(1 - np.average(left**2, weights=weight) / total) if total > 0 else 1.0
