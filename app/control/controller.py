"""The controller: measurement in, one control step out, without simulator or display.

A step calls the compiled functions `update_estimate` and `run_algorithm_2`; between them pinocchio
computes kinematics, dynamics and distances.
"""

from collections.abc import Mapping

import numpy as np

from app.avoidance.closest_points import SmoothPoints
from app.border.cache import BorderData
from app.border.nearest import border_of
from app.border.score import ScoreField
from app.compiled import direct
from app.config import Config, slowed
from app.control import CONTROLLERS
from app.control.admittance import admissible_command, largest_command
from app.control.algorithm import (
    BASE_AS_COMMANDED,
    BASE_MEASURED,
    DRIVE_MODEL,
    FREE_BASE,
    HIERARCHY,
    ROOM,
    run_algorithm_2,
    update_estimate,
)
from app.control.contract import (
    LONGEST,
    SHORTEST,
    check_gains,
    checked_period,
    checked_reference,
    implausible,
    no_motion,
)
from app.control.hqp import solved_by_hierarchy
from app.control.inputs import METHODS, gains_struct, robot_struct
from app.control.quantities import QUANTITIES, ControlStep
from app.control.readings import IMPLAUSIBLE, PERIOD
from app.control.references import take_reference
from app.control.rescue import OpenQP, changed_by_proxqp, solved_by_proxqp
from app.control.tasks import Reference
from app.errors import check_name
from app.robot.bases.kind import BaseKind
from app.robot.link_pairs import PairDistances
from app.robot.model import RobotModel
from app.robot.state import (
    Measurement,
    RobotState,
    checked,
    compute_dynamics,
    pinocchio_views,
)
from app.strict import Array

_take = direct(take_reference)
_estimate, _law = direct(update_estimate), direct(run_algorithm_2)

_MEMORY = tuple(each.name for each in QUANTITIES if each.meaning.startswith("memory"))
_UNKNOWN = ("d_b", "u_a", "v_last", "q_posture", "reading", "x_sent")  # NaN until known


class Controller:
    """Reactive self-collision avoidance: Algorithm 2, with all its data.

    With a reference the end-effector tracks this reference. Without one a person guides the arm,
    and the controller applies gravity compensation, joint damping and the avoidance task.
    """

    def __init__(
        self,
        model: RobotModel,
        data: BorderData,
        config: Config,
        *,
        name: str = "dbb",
        dt: float = 0.001,
        interpolate: bool = False,
    ) -> None:
        """Prepare the controller.

        Args:
            model: The robot.
            data: The robot's link pairs and border.
            config: Parameters, which `configure` replaces.
            name: One of `CONTROLLERS`.
            dt: [s] control period.
            interpolate: Whether to interpolate references that jump (`app.control.references`).

        Raises:
            UnknownNameError: The controller does not exist.
            ConfigError: The period is invalid, or too long for a gain.
            DescriptionError: The description has no reachability of a body that can meet the mobile
                robot.
        """
        self._model, self._data, self._config = model, data, config
        self._dt, self._interpolate = checked_period(dt), interpolate
        self._base = model.description.base
        self._distances = PairDistances(model, data.pairs.all)
        self.state = RobotState(model)
        """The robot's state at the last valid measurement."""
        smooth = SmoothPoints(self.state, data.pairs.all)
        self._robot = robot_struct(model, data, smooth)
        views, sizes = pinocchio_views(self.state.data), _sizes(model, data, smooth)
        self.last = ControlStep(sizes, views, data.pairs.all, smooth.rows)
        """The table of quantities of the last step."""
        self.last.pinocchio = self.state.data  # owns the memory of the views
        self.state.share(self.last)
        self.faulty = False
        """Whether the readings of the last step have a fault."""
        self.use(name)
        self._own_drive = _overrides(self._base, "drive_acceleration")
        self._own_commands = _overrides(self._base, "admissible")
        self.reset()

    def use(self, name: str) -> None:
        """Use a different controller from the next step on.

        Raises:
            UnknownNameError: The controller does not exist.
        """
        check_name("controller", name, CONTROLLERS)
        self.name = name
        self.configure(self._config)

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on.

        A new d_b or ε selects a different border at once. The buffer distance in use approaches the
        new d_b at `algorithm.BUFFER_RATE`, because a jump would abruptly accelerate an arm inside
        the buffer.

        Raises:
            ConfigError: The control period is too long for a gain.
        """
        check_gains(config, self._dt)
        border, load, w = config.border, config.payload, self.last
        added = load.mass - self._config.payload.mass
        self._config = config
        self.state.carry(load.mass, (load.x, load.y, load.z))
        if added != 0.0:
            w.torques += added * w.lifts
            w.loaded -= added
            w.unstated[...] = 0.0
        if METHODS[self.name].get("hierarchy"):
            border = border.model_copy(update={"kind": "points"})
        clouds = tuple(self._data.clouds[pair.name] for pair in self._data.pairs.mobile)
        self._border = border_of(self._model, clouds, border).struct
        self._set_gains()
        self._largest_command = largest_command(self._base, config.admittance)

    def _set_gains(self) -> None:
        config, model = self._config, self._model
        self._gains = gains_struct(config, model, self.name, self._dt)
        self._slow = gains_struct(slowed(config), model, self.name, self._dt)

    @property
    def config(self) -> Config:
        """The parameters in use."""
        return self._config

    @property
    def dt(self) -> float:
        """[s] the control period: the stated one, or the measured one after the fault `period`."""
        return self._dt

    def reset(self) -> None:
        """Start again: the next reading is the initial state, and the base's command starts at 0.

        The controller forgets posture, torques, estimate, commands and the counts of failures. A
        measured period stays in use.
        """
        for name in _MEMORY:
            getattr(self.last, name)[...] = np.nan if name in _UNKNOWN else 0.0

    @property
    def d_b(self) -> float:
        """[m] the buffer distance in use, which approaches a new d_b slowly."""
        return self._config.border.d_b if np.isnan(self.last.d_b) else float(self.last.d_b)

    def step(
        self,
        measurement: Measurement,
        reference: Reference | None = None,
        *,
        base_acceleration: Array | None = None,
    ) -> ControlStep:
        """Compute one step of Algorithm 2, with the commanded or measured acceleration of the base.

        Args:
            measurement: The sensors' readings.
            reference: Desired motion of the end-effector, or None while a person guides the arm.
            base_acceleration: (n_b,) [m/s² or rad/s²] measured acceleration of the base; default:
                the commanded acceleration of this step.

        Returns:
            The quantities of this step, which the next step overwrites. They always contain a
            command. If there is no valid reading for 0.1 s, or the arm's QP has no solution, this
            command is the fallback command: gravity compensation and damping at the last valid
            state (before the first valid state, at the ready posture), and a base that brakes.

        Raises:
            MeasurementError: A reading or the reference has a wrong number of entries, or the
                first reading has a joint far outside of its limits, for example in degrees; or
                the reference is not a finite motion.
        """
        if base_acceleration is None:
            return self._step(measurement, reference, BASE_AS_COMMANDED)
        self.last.a_base_meas[:] = base_acceleration
        return self._step(measurement, reference, BASE_MEASURED)

    def step_with_drive(self, measurement: Measurement, reference: Reference | None) -> ControlStep:
        """Execute a step as `step` does, with the base acceleration from the model of the drive.

        The model computes this acceleration from the last velocity command. `v_cmd` of the returned
        step is the new velocity command.
        """
        if not self._own_drive:
            return self._step(measurement, reference, DRIVE_MODEL)
        measurement = checked(measurement, self._model)
        drive = measurement.drive if len(measurement.drive) else self._base.drive_at_rest()
        read, v_cmd = measurement.base_velocity, self.last.v_cmd
        v = np.where(np.isfinite(read), read, self.last.base_velocity)
        a = self._base.drive_acceleration(v, drive, v_cmd)
        self.last.a_base_meas[:] = np.where(np.isfinite(a), a, 0.0)  # a lost reading of the drive
        return self._step(measurement, reference, BASE_MEASURED)

    def score_field(self, pair: str) -> ScoreField:
        """The score for the acting points of a pair of L_m, by the name of an existing pair."""
        body = next(each.b for each in self._data.pairs.mobile if each.name == pair)
        return ScoreField.of(self._model, body)

    def _step(
        self, measurement: Measurement, reference: Reference | None, base_source: int
    ) -> ControlStep:
        w, robot, gains, data = self.last, self._robot, self._gains, self.state.data
        if reference is not None:
            pose, v, a = reference = checked_reference(reference)
            R, p = pose.rotation, pose.translation
            if not _take(gains, w.struct, R, p, v, a, self._interpolate):
                raise no_motion(reference)
        measurement = checked(measurement, self._model)
        self.faulty = _estimate(robot, gains, w.struct, *measurement)
        if self.faulty and w.faults[PERIOD]:
            self._dt = min(max(self._dt * float(w.ratio), SHORTEST), LONGEST)
            self._set_gains()
        if self.faulty and w.faults[IMPLAUSIBLE] and np.isnan(w.q_posture[0]):
            raise implausible(self._model, measurement.q_m)
        if not self.faulty or w.valid:
            self.state.drive = measurement.drive
            compute_dynamics(self.state.pin, data, w.q_pin, w.v_pin)
        self._distances.update_from(data)
        self._distances.write_distances(w.d)
        tracking = reference is not None
        problem = robot, gains, self._slow, self._border, w.struct, base_source
        while left_open := _law(*problem, tracking):
            self._rescue(int(left_open) - 1)
        if self._own_commands and w.command_due:
            w.v_cmd[:] = admissible_command(self._base, w.v_cmd, w.v_before, self._largest_command)
        return w

    def _rescue(self, which: int) -> None:
        """Solve the open QP, number `which` from 0, by ProxQP, and write the result into `qp_x`."""
        w, m = self.last, int(self.last.qp_rows)
        w.qp_tried[which] = 1.0
        if which == HIERARCHY:
            w.qp_x[which] = solved_by_hierarchy(w, self._config.task)
            return
        fixed = 0 if which == FREE_BASE else self._model.n_b
        limits = w.C[:m], w.l[:m], w.u[:m], w.slack_weight[:m]
        qp = OpenQP(w.qp_H, w.qp_c, *limits, w.qp_fixed[:fixed])
        w.qp_x[which] = changed_by_proxqp(qp) if which == ROOM else solved_by_proxqp(qp)


def _sizes(model: RobotModel, data: BorderData, smooth: SmoothPoints) -> Mapping[str, int]:
    """The dimensions of a step's quantities."""
    pairs, mobile, rows = len(data.pairs.all), len(data.pairs.mobile), len(smooth.joints)
    return {
        "n": model.n,
        "n_b": model.n_b,
        "n_m": model.n_m,
        "n_j": model.pin.njoints,
        "n_q": model.pin.nq,
        "n_v": model.pin.nv,
        "n_p": pairs,
        "n_mob": mobile,
        "n_r": rows,
        "n_s": model.n_b + pairs - mobile + 3 * mobile,
        "n_l": 2 * model.n_m + rows + model.n_b,
    }


def _overrides(base: BaseKind, method: str) -> bool:
    """Whether a kind of base overrides a method."""
    return getattr(type(base), method) is not getattr(BaseKind, method)
