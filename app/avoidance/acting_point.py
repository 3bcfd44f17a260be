"""FindActingPoint (Algorithm 3), and the force at the acting point (§3.1).

All points and normals are in the base's frame. The border moves with this frame.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from app.border.nearest import nearest_border
from app.border.score import ScoreField, field_at
from app.compiled import compiled
from app.config import ForceConfig
from app.strict import Array


class ActingPoint(NamedTuple):
    """Result of Algorithm 3, in the base's frame; all its points have the height of p_b.

    If l_m has no border, `alpha` and the x and y of points and tangent are NaN.
    """

    p_n: Array
    """(3,) [m] point of the border nearest to p_b."""
    p_t: Array
    """(3,) [m] p_n moved along the tangent towards a better score."""
    p_act: Array
    """(3,) [m] acting point, the point of the border nearest to p_t."""
    t: Array
    """(3,) unit tangent, horizontal."""
    alpha: float
    """[m] α of (13), the largest size of the step (12)."""


@compiled()
def step_size(d: float, score: float, gain: float, alpha_min: float, alpha_max: float) -> float:
    """α = S_0 d / (|S(p_n)| + S_0/2) [m], within its bounds; S_0 [m⁴/rad⁴] is `gain`.

    For a large |S|, α is proportional to d/|S|. Near the wheel axis, where S vanishes, d/|S| would
    jump from one bound to the other within millimetres. There the formula above changes smoothly
    and approaches 2 d, which is enough for the force to turn the base. A d below 0 counts as 0.

    Paper: Eq. (13). The bounds `alpha_min` and `alpha_max` [m] are those of Figure 8b: after a step
    that is too large, the force has no component along the line between the end-effector and the
    border. `d` [m] is the pair's signed distance, `score` S(p_n) divided by `BaseKind.score_unit`.
    """
    proportional = gain * max(d, 0.0) / max(abs(score) + gain / 2.0, 1e-12)
    return min(max(proportional, alpha_min), alpha_max)


@compiled()
def uphill(gradient: Array) -> Array:
    """(3,) ∇S/‖∇S‖ from ∇S (3,); e_x if ∇S = 0: on the wheel axis, the limit from both sides."""
    norm = math.sqrt((gradient**2).sum())
    return gradient / norm if norm > 0.0 else np.array([1.0, 0.0, 0.0])


@compiled()
def tangential_step(gradient: Array, t: Array, alpha: float) -> Array:
    """α (∇S·t / ‖∇S‖) t, (3,) [m]: the step from p_n to p_t, for ∇S (3,), t (3,) and α [m].

    Paper: Eq. (12).
    """
    return alpha * (uphill(gradient) * t).sum() * t


@compiled()
def find_acting_point(
    border: Any, pair: int, score: Array, p_b: Array, d: float, step: tuple[float, float, float]
) -> ActingPoint:
    """Algorithm 3: acting point of a pair of arm and base, for the closest point p_b on the arm.

    `border` is `BORDER` of the robot, `pair` the number of the pair in L_m, from 0, and `score`
    (9,) the `ScoreField.coefficients` of the pair's body. `p_b` (3,) [m] is in the base's frame,
    `d` [m] the signed distance. `step` has `gain`, `alpha_min` and `alpha_max` of `step_size`.
    """
    p_n, t = nearest_border(border, pair, p_b)
    if math.isnan(p_n[0]):
        return ActingPoint(p_n, p_n, p_n, t, math.nan)
    _, value, gradient = field_at(score, p_n)
    alpha = step_size(d, value / score[2], step[0], step[1], step[2])
    p_t = p_n + tangential_step(gradient, t, alpha)
    p_act, _ = nearest_border(border, pair, p_t)
    return ActingPoint(p_n, p_t, p_act, t, alpha)


@compiled()
def avoidance_force(
    p_b: Array, p_act: Array, d: float, n: Array, f_max: float, d_b: float
) -> Array:
    """f_m,i (3,) [N]: horizontal force on the base, from the acting point to the closest point.

    f = f_max (1 − d/d_b) ‖n_xy‖ (p_b − p_act) / ‖p_b − p_act‖, where 1 − d/d_b is limited to 0 … 1.
    The factor ‖n_xy‖ is our extension: above the base's flat top, where no horizontal force helps,
    it is 0; beside the base it is 1. At p_b = p_act the direction is that of the horizontal part of
    −n. The force is 0 if this part is 0 too.

    The closest point `p_b` on the arm and the acting point `p_act` (3,) [m] have the same height.
    `d` is the signed distance of the pair and `d_b` the buffer distance [m]. `n` (3,) is the pair's
    normal from the base to the arm, of length 1 or less. `f_max` [N] is the largest force.

    Paper: Eq. (14).
    """
    magnitude = f_max * min(max(1.0 - d / d_b, 0.0), 1.0) * math.sqrt(n[0] ** 2 + n[1] ** 2)
    direction = p_b - p_act
    length = math.sqrt((direction**2).sum())
    if length < 1e-6:  # [m]
        direction = np.array([-n[0], -n[1], 0.0])
        length = math.sqrt((direction**2).sum())
    return magnitude / length * direction if length > 0.0 else np.zeros(3)


@compiled()
def resultant_force(f: Array, p_act: Array) -> Array:
    """f_m (3,): Σ f_x, Σ f_y [N] and the torque [N m] about the base's centre.

    `f` (k, 3) [N] are forces at `p_act` (k, 3) [m]; an acting point without a force can be NaN.

    Paper: Eq. (15).
    """
    total = np.zeros(3)
    for i in range(len(f)):
        if f[i, 0] != 0.0 or f[i, 1] != 0.0:
            total[0] += f[i, 0]
            total[1] += f[i, 1]
            total[2] += p_act[i, 0] * f[i, 1] - p_act[i, 1] * f[i, 0]
    return total


@compiled()
def generate_mob_acc(A_b: Array, f_m: Array) -> Array:
    """ẍ_m = A_b f_m (n_b,) [m/s² or rad/s²]: acceleration along the base's axes by the force f_m.

    `A_b` (n_b, 3) is `BaseKind.A_b`: (17) and (18) for a differential base. `f_m` (3,) [N, N, N m].

    Paper: Eq. (16).
    """
    xdd_m = np.zeros(len(A_b))
    for k in range(3):
        xdd_m += A_b[:, k] * f_m[k]
    return xdd_m


class ActingPointFinder:
    """Algorithm 3 for one pair, for drawings and studies outside of a control step."""

    def __init__(self, border: Any, field: ScoreField) -> None:
        """Use the first pair of `border`, a `BORDER`."""
        self.field = field
        """The score of the pair's body."""
        self._border, self._score = border, field.coefficients()

    def find_acting_point(self, p_b: Array, d: float, force: ForceConfig) -> ActingPoint | None:
        """The acting point for p_b (3,) [m] at the distance d [m]; None if l_m has no border."""
        step = force.alpha_gain, force.alpha_min, force.alpha_max
        found = find_acting_point(self._border, 0, self._score, np.array(p_b, float), d, step)
        return None if math.isnan(found.alpha) else found
