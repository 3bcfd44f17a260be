"""The table of quantities: each quantity of a control step is declared once.

A `ControlStep` is the memory of these quantities. The compiled law (`app.control.algorithm`) writes
them; snapshots, the explanation, studies and tests read them by name. The next step overwrites
them. In a step without valid readings the kinematics are those of the last valid step, except the
predicted `qd`. docs/notation.md explains the frames, and "memory" with the effect of `reset`. Two
states are not in the table: the control period `Controller.dt`, and the drive's `RobotState.drive`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types
from typing_extensions import Self

from app.robot.link_pairs import Pair
from app.strict import Array
from app.structs import StructType


class Quantity(NamedTuple):
    """One quantity of a control step."""

    name: str
    """Name in the code, and in everything generated from the table."""
    symbol: str
    """Symbol in the paper or in robotics; can be empty."""
    shape: str
    """Dimensions of `DIMENSIONS` or numbers, separated by blanks; empty for a number."""
    unit: str
    """SI units; for a vector with several kinds of entries all of them; can be empty."""
    frame: str
    """Frame or axes of the components; empty for a quantity without components."""
    source: str
    """Equation, algorithm, section of the paper, or name of a function or module; can be empty."""
    meaning: str
    """Meaning in one line; for a quantity that the next step reads, this line begins "memory:"."""


DIMENSIONS = {
    "n": "degrees of freedom of the reduced velocity q̇ = (q̇_b, q̇_m): n_b + n_m",
    "n_b": "velocity axes of the base",
    "n_m": "joints of the arm",
    "n_j": "pinocchio's joints: the world, the base and the joints of the arm",
    "n_q": "entries of pinocchio's configuration, 4 + n_m",
    "n_v": "entries of pinocchio's velocity, 3 + n_m",
    "n_p": "link pairs, those of arm and base (L_m) first",
    "n_mob": "link pairs of arm and base (L_m)",
    "n_r": "distances: one for each pair, then one for each convex part of an l_a of several parts",
    "n_s": "rows of T_sca: n_b of the base, n_p − n_mob between links, then 3 n_mob of T_rep",
    "n_l": "limits: n_m torques, n_m joints, then distances, then n_b accelerations of the base",
}
"""The sizes of the arrays."""

_TABLE = """
# The robot and its dynamics
base_pose | (x, y, φ) | 3 | m, m, rad | world | §2.1 | present base pose
base_velocity | ν | n_b | m/s, rad/s | axes | §2.1 | present base velocity
q_m | q_m | n_m | rad, m | joints | estimate | estimated joint positions
qd_m | q̇_m | n_m | rad/s, m/s | joints | estimate | estimated joint velocities
qd | q̇ | n | rad/s, m/s | reduced | §2.1 | reduced velocity (q̇_b, q̇_m)
q_pin | | n_q | m, 1, rad | world | | pinocchio's configuration
v_pin | | n_v | m/s, rad/s | base | | pinocchio's velocity
M | M | n n | kg m², kg | reduced | (26) | inertia matrix
h | C q̇ + g | n | N m, N | reduced | (26) | Coriolis and gravity terms
g | g | n | N m, N | reduced | (26) | gravity terms
L_aa | L | n_m n_m | | joints | | Cholesky factor of the arm's part of M
R_base | R | 3 3 | 1 | world | | rotation of the base
p_o | p_o | 3 | m | world | Fig. 4 | centre of the base on the floor
R_ee | | 3 3 | 1 | world | | rotation of the end-effector
p_ee | | 3 | m | world | | position of the end-effector
J_ee | J_2 | 6 n | m/rad, 1 | world | (26) | end-effector Jacobian
v_ee | ẋ | 6 | m/s, rad/s | world | (26) | end-effector velocity
Jdqd_ee | J̇_2 q̇ | 6 | m/s², rad/s² | world | (26) | end-effector acceleration at q̈ = 0
twists | | n_j 6 | m/s, rad/s | world | |
    velocity of the body on each joint, at the origin of the world: linear, then angular
biases | | n_j 6 | m/s², rad/s² | world | | derivative of `twists` at q̈ = 0
# The estimate of the arm
valid | | | 1 | | readings |
    0 before a usable reading, after 0.1 s without one, or after a contradiction; else 1
faults | | 13 | 1 | | readings | 1 for each fault of the readings, in the order of `readings.FAULTS`
blind_time | T | | s | | readings | memory: recent longest age of readings in use, with doubts
v_read | ν | n_b | m/s, rad/s | axes | readings | memory: newest velocity of the base
load | m | | kg | | readings |
    memory: mass at the end-effector that explains the newest interval of `torques` best
x_est | x̂ | 3 n_m | rad, rad/s, rad/s² | joints | estimate |
    memory: present position, velocity and external acceleration q̈_ext
P_est | P | n_m 3 3 | | joints | estimate | memory: covariance of the Kalman state
noise_var | σ² | 2 n_m | rad², rad²/s² | joints | estimate |
    memory: estimated noise variance of positions and velocities
v_last | ν | n_b | m/s, rad/s | axes | estimate | memory: last base velocity; NaN after a gap
# Memory of readings
contradiction | | 1 | | evidence that the readings contradict the commanded torques
age | | 1 | | control periods since the newest reading
lag | | 1 | | delay of the readings in control periods
clock | | s | | `Measurement.now` of the last step; NaN without a clock
clock_ahead | | 1 | | control periods by which the clock is ahead of the counted ones
clock_rest | | 1 | | number of steps since the clock has changed
clock_span | 3 | 1 | |
    since the last measurement of the period by the clock, the number of steps, and the sums of
    their intervals in control periods and of the squares of these intervals
clock_ratio | | 1 | | ratio of the control period by the clock to `dt`; 0 before a measurement
elapsed | | s | |
    time since the last step; 1 period after a pause too long to predict; 0 if the loop catches up
stamp | | s | | time stamp of the newest reading; NaN without one
hidden_lag | | 1 | | the part of `lag` that time stamps do not show, in control periods
stated_lag | | 1 | | the part of `lag` that `estimate.delay` states
ratio | | 1 | | ratio of a joint's motion to the integral of its velocity; 0 before a measurement
agreed | | s | | duration of the successive measurements that agree on a `ratio` other than 1
corrected | | 1 | | 1 after a fault `period` without a clock
no_velocity | | 1 | | 1 while velocities do not match the positions
rested | n_m | 1 | joints | number of successive equal readings of a joint, without repetitions
grain | n_m | rad, m | joints | upper bound of each encoder's resolution; 0 before a change
interval | | 1 | | control periods between the last two new readings
reading | 2 n_m | rad, rad/s | joints | newest positions and velocities
pose_read | 3 | m, m, rad | world | newest pose of the base
pose_last | 3 | m, m, rad | world | pose of the base, `lag` control periods ago
pose_moved | 3 | m, m, rad | world | integral of the velocities since the newest pose of the base
pose_error | 3 | m, m, rad | world | recent changes of the pose minus those by the velocities
pose_jump | 3 | m, m, rad | world |
    difference of the newest pose from the expected one; 0 after the reference has used it
pose_way | 2 | m, rad | | recent path length and angle; infinite until a pose is known
pose_age | | s | | time since the newest pose of the base
astray | n_b | m/s, rad/s | axes |
    recent changes of the base's velocity that the model of its drive does not explain
history | 128 n_m | rad/s² | joints | ring buffer: predicted accelerations of the last periods
base_history | 128 n_b | m/s², rad/s² | axes | assumed accelerations of the base, as in `history`
base_late | | 1 | | 1 if the base's readings are advanced to the time of the joints' readings
base_lost | | 1 | | 1 if the last step had no new reading of the base
periods | | 1 | | index of the newest row of `history`
known | | 1 | | number of rows of `history` since the last gap
group | 16 n_m | rad | joints | mean positions of the last groups of readings
group_age | 16 | 1 | | mean age of each row of `group`, in control periods
group_size | | 1 | | number of readings in the newest group
evidence | 26 | 1 | | evidence for each lag from 0 to 24 control periods, and for a longer one
travel | 3 n_m | rad, rad/s | joints |
    start positions for the measurement of the period, the integral of the velocities, and the
    velocities at the start
since | | 1 | | number of readings in the integral of `travel`
travel_time | | s | | duration of the integral of `travel`
loaded | | kg | | sum of the loads that began suddenly, minus the additions to `payload.mass`
unstated | | kg | | mass of the reported load, negative if a stated load has ceased; 0 without one
torques | 8 n_m | N m, N | joints | mean external torques of intervals of ≥ 0.02 s, the newest first
lifts | 8 n_m | N m/kg, N/kg | joints | torques that move 1 kg at the end-effector, as in `torques`
v_tip | 3 | m/s | world | velocity of the end-effector one control period ago
torques_age | | s | | age of the newest interval of `torques`
x_read | 3 n_m | rad, rad/s, rad/s² | joints | Kalman state: `x_est` at the newest reading
v_error | n_m | rad/s, m/s | joints | recent error of the law's velocities by rare or late readings
qd_used | 128 n_m | rad/s, m/s | joints | ring buffer: `qd_m` of the last control periods
# Memory of estimate
q_last | 4 n_m | rad/s, rad, 1 | joints |
    last velocity from positions, last position, the unexplained second difference of the
    positions, and the control periods from the joint's newest reading to the newest of all
samples | | 1 | | number of samples in the noise estimate
# Link pairs, acting points, the base's acceleration
d_b | d_b | | m | | §2.2 | memory: present buffer distance; it approaches a new d_b slowly
d | d | n_r | m | | line 4 | signed distances, negative in penetration
p_a | p_a | n_r 3 | m | world | line 4 | closest points on l_a
p_b | p_b | n_r 3 | m | world | line 4 | closest points on l_b
normal | n | n_r 3 | 1 | world | (21) | normals from l_a to l_b, also in penetration
core | | n_r 3 | m | world | (21) | points of the core of l_b that belong to p_b
J | J_r | n_r n | m/rad, 1 | reduced | (21) | Jacobians of the distances
Jdqd | J̇_r q̇ | n_r | m/s² | | (21) | accelerations of the distances at q̈ = 0
d_dot | ḋ | n_r | m/s | | (21) | speeds of the distances
beta | β | n_p | 1 | | Figure 10 | activation of each pair
beta_m | β_m | | 1 | | (28) | largest β of L_m; `B` has 0 instead if the base's rows are not used
p_n | p_n | n_mob 3 | m | base | Algorithm 3 | border point nearest to p_b; NaN while β = 0
p_t | p_t | n_mob 3 | m | base | (12) | p_n moved towards a better score; NaN while β = 0
p_act | p_act | n_mob 3 | m | base | Algorithm 3 | acting point; NaN while β = 0
tangent | t | n_mob 3 | 1 | base | (12) | tangent of the border at p_n; NaN while β = 0
alpha | α | n_mob | m | | (13) | step size; NaN while β = 0
f | f_m,i | n_mob 3 | N | base | (14) | force on the base, 0 while β = 0
xdd_m | ẍ_m | n_b | m/s², rad/s² | axes | (16) | base acceleration by the force, without factor β_m
# Tasks
J_sca | J_sca | n_s n | | | (25) | Jacobian of T_sca
b_sca | ẍ_sca − J̇_sca q̇ | n_s | m/s², rad/s² | | (24) | right-hand side of T_sca
B | B | n_s | 1 | | (27) | diagonal of B: the activation of each row
activation | | | 1 | | (27) | largest entry of B
tracking | | | 1 | | | memory: 1 with a reference, 0 while a person guides the arm
x_ref | x_d | 4 3 | 1, m | world | (26) | reference pose: columns of the rotation, then position
v_ref | ẋ_d | 6 | m/s, rad/s | world | (26) | reference velocity
a_ref | ẍ_d | 6 | m/s², rad/s² | world | (26) | reference acceleration
e_ee | x_d ⊖ x | 6 | m, rad | world | (26) | end-effector pose error
b_ee | | 6 | m/s², rad/s² | world | (26) | right-hand side of T_2
lm_damping | λ | | m² | | end_effector_task | Levenberg-Marquardt damping of T_2
q_posture | | n_m | rad, m | joints | posture_objective |
    memory: arm posture of the first valid measurement, or of the last fault `jump`; NaN before
u_free | u_0 | n_m | N m, N | joints | free_arm_torque | torque of a guided arm without avoidance
H_low | H | n n | | reduced | (26) | Hessian of the posture task, or of the task of a guided arm
c_low | c | n | | reduced | (26) | linear term of the task of `H_low`
H | H | n n | | reduced | (26) | Hessian of all tasks below T_sca
c | c | n | | reduced | (26) | linear term of all tasks below T_sca
# Memory of references
x_sent | 4 3 | 1, m | world | pose of the newest reference; NaN before the first
v_sent | 6 | m/s, rad/s | world | velocity of the newest reference
a_sent | 6 | m/s², rad/s² | world | acceleration of the newest reference
x_origin | 4 3 | 1, m | world | first pose of the interpolating polynomial
way | 6 6 | m, rad | world | coefficients of the interpolating polynomial by the power of time
way_time | | s | | time since the beginning of `way`
way_duration | | s | | duration of `way`; 0 without a polynomial
way_continues | | 1 | | 1 if `way` does not end at rest
way_capped | | 1 | | 1 if `way` ends before the newest sample
shift | 6 6 | m, rad | world |
    coefficients, by the power of time, of the reference's shift after a jump of the base's pose
shift_time | | s | | time since the beginning of `shift`
shift_duration | | s | | duration of `shift`; 0 without a shift
since_sample | | s | | time since the newest sample of a planner
sample_interval | | s | | mean time between the samples of a motion; 0 without one
# Limits, the base, the arm
u_min | | n_m | N m, N | joints | torque_range | smallest torque of this step
u_max | | n_m | N m, N | joints | torque_range | largest torque of this step
C | C | n_l n | | | limits.py | rows of the limits l ≤ C q̈ ≤ u
l | l | n_l | | | limits.py | lower limits
u | u | n_l | | | limits.py | upper limits
softness | ε² | n_l | 1 | | limits.py | softness of each limit; a limit with 0 is hard
n_limits | | | 1 | | limits.py | rows of C in the arm's QP
a_base_free | | n_b | m/s², rad/s² | axes | (29) | base acceleration without the base's rows
a_base_des | | n_b | m/s², rad/s² | axes | (29) | desired base acceleration: the blend of (29)
a_base_cmd | a | n_b | m/s², rad/s² | axes | §4.1 |
    commanded base acceleration, input of the admittance law: a_base_des after `undragged` and
    `set_up_room`, not an equation of the paper (`command_base`, `put_commands`)
a_base_meas | | n_b | m/s², rad/s² | axes | assume_base |
    base acceleration in the arm's QP: of the drive's model, of the caller, or the commanded one
qdd | q̈ | n | rad/s², m/s² | reduced | (29) | arm's QP solution; NaN with the fallback command
u_cmd | u | n_m | N m, N | joints | (26) | commanded arm torque
u_a | u | n_m | N m, N | joints | (26) | memory: `u_cmd`; NaN before the first measured posture
solved | | | 1 | | | 1 if the command is the QP's solution, 0 if it is the fallback command
failures | | | 1 | | | memory: number of steps with the fallback command
given_up | | | 1 | | | memory: number of steps without a solution of a QP of the base
a_sum | | n_b | m/s, rad/s | axes | §4.1 | memory: integral of a_base_cmd over the command period
t_sum | | | s | | §4.1 | memory: time since the last velocity command
command_due | | | 1 | | §4.1 | 1 in a step with a new velocity command
v_before | | n_b | m/s, rad/s | axes | §4.1 | velocity command of the last command period
v_cmd | ν_cmd | n_b | m/s, rad/s | axes | §4.1 | memory: present velocity command
# A QP that Python has to solve
qp_open | | | 1 | | | number 1 to 4 of the problem that Python has to solve; 0 without one
qp_x | | 4 n | | reduced | | Python's solutions of three QPs and the hierarchy; NaN if it finds none
qp_tried | | 4 | 1 | | | 1 for each of these four problems that Python has tried to solve
qp_H | | n n | | reduced | | Hessian of the open QP
qp_c | | n | | reduced | | linear term of the open QP
qp_fixed | | n_b | | reduced | | base's entries of q̈ before the QP; fixed in the arm's QP
qp_rows | | | 1 | | | number of rows of the open QP in C, l, u and softness
"""
"""A line for each quantity: name | symbol | shape | unit | frame | source | meaning.

Below a heading "Memory of" a module: name | shape | unit | frame | meaning.
"""


def _read_table(text: str) -> Iterator[Quantity]:
    module = ""
    for line in re.sub(r"\n\s+", " ", text).strip().splitlines():
        if line.startswith("#"):
            module = line.split()[-1]  # only for a heading "Memory of" a module
            continue
        cells = [cell.strip() for cell in line.split("|")]
        if len(cells) == 5:
            name, shape, unit, frame, meaning = cells
            cells = [name, "", shape, unit, frame, module, f"memory: {meaning}"]
        yield Quantity(*cells)


QUANTITIES: tuple[Quantity, ...] = tuple(_read_table(_TABLE))
"""The rows of the table."""

PINOCCHIO = {
    "M_pin": types.Array(types.f8, 2, "F"),
    "h_pin": types.Array(types.f8, 1, "C"),
    "J_pin": types.Array(types.f8, 2, "F"),
    "Y_pin": types.Array(types.f8, 2, "A"),
    "oMi": types.Array(types.f8, 3, "C"),
    "signed": types.Array(types.f8, 1, "A"),
}
"""Views of the libraries' results: `pinocchio_views`, and the signed distances [m] of shapes."""

_Values: Any = NamedTuple(  # type: ignore[misc]
    "_Values",
    [(each, Any) for each in (*PINOCCHIO, *(q.name for q in QUANTITIES))],  # pyright: ignore
)
STEP = StructType(
    "_Values",
    PINOCCHIO | {q.name: types.Array(types.f8, len(q.shape.split()), "C") for q in QUANTITIES},
)
"""The struct of a step, for signatures of compiled functions."""


class ControlStep:
    """The quantities of one control step, by the names of the table.

    Each quantity is an array that the next step overwrites; a number is an array without dimension.
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        pinocchio: Mapping[str, Array],
        pairs: Sequence[Pair],
        rows: Sequence[Sequence[int]],
    ) -> None:
        """Allocate the memory for a robot.

        `sizes` has the value of each dimension in `DIMENSIONS`, and `pinocchio` the views of
        `PINOCCHIO`. The `pairs` of L_m are first; `rows` has, for each pair, the row of its
        distance, and the rows of its convex parts.
        """
        self.pairs, self.rows = tuple(pairs), rows
        self.pinocchio: object = None
        """The owner of the memory of `PINOCCHIO`'s views; it must exist as long as the views."""
        self.n_b, self.n_mob = sizes["n_b"], sizes["n_mob"]
        self._shapes = [
            [sizes[size] if size in sizes else int(size) for size in each.shape.split()]
            for each in QUANTITIES
        ]
        ends = np.cumsum([0, *map(math.prod, self._shapes)]).tolist()
        self.memory = np.zeros(ends[-1])
        """All quantities, one after the other: neighbours share cache lines."""
        places = map(range, ends, ends[1:])
        self.places = {q.name: place for q, place in zip(QUANTITIES, places, strict=True)}
        """Indices of the entries of each quantity in `memory`."""
        self._name_quantities()
        self.__dict__.update(pinocchio)
        values = _Values(**{name: getattr(self, name) for name in _Values._fields})
        self.struct = STEP.made_of(values)
        """The same memory for compiled functions."""

    def _name_quantities(self) -> None:
        """Make each quantity an attribute: a view of its entries in `memory`."""
        for (name, place), shape in zip(self.places.items(), self._shapes, strict=True):
            setattr(self, name, self.memory[place.start : place.stop].reshape(shape))

    def __getattr__(self, name: str) -> Array:  # for type checkers, and for a clear error
        raise AttributeError(f"a control step has no quantity {name!r}")

    @property
    def base_avoidance(self) -> Array:
        """(n_b,) [m/s² or rad/s²] β_m ẍ_m; 0 without active rows of the base."""
        return self.B[: self.n_b] * self.xdd_m

    def __getstate__(self) -> dict[str, Any]:
        """The values for `copy.deepcopy` and `pickle`; the copy has no struct."""
        own = {name: value for name, value in vars(self).items() if name not in self.places}
        return own | {"struct": None, "pinocchio": None}

    def __setstate__(self, state: Mapping[str, Any]) -> None:
        """Use the values of `__getstate__`."""
        self.__dict__.update(state)
        self._name_quantities()

    def copy(self) -> Self:
        """A copy in separate memory, which no step overwrites."""
        copied = type(self).__new__(type(self))
        state = self.__getstate__().items()
        copied.__setstate__({k: np.array(v) if isinstance(v, np.ndarray) else v for k, v in state})
        return copied
