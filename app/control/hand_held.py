"""The base's acceleration where the arm cannot hold its hand: what takes the hand along goes."""

from __future__ import annotations

import numpy as np

from app.avoidance.holding import Holding
from app.config import AdmittanceConfig
from app.control.admittance import by_axis, largest_command, response
from app.robot.state import RobotState

Array = np.ndarray

_SETTLE = 5.0  # [1/s] how fast the base may close in on its largest speed, per speed left
_INSIDE = 0.1  # [-] of the largest acceleration, from what holds the hand to the bounds


def base_with_hand_held(
    state: RobotState, wanted: Array, free: Array, holding: Holding, beta: float,
    config: AdmittanceConfig,
) -> Array:  # fmt: skip
    """The base's part of (29) as far as the arm can hold the hand, (n_b,), within its limits.

    The hand's own task needs the base's acceleration `free`; along directions in which the arm does
    not make up for the base, the base keeps to what that does to the hand. The admittance law damps
    each axis by another share and ends at its largest speeds; both would bend the base's path, so
    both are foreseen. Continuous; as β goes to 0 and `wanted` to `free`, it goes to `free` within
    the limits.

    Args:
        state: The robot's state.
        wanted: (n_b,) [m/s² or rad/s²] of (29).
        free: (n_b,) of the solution without the base's rows.
        holding: What the arm can do.
        beta: [-] activation of the base's rows.
        config: The admittance law.
    """
    model, base, nu = state.model, state.model.description.base, state.measurement.base_velocity
    most, v_max = model.base_acceleration_max, largest_command(base, config)
    gain, drag = response(base, config)
    inside = _INSIDE * most
    held = np.clip(free / gain + drag * nu, inside - most, most - inside)
    rest = np.clip(free, -most, most)
    asked = with_hand_held(
        np.clip(wanted, -most, most), held, beta * holding.weight, mass=base.mass_kg,
        carry=state.J_ee[:2, : model.n_b] @ model.J_m_inv * gain,
        inertia=by_axis(base, base.mass_kg, base.inertia_kgm2),
    )  # fmt: skip
    lower = np.maximum(_SETTLE * (-v_max - nu) / gain + drag * nu, -most)
    upper = np.minimum(_SETTLE * (v_max - nu) / gain + drag * nu, most)
    lower = np.minimum(lower, np.minimum(held - inside, rest))
    upper = np.maximum(upper, np.maximum(held + inside, rest))
    slow = farthest(held, asked, lower, upper)
    return slow + holding.share * (farthest(held, asked, -most, most) - slow)


def with_hand_held(
    wanted: Array, held: Array, weight: Array, *, mass: float, carry: Array, inertia: Array
) -> Array:
    """The base's acceleration nearest to the wanted one that does not take the hand along, (n_b,).

    The least of (a - a_wanted)ᵀ I (a - a_wanted) + m ‖H (a - a_held)‖²_weight: so a force moves a
    base that the hand clings to, and what holds the hand does no work. Without a weight this is the
    wanted one; the larger the weight, the less the hand is carried.

    Args:
        wanted: (n_b,) [m/s² or rad/s²].
        held: (n_b,) one with which the hand does what its own task asks.
        weight: (2, 2) [-] W, as of `Holding` times β.
        mass: [kg] m.
        carry: (2, n_b) H, from what is asked of the base's axes to the horizontal acceleration of
            the hand that it causes with the arm at rest; so what the admittance law makes of it is
            in it.
        inertia: (n_b,) [kg or kg m²] I of the base's axes.
    """
    added = mass * carry.T @ weight @ carry
    return held + np.linalg.solve(np.diag(inertia) + added, inertia * (wanted - held))


def farthest(begin: Array, end: Array, lower: Array, upper: Array) -> Array:
    """The last point on the way from `begin`, within the bounds, to `end` that is within them.

    Continuous while `begin` is strictly inside: on a bound a step out of it, however small, would
    stop all axes.
    """
    step = end - begin
    moves = np.abs(step) > 1e-12
    room = np.where(step > 0.0, upper - begin, lower - begin)[moves] / step[moves]
    return begin + min(float(room.min(initial=1.0)), 1.0) * step
