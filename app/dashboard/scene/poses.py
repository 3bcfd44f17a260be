"""Poses between pinocchio's way of writing them and viser's."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

Array = np.ndarray


def to_viser(T: pin.SE3) -> tuple[Array, Array]:
    """Position (3,) [m] and quaternion wxyz (4,) of a pose."""
    xyzquat = np.array(pin.SE3ToXYZQUAT(T))
    return xyzquat[:3], xyzquat[[6, 3, 4, 5]]


def from_viser(position: Array, wxyz: Array) -> pin.SE3:
    """The pose of a position (3,) [m] and a quaternion wxyz (4,)."""
    return pin.XYZQUATToSE3(np.concatenate([position, wxyz[1:], wxyz[:1]]))


def moved(T: pin.SE3, points: np.ndarray) -> np.ndarray:
    """(N, 3) points of one frame in another."""
    return points @ T.rotation.T + T.translation
