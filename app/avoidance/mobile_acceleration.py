"""GenerateMobAcc: the force on the base and the accelerations that realise it (§3.1)."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from app.robot.bases.kind import BaseForce, BaseKind

Array = np.ndarray


class PairForce(NamedTuple):
    """The force of one pair of L_m, in the base's frame.

    Attributes:
        f: (3,) [N] f_m,i.
        p_act: (3,) [m] where it acts.
    """

    f: Array
    p_act: Array


def avoidance_force(
    p_b: Array, p_act: Array, d: float, n: Array, *, f_max: float, d_b: float
) -> Array:
    """f_m,i: from the acting point towards the closest point, stronger the nearer they are.

    f = f_max (1 - d/d_b) (1 - n_z²) (p_b - p_act) / ‖p_b - p_act‖. The magnitude is kept in
    [0, f_max]. The factor 1 - n_z² is our extension: over the base's flat top no horizontal force
    helps, and there it vanishes; from the side it is 1. At p_b = p_act the direction is that of -n
    in the plane.

    Paper: Eq. (14).

    Args:
        p_b: (3,) [m] closest point on the arm, in the base's frame.
        p_act: (3,) [m] acting point, at the same height.
        d: [m] signed distance of the pair.
        n: (3,) unit normal of the pair from the base to the arm, in the base's frame.
        f_max: [N] force at contact.
        d_b: [m] buffer distance.

    Returns:
        (3,) [N], horizontal.
    """
    magnitude = f_max * min(max(1.0 - d / d_b, 0.0), 1.0) * max(1.0 - float(n[2]) ** 2, 0.0)
    direction = p_b - p_act
    length = math.sqrt(direction @ direction)
    if length < 1e-6:  # [m]
        direction = np.array([-n[0], -n[1], 0.0])
        length = math.sqrt(direction @ direction)
    return magnitude / length * direction if length > 0.0 else np.zeros(3)


def resultant_force(forces: Iterable[PairForce]) -> Array:
    """f_m, the sum over the pairs of L_m, (3,) [N].

    Paper: Eq. (15).
    """
    return sum((force.f for force in forces), np.zeros(3))


def generate_mob_acc(forces: Iterable[PairForce], base: BaseKind) -> Array:
    """ẍ_m: what the forces do to the base as it can move, with its frame's origin as the centre.

    Paper: Eq. (16).

    Args:
        forces: Force and acting point of each pair of L_m, in the base's frame.
        base: The base.

    Returns:
        (n_b,) [m/s² or rad/s²] along the base's axes.
    """
    forces = tuple(forces)
    if not forces:
        return np.zeros(base.n_b)
    f_m, torque = resultant_force(forces), 0.0
    for f, p_act in forces:
        (f_x, f_y, _), (x, y, _) = f.tolist(), p_act.tolist()
        torque += x * f_y - y * f_x
    return base.acceleration(BaseForce(float(f_m[0]), float(f_m[1]), torque))
