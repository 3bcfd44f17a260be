"""The table of quantities: everything that one control step computes, each declared once.

A `ControlStep` is the memory of these quantities. The compiled law (`app.control.algorithm`) writes them;
logs, the explanation, studies and tests read them under the same names. Values that a step needs of
the step before stay in the same memory: they are marked "memory".

Frames: `world` has its floor at z = 0; `base` is fixed to the base's centre on the floor, x ahead;
`axes` are the base's velocity axes ν, v and ω of a differential base; `joints` are the arm's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numba import types
from typing_extensions import Self

from app.compiled import compiled
from app.robot.link_pairs import ClosestPoints, Pair, with_parts
from app.strict import Array
from app.structs import assemble, struct_type


class Quantity(NamedTuple):
    """One quantity of a control step."""

    name: str
    """In code, and in everything generated from the table."""
    symbol: str
    """In the paper or the field."""
    shape: str
    """Its dimensions, separated by blanks; empty for a number. See `DIMENSIONS`."""
    unit: str
    """SI units; of a vector with several kinds of entries all of them."""
    frame: str
    """Frame or axes of the components; empty if it has none."""
    source: str
    """Equation, algorithm or section of the paper, or the function that computes it."""
    meaning: str
    """One line."""


DIMENSIONS = {
    "n": "degrees of freedom of the reduced velocity q̇ = (q̇_b, q̇_m): n_b + n_m",
    "n_b": "velocity axes of the base",
    "n_m": "joints of the arm",
    "n_j": "pinocchio's joints: the world, the base and those of the arm",
    "n_q": "entries of pinocchio's configuration, 4 + n_m",
    "n_v": "entries of pinocchio's velocity, 3 + n_m",
    "n_p": "link pairs, those of L_m first",
    "n_mob": "link pairs of L_m",
    "n_r": "distances: one of each pair, then one of each convex part of a base of several parts",
    "n_s": "rows of T_sca: n_b of the base, n_p − n_mob between links, 3 n_mob of T_rep",
    "n_l": "limits: n_m torques, n_m joints, then distances, then n_b accelerations of the base",
}
"""The sizes of the arrays."""

_ROBOT = (
    Quantity("base_pose", "(x, y, φ)", "3", "m, m, rad", "world", "§2.1", "measured base pose"),
    Quantity("base_velocity", "ν", "n_b", "m/s, rad/s", "axes", "§2.1", "measured base velocity"),
    Quantity("q_m", "q_m", "n_m", "rad, m", "joints", "estimate", "estimated joint positions"),
    Quantity(
        "qd_m", "q̇_m", "n_m", "rad/s, m/s", "joints", "estimate", "estimated joint velocities"
    ),
    Quantity("qd", "q̇", "n", "rad/s, m/s", "joints", "§2.1", "reduced velocity (q̇_b, q̇_m)"),
    Quantity("q_pin", "", "n_q", "m, 1, rad", "world", "", "pinocchio's configuration"),
    Quantity("v_pin", "", "n_v", "m/s, rad/s", "base", "", "pinocchio's velocity"),
    Quantity("M", "M", "n n", "kg m², kg", "joints", "(26)", "inertia matrix"),
    Quantity("h", "C q̇ + g", "n", "N m, N", "joints", "(26)", "Coriolis and gravity terms"),
    Quantity("g", "g", "n", "N m, N", "joints", "(26)", "gravity terms"),
    Quantity("L_aa", "L", "n_m n_m", "", "joints", "", "Cholesky factor of the arm's part of M"),
    Quantity("R_base", "R", "3 3", "1", "world", "", "rotation of the base"),
    Quantity("p_o", "p_o", "3", "m", "world", "Fig. 3", "centre of the base on the floor"),
    Quantity("R_ee", "", "3 3", "1", "world", "", "rotation of the end-effector"),
    Quantity("p_ee", "", "3", "m", "world", "", "position of the end-effector"),
    Quantity("J_ee", "J_2", "6 n", "m/rad, 1", "world", "(26)", "end-effector Jacobian"),
    Quantity("v_ee", "ẋ", "6", "m/s, rad/s", "world", "(26)", "end-effector velocity"),
    Quantity("Jdqd_ee", "J̇_2 q̇", "6", "m/s², rad/s²", "world", "(26)", "its bias acceleration"),
    Quantity("twists", "", "n_j 6", "m/s, rad/s", "world", "", "twist of each joint's body"),
    Quantity("biases", "", "n_j 6", "m/s², rad/s²", "world", "", "its change at q̈ = 0"),
)

_ESTIMATE = (
    Quantity("valid", "", "", "1", "", "", "1 if all readings are finite, else 0"),
    Quantity(
        "x_est",
        "x̂",
        "3 n_m",
        "rad, rad/s, rad/s²",
        "joints",
        "estimate",
        "memory: Kalman state, position, velocity, external acceleration q̈_ext",
    ),
    Quantity("P_est", "P", "n_m 3 3", "", "joints", "estimate", "memory: its covariance"),
    Quantity(
        "noise_var",
        "σ²",
        "2 n_m",
        "rad², rad²/s²",
        "joints",
        "estimate",
        "memory: learnt noise variance of positions and velocities",
    ),
    Quantity(
        "q_last",
        "",
        "3 n_m",
        "rad",
        "joints",
        "estimate",
        "memory: last two measured positions, and the last unexplained second difference",
    ),
    Quantity("samples", "", "", "1", "", "estimate", "memory: samples of the noise"),
    Quantity(
        "v_last",
        "ν",
        "n_b",
        "m/s, rad/s",
        "axes",
        "estimate",
        "memory: last base velocity; NaN after a gap",
    ),
)

_PAIRS = (
    Quantity("d_b", "d_b", "", "m", "", "§2.2", "memory: buffer distance in force"),
    Quantity("d", "d", "n_r", "m", "", "line 4", "signed distances"),
    Quantity("p_a", "p_a", "n_r 3", "m", "world", "line 4", "closest points on l_a"),
    Quantity("p_b", "p_b", "n_r 3", "m", "world", "line 4", "closest points on l_b"),
    Quantity("normal", "n", "n_r 3", "1", "world", "(21)", "signed normals from l_a to l_b"),
    Quantity("core", "", "n_r 3", "m", "world", "(21)", "points of the core of l_b behind p_b"),
    Quantity("J", "J_r", "n_r n", "m/rad, 1", "joints", "(21)", "Jacobians of the distances"),
    Quantity("Jdqd", "J̇_r q̇", "n_r", "m/s²", "", "(21)", "accelerations of the distances at q̈ = 0"),
    Quantity("d_dot", "ḋ", "n_r", "m/s", "", "(21)", "speeds of the distances"),
    Quantity("beta", "β", "n_p", "1", "", "Fig. 10", "activation of each pair"),
    Quantity("beta_m", "β_m", "", "1", "", "(28)", "activation of the base's rows"),
    Quantity(
        "p_n",
        "p_n",
        "n_mob 3",
        "m",
        "base",
        "Algorithm 3",
        "border point nearest to p_b; NaN while β = 0",
    ),
    Quantity("p_t", "p_t", "n_mob 3", "m", "base", "(12)", "p_n moved towards a better score"),
    Quantity("p_act", "p_act", "n_mob 3", "m", "base", "Algorithm 3", "acting point"),
    Quantity("tangent", "t", "n_mob 3", "1", "base", "(12)", "tangent of the border at p_n"),
    Quantity("alpha", "α", "n_mob", "m", "", "(13)", "step size"),
    Quantity("f", "f_m,i", "n_mob 3", "N", "base", "(14)", "force on the base, 0 while β = 0"),
    Quantity(
        "xdd_m",
        "ẍ_m",
        "n_b",
        "m/s², rad/s²",
        "axes",
        "(16)",
        "desired base acceleration, before β_m",
    ),
)

_TASKS = (
    Quantity("J_sca", "J_sca", "n_s n", "", "", "(25)", "Jacobian of T_sca"),
    Quantity(
        "b_sca", "ẍ_sca − J̇_sca q̇", "n_s", "m/s², rad/s²", "", "(24)", "right-hand side of T_sca"
    ),
    Quantity("B", "B", "n_s", "1", "", "(27)", "diagonal of B: the activation of each row"),
    Quantity("activation", "", "", "1", "", "(27)", "largest entry of B"),
    Quantity(
        "tracking", "", "", "1", "", "", "1 with a reference, 0 while a person guides the arm"
    ),
    Quantity(
        "x_ref",
        "x_d",
        "4 3",
        "1, m",
        "world",
        "(26)",
        "reference pose: three columns of the rotation, then the position",
    ),
    Quantity("v_ref", "ẋ_d", "6", "m/s, rad/s", "world", "(26)", "reference velocity"),
    Quantity("a_ref", "ẍ_d", "6", "m/s², rad/s²", "world", "(26)", "reference acceleration"),
    Quantity("e_ee", "x_d ⊖ x", "6", "m, rad", "world", "(26)", "end-effector pose error"),
    Quantity("b_ee", "", "6", "m/s², rad/s²", "world", "(26)", "right-hand side of T_ee"),
    Quantity(
        "lm_damping", "λ", "", "m²", "", "tracking_objective", "Levenberg-Marquardt damping of T_ee"
    ),
    Quantity(
        "q_posture",
        "",
        "n_m",
        "rad, m",
        "joints",
        "posture_objective",
        "memory: posture, that of the first valid measurement; NaN before",
    ),
    Quantity(
        "u_free",
        "u_0",
        "n_m",
        "N m, N",
        "joints",
        "free_arm_torque",
        "torque of a guided arm without avoidance",
    ),
    Quantity(
        "H_low",
        "H",
        "n n",
        "",
        "joints",
        "(26)",
        "Hessian of the lowest task: posture, or guided arm",
    ),
    Quantity("c_low", "c", "n", "", "joints", "(26)", "its linear term"),
    Quantity("H", "H", "n n", "", "joints", "(26)", "Hessian of all tasks below T_sca"),
    Quantity("c", "c", "n", "", "joints", "(26)", "its linear term"),
)

_SOLUTION = (
    Quantity(
        "u_min", "", "n_m", "N m, N", "joints", "torque_range", "smallest torque of this step"
    ),
    Quantity("u_max", "", "n_m", "N m, N", "joints", "torque_range", "largest torque of this step"),
    Quantity("C", "C", "n_l n", "", "", "limit_rows", "rows of the limits l ≤ C q̈ ≤ u"),
    Quantity("l", "l", "n_l", "", "", "limit_rows", "lower limits"),
    Quantity("u", "u", "n_l", "", "", "limit_rows", "upper limits"),
    Quantity(
        "slack_weight", "ε", "n_l", "1", "", "limit_rows", "softness of each limit; 0 is hard"
    ),
    Quantity("n_limits", "", "", "1", "", "limit_rows", "rows of C in the arm's QP"),
    Quantity(
        "a_base_free",
        "",
        "n_b",
        "m/s², rad/s²",
        "axes",
        "(29)",
        "base acceleration without the base's rows",
    ),
    Quantity(
        "a_base_des",
        "",
        "n_b",
        "m/s², rad/s²",
        "axes",
        "(29)",
        "desired base acceleration: the blend of (29)",
    ),
    Quantity(
        "a_base_cmd",
        "",
        "n_b",
        "m/s², rad/s²",
        "axes",
        "solve_base",
        "commanded base acceleration, input of the admittance law",
    ),
    Quantity(
        "a_base_meas",
        "",
        "n_b",
        "m/s², rad/s²",
        "axes",
        "Drive",
        "base acceleration that the drive now has",
    ),
    Quantity(
        "qdd",
        "q̈",
        "n",
        "rad/s², m/s²",
        "joints",
        "(29)",
        "solution of the arm's QP; NaN with the fallback command",
    ),
    Quantity("u_cmd", "u", "n_m", "N m, N", "joints", "(26)", "commanded arm torque"),
    Quantity(
        "u_a",
        "u",
        "n_m",
        "N m, N",
        "joints",
        "(26)",
        "memory: the same once a posture is measured; NaN before",
    ),
    Quantity(
        "solved", "", "", "1", "", "", "1 if the command solves the QP, 0 for the fallback command"
    ),
    Quantity("failures", "", "", "1", "", "", "memory: steps with the fallback command"),
    Quantity(
        "given_up", "", "", "1", "", "", "memory: steps in which the base's QP had no solution"
    ),
    Quantity(
        "a_sum",
        "",
        "n_b",
        "m/s, rad/s",
        "axes",
        "§4.1",
        "memory: a_base_cmd summed over the command period",
    ),
    Quantity("t_sum", "", "", "s", "", "§4.1", "memory: time since the last velocity command"),
    Quantity("command_due", "", "", "1", "", "§4.1", "1 if the velocity command is new"),
    Quantity("v_before", "", "n_b", "m/s, rad/s", "axes", "§4.1", "velocity command before it"),
    Quantity(
        "v_cmd", "ν_cmd", "n_b", "m/s, rad/s", "axes", "§4.1", "memory: velocity command in force"
    ),
)

_RESCUE = (
    Quantity("qp_open", "", "", "1", "", "", "1 to 4: the problem that is left to Python; 0 none"),
    Quantity("qp_x", "", "4 n", "", "joints", "", "solutions of these by ProxQP; NaN: none"),
    Quantity("qp_tried", "", "4", "1", "", "", "1 where ProxQP was tried"),
    Quantity("qp_H", "", "n n", "", "joints", "", "Hessian of the open QP"),
    Quantity("qp_c", "", "n", "", "joints", "", "its linear term"),
    Quantity("qp_fixed", "", "n_b", "", "joints", "", "its fixed first entries"),
    Quantity(
        "qp_rows", "", "", "1", "", "", "rows of its limits, which stand in C, l, u, slack_weight"
    ),
)

QUANTITIES: tuple[Quantity, ...] = (
    *_ROBOT,
    *_ESTIMATE,
    *_PAIRS,
    *_TASKS,
    *_SOLUTION,
    *_RESCUE,
)
"""The table."""

PINOCCHIO = {
    "M_pin": types.Array(types.f8, 2, "F"),
    "h_pin": types.Array(types.f8, 1, "C"),
    "g_pin": types.Array(types.f8, 1, "C"),
    "J_pin": types.Array(types.f8, 2, "F"),
    "oMi": types.Array(types.f8, 3, "C"),
}
"""Views of pinocchio's results: M, C q̇ + g, g, the Jacobian J, and of each joint (n_j, 4, 3) the
columns of its rotation and its origin [m], in the world."""

_Values: Any = NamedTuple(  # type: ignore[misc]
    "_Values", [(each, Any) for each in (*PINOCCHIO, *(q.name for q in QUANTITIES))]
)
STEP = struct_type(
    _Values,
    PINOCCHIO | {q.name: types.Array(types.f8, len(q.shape.split()), "C") for q in QUANTITIES},
)
"""The struct of a step, for signatures of compiled functions."""


@compiled(STEP.made_from)
def _make(values: Any) -> Any:
    return assemble(values)


class ControlStep:
    """The quantities of one control step, by the names of the table.

    Each is an array that the next step overwrites; numbers are arrays of no dimension.
    """

    def __init__(
        self,
        sizes: Mapping[str, int],
        pinocchio: Mapping[str, Array],
        pairs: Sequence[Pair],
        rows: Sequence[Sequence[int]],
    ) -> None:
        """Memory for a robot.

        Args:
            sizes: The dimensions of `DIMENSIONS`.
            pinocchio: The views of `PINOCCHIO`.
            pairs: The link pairs, those of L_m first.
            rows: Of each pair: its row among the distances, and those of its convex parts.
        """
        self.pairs, self.rows = tuple(pairs), rows
        self.n_b, self.n_mob = sizes["n_b"], sizes["n_mob"]
        for each in QUANTITIES:
            shape = [sizes[size] if size in sizes else int(size) for size in each.shape.split()]
            setattr(self, each.name, np.zeros(shape))
        self.__dict__.update(pinocchio)
        self.struct = _make(_Values(**{name: getattr(self, name) for name in _Values._fields}))
        """The same memory for compiled functions."""

    def __getattr__(self, name: str) -> Array:  # for those who check types, and for a clear error
        raise AttributeError(f"a control step has no quantity {name!r}")

    def closest(self, i: int) -> ClosestPoints:
        """The closest points of the i-th pair, in the world; copies, safe to keep."""
        return with_parts(*[self._closest(self.pairs[i], row) for row in self.rows[i]])

    def _closest(self, pair: Pair, row: int) -> ClosestPoints:
        points = (each[row].copy() for each in (self.p_a, self.p_b, self.normal, self.core))
        return ClosestPoints(pair, float(self.d[row]), *points)

    @property
    def base_avoidance(self) -> Array:
        """(n_b,) [m/s² or rad/s²] β_m ẍ_m as the method inserts it, 0 if it does not."""
        return self.B[: self.n_b] * self.xdd_m

    def copy(self) -> Self:
        """The same values in memory of their own, which no step overwrites."""
        copied = type(self).__new__(type(self))
        copied.__dict__.update(
            {
                name: np.array(v) if isinstance(v, np.ndarray) else v
                for name, v in vars(self).items()
            }
            | {"struct": None}
        )
        return copied
