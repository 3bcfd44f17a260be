"""Algorithm 2: state in, arm torques and base acceleration out. Knows no simulator, no screen."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.avoidance.self_collision import Avoidance, SelfCollisionAvoidance
from app.avoidance.task import mobile_rows
from app.border.cache import BorderData
from app.border.score import ScoreField
from app.config import Config, TaskConfig, slowed
from app.control.hand_held import base_with_hand_held
from app.control.hqp import HierarchicalQP, NoSolutionError
from app.control.limits import robot_limits, with_barriers
from app.control.methods import METHODS, Inserted
from app.control.tasks import (
    Reference,
    Stack,
    base_rest_acceleration,
    base_rest_objective,
    end_effector_task,
    free_arm_torque,
    guided_arm_objective,
    posture_objective,
    softened,
)
from app.control.transition import TaskTransition
from app.control.workings import ArmSolve, Workings
from app.errors import UnknownNameError
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState

Array = np.ndarray

CONTROLLERS = tuple(METHODS)
"""Names of the controllers: the paper's method, those it is compared with, and none."""


class ControlOutput(NamedTuple):
    """What one control step gives.

    Attributes:
        u_a: (n_m,) [N m or N] torques of the arm.
        base_acceleration: (n_b,) [m/s² or rad/s²] for the base's admittance law: v̇ and ω̇.
        avoidance: The avoidance task of this step, whether or not the method inserts it.
        inserted: What the method put above the stack or among its limits.
        solved: False if a QP had no solution and this is the safe command.
        tracking: Whether there was a reference.
        workings: How it came about, or None with the safe command.
    """

    u_a: Array
    base_acceleration: Array
    avoidance: Avoidance
    inserted: Inserted
    solved: bool
    tracking: bool = False
    workings: Workings | None = None

    @property
    def activation(self) -> float:
        """[-] the largest activation of the rows that were inserted, 0 if none was."""
        return self.inserted.activation


class Controller:
    """Reactive self-collision avoidance over a task stack.

    With a reference the stack is T_ee above posture and damping; without one the arm is guided by
    hand: gravity compensation, joint damping and what avoidance asks.

    The base obeys velocity commands at a slow rate, so its acceleration is not the one that (29)
    asks for. The arm's torques are therefore solved with the acceleration that the base really has;
    the one asked for goes to the admittance law. What the base is asked to correct besides T_sca's
    own rows is asked with gains that its rate can follow, else it and the arm would fight.

    Attributes:
        state: The robot's state at the last step.
        failures: QPs without a solution so far.
        q_posture: (n_m,) the posture of the lowest level, set at the first step after `reset`.
    """

    def __init__(
        self, model: RobotModel, data: BorderData, config: Config, *, name: str = "dbb",
        dt: float = 0.001,
    ) -> None:  # fmt: skip
        """Prepare the controller.

        Args:
            model: The robot.
            data: Its link pairs and sampled clouds.
            config: Parameters; `configure` changes them.
            name: One of `CONTROLLERS`.
            dt: [s] between two steps.

        Raises:
            UnknownNameError: No controller has that name.
        """
        self.use(name)
        self.state = RobotState(model)
        self._model = model
        self._config = config
        self._slow = slowed(config.task, config.repulsion)
        self._avoidance = SelfCollisionAvoidance(self.state, data.pairs, data.clouds, config)
        self._solver = HierarchicalQP(model.n)
        self._transition = TaskTransition(self._solver)
        self._dt = dt
        self.reset()

    def use(self, name: str) -> None:
        """Use another of the compared methods from the next step on.

        Raises:
            UnknownNameError: No controller has that name.
        """
        if name not in METHODS:
            raise UnknownNameError("controller", name, CONTROLLERS)
        self.name = name
        self._method = METHODS[name]

    def reset(self) -> None:
        """Forget the posture, the last torques and the counts of failures."""
        self._u_a: Array | None = None
        self.q_posture: Array | None = None
        self.failures = 0
        self._solver.given_up = 0

    @property
    def given_up(self) -> int:
        """QPs of lower levels without an answer since the reset."""
        return self._solver.given_up

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on."""
        self._config = config
        self._slow = slowed(config.task, config.repulsion)
        self._avoidance.configure(config)

    def step(
        self,
        measurement: Measurement,
        reference: Reference | None = None,
        *,
        base_acceleration: Array | None = None,
    ) -> ControlOutput:
        """One pass of Algorithm 2.

        Paper: Algorithm 2.

        Args:
            measurement: The sensors' readings.
            reference: Where the end-effector shall be, or None while it is guided by hand.
            base_acceleration: (n_b,) [m/s² or rad/s²] that the base really has now; None means that
                it does what is asked.

        Returns:
            Torques of the arm and acceleration of the base; never without an answer.
        """
        self.state.update(measurement)
        if self.q_posture is None:
            self.q_posture = measurement.q_m.copy()
        if self._u_a is None:
            self._u_a = free_arm_torque(self.state)
        avoidance = self._avoidance.update()
        inserted = self._method.insert(self.state, avoidance, self._config)
        workings = None
        try:
            wanted, asked = self._base_acceleration(inserted, reference)
            given = asked if base_acceleration is None else base_acceleration
            arm = self._solve_arm(given, inserted, reference)
            u_a, workings = arm.u_a, Workings(wanted, given, arm)
        except NoSolutionError:
            self.failures += 1
            u_a, asked = self._safe_command()
        self._u_a = self._u_a + _clipped(u_a - self._u_a, self._slew)
        return ControlOutput(
            self._u_a.copy(), asked, avoidance, inserted, workings is not None,
            tracking=reference is not None, workings=workings,
        )  # fmt: skip

    def score_field(self, pair: str) -> ScoreField:
        """The score by which a pair of L_m chooses its acting points, by the pair's name."""
        return self._avoidance.field(pair)

    def _base_acceleration(
        self, inserted: Inserted, reference: Reference | None
    ) -> tuple[Array, Array]:
        """The base's part of (29): its rows fix it once the solution without them is known.

        Paper: Eq. (29), the base's rows.

        Returns:
            (n_b,) what (29) wants, and (n_b,) what of it is asked, within the base's limits and as
            far as the arm can hold the hand.
        """
        most = self._model.base_acceleration_max
        rows_m = inserted.rows_m
        kept = inserted.holding.share < 1.0  # then what the hand needs counts, whatever β
        if rows_m is not None and rows_m.beta >= 1.0 and not kept:
            free = np.zeros(self._model.n_b)  # weighs nothing
        elif reference is None and not inserted.barriers:
            free = base_rest_acceleration(self.state, self._config.task)
        else:
            free = self._model.J_m @ self._slow_solution(inserted, reference)[: self._model.n_b]
        if rows_m is None:
            return free, _clipped(free, most)
        wanted = rows_m.beta * rows_m.xdd + (1.0 - rows_m.beta) * free
        if not kept:
            return wanted, _clipped(wanted, most)
        asked = base_with_hand_held(
            self.state, wanted, free, inserted.holding, rows_m.beta, self._config.admittance
        )
        return wanted, _clipped(asked, most)

    def _slow_solution(self, inserted: Inserted, reference: Reference | None) -> Array:
        """q̈ of (29) without the base's rows, (n,), its loops as slow as the base is.

        The arm's own rows against the base have no part in it: there the base's rows say how it
        helps.
        """
        state = self.state
        task, repulsion = self._slow
        rows = [
            row._replace(xdd=repulsion.k_p - repulsion.k_v * (row.J @ state.qd))
            for row in inserted.rows_links
        ]
        if reference is None:
            base = base_rest_objective(state, self._config.task)
            stack = Stack((), guided_arm_objective(state, base))
        else:
            stack = self._tracking_stack(reference, task)
        limits = robot_limits(state, self._config.limit, np.zeros(self._model.n_b))
        limits = with_barriers(limits, inserted.barriers)
        return self._transition.solve(rows, *self._weighted(stack), limits, slot="slow").qdd

    def _solve_arm(
        self, base_acceleration: Array, inserted: Inserted, reference: Reference | None
    ) -> ArmSolve:
        """The arm's part of (29) with the acceleration that the base really has."""
        state = self.state
        given = mobile_rows(self._model.J_m, self._model.n, base_acceleration, 1.0)
        stack = (
            Stack((), guided_arm_objective(state))
            if reference is None
            else self._tracking_stack(reference, self._config.task)
        )
        wheels = self._model.J_m_inv @ base_acceleration
        limits = with_barriers(robot_limits(state, self._config.limit, wheels), inserted.barriers)
        rows = (given, *inserted.rows_arm, *inserted.rows_links)
        solution = self._transition.solve(rows, *self._weighted(stack), limits, slot="arm")
        n_b = self._model.n_b
        u_a = state.M[n_b:] @ solution.qdd + state.h[n_b:]
        u_a = _clipped(u_a, self._model.tau_max)
        return ArmSolve(rows, stack, limits, solution, u_a)

    def _tracking_stack(self, reference: Reference, config: TaskConfig) -> Stack:
        assert self.q_posture is not None
        task = end_effector_task(self.state, reference, config)
        return Stack((task,), posture_objective(self.state, self.q_posture, config))

    def _weighted(self, stack: Stack) -> Stack:
        """The stack as the method solves it: its levels strict, or weighted."""
        return softened(stack, self._config.task.soft_weight) if self._method.soft else stack

    @property
    def _slew(self) -> float:
        """[N m] or [N] largest change of a torque in one step."""
        return self._config.limit.torque_rate * self._dt

    def _safe_command(self) -> tuple[Array, Array]:
        """Gravity compensation and damping for the arm, braking for the base."""
        u_a = _clipped(free_arm_torque(self.state), self._model.tau_max)
        return u_a, base_rest_acceleration(self.state, self._config.task)


def _clipped(values: Array, largest: Array | float) -> Array:
    """Values within ±largest; `np.clip` costs thrice as much on so few."""
    return np.minimum(np.maximum(values, -largest), largest)
