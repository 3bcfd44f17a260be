"""What the loop publishes: immutable records that may cross a process border."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from app.config import Config
from app.control.buffer_watch import BufferReading
from app.control.explanation import Explanation
from app.simulation.people import PullReading
from app.simulation.plants.door import Door
from app.simulation.trace.comparison import GhostReading, Score

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


class DoorView(NamedTuple):
    """A door that the hand holds."""

    door: Door
    """Its geometry, which does not change: `door.pose(angle)` is T_world_door."""
    angle: float
    """[rad] how far it is open."""
    force: Array
    """(3,) [N] that the hand exerts on it while it opens it, in the world."""


class Refusal(NamedTuple):
    """A command that could not be obeyed, which has changed nothing."""

    number: int
    """Of the refusal, from 1 on: a larger one than the last is news."""
    message: str


@dataclass(frozen=True)
class Snapshot:
    """The whole simulation at one instant."""

    t: float
    """[s] simulated time since the last reset."""
    base_pose: Array
    """(3,) x, y [m], φ [rad]."""
    base_velocity: Array
    """(n_b,) [m/s or rad/s] measured along the base's axes: v, ω of a differential one."""
    base_velocity_command: Array
    """(n_b,) [m/s or rad/s] commanded, renewed at 10 Hz."""
    base_acceleration: Array
    """(n_b,) [m/s² or rad/s²] that the HQP asks of the base."""
    avoidance_acceleration: Array
    """(n_b,) β times the desired accelerations of (16), as in Figure 15; 0 if the controller does
    not insert them."""
    wheel_angles: Array
    """(n_w,) [rad] of the base's `wheels`, for drawing: the right and the left side."""
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
    """(3,) [m] where the (first) person pulls the end-effector, or None if nobody does."""
    hand_force: Array
    """(3,) [N] the force on the end-effector: of all persons there, or of a door."""
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
    """Control steps since the last reset that missed their period of 1 ms, over the speed: their
    own work took longer, or they began after it was over."""
    paused: bool
    mode: str
    """"guiding", or "tracking" while the arm follows a reference."""
    controller: str
    config: Config
    """The parameters in force; a scenario may firm those that it was given."""
    buffer: BufferReading
    """Whether d_b is enough for how fast the arm comes."""
    pulls: tuple[PullReading, ...] = ()
    """All that hold the robot, a scenario's person as number -1."""
    ghosts: tuple[GhostReading, ...] = ()
    """Robots that run the same input with other controllers, after the control step of `t`."""
    scores: tuple[Score, ...] = ()
    """Since the comparison began: of this robot, then of the ghosts; empty without ghosts."""
    same: str = ""
    """What is the same at the ghosts, "path" or "force", or empty without ghosts."""
    scenario: str = ""
    """Name of the scenario that leads the hand, or empty while it is free."""
    scenario_ends: float | None = None
    """[s] simulated time at which the scenario ends, or None while the hand is free."""
    door: DoorView | None = None
    """The door that the hand holds, also after its scenario."""
    speed: float = 1.0
    """[-] the wanted `realtime_factor`."""
    busy: str = ""
    """What is being prepared while time stands still, or empty."""
    refusal: Refusal | None = None
    """The newest command that was found out to be impossible only when it was obeyed."""
    explanation: Explanation | None = None
    """Why the robot moved as it did in the control step of `t`; None where nobody asked."""

    @property
    def held(self) -> PullReading | None:
        """The pull that has lasted longest, or None if nobody holds the robot."""
        return self.pulls[0] if self.pulls else None
