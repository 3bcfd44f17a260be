"""What the loop publishes and is told: immutable records that may cross a process border."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from app.config import Config
from app.control.buffer_watch import BufferReading
from app.control.explanation import Explanation
from app.simulation.leading import Scenario

Array = np.ndarray


class PairReading(NamedTuple):
    """One link pair at one instant; positions in the world."""

    name: str
    """As in `lm-lEE`."""
    mobile: bool
    """Whether it belongs to L_m."""
    d: float
    """[m] signed distance."""
    beta: float
    """[-] activation parameter."""
    p_a: Array
    """(3,) [m] closest point on the link nearer to the base."""
    p_b: Array
    """(3,) [m] closest point on the link farther out."""


class ActingReading(NamedTuple):
    """The acting point of one active pair of L_m; positions in the world."""

    name: str
    """The pair, as in `lm-lEE`."""
    p_n: Array
    """(3,) [m] nearest point of the border at the hand's height."""
    p_t: Array
    """(3,) [m] p_n moved along the tangent, (12)."""
    p_act: Array
    """(3,) [m] acting point."""
    f: Array
    """(3,) [N] force f_m,i of (14)."""


@dataclass(frozen=True)
class Snapshot:
    """The whole simulation at one instant."""

    t: float
    """[s] simulated time since the last reset."""
    base_pose: Array
    """(3,) x, y [m], φ [rad]."""
    base_velocity: Array
    """(2,) measured v [m/s], ω [rad/s]."""
    base_velocity_command: Array
    """(2,) commanded v [m/s], ω [rad/s], renewed at 10 Hz."""
    base_acceleration: Array
    """(2,) v̇ [m/s²], ω̇ [rad/s²] that the HQP asks of the base."""
    avoidance_acceleration: Array
    """(2,) β times the desired accelerations of (16), as in Figure 15; 0 if the controller does not
    insert them."""
    wheel_angles: Array
    """(2,) [rad] of the right and the left side, for drawing."""
    q_m: Array
    """(n_m,) arm joints."""
    u_a: Array
    """(n_m,) [N m] arm torques."""
    p_ee: Array
    """(3,) [m] end-effector in the world."""
    wxyz_ee: Array
    """(4,) its orientation as a quaternion."""
    pairs: tuple[PairReading, ...]
    """All link pairs, those of L_m first."""
    acting: tuple[ActingReading, ...]
    """Acting points of the pairs of L_m inside their buffer, if the controller uses them."""
    beta_m: float
    """[-] of (28)."""
    hand_target: Array | None
    """(3,) [m] where the person pulls the end-effector, or None if nobody does."""
    hand_force: Array
    """(3,) [N] the person's force."""
    ee_error: float
    """[m] from the end-effector to its reference or to where the person pulls, else 0."""
    in_contact: bool
    """Arm and base touch."""
    arm_in_contact: bool
    """Parts of the arm touch."""
    solver_failures: int
    """QPs without a solution since the last reset."""
    step_time_us: float
    """[µs] mean duration of a control step over the last second."""
    realtime_factor: float
    """[-] simulated over real time in the last second."""
    overruns: int
    """Control steps since the last reset that missed their period of 1 ms: their own work took
    longer, or they began after it was over."""
    paused: bool
    mode: str
    """"guiding", or "tracking" while the arm follows a reference."""
    controller: str
    config: Config
    buffer: BufferReading
    """Whether d_b is enough for how fast the arm comes."""
    explanation: Explanation | None = None
    """Why the robot moved as it did in the control step of `t`; None where nobody asked."""


@dataclass(frozen=True)
class Pull:
    """The person takes the end-effector and pulls it to `target`; None lets go."""

    target: tuple[float, float, float] | None


@dataclass(frozen=True)
class Configure:
    """Use this configuration from now on."""

    config: Config


@dataclass(frozen=True)
class Choose:
    """Use the controller of that name from now on."""

    controller: str


@dataclass(frozen=True)
class Pause:
    """Stop (True) or go on (False)."""

    paused: bool


@dataclass(frozen=True)
class Reset:
    """Begin anew at the starting pose."""


@dataclass(frozen=True)
class Play:
    """Begin anew, and let a scenario that starts there lead the hand until its end or a pull."""

    scenario: Scenario


Command = Pull | Configure | Choose | Pause | Reset | Play
