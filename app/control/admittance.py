"""The base's velocity command: an admittance law at the base's own slow rate (§4.1)."""

import numpy as np

from app.compiled import compiled
from app.config import AdmittanceConfig
from app.robot.bases.kind import BaseKind
from app.strict import Array


@compiled()
def _gain(decay: float) -> float:
    """(1 − e^{−x}) / x, which is 1 at x = 0."""
    return -np.expm1(-decay) / decay if decay > 1e-12 else 1.0


@compiled()
def next_command(
    acceleration: Array,
    command: Array,
    period: float,
    mass: Array,
    damping: Array,
    a_max: Array,
    v_max: Array,
) -> Array:
    """The velocity command after one period of M_a v̇ + D_a v = F with F = M_a a, solved exactly.

    The change and the result are limited by `a_max` and `v_max`. The input a is the mean of
    `a_base_cmd` in the command period, so that all steps of the 1 kHz controller have an effect. F
    is not the base's part of u: that part is not zero while the base is at rest, so that the base
    would drift.

    Args:
        acceleration: (n_b,) [m/s² or rad/s²] a, mean of the commanded acceleration.
        command: (n_b,) [m/s or rad/s] the previous command.
        period: [s] command period.
        mass: (n_b,) [kg or kg m²] diagonal of M_a.
        damping: (n_b,) [N s/m or N m s] diagonal of D_a.
        a_max: (n_b,) [m/s² or rad/s²] largest accelerations of the base.
        v_max: (n_b,) [m/s or rad/s] largest commands.
    """
    found = np.empty(len(command))
    for i in range(len(command)):
        gain = _gain(damping[i] / mass[i] * period)
        F = mass[i] * acceleration[i]
        change = gain * (F - damping[i] * command[i]) / mass[i] * period
        change = min(max(change, -a_max[i] * period), a_max[i] * period)
        found[i] = min(max(command[i] + change, -v_max[i]), v_max[i])
    return found


def admissible_command(base: BaseKind, command: Array, before: Array, v_max: Array) -> Array:
    """The feasible command (n_b,) nearest to `command`, within the largest commands `v_max`.

    If the axes of a base depend on each other, the nearest feasible command can exceed the largest
    command of an axis. Then all axes are multiplied by the same factor. `before` (n_b,) is the
    previous command; all values are in m/s or rad/s.
    """
    found = base.admissible(command, before)
    over = float(np.max(np.abs(found) / v_max))
    return found / over if over > 1.0 else found


def virtual_mass(base: BaseKind, config: AdmittanceConfig) -> Array:
    """(n_b,) [kg or kg m²] the diagonal of M_a."""
    return by_axis(base, config.mass, config.inertia)


def virtual_damping(base: BaseKind, config: AdmittanceConfig) -> Array:
    """(n_b,) [N s/m or N m s] the diagonal of D_a."""
    return by_axis(base, config.damping, config.angular_damping)


def response(base: BaseKind, config: AdmittanceConfig) -> tuple[Array, Array]:
    """Gain and drag of the law's mean response over a command period to an acceleration a.

    The response is gain · (a − drag · ν), where ν is the velocity at the period's start. It has
    this form while the law's limits are not active.

    Returns:
        (n_b,) the gain [-], and (n_b,) the drag [1/s].
    """
    drag = virtual_damping(base, config) / virtual_mass(base, config)
    return np.array([_gain(each * config.period) for each in drag]), drag


def largest_command(base: BaseKind, config: AdmittanceConfig) -> Array:
    """(n_b,) [m/s or rad/s] the largest command of each axis."""
    return np.minimum(base.max_velocity, by_axis(base, config.v_max, config.omega_max))


def by_axis(base: BaseKind, linear: float, angular: float) -> Array:
    """(n_b,) for each axis of a base the number `linear` or `angular`, by the kind of the axis."""
    return np.array([angular if axis.angular else linear for axis in base.axes])
