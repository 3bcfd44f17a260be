"""Vertices of a mesh file; read in a child process."""

from pathlib import Path

import numpy as np


def mesh_points(path: Path) -> np.ndarray:
    """(N, 3) the vertices of a mesh file, in its unit."""
    import trimesh

    loaded = trimesh.load(path, force="mesh")
    assert isinstance(loaded, trimesh.Trimesh)
    return np.array(loaded.vertices)
