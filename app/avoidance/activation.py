"""Activation parameter β of the link pairs."""

from __future__ import annotations

from collections.abc import Sequence

from app.config import ActivationConfig

_FASTEST = 3.0  # [m/s] approach beyond which the arm looks no farther ahead
_ONSET = 0.8  # [-] |n_z| from which on the arm has a share


def activation(d: float, d_b: float, d_full: float) -> float:
    """β of a link pair: 0 outside the buffer, 1 at `d_full` and nearer, a cubic between.

    Paper: Figure 10; there d_b = 0.15 m and d_full = 0.05 m.

    Args:
        d: [m] signed distance of the pair.
        d_b: [m] buffer distance.
        d_full: [m] distance at which the task is in full force, below d_b.

    Returns:
        β in [0, 1], with a continuous derivative in d.
    """
    return cubic((d_b - d) / (d_b - d_full))


def share_from_above(n_z: float) -> float:
    """How much a pair of L_m meets from above, by the height of the pair's normal.

    0 up to 53 degrees above the horizon, where the base can give way; 1 straight above, where no
    motion of the base changes the distance; a cubic in |n_z| between.

    Args:
        n_z: [-] vertical component of the pair's unit normal.
    """
    return cubic((abs(n_z) - _ONSET) / (1.0 - _ONSET))


def arm_activation(d: float, n_z: float, config: ActivationConfig) -> float:
    """β of the arm's own row against the base: 0 outside the arm's buffer, 1 in its inner half.

    Our extension. From above no horizontal force helps, so there the arm itself resists, within
    `d_above`. From the side it is the last resort only, within `d_last`: the base has not got away
    in time, or the pair began in penetration. Over the edge one buffer turns into the other. Its
    rows ask for a constant acceleration, far more than a tracking task does: a share of the paper's
    β that only faded out with n_z, such as n_z², would hold a hand up at the buffer's border from
    the side too.

    Args:
        d: [m] signed distance of a pair of L_m, or the one to come (`distance_to_come`).
        n_z: [-] vertical component of the pair's unit normal.
        config: The buffers.

    Returns:
        β in [0, 1], with a continuous derivative in d and n_z.
    """
    buffer = config.d_last + share_from_above(n_z) * (config.d_above - config.d_last)
    return activation(d, buffer, 0.5 * buffer)


def distance_to_come(d: float, speed: float, config: ActivationConfig) -> float:
    """The distance on which the arm's own row acts: d on a retreat, d + `ahead` ḋ on an approach.

    The arm's torques change at a limited rate. A row that acts on d alone brakes a fast hand late
    and, worse, lets go of it late: the hand is thrown back faster than it came, the person pulls it
    in again, and it comes faster each time. Looking ahead only while the pair closes, the row takes
    hold early and lets go early. A hand that is at rest or retreats feels nothing of it.

    Args:
        d: [m] signed distance of a pair of L_m.
        speed: [m/s] ḋ, taken as -3 m/s if it is less.
        config: The time `ahead`.

    Returns:
        [m] continuous in d and ḋ, and never above d.
    """
    return d + config.ahead * min(max(speed, -_FASTEST), 0.0)


def cubic(s: float) -> float:
    """0 below 0, 1 above 1, a cubic with flat ends between."""
    s = min(max(s, 0.0), 1.0)
    return s * s * (3.0 - 2.0 * s)


def mobile_activation(betas: Sequence[float]) -> float:
    """β_m, the largest of the activations of the pairs of L_m.

    Paper: Eq. (28).
    """
    return max(betas, default=0.0)
