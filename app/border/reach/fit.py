"""The coefficients of (9) that fit a reachability map best, and its means over shells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from app.border.score import FLOOR
from app.errors import DescriptionError

if TYPE_CHECKING:
    from app.border.reach.map import ReachMap

Array = np.ndarray

SHELL = 0.05
"""[m] thickness of a shell."""
ROUNDING = 1e-6
"""[-] share of a shell's thickness below which a distance counts as its inner border."""
_FEWEST = 20  # [-] values that a shell needs before its mean can be the peak


@dataclass(frozen=True)
class RadialProfile:
    """Reachability over the distance from the mount, shell by shell from the mount outwards.

    Attributes:
        rho_m: (K,) [m] middle of each shell.
        mean: (K,) mean of the values in it, not a number where there is none.
        spread: (K,) standard deviation of the values in it.
        count: (K,) number of values in it.
    """

    rho_m: Array
    mean: Array
    spread: Array
    count: Array

    def peak(self) -> int:
        """The shell with the largest mean; shells of few values do not compete.

        Raises:
            ValueError: No shell has enough values.
        """
        enough = self.count >= min(_FEWEST, self.count.max(initial=0))
        if not self.count.any():
            raise ValueError("there are no values")
        return int(np.argmax(np.where(enough & (self.count > 0), self.mean, -np.inf)))

    def band(self, share: float) -> tuple[float, float]:
        """[m] the unbroken run of shells around the peak whose mean is at least a share of its."""
        first = last = self.peak()
        good = self.mean >= share * self.mean[first]
        while first > 0 and good[first - 1]:
            first -= 1
        while last + 1 < len(good) and good[last + 1]:
            last += 1
        half = (self.rho_m[1] - self.rho_m[0]) / 2 if len(self.rho_m) > 1 else self.rho_m[0]
        return float(max(self.rho_m[first] - half, 0.0)), float(self.rho_m[last] + half)


def radial_profile(rho: Array, reach: Array, shell: float = SHELL) -> RadialProfile:
    """Means over shells.

    Args:
        rho: (N,) [m] distances from the mount.
        reach: (N,) values there.
        shell: [m] thickness of a shell.
    """
    # Positions of a lattice may stand on the border of two shells: rounding must not decide.
    index = np.floor(np.asarray(rho) / shell + ROUNDING).astype(int)
    size = int(index.max(initial=-1)) + 1
    count = np.bincount(index, minlength=size)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.bincount(index, reach, size) / count
        square = np.bincount(index, (reach - mean[index]) ** 2, size) / count
    return RadialProfile((np.arange(size) + 0.5) * shell, mean, np.sqrt(square), count)


class ReachFit(NamedTuple):
    """A, B, C of (9) and how well they describe the map.

    Attributes:
        A_per_m2, B_m, C: The coefficients.
        r_squared: Share of the variance that (9) explains, of the means over shells of ρ, each
            weighted by its positions.
        rms: Root mean square of what is left of those means, in units of the reachability.
        r_squared_positions: The same share for the single positions, whose values scatter by the
            counting and by direction, which (9) does not know.
        rho_min_m, rho_max_m: [m] the distances fitted.
        points: Positions fitted.
    """

    A_per_m2: float
    B_m: float
    C: float
    r_squared: float
    rms: float
    r_squared_positions: float
    rho_min_m: float
    rho_max_m: float
    points: int

    def at(self, rho: Array) -> Array:
        """(9) at distances rho [m], as printed: it may be negative."""
        return self.C - self.A_per_m2 * (np.asarray(rho) - self.B_m) ** 2


def fit_reachability(reach_map: ReachMap, share: float = FLOOR) -> ReachFit:
    """A, B, C of (9) for a map.

    Args:
        reach_map: The map.
        share: [-] of the peak, as `fit_parabola`.

    Raises:
        DescriptionError: The map does not rise and fall with the distance from the mount.
    """
    try:
        return fit_parabola(reach_map.rho, reach_map.reach, share)
    except ValueError as error:
        raise DescriptionError(f"{reach_map.body}: (9) does not fit its map: {error}") from None


def fit_parabola(rho: Array, reach: Array, share: float = FLOOR) -> ReachFit:
    """Ordinary least squares of (9), each value counting the same.

    Paper: Eq. (9).
    It is fitted where it is meaningful: over the unbroken range of distances around the peak in
    which the mean is at least a share of the peak's: 0.05, below which `ScoreField.reachability`
    bends (9), unless another is asked for.

    Args:
        rho: (N,) [m] distances from the arm's mount.
        reach: (N,) [-] values there, those of zero included.
        share: [-] of the peak above which the mean over a shell has to be.

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
    if not a < 0:
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
