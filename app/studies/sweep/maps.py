"""The maps that sweeps have left in a folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np

Array = np.ndarray


def newest_map(folder: Path) -> Path | None:
    """The picture of the newest sweep from the side in a folder, or None."""
    found = list(folder.glob("sweep_h*_v*.png")) if folder.is_dir() else []
    return max(found, key=lambda path: (path.stat().st_mtime_ns, path.name), default=None)


def read_map(path: Path) -> Array:
    """(H, W, 3) the picture's pixels, 0 to 255."""
    # Imported here: matplotlib would make the dashboard start later.
    from matplotlib.image import imread

    pixels = imread(path)[..., :3]
    return np.round(255.0 * pixels).astype(np.uint8)
