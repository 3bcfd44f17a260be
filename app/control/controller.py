"""The controller: measurement in, one control step out, without simulator or display.

A step calls the compiled functions `take_reference` (with a reference), `update_estimate` and
`run_algorithm_2`; before the last one, pinocchio computes kinematics, dynamics and distances.
`ControlLoop` is the complete control in one object, for your own loop and for the simulation.
"""

import logging
from collections.abc import Mapping, Sequence
from typing import NamedTuple, NoReturn

import numpy as np

from app.avoidance.closest_points import SmoothPoints
from app.border.cache import BorderData, load_border_data
from app.border.offset import border_of
from app.compiled import direct
from app.config import Config, slowed
from app.control import CONTROLLERS, algorithm, contract
from app.control.hqp import solved_by_hierarchy
from app.control.inputs import METHODS, gains_struct, largest_command, robot_struct
from app.control.qp import changed_by_proxqp, solved_by_proxqp
from app.control.quantities import QUANTITIES, ControlStep
from app.control.readings import EARLY, FAULTS, IMPLAUSIBLE, LAG, PERIOD, later_base
from app.control.references import is_motion, take_reference
from app.control.tasks import Reference
from app.errors import ConfigError, check_name
from app.robot.bases.kind import BaseKind
from app.robot.link_pairs import PairDistances
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState, checked, compute_dynamics, numbers
from app.strict import Array

logger = logging.getLogger(__name__)

_possible, _take, _later = direct(is_motion), direct(take_reference), direct(later_base)
_estimate, _law = direct(algorithm.update_estimate), direct(algorithm.run_algorithm_2)

_MEMORY = tuple(each.name for each in QUANTITIES if each.meaning.startswith("memory"))
_UNKNOWN = "d_b", "u_a", "v_last", "q_posture", "reading", "x_sent", "clock", "stamp"  # first NaN


class Controller:
    """Reactive self-collision avoidance: Algorithm 2, with all its data.

    With a reference the end-effector tracks this reference. Without one a person guides the arm,
    and the controller applies gravity compensation, joint damping and the avoidance task.
    """

    def __init__(
        self,
        model: RobotModel,
        data: BorderData | None = None,
        config: Config | None = None,
        *,
        name: str = "dbb",
        dt: float = 0.001,
        interpolate: bool = False,
    ) -> None:
        """Arguments and errors as `ControlLoop`, but `interpolate` is False by default."""
        contract.check_types(model, data, interpolate)
        check_name("controller", name, CONTROLLERS)
        self.config = model.description.config if config is None else config
        """The parameters in use; `configure` changes them."""
        self.dt = contract.checked_period(dt)
        """[s] the control period: the stated one, or the measured one after the fault `period`."""
        contract.check_gains(self.config, self.dt)
        data = data or load_border_data(model)
        self._model, self._data, self._interpolate = model, data, bool(interpolate)
        self._top = contract.largest_speeds(model)
        self._base = model.description.base
        self._distances = PairDistances(model, data.pairs.all)
        self.state = RobotState(model)
        """The robot's estimated state in the last step with `valid` readings."""
        smooth = SmoothPoints(model, data.pairs.all)
        self._robot = robot_struct(model, data, smooth, self._distances)
        views = self.state.views | {"signed": self._distances.signed}
        self.last = ControlStep(_sizes(model, data, smooth), views, data.pairs.all, smooth.rows)
        """The table of quantities of the last step."""
        self.last.pinocchio = self.state.data, self._distances  # own the memory of the views
        self.state.share(self.last)
        self.faulty = False
        """Whether the readings of the last step have a fault."""
        self.use(name)
        kind = type(self._base)
        self._own_drive = kind.drive_acceleration is not BaseKind.drive_acceleration
        self._own_commands = kind.admissible is not BaseKind.admissible
        self.reset()

    def __reduce__(self) -> NoReturn:
        raise ConfigError("a controller cannot be copied or pickled: create one in each process")

    def use(self, name: str) -> None:
        """Use a different controller from the next step on; errors as `ControlLoop`."""
        check_name("controller", name, CONTROLLERS)
        contract.check_gains(self.config, self.dt)
        self.name = name
        self.configure(self.config)

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on.

        The border changes at once; for the method `hqp`, its kind is always `points`. The buffer
        distance in use approaches a new d_b at `algorithm.BUFFER_RATE`. An addition to the mass of
        the payload is subtracted from the detected loads.

        Raises:
            ConfigError: `config` is not a `Config`, or a gain is too large for the period `dt`.
        """
        contract.check_gains(config, self.dt)
        border, load, w = config.border, config.payload, self.last
        added = load.mass - self.config.payload.mass
        self.config = config
        self.state.carry(load.mass, (load.x, load.y, load.z))
        if added != 0.0:
            w.torques += added * w.lifts
            w.loaded -= added
            w.unstated[...] = 0.0
        if "hierarchy" in METHODS[self.name]:
            border = border.model_copy(update={"kind": "points"})
        clouds = tuple(self._data.clouds[pair.name] for pair in self._data.pairs.mobile)
        self._border = border_of(self._model, clouds, border)
        self._set_gains()

    def _set_gains(self) -> None:
        self._gains = gains_struct(self.config, self._model, self.name, self.dt)
        self._slow = gains_struct(slowed(self.config), self._model, self.name, self.dt)

    def reset(self) -> None:
        """Start again: the next reading is the initial state, and the base's command starts at 0.

        A measured control period stays in use, and until the next valid reading the fallback
        command compensates gravity at the last valid posture.
        """
        self.last.qd[...] = 0.0  # the fallback command damps these speeds
        for name in _MEMORY:
            getattr(self.last, name)[...] = np.nan if name in _UNKNOWN else 0.0

    @property
    def d_b(self) -> float:
        """[m] the buffer distance in use, which approaches a new d_b slowly."""
        return self.config.border.d_b if np.isnan(self.last.d_b) else float(self.last.d_b)

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
                the commanded one of this step.

        Returns:
            The quantities of this step, which the next step overwrites. They always contain a
            command. It is the fallback command before the first valid reading and after 0.1 s
            without one, after readings that contradict the torques (until `reset`), and if the
            arm's QP or the hierarchy of `hqp` has no solution (docs/own_loop.md).

        Raises:
            MeasurementError: An argument has a wrong type or size, the reference is no possible
                motion (`is_motion`), `base_acceleration` is not finite, a joint of the first
                reading is far outside of its limits, or its time stamp is too far from `now`.
        """
        if base_acceleration is None:
            return self._step(measurement, reference, algorithm.BASE_AS_COMMANDED)
        n_b = self._model.n_b
        self.last.a_base_meas[:] = numbers("base_acceleration", base_acceleration, n_b, finite=True)
        return self._step(measurement, reference, algorithm.BASE_MEASURED)

    def step_with_drive(self, measurement: Measurement, reference: Reference | None) -> ControlStep:
        """A step as in `step`, with the base acceleration from the model of the drive.

        The model computes the acceleration from the last velocity command, not from the new one.
        """
        return self._step(measurement, reference, algorithm.DRIVE_MODEL)

    def _step(
        self, measurement: Measurement, reference: Reference | None, base_source: int
    ) -> ControlStep:
        w, robot, gains, data = self.last, self._robot, self._gains, self.state.data
        measurement = checked(measurement, self._model)
        if reference is not None:
            pose, v, a = reference = contract.checked_reference(reference)
            R, p = pose.rotation, pose.translation
            if not _possible(R, p, v, a, self._top):
                raise contract.no_motion(reference, self._top)
            _take(gains, w.struct, R, p, v, a, measurement.now, self._interpolate)
        base, velocity, q, qd, drive, now, time, base_time = measurement
        if base_time == base_time:  # advance the base's readings to the time of the joints'
            new = time == time and time != w.stamp
            until = time if new else now - float(w.lag) * self.dt
            age = np.inf if base_time - now > EARLY else until - base_time
            base, velocity = _later(robot, gains, w.struct, base, velocity, age)
        readings = base, velocity, q, qd, drive
        self.faulty = _estimate(robot, gains, w.struct, readings, now, time)
        if self.faulty and w.faults[PERIOD]:
            ratio = float(w.clock_ratio or w.ratio)
            self.dt = min(max(self.dt * ratio, contract.SHORTEST), contract.LONGEST)
            self._set_gains()
            gains = self._gains
            if w.stamp == w.stamp:  # its age is now a different number of periods
                hidden = w.hidden_lag - w.stated_lag
                w.lag[...] = np.rint((w.lag - hidden) / ratio) + hidden
        if self.faulty and np.isnan(w.q_posture[0]):
            if w.faults[IMPLAUSIBLE]:
                raise contract.implausible(self._model, measurement.q_m)
            if w.faults[LAG] or measurement.time - measurement.now > EARLY:
                raise contract.clocks_differ(measurement)
        if not self.faulty or w.valid:
            self.state.drive = measurement.drive
            compute_dynamics(self.state.pin, data, w.q_pin, w.v_pin)
        self._distances.update_from(data)
        if self._own_drive and base_source == algorithm.DRIVE_MODEL:
            state = drive if len(drive) else self._base.drive_at_rest()
            if np.isfinite(state).all():  # after a lost reading the acceleration stays the same
                v = w.base_velocity.copy()
                w.a_base_meas[:] = self._base.drive_acceleration(v, state, w.v_cmd)
            base_source = algorithm.BASE_MEASURED
        tracking, slow, border = reference is not None, self._slow, self._border
        while left_open := _law(robot, gains, slow, border, w.struct, base_source, tracking):
            self._rescue(int(left_open) - 1)
        if self._own_commands and w.command_due:
            largest = largest_command(self._base, self.config.admittance)
            w.v_cmd[:] = admissible_command(self._base, w.v_cmd, w.v_before, largest)
        return w

    def _rescue(self, which: int) -> None:
        """Solve problem `which` that the law left open, and write its row of qp_x and qp_tried."""
        w, m = self.last, int(self.last.qp_rows)
        w.qp_tried[which] = 1.0
        if which == algorithm.HIERARCHY:
            w.qp_x[which] = solved_by_hierarchy(w, self.config.task)
            return
        fixed = 0 if which == algorithm.FREE_BASE else self._model.n_b
        limits = w.C[:m], w.l[:m], w.u[:m], w.softness[:m]
        solution = changed_by_proxqp if which == algorithm.ROOM else solved_by_proxqp
        w.qp_x[which] = solution(w.qp_H, w.qp_c, *limits, w.qp_fixed[:fixed])


class Command(NamedTuple):
    """The commands of one control step.

    The next step of the loop changes `step` and the properties below, except in a `copy.deepcopy`.
    """

    u_a: Array
    """(n_m,) [N m or N] torques of the arm, including gravity and Coriolis terms."""
    base_velocity: Array
    """(n_b,) [m/s or rad/s] velocity command along the base's axes: v and ω for a differential
    base. It changes only at the end of each command period, at 10 Hz by default."""
    step: ControlStep
    """All quantities of the step, such as the distances; the next step overwrites them."""

    @property
    def gravity(self) -> Array:
        """(n_m,) [N m or N] the gravity terms in `u_a`.

        Subtract them if the robot's driver adds gravity compensation, as for UR and Franka.
        """
        return self.step.g[self.step.n_b :].copy()

    @property
    def load(self) -> float:
        """[kg] mass of the load in the fault `load`; negative if a load of `payload.mass` is gone.

        Without this fault, the mass that best explains the external torques, including a person's.
        """
        return float(self.step.unstated or self.step.load)

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of all faults of this step's readings, from `app.control.readings.FAULTS`."""
        return tuple(name for name, is_on in zip(FAULTS, self.step.faults, strict=True) if is_on)


class ControlLoop:
    """The controller with the model of the base's drive."""

    def __init__(
        self,
        model: RobotModel,
        data: BorderData | None = None,
        config: Config | None = None,
        *,
        name: str = "dbb",
        dt: float = 0.001,
        interpolate: bool = True,
    ) -> None:
        """Prepare the control.

        Args:
            model: The robot.
            data: Link pairs and border; default: read from a file, or sampled now.
            config: Parameters; default: those of the robot.
            name: One of `app.control.CONTROLLERS`.
            dt: [s] control period.
            interpolate: Whether to interpolate references that jump.

        Raises:
            UnknownNameError: The controller does not exist.
            ConfigError: An argument has a wrong type, dt is not within 0.1 to 20 ms, or a gain is
                too large for dt.
            AssetError: A mesh is missing.
            DescriptionError: The description has no reachability of a body of the arm that can meet
                the base, or the base is too large for a border.
        """
        self.controller = Controller(model, data, config, name=name, dt=dt, interpolate=interpolate)
        """Algorithm 2."""
        self.reported: set[str] = set()
        """Names of all faults of the readings since `reset`."""

    def joint_order(self, names: Sequence[str]) -> contract.JointOrder:
        """A function that selects the arm's joints from joint states in the order `names`.

        Raises:
            MeasurementError: `names` is a string or a set, or lacks or repeats a joint of the arm.
        """
        return contract.JointOrder(self.controller.state.model, names)

    def reset(self) -> None:
        """Start again: the next reading is the initial state, and the base's command starts at 0.

        Call it after a protective stop, a pause, or a motion of the arm without the controller.
        """
        self.controller.reset()
        self.reported.clear()

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on; errors as `Controller.configure`."""
        self.controller.configure(config)

    def step(self, measured: Measurement, reference: Reference | None = None) -> Command:
        """Compute the commands of one control step; errors as `Controller.step`.

        `reference` is the desired motion of the end-effector; None while a person guides the arm.
        """
        step = self.controller.step_with_drive(measured, reference)
        command = Command(step.u_cmd.copy(), step.v_cmd.copy(), step)
        if self.controller.faulty:
            self._report(command, measured)
        return command

    def _report(self, command: Command, measured: Measurement) -> None:
        """Log each fault of the readings once until `reset`."""
        for name in command.faults:
            if name not in self.reported:
                self.reported.add(name)
                dt, note = self.controller.dt, ""
                if name == "lag":
                    note = f" ({command.step.lag * dt * 1000:.0f} ms)"
                elif name == "period":
                    reason = contract.too_large_gain(self.controller.config, dt)
                    note = f" ({dt * 1000:.2f} ms{reason and '; '}{reason})"
                note += contract.rounding(measured, 0.5 * dt)
                logger.warning("readings, %s: %s%s", name, FAULTS[name], note)


def _sizes(model: RobotModel, data: BorderData, smooth: SmoothPoints) -> Mapping[str, int]:
    """The value of each dimension in `quantities.DIMENSIONS`."""
    pairs, mobile, rows = len(data.pairs.all), len(data.pairs.mobile), len(smooth.arrays["sought"])
    return {
        **{name: getattr(model, name) for name in ("n", "n_b", "n_m")},
        "n_j": model.pin.njoints,
        "n_q": model.pin.nq,
        "n_v": model.pin.nv,
        "n_p": pairs,
        "n_mob": mobile,
        "n_r": rows,
        "n_s": model.n_b + pairs - mobile + 3 * mobile,
        "n_l": 2 * model.n_m + rows + model.n_b,
    }


def admissible_command(base: BaseKind, command: Array, before: Array, v_max: Array) -> Array:
    """The feasible command (n_b,) [m/s or rad/s] nearest to `command`, after the command `before`.

    If the axes of a base depend on each other, the nearest feasible command can exceed `v_max`
    (n_b,). Then all its entries are multiplied by the same factor.
    """
    found = base.admissible(command, before)
    over = float(np.max(np.abs(found) / v_max))
    return found / over if over > 1.0 else found
