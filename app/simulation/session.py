"""A session: plant, controller, disturbances and people, stepped together at the control rate."""

import math
from collections import deque
from collections.abc import Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.avoidance.closest_points import DistanceMonitor
from app.border.cache import BorderData
from app.config import Config, DisturbanceConfig
from app.control.buffer_watch import BufferReading, BufferWatch
from app.control.contract import check_gains
from app.control.controller import Controller, ControlLoop
from app.control.inputs import MOVES_BASE
from app.control.quantities import ControlStep
from app.control.tasks import Reference
from app.errors import DescriptionError, TargetError
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.people import Hold, People, PersonForces, PullReading
from app.simulation.plants import chosen_plant, make_physics
from app.simulation.plants.door import NO_DOOR, DoorView, OpenDoor
from app.simulation.plants.interface import Contacts, Physics, PointLoad
from app.strict import Array, Vector3

DT = 0.001  # [s] control step, the paper's 1 kHz
_BANDWIDTH = 250.0  # [rad/s] natural frequency (40 Hz) of the loop `VelocityTracking`
_ROUNDING = 1e-6  # [rad or m] tolerance of a joint at its limit
SCENARIO_PERSON = -1  # number of a scenario's person


class Step(NamedTuple):
    """The results of one control step."""

    t: float  # [s] simulated time at the start of the step
    measurement: Measurement  # readings that the controller received
    control: ControlStep  # quantities of the control step; the next step overwrites them
    base_command: Array  # (n_b,) [m/s or rad/s] command for the base, before delay and slip
    hand_target: Array | None  # (3,) [m] as `Snapshot.hand_target`
    hand_force: Array  # (3,) [N] as `Snapshot.hand_force`
    ee_error: float  # [m] as `Snapshot.ee_error`
    contacts: Contacts  # contacts during the step
    duration: float  # [s] real time of the controller's computation
    truth: Measurement  # readings without sensor errors
    state: RobotState  # true kinematics (M, h, g can differ); the next step overwrites it
    distances: Array  # (n_p,) [m] true signed distances of all link pairs
    buffer: BufferReading  # whether d_b is sufficient for the arm's approach speed
    door: DoorView | None = None  # the door that the end-effector holds, or None
    pulls: tuple[PullReading, ...] = ()  # of all people; empty if `Session.step` had `forces`
    person: PersonForces = PersonForces(np.zeros(3))  # forces of all people during the step
    reference: Reference | None = None  # the tracked reference; None in the mode "guiding"
    ee_speed: float = 0.0  # [m/s] true speed of the end-effector

    @property
    def people(self) -> int:
        """Number of people in `pulls`."""
        return len(self.pulls)

    @property
    def duration_us(self) -> float:
        """[µs] real time of the controller's computation."""
        return 1e6 * self.duration

    @property
    def door_numbers(self) -> Array:
        """(7,) `DoorView.numbers` of the door; NaN without a door."""
        return NO_DOOR if self.door is None else self.door.numbers


def check_avoidance(model: RobotModel, data: BorderData) -> None:
    """Raise a DescriptionError if L_m is empty: no link pair contains the base."""
    if not data.pairs.mobile:
        why = f"{model.description.name}: no monitored part of the arm can meet the base"
        why += ", so no controller can avoid a collision; check the pairs under `unwatched` in "
        why += "robot.toml, and in the robot's report that the bodies enclose the links"
        raise DescriptionError(why)


class Session:
    """A robot with its controller in a plant."""

    def __init__(
        self,
        model: RobotModel,
        data: BorderData,
        config: Config,
        controller: str = "dbb",
        physics: str | None = None,
        seed: int = 0,
        *,
        plant: RobotModel | None = None,
        door: OpenDoor | None = None,
    ) -> None:
        """Start at rest in the ready posture, with the base at the origin.
        `model` is the robot of the controller, `plant` that in the plant, by default `model`.
        `physics` names the plant, by default `default_plant`. The end-effector holds any `door`; it
        is then the last body of `model`, and no body of `plant`. `seed` fixes all random numbers.
        Raises the errors of `ControlLoop`, `make_physics` and `check_avoidance`.
        """
        check_avoidance(model, data)
        self.model, self.data, self.config = model, data, config
        self.kind, self.seed, self.door = chosen_plant(physics), seed, door
        self._stated = config.disturbance.stated_period
        self.loop = ControlLoop(model, data, config, name=controller, dt=self._stated)
        self._base = model.description.base
        self._disturbances = Disturbances(config.disturbance, DT, seed)
        self._own_state = RobotState(model)  # true kinematics, if the readings are disturbed
        self._distances = DistanceMonitor(self._own_state, data.pairs.all)
        self._watch = BufferWatch(config)
        self.controller.state.scale_arm_inertias(1.0 + config.disturbance.mass_error)
        self.physics: Physics = make_physics(self.kind, plant or model, dt=DT, door=door)
        self.reset(np.array(model.description.arm.ready_position))

    def reset(
        self, q_m: Array, base_pose: Array | None = None, config: Config | None = None
    ) -> None:
        """Put the robot at rest, without people; restart the time and the random numbers.
        `q_m` (n_m,) [rad or m] are the arm's joint positions, `base_pose` (3,) x, y [m] and heading
        [rad] of the base, by default zero. `config`, if specified, replaces all parameters,
        including `disturbance.stated_period`. Before any change, this raises a TargetError if the
        posture is invalid, or a ConfigError if the stated control period is too long for a gain.
        """
        check_posture(self.model, q_m)
        if config is not None:
            period, name = config.disturbance.stated_period, self.controller.name
            check_gains(config, period)
            if period != self._stated:
                self.loop = ControlLoop(self.model, self.data, config, name=name, dt=period)
                self._stated = period
            self.configure(config)
        self.t = 0.0  # [s] simulated time
        self.physics.reset(np.zeros(3) if base_pose is None else base_pose, q_m)
        self.loop.reset()
        self._disturbances.reset()
        self._people = People(self.model, self.config.hand, DT)
        self._wheel_angles = [0.0] * len(self._base.wheels)
        self.controller.state.update(self.physics.measure())
        self.state = self.controller.state  # true kinematics of the robot at the last step
        self._watch.reset()
        self._loads: dict[tuple[str, float, Vector3, float], PointLoad] = {}
        self._loads = self._loads_of(self.config)

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on, except a new `disturbance.stated_period`.
        If the control period is too long for a gain, this raises a ConfigError before any change.
        """
        self.loop.configure(config)
        self.config = config
        self._people.configure(config.hand)
        self._watch.config = config
        self._disturbances.configure(config.disturbance)
        self.controller.state.scale_arm_inertias(1.0 + config.disturbance.mass_error)
        self._loads = self._loads_of(config)

    @property
    def controller(self) -> Controller:
        return self.loop.controller

    @property
    def T_world_ee(self) -> pin.SE3:
        """The controller's estimate of the end-effector's pose in the world, at the last step."""
        return self.controller.state.T_world_ee

    @property
    def wheel_angles(self) -> Array:
        """(n_w,) [rad] angles of the base's wheels, from its motion as if they did not slip."""
        return np.array(self._wheel_angles)

    def step(
        self,
        reference: Reference | None = None,
        pull: Array | None = None,
        door: DoorView | None = None,
        holds: Sequence[Hold] = (),
        *,
        forces: PersonForces | None = None,
    ) -> Step:
        """Advance by one control step; raises the errors of `ControlLoop.step` and `People.pull`.
        The first four arguments are the fields of `StepInput`. `forces`, if specified, replace the
        forces of `pull` and `holds`, and `Step.pulls` is then empty; `Step.hand_target` and
        `Step.ee_error` still have the target of `pull` or, without it, of a hold without a link.
        """
        truth = self.physics.measure()
        measurement = self._disturbances.sensed(truth)
        begin = perf_counter()
        u_a, command, control = self.loop.step(measurement, reference)
        duration = perf_counter() - begin
        state, distances = self._observe(truth, measurement, control)
        if pull is not None:
            holds = (Hold(SCENARIO_PERSON, pull), *holds)
        pulls, own = self._people.pull(state, holds if forces is None else ())
        person = own if forces is None else forces
        p_ee = state.p_ee
        target = next((hold.target for hold in holds if hold.link is None), None)
        aim = target if target is not None else reference.pose.translation if reference else p_ee
        error = math.dist(p_ee.tolist(), aim.tolist())
        loads = [load.push(state) for (*_, begins), load in self._loads.items() if self.t >= begins]
        arriving = self._disturbances.arriving(command)
        self.physics.step(u_a, arriving, person.hand, (*person.pushes, *loads))
        qd_b = state.qd[: self.model.n_b].tolist()
        self._wheel_angles = self._base.turned(self._wheel_angles, qd_b, truth.drive, DT)
        hand_force, contacts = person.hand if door is None else door.force, self.physics.contacts()
        if (held := self.physics.door) is not None:
            door = door or DoorView(held.door, held.angle(), np.zeros(3))
            door = door._replace(contact=contacts.door_base)
        step = Step(
            self.t,
            measurement,
            control,
            command,
            target,
            hand_force,
            error,
            contacts,
            duration,
            truth,
            state,
            distances,
            self._watch.update(state, control, DT, gives_way=self.controller.name in MOVES_BASE),
            door,
            pulls,
            person,
            reference,
            math.hypot(*state.v_ee[:3].tolist()),
        )
        self.t += DT
        return step

    def _observe(
        self, truth: Measurement, measurement: Measurement, control: ControlStep
    ) -> tuple[RobotState, Array]:
        """Update `state` to the true kinematics; return it and the pairs' distances (n_p,) [m]."""
        if measurement is truth and control.valid:  # so the controller has computed both
            self.state = self.controller.state
            return self.state, control.d[: len(control.pairs)].copy()
        self.state = self._own_state
        self.state.update_kinematics(truth)
        return self.state, np.array(self._distances.distances())

    def _loads_of(self, config: Config) -> dict[tuple[str, float, Vector3, float], PointLoad]:
        """The loads with a mass, by name, mass [kg], centre [m] and time of beginning [s]."""
        load, disturbance = config.payload, config.disturbance
        loads = (
            ("payload", load.mass, (load.x, load.y, load.z), 0.0),
            ("unknown", disturbance.unknown_load, (0.0, 0.0, 0.0), disturbance.begins),
        )
        return {
            each: self._loads.get(each) or PointLoad(self.model, each[1], np.array(each[2]), DT)
            for each in loads
            if each[1] > 0.0
        }

    def close(self) -> None:
        self.physics.close()


class Disturbances:
    """The disturbances of the signals between controller and robot: noise, delays, losses, slip."""

    def __init__(self, config: DisturbanceConfig, dt: float, seed: int) -> None:
        """Start as after `reset`; `dt` [s] is the control step; `seed` fixes all random numbers."""
        self._dt, self._seed = dt, seed
        self._commands: deque[Array] = deque()
        self._sent: deque[Measurement] = deque()
        self.configure(config)
        self.reset()

    def configure(self, config: DisturbanceConfig) -> None:
        """Use these disturbances from now on; if a delay grows, the oldest known signal repeats."""
        self._config = config
        late = round(config.base_delay / self._dt)  # [-] steps
        known = list(self._commands)
        self._commands = deque(known[:1] * (late + 1 - len(known)) + known, late + 1)
        self._sent = deque(self._sent, round(config.sensor_delay / self._dt) + 1)
        self._every = max(round(config.sensor_period / self._dt), 1)  # [-] steps
        self._begins = round(config.begins / self._dt)  # [-] steps

    def reset(self) -> None:
        """Restart the random numbers from the seed, and forget all commands and readings."""
        self._rng = np.random.default_rng(self._seed)
        self._tracking = None
        self._commands.clear()
        self._sent.clear()
        self._seen: Measurement | None = None
        self._steps = 0

    def sensed(self, truth: Measurement) -> Measurement:
        """The readings that the controller receives in a control step: `truth`, or readings that
        are noisy, late or repeated, or have time stamps. With noise, `VelocityTracking` computes
        the joint velocities from the noisy positions. The base's sensors have no noise.
        """
        config, sent = self._config, truth
        if config.encoder_noise == 0.0:
            self._tracking = None
        else:
            q_m = truth.q_m + config.encoder_noise * self._rng.standard_normal(len(truth.q_m))
            if self._tracking is None:
                self._tracking = VelocityTracking(truth.q_m, truth.qd_m, self._dt)
            sent = truth._replace(q_m=q_m, qd_m=self._tracking.update(q_m))
        step, self._steps = self._steps, self._steps + 1
        now = step * self._dt if config.time_stamps == "yes" else None
        sent = sent if now is None else sent._replace(time=now)
        self._sent.append(sent)
        if step < self._begins:
            self._seen = sent
        else:
            lost = config.dropped > 0.0 and self._rng.random() < config.dropped
            if self._seen is None or (step % self._every == 0 and not lost):
                self._seen = self._sent[0]  # the oldest reading, at most as old as the delay
        return self._seen if now is None else self._seen._replace(now=now)

    def arriving(self, command: Array) -> Array:
        """Base command (n_b,) [m/s or rad/s] after delay and slip; 0 until the first arrives."""
        commands = self._commands
        commands.append(command)
        late = commands[0] if len(commands) == commands.maxlen else np.zeros_like(command)
        return late if self._config.slip == 0.0 else (1.0 - self._config.slip) * late


class VelocityTracking:
    """Velocities from positions: a tracking loop, as in the electronics of encoders.
    The transfer function from q to v̂ is ω² s / (s + ω)², discretised with exact poles: constant
    velocities are exact, and changes have a delay of about 2/ω = 8 ms. Position noise with the
    standard deviation σ causes velocity noise of about σ √(ω³ dt) / 2, 62 σ/s at 1 kHz.
    """

    def __init__(self, q: Array, qd: Array, dt: float) -> None:
        """Start as after a long motion with the constant velocities `qd` (n,) [rad/s or m/s]. `q`
        (n,) [rad or m] are the positions at the first update; updates follow each `dt` [s].
        """
        pole = math.exp(-_BANDWIDTH * dt)  # a double pole: critically damped
        self._gain_q, self._gain_v = 1.0 - pole**2, (1.0 - pole) ** 2 / dt
        self._q, self._qd, self._dt = q - qd * dt, qd.copy(), dt

    def update(self, q: Array) -> Array:
        """Return the new velocities (n,) [rad/s or m/s] from the next positions (n,) [rad or m]."""
        ahead = self._q + self._qd * self._dt
        error = q - ahead
        self._q = ahead + self._gain_q * error
        self._qd = self._qd + self._gain_v * error
        return self._qd.copy()


def check_posture(model: RobotModel, q_m: Array) -> None:
    """Raise a TargetError if `q_m` [rad or m] is not (n_m,), or a joint is beyond its limits."""
    if len(q_m) != model.n_m:
        raise TargetError(f"the posture has {len(q_m)} joints; the arm has {model.n_m}")
    limits = zip(model.description.arm.joints, q_m, model.q_lower, model.q_upper, strict=True)
    for name, at, low, high in limits:
        if not low - _ROUNDING <= at <= high + _ROUNDING:
            why = f"{name} at {at:.4g} is beyond its limits, {low:g} to {high:g}"
            raise TargetError(f"start: {why}")
