"""Vertices of a mesh file; imported only where one is read, as trimesh takes long to import."""

from pathlib import Path

import numpy as np
import trimesh


def mesh_points(path: Path) -> np.ndarray:
    """(N, 3) the vertices of a mesh file, in its unit."""
    loaded = trimesh.load(path, force="mesh")
    assert isinstance(loaded, trimesh.Trimesh)
    return np.array(loaded.vertices)
