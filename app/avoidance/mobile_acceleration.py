"""Where the force on the base acts, and what it does to the base (Algorithm 3, §3.1).

The search of FindActingPoint is done in the base's frame. The border moves with the base, whose
motion is planar, so nothing changes but the cost: one point is transformed instead of fifty
thousand.
"""

import math
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np

from app.border.contours import NearestBorder
from app.border.score import ScoreField
from app.compiled import compiled
from app.config import ForceConfig
from app.robot.bases.kind import BaseForce, BaseKind
from app.strict import Array


class ActingPoint(NamedTuple):
    """Result of Algorithm 3, in the base's frame; all at the height of p_b."""

    p_n: Array
    """(3,) [m] point of the border nearest to p_b at its height."""
    p_t: Array
    """(3,) [m] p_n moved along the tangent towards a better score."""
    p_act: Array
    """(3,) [m] acting point, the point of the border nearest to p_t."""
    t: Array
    """(3,) unit tangent, horizontal."""
    alpha: float
    """[m] step size."""


def step_size(d: float, score: float, force: ForceConfig) -> float:
    """α = S_0 d / (|S(p_n)| + S_0/2), bounded below and above, in metres; S_0 is `alpha_gain`.

    Where the base moves the point well it is in proportion to d / |S|. Near the wheel axis, where S
    vanishes, that ratio would race from bound to bound within millimetres; this one is 2 d there,
    enough for the force to turn the base, and changes no faster than that.

    Paper: Eq. (13). Bounds as Figure 8b asks: too large a step leaves no component of the force
    along the line between the hand and the border.
    """
    proportional = force.alpha_gain * max(d, 0.0) / max(abs(score) + force.alpha_gain / 2.0, 1e-12)
    return min(max(proportional, force.alpha_min), force.alpha_max)


@compiled("f8[::1](f8[:])")
def uphill(gradient: Array) -> Array:
    """(3,) ∇S/‖∇S‖ from ∇S (3,); where ∇S = 0, on the wheels' axis, its limit e_x."""
    norm = math.sqrt((gradient**2).sum())
    direction = np.array([1.0, 0.0, 0.0])
    if norm > 0.0:
        direction[:] = gradient / norm
    return direction


@compiled("f8[::1](f8[:], f8[:], f8)")
def tangential_step(gradient: Array, t: Array, alpha: float) -> Array:
    """α (∇S·t / ‖∇S‖) t, (3,) [m].

    Paper: Eq. (12). On the wheel axis ∇S = 0 and the quotient is 0/0; its limit from both sides is
    the direction +e_x.
    """
    return alpha * (uphill(gradient) * t).sum() * t


class ActingPointFinder:
    """Algorithm 3 for one pair of L_m, on its border as points or as a surface."""

    def __init__(self, border: NearestBorder, field: ScoreField) -> None:
        self.field = field
        self._border, self._unit = border, field.base.score_unit

    def find_acting_point(self, p_b: Array, d: float, force: ForceConfig) -> ActingPoint | None:
        """The acting point for the closest point p_b.

        Paper: Algorithm 3.

        Args:
            p_b: (3,) [m] closest point on the arm, in the base's frame.
            d: [m] distance of the pair.
            force: Step bounds.

        Returns:
            The acting point, or None if l_m has no border at all.
        """
        foot = self._border.nearest(p_b)
        if foot is None:
            return None
        p_n, t = foot
        score, gradient = self.field.at_point(p_n)
        alpha = step_size(d, score / self._unit, force)
        p_t = p_n + tangential_step(gradient, t, alpha)
        nearest = self._border.nearest(p_t)
        assert nearest is not None
        return ActingPoint(p_n, p_t, nearest.p, t, alpha)


class PairForce(NamedTuple):
    """The force of one pair of L_m, in the base's frame."""

    f: Array
    """(3,) [N] f_m,i."""
    p_act: Array
    """(3,) [m] where it acts."""


@compiled("f8[::1](f8[:], f8[:], f8, f8[:], f8, f8)")
def avoidance_force(
    p_b: Array, p_act: Array, d: float, n: Array, f_max: float, d_b: float
) -> Array:
    """f_m,i: from the acting point towards the closest point, stronger the nearer they are.

    f = f_max (1 - d/d_b) ‖n_xy‖ (p_b - p_act) / ‖p_b - p_act‖. The magnitude is kept in [0, f_max].
    The factor ‖n_xy‖ is our extension: of a force along n the horizontal part; over the base's flat
    top, where no horizontal force helps, it vanishes, and from the side it is 1. At p_b = p_act the
    direction is that of -n in the plane.

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
    magnitude = f_max * min(max(1.0 - d / d_b, 0.0), 1.0) * math.sqrt(n[0] ** 2 + n[1] ** 2)
    direction = p_b - p_act
    length = math.sqrt((direction**2).sum())
    if length < 1e-6:  # [m]
        direction = np.array([-n[0], -n[1], 0.0])
        length = math.sqrt((direction**2).sum())
    return magnitude / length * direction if length > 0.0 else np.zeros(3)


def resultant_force(forces: Iterable[PairForce]) -> BaseForce:
    """f_m, the sum over the pairs of L_m, with its torque about the base's centre.

    Paper: Eq. (15).
    """
    along = across = torque = 0.0
    for f, p_act in forces:
        (f_x, f_y, _), (x, y, _) = f.tolist(), p_act.tolist()
        along, across, torque = along + f_x, across + f_y, torque + x * f_y - y * f_x
    return BaseForce(along, across, torque)


def generate_mob_acc(forces: Iterable[PairForce], base: BaseKind) -> Array:
    """ẍ_m: what the forces do to the base as it can move, with its frame's origin as the centre.

    Paper: Eq. (16).

    Args:
        forces: Force and acting point of each pair of L_m, in the base's frame.
        base: The base.

    Returns:
        (n_b,) [m/s² or rad/s²] along the base's axes.
    """
    return base.acceleration(resultant_force(forces))
