"""Strata of the sampling: voxels of plan and height around the mobile robot, cut into sectors."""

from __future__ import annotations

import numpy as np

from app.border.cloud import POINT_RANGE, POINT_UNIT
from app.errors import DescriptionError

Array = np.ndarray

_STEPS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


class Voxels:
    """A grid over the box of all points up to `reach` from l_m and above the floor.

    Points are int16 in units of 0.1 mm, so that a point's voxel is exact and the same everywhere.

    Attributes:
        shape: (3,) number of voxels along x, y and z.
        count: Number of voxels.
    """

    def __init__(
        self, lower: Array, upper: Array, *, reach: float, size: Array, sectors: int
    ) -> None:
        """Lay the grid.

        Args:
            lower: (3,) [m] lower corner of a box around l_m in the base's frame.
            upper: (3,) [m] its upper corner.
            reach: [m] largest distance from l_m.
            size: (3,) [m] sides of a voxel, multiples of the points' resolution.
            sectors: Number of sectors of plan angle about the base's centre.

        Raises:
            DescriptionError: The base is too large for the points' range.
        """
        low, high = lower - reach, upper + reach
        if max(np.abs(low).max(), np.abs(high).max()) > POINT_RANGE:
            raise DescriptionError(
                f"bodies: the mobile robot reaches further than {POINT_RANGE - reach:g} m "
                "from the base's centre; the border cannot be kept"
            )
        low[2] = 0.0  # nothing of interest is under the floor
        self._size = np.rint(size / POINT_UNIT).astype(int)
        self._origin = np.floor(low / POINT_UNIT / self._size).astype(int) * self._size
        span = np.ceil(high / POINT_UNIT).astype(int) - self._origin
        self.shape = np.maximum(-(-span // self._size), 1)
        self.count = int(self.shape.prod())
        self._sectors = sectors

    def cells(self, points: Array) -> Array:
        """(N, 3) cell along x, y and z of points (N, 3) int16; may lie outside of the grid."""
        return (points - self._origin) // self._size

    def keys(self, cells: Array) -> Array:
        """(N,) number of each cell (N, 3), or −1 outside of the grid."""
        inside = ((cells >= 0) & (cells < self.shape)).all(axis=-1)
        nx, ny, _ = self.shape
        return np.where(inside, (cells[..., 2] * ny + cells[..., 1]) * nx + cells[..., 0], -1)

    def neighbours(self, cells: Array) -> Array:
        """(N, 6, 3) the cells that share a face with each cell (N, 3)."""
        return cells[:, None, :] + _STEPS

    def centres(self, cells: Array) -> Array:
        """(…, 3) [m] centre of each cell (…, 3)."""
        return ((cells + 0.5) * self._size + self._origin) * POINT_UNIT

    def sector_mask(self, sector: int) -> Array:
        """(count,) whether each voxel lies in a sector."""
        return np.tile(self._plan_sectors().ravel() == sector, int(self.shape[2]))

    def sectors(self, keys: Array) -> Array:
        """(…) sector of each voxel by its number (…)."""
        return self._plan_sectors().ravel()[keys % (self.shape[0] * self.shape[1])]

    def leads_to(self, points: Array, free: Array) -> Array:
        """(N, 7) sectors of the free voxels at and beside each point (N, 3) int16, else −1."""
        cells = self.cells(points)
        around = np.concatenate([cells[:, None], self.neighbours(cells)], axis=1)
        keys = self.keys(around)
        return np.where((keys >= 0) & free[keys], self.sectors(keys), -1)

    def _plan_sectors(self) -> Array:
        """(ny, nx) sector of each column of voxels.

        The sectors are turned by half of one, so that no seam lies on the wheels' axis.
        """
        x = (np.arange(self.shape[0]) + 0.5) * self._size[0] + self._origin[0]
        y = (np.arange(self.shape[1]) + 0.5) * self._size[1] + self._origin[1]
        turn = np.arctan2(y[:, None], x[None, :]) / (2 * np.pi) + 0.5 / self._sectors
        return np.floor(turn % 1.0 * self._sectors).astype(int) % self._sectors
