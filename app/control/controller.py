"""Algorithm 2: state in, arm torques and base acceleration out. Knows no simulator, no screen."""

from typing import NamedTuple

from app.avoidance.self_collision import Avoidance, SelfCollisionAvoidance
from app.avoidance.task import TaskRows
from app.border.cache import BorderData
from app.border.score import ScoreField
from app.config import Config, slowed
from app.control import CONTROLLERS
from app.control.admittance import response
from app.control.estimate import ArmEstimate
from app.control.kernels import base_blend, clipped, torque_range
from app.control.limits import ArmNow, base_limits, robot_limits
from app.control.methods import METHODS, Inserted
from app.control.qp import Limits, NoSolutionError, Objective, TaskQP, insert_rows
from app.control.tasks import (
    EndEffectorError,
    EqualityTask,
    Reference,
    base_rest_acceleration,
    base_with_hand,
    carried,
    end_effector_error,
    end_effector_task,
    free_arm_torque,
    guided_objective,
    posture_objective,
    tracking_objective,
    with_base_at_rest,
)
from app.errors import check_name
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, checked, is_finite
from app.strict import Array


class Stack(NamedTuple):
    """The tasks below self-collision avoidance, over q̈ (n,)."""

    objective: Objective
    """All of them."""
    lowest: Objective
    """The posture alone, or what a guided arm does by itself."""
    ee_task: EqualityTask | None
    """T_ee, or None where the arm is guided."""


class Workings(NamedTuple):
    """How a control step came to its answer; what explains it is made from this, when asked for."""

    base_wanted: Array
    """(n_b,) [m/s² or rad/s²] of (29) before the base's acceleration limits."""
    base_given: Array
    """(n_b,) the same that the base really has, with which the arm's part is solved."""
    rows: tuple[TaskRows, ...]
    """Rows above the tasks: the method's against the base, then those between links."""
    stack: Stack
    limits: Limits
    """On q̈, the hard torques first, then joints, then barriers."""
    torque: Array
    """(2, n_m) the smallest and the largest torque [N m or N] that the step allowed, by the limits
    of the torques and of their change."""
    qdd: Array
    """(n,) q̈ of base and arm."""


class ControlOutput(NamedTuple):
    """What one control step gives."""

    u_a: Array
    """(n_m,) [N m or N] torques of the arm."""
    base_acceleration: Array
    """(n_b,) [m/s² or rad/s²] for the base's admittance law: v̇ and ω̇."""
    avoidance: Avoidance
    """The avoidance task of this step, whether or not the method inserts it."""
    inserted: Inserted
    """What the method put above the stack or among its limits."""
    solved: bool
    """False if a QP had no solution and this is the safe command."""
    tracking: bool = False
    """Whether there was a reference."""
    workings: Workings | None = None
    """How it came about, or None with the safe command."""

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
    the one asked for goes to the admittance law. What the base is asked besides T_sca's own rows is
    asked with gains that its rate can follow, else it and the arm would fight.
    """

    def __init__(
        self,
        model: RobotModel,
        data: BorderData,
        config: Config,
        *,
        name: str = "dbb",
        dt: float = 0.001,
    ) -> None:
        """Prepare the controller.

        `name` is one of `CONTROLLERS`, `dt` [s] between two steps; `configure` changes the
        parameters.

        Raises:
            UnknownNameError: No controller has that name.
        """
        self.use(name)
        self.state = RobotState(model)
        """The robot's state at the last good measurement."""
        self._model = model
        self._base_limits = base_limits(model)
        self._avoidance = SelfCollisionAvoidance(self.state, data.pairs, data.clouds, config)
        self.configure(config)
        self._solver = TaskQP()
        self.estimate = ArmEstimate(model.n_m)
        """Where the arm is, and who pushes it."""
        self._dt = dt
        self.reset()

    def use(self, name: str) -> None:
        """Use another of the compared methods from the next step on.

        Raises:
            UnknownNameError: No controller has that name.
        """
        check_name("controller", name, CONTROLLERS)
        self.name = name
        self._method = METHODS[name]

    def reset(self) -> None:
        """Forget the posture, the last torques, who pushes, and the counts of failures."""
        self._u_a: Array | None = None
        self.estimate.reset()
        self._avoidance.reset()
        self.q_posture: Array | None = None
        """(n_m,) the posture that the arm is drawn to, that of the first good measurement."""
        self.failures = self.given_up = 0
        """Steps so far in which the arm got the safe command, for want of a good measurement or a
        solution, and in which the base's own part had no solution; it was braked."""

    @property
    def d_b(self) -> float:
        """[m] the buffer distance in force, which follows another one step by step."""
        return self._avoidance.d_b

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on."""
        self._config = config
        self._avoidance.configure(config)
        self._slow = slowed(config)
        self._response = response(self._model.description.base, config.admittance)

    def step(
        self,
        measurement: Measurement,
        reference: Reference | None = None,
        *,
        base_acceleration: Array | None = None,
    ) -> ControlOutput:
        """One pass of Algorithm 2.

        Paper: Algorithm 2.

        Without a reference the end-effector is guided by hand. `base_acceleration` (n_b,) [m/s² or
        rad/s²] is what the base really has now; None means that it does what is asked.

        Returns:
            Torques of the arm and acceleration of the base; never without an answer. Where the
            measurement or the reference is not finite, gravity compensation with damping at the
            last good one, before the first at the arm's ready posture, and a base that is braked.

        Raises:
            MeasurementError: A reading is not that many numbers.
        """
        measurement = checked(measurement, self._model)
        good = is_finite(measurement)
        if good:
            u_a, filtering = self._u_a, self._config.estimate
            here = self.estimate.update(measurement, self.state, u_a, filtering, self._dt)
            self.state.update(here)
        else:
            self.estimate.begin_anew()
        if good and self.q_posture is None:
            self.q_posture = measurement.q_m.copy()
        last = free_arm_torque(self.state) if self._u_a is None else self._u_a
        slew = self._config.limit.torque_rate * self._dt
        torque, workings = torque_range(last, self._model.tau_max, slew), None
        avoidance = self._avoidance.update(self._dt)
        inserted = self._method(self.state, avoidance, self._config)
        try:
            if not good:
                raise NoSolutionError("the measurement is not finite")
            error = None if reference is None else end_effector_error(self.state, reference)
            stack = self._stack(inserted, error)
            wanted, asked = self._base_part(inserted, error, stack)
            asked = self._possible(asked)
            given = asked if base_acceleration is None else base_acceleration
            workings = self._arm_part(wanted, given, inserted, stack, torque)
            n_b = self._model.n_b
            u_a = self.state.M[n_b:] @ workings.qdd + self.state.h[n_b:]
        except NoSolutionError:
            self.failures += 1
            u_a = free_arm_torque(self.state)
            asked = base_rest_acceleration(self.state, self._config.task)
        u_a = clipped(u_a, *torque)
        if self.q_posture is not None:  # else the torques are those of no pose that was measured
            self._u_a = u_a
        solved, tracking = workings is not None, reference is not None
        return ControlOutput(u_a.copy(), asked, avoidance, inserted, solved, tracking, workings)

    def score_field(self, pair: str) -> ScoreField:
        """The score by which a pair of L_m chooses its acting points, by the pair's name."""
        return self._avoidance.field(pair)

    def _base_part(
        self, inserted: Inserted, error: EndEffectorError | None, stack: Stack
    ) -> tuple[Array, Array]:
        """The base's acceleration of (29), (n_b,), and what of it the arm can make up for.

        The rows fix it once the solution without them is known, in which the arm's own rows against
        the base have no part: there the base's rows say how it helps. Loops are as slow as the base
        is; it is braked where there is no solution.

        Paper: Eq. (29), the base's rows.
        """
        state, slow, lowest = self.state, self._slow, stack.lowest
        rest = base_rest_acceleration(state, slow.task)
        if error is None and not inserted.base_too:
            return self._by_rows(rest, inserted.rows_m)
        k_p, k_v, softness = slow.repulsion.k_p, slow.repulsion.k_v, slow.task.softness
        links = [row._replace(xdd=k_p - k_v * (row.J @ state.qd)) for row in inserted.rows_links]
        kept = inserted.kept if inserted.base_too else None
        limits = robot_limits(state, self._config, kept)
        if error is None:
            T_ee, objective = None, with_base_at_rest(state, lowest, slow.task)
        else:  # an error that is left damps nothing here: the base drives there
            T_ee = end_effector_task(state, error, slow.task)
            objective = tracking_objective(lowest, T_ee._replace(give=0.0), slow.task.ee_weight)
        try:
            whole = insert_rows(objective, links, softness)
            qdd = self._solver.solve(whole, limits.and_also(self._base_limits))
            free = self._model.J_m @ qdd[: self._model.n_b]
            wanted, asked = self._by_rows(free, inserted.rows_m)
            if T_ee is None:
                return wanted, asked
            return wanted, asked + self._relief(asked, T_ee, lowest, inserted)
        except NoSolutionError:
            self.given_up += 1
            return rest, rest

    def _by_rows(self, free: Array, rows_m: TaskRows | None) -> tuple[Array, Array]:
        """The blend of (29) for the base, (n_b,), and what of it does not take the hand along."""
        if rows_m is None:
            return free, free
        (gain, drag), (_, low, high, _) = self._response, self._base_limits
        velocity, beta = self.state.measurement.base_velocity, rows_m.beta
        wanted, possible, held = base_blend(free, rows_m.xdd, beta, low, high, gain, drag, velocity)
        holding = self._config.holding
        taken, weight = carried(self.state, holding.speed) * gain, beta * holding.weight
        return wanted, base_with_hand(self.state, possible, held, weight, taken)

    def _possible(self, acceleration: Array) -> Array:
        """The base's, (n_b,), within its limits."""
        return clipped(acceleration, *self._base_limits[1:3])

    def _relief(
        self, asked: Array, T_ee: EqualityTask, posture: Objective, inserted: Inserted
    ) -> Array:
        """The least change of what the base is asked, (n_b,), with which the arm holds T_ee.

        That is, of what base and arm would do if the arm had no limits, T_ee being far costlier,
        and the base's rows as far as they are active. The limits are all that the arm puts above
        T_ee: joints, distances, and the buffers of its own links. They are approached as slowly as
        the base answers, so that it looks ahead as far as it needs: a wrist that comes to its limit
        while the base makes room turns the base in time.
        """
        task, (gain, drag) = self._slow.task, self._response
        lost = drag * self.state.measurement.base_velocity
        tasks = tracking_objective(posture, T_ee, task.base_weight * task.ee_weight)
        rows = [] if inserted.rows_m is None else [inserted.rows_m]
        tasks = insert_rows(tasks, rows, task.softness)
        qdd_b = self._model.J_m_inv @ (gain * (asked - lost))
        limits = robot_limits(self.state, self._slow, inserted.ahead)
        return self._model.J_m @ self._solver.change(tasks, limits, qdd_b) / gain

    def _arm_part(
        self,
        wanted: Array,
        given: Array,
        inserted: Inserted,
        stack: Stack,
        torque: Array,
    ) -> Workings:
        """The arm's part of (29) for the acceleration that the base really has.

        Raises:
            NoSolutionError: There is none.
        """
        config, softness = self._config, self._config.task.softness
        rows = (*inserted.rows_arm, *inserted.rows_links)
        qdd_b = self._model.J_m_inv @ given
        now = ArmNow(qdd_b, torque, self.estimate.pushed)
        limits = robot_limits(self.state, config, inserted.kept, arm=now)
        whole = insert_rows(stack.objective, rows, softness, given=len(qdd_b))
        qdd = self._solver.solve(whole, limits, qdd_b)
        return Workings(wanted, given, rows, stack, limits, torque, qdd)

    def _stack(self, inserted: Inserted, error: EndEffectorError | None) -> Stack:
        if error is None:
            guided = guided_objective(self.state, free_arm_torque(self.state) + inserted.u_a)
            return Stack(guided, guided, None)
        assert self.q_posture is not None
        task = self._config.task
        posture = posture_objective(self.state, self.q_posture, task)
        T_ee = end_effector_task(self.state, error, task)
        return Stack(tracking_objective(posture, T_ee, task.ee_weight), posture, T_ee)
