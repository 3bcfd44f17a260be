"""The coefficients of (9) that fit a reachability map best."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border.reach.map import ReachMap
from app.border.reach.radial import ROUNDING, SHELL, radial_profile
from app.border.score import FLOOR
from app.errors import DescriptionError

Array = np.ndarray


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
    which the mean is at least a share of the peak's: 0.05, below which `score.reachability` bends
    (9), unless another is asked for.

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
