"""§2.3, (9) to (11): the score of a point near the base, from base and arm.

Points are in the base's frame: origin on the floor under the base's centre, x forward. The
coefficients of (9) are a least-squares fit to a reachability map (§2.3.2), to its means in shells.
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
SHELL = 0.05  # [m] thickness of a shell
ROUNDING = 1e-6
"""[-] tolerance of a shell's inner border, relative to its thickness."""
_FEWEST = 20  # [-] values that a shell needs before its mean can be the peak


@dataclass(frozen=True)
class ScoreField:
    """The score for one robot and one of its bodies; points are (…, 3) [m]."""

    base: BaseKind
    """The base's measure in place of the determinant of (7), with its sign."""
    p_base: Array
    """(3,) [m] of (9), the arm's mount."""
    A: float
    """[1/m²] of (9), the curvature."""
    B: float
    """[m] of (9), the distance of the best reach."""
    C: float
    """[-] of (9), the best reach."""

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
        """(…) det(J_c J_cᵀ) of (7), or the base's measure in its place; without a sign."""
        return np.abs(self.base.singularity(p)[0])

    def reachability(self, p: Array) -> Array:
        """(…) [-] R, the density of joint positions that reach a point, by its distance from the
        mount.

        Paper: Eq. (9).
        Departs from the print: (9) is negative far from B and would change the score's sign. Below
        R_1 = 0.05 C it continues as R_1² / (2 R_1 − R), with the same value and slope at R_1:
        positive everywhere, with a gradient that never vanishes.
        """
        return self._fields(p)[..., 0]

    def score(self, p: Array) -> Array:
        """(…) [unit of the base's measure; m⁴/rad⁴ of a differential one] S, with its sign.

        It is positive where the base moves the point well; for the paper's base in front of the
        axis. A control step computes it with `score_at`.

        Paper: Eq. (10).
        Paper: Eq. (11).
        """
        return self._fields(p)[..., 1]

    def gradient(self, p: Array) -> Array:
        """(…, 3) ∇S by the point; zero on the axis of a differential base's wheels."""
        return self._fields(p)[..., 2:]

    def coefficients(self) -> Array:
        """(9,) the argument of `score_at`: the base's measure and its unit, p_base, A, B and C."""
        constant, per_square_metre = self.base.measure
        unit = self.base.score_unit
        return np.array(
            [constant, per_square_metre, unit, *self.p_base.tolist(), self.A, self.B, self.C]
        )

    def _fields(self, p: Array) -> Array:
        """(…, 5) R, S and ∇S."""
        p = np.asarray(p, dtype=float)
        signed, by_point = self.base.singularity(p)
        measures = np.column_stack([signed.ravel(), by_point.reshape(-1, 3)[:, :2]])
        found = _fields(p.reshape(-1, 3), measures, self.p_base, self.A, self.B, self.C)
        return found.reshape(*p.shape[:-1], 5)


Measure = tuple[float, float, float]
"""The base's measure of (7) at a point, with its sign, and its derivatives by x and y."""


@compiled()
def _field(
    p: Array, measure: Measure, p_base: Array, A: float, B: float, C: float
) -> tuple[float, float, float, float, float]:
    """R, S and ∇S at a point; at the mount the gradient of R is undefined and counts as 0."""
    x, y, z = p[0] - p_base[0], p[1] - p_base[1], p[2] - p_base[2]
    rho, R_1 = math.sqrt(x * x + y * y + z * z), FLOOR * C
    R, slope = C - A * (rho - B) ** 2, -2 * A * (rho - B)
    if R < R_1:
        low = R_1 / (2 * R_1 - R)
        R, slope = R_1 * low, slope * low**2
    signed, by_x, by_y = measure
    by_way = signed * (slope / rho if rho > 0.0 else 0.0)
    return R, signed * R, x * by_way + by_x * R, y * by_way + by_y * R, z * by_way


@compiled("f8[:,::1](f8[:,:], f8[:,:], f8[:], f8, f8, f8)")
def _fields(points: Array, measures: Array, p_base: Array, A: float, B: float, C: float) -> Array:
    """(N, 5) R, S and ∇S at points (N, 3), from measures (N, 3) there."""
    found = np.empty((len(points), 5))
    for k in range(len(points)):
        measure = (measures[k, 0], measures[k, 1], measures[k, 2])
        found[k] = _field(points[k], measure, p_base, A, B, C)
    return found


@compiled()
def score_at(coefficients: Array, p: Array) -> tuple[float, Array]:
    """S of (10) and (11), and ∇S (3,), at one point (3,) [m], with `ScoreField.coefficients`."""
    constant, quadratic = coefficients[0], coefficients[1]
    measure = (constant + quadratic * p[0] * abs(p[0]), 2 * quadratic * abs(p[0]), 0.0)
    A, B, C = coefficients[6], coefficients[7], coefficients[8]
    _, score, x, y, z = _field(p, measure, coefficients[3:6], A, B, C)
    return score, np.array([x, y, z])


@dataclass(frozen=True)
class RadialProfile:
    """Reachability over the distance from the mount, shell by shell from the mount outwards."""

    rho_m: Array
    """(K,) [m] middle of each shell."""
    mean: Array
    """(K,) mean of the values in each shell, NaN without values."""
    spread: Array
    """(K,) standard deviation of the values in each shell."""
    count: Array
    """(K,) number of values in each shell."""

    def peak(self) -> int:
        """The shell with the largest mean, among those with enough values.

        Raises:
            ValueError: No shell has enough values.
        """
        enough = self.count >= min(_FEWEST, self.count.max(initial=0))
        if not self.count.any():
            raise ValueError("there are no values")
        return int(np.argmax(np.where(enough & (self.count > 0), self.mean, -np.inf)))

    def band(self, share: float) -> tuple[float, float]:
        """[m] the uninterrupted run of shells around the peak above a share of its mean."""
        first = last = self.peak()
        good = self.mean >= share * self.mean[first]
        while first > 0 and good[first - 1]:
            first -= 1
        while last + 1 < len(good) and good[last + 1]:
            last += 1
        half = (self.rho_m[1] - self.rho_m[0]) / 2 if len(self.rho_m) > 1 else self.rho_m[0]
        return float(max(self.rho_m[first] - half, 0.0)), float(self.rho_m[last] + half)


def radial_profile(rho: Array, reach: Array, shell: float = SHELL) -> RadialProfile:
    """Means of values (N,) at distances rho (N,) [m] from the mount, over shells [m] thick."""
    # Positions of a lattice may be on the border of two shells: rounding must not decide.
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
    """[1/m²] of (9), the curvature."""
    B_m: float
    """[m] of (9), the distance of the best reach."""
    C: float
    """[-] of (9), the best reach."""
    r_squared: float
    """Share of the variance of the means over shells of ρ that (9) explains, each mean weighted by
    its number of positions."""
    rms: float
    """Root mean square of the residuals of those means, in units of the reachability."""
    r_squared_positions: float
    """The same share for single positions, which scatter by the counting and by direction, which
    (9) does not include."""
    rho_min_m: float
    """[m] the smallest fitted distance."""
    rho_max_m: float
    """[m] the largest fitted distance."""
    points: int
    """Positions fitted."""

    def at(self, rho: Array) -> Array:
        """(9) at distances rho [m], as printed: it may be negative."""
        return self.C - self.A_per_m2 * (np.asarray(rho) - self.B_m) ** 2


def fit_parabola(rho: Array, reach: Array, share: float = FLOOR) -> ReachFit:
    """Ordinary least squares of (9) with equal weights.

    Paper: Eq. (9).
    The fit covers the uninterrupted range of distances around the peak with means of at least a
    share [-] of the peak. The default is 0.05, where `ScoreField.reachability` starts to modify
    (9). The values (N,) [-] at distances rho (N,) [m] from the arm's mount include those of zero.

    Raises:
        ValueError: There are too few values, or they are not concave.
    """
    rho, reach = np.asarray(rho, dtype=float), np.asarray(reach, dtype=float)
    low, high = radial_profile(rho, reach).band(share)
    slack = ROUNDING * SHELL
    chosen = (rho >= low - slack) & (rho < high - slack)
    x, y = rho[chosen], reach[chosen]
    if len(np.unique(x)) < 4:
        raise ValueError("it is above zero at too few distances")
    polynomial = np.polynomial.Polynomial.fit(x, y, 2)
    c, b, a = polynomial.convert().coef
    if not a < 0 < b:
        raise ValueError("it does not fall off on both sides of a best distance")
    B = -b / (2 * a)
    left = y - polynomial(x)
    r_squared, rms = _radial_quality(x, y, left)
    return ReachFit(
        A_per_m2=float(-a),
        B_m=float(B),
        C=float(c - a * B**2),
        r_squared=r_squared,
        rms=rms,
        r_squared_positions=_explained(y, left),
        rho_min_m=float(x.min()),
        rho_max_m=float(x.max()),
        points=len(x),
    )


def _explained(y: Array, left: Array, weight: Array | None = None) -> float:
    total = np.average((y - np.average(y, weights=weight)) ** 2, weights=weight)
    return float(1 - np.average(left**2, weights=weight) / total) if total > 0 else 1.0


def _radial_quality(x: Array, y: Array, left: Array) -> tuple[float, float]:
    """R² and RMS residual of the means over shells."""
    values, rest = radial_profile(x, y), radial_profile(x, left)
    there = values.count > 0
    mean, missed, weight = values.mean[there], rest.mean[there], values.count[there]
    rms = np.sqrt(np.average(missed**2, weights=weight))
    return _explained(mean, missed, weight), float(rms)
