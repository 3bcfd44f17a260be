"""The reachability by its distance from the arm's mount: means over shells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
