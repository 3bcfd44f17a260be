"""One run: plant, controller, base command and person, stepped together at the control rate."""

from __future__ import annotations

import math
from collections.abc import Sequence
from time import perf_counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.avoidance.closest_points import DistanceMonitor
from app.border.cache import BorderData
from app.config import Config, DisturbanceConfig
from app.control.buffer_watch import BufferReading, BufferWatch
from app.control.control_loop import ControlLoop
from app.control.controller import Controller, ControlOutput
from app.control.tasks import Reference
from app.errors import TargetError
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.disturbance import Disturbances
from app.simulation.people import Hold, People, PersonForces, PullReading
from app.simulation.plants import chosen_plant, make_physics
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Contacts, Physics
from app.simulation.scenarios.leading import DoorReading

Array = np.ndarray

DT = 0.001  # [s] control step, the paper's 1 kHz
_ROUNDING = 1e-6  # [rad or m] by which a joint at its limit may seem beyond
LEAD = -1
"""Number of the person whose pull a scenario gives."""


class Step(NamedTuple):
    """What happened in one control step.

    Attributes:
        t: [s] simulated time at the step's begin.
        measurement: The sensors' readings.
        output: The controller's answer.
        base_command: (n_b,) [m/s or rad/s] in force; what arrives at the drive may be late.
        hand_target: (3,) [m] where the (first) person at the end-effector pulls it, or None.
        hand_force: (3,) [N] force on the end-effector in the world: the person's, or what the hand
            exerts on a door that it holds.
        ee_error: [m] true distance of the end-effector from its reference, or from where the
            person pulls; 0 if there is neither.
        contacts: What touched in the step.
        duration: [s] real time that the control took.
        truth: The robot as it is; the same as `measurement` without noise.
        distances: [m] true signed distances, in the order of the output's pairs.
        buffer: Whether d_b is enough for how fast the arm comes.
        door: How the opening of a door goes, or None if there is none.
        pulls: All that hold the robot.
        person: The forces of people that acted on the robot.
        reference: What the arm tracked, or None while it was guided.
        given_up: Steps since the last reset in which the base's own part had no solution.
        hand_speed: [m/s] true speed of the end-effector.
    """

    t: float
    measurement: Measurement
    output: ControlOutput
    base_command: Array
    hand_target: Array | None
    hand_force: Array
    ee_error: float
    contacts: Contacts
    duration: float
    truth: Measurement
    distances: tuple[float, ...]
    buffer: BufferReading
    door: DoorReading | None = None
    pulls: tuple[PullReading, ...] = ()
    person: PersonForces = PersonForces(np.zeros(3))
    reference: Reference | None = None
    given_up: int = 0
    hand_speed: float = 0.0


class Session:
    """A robot with its controller in a plant.

    Attributes:
        t: [s] simulated time since the last reset.
        model: The robot as the controller knows it.
        data: Its pairs and clouds.
        config: Parameters.
        kind: Kind of plant.
        seed: Of everything random.
        door: The door that the hand holds, and how far it is open at the start, or None.
        loop: All of the control, as a robot's own loop calls it.
        physics: The plant.
        state: The robot as it was at the last step.
        wheel_angles: (n_w,) [rad] of the base's `wheels`, for drawing.
    """

    def __init__(
        self,
        model: RobotModel,
        data: BorderData,
        config: Config,
        *,
        controller: str = "dbb",
        physics: str | None = None,
        seed: int = 0,
        plant: RobotModel | None = None,
        door: OpenDoor | None = None,
    ) -> None:
        """Set up; call `reset` before the first step.

        Args:
            model: The robot as the controller knows it.
            data: Its pairs and clouds.
            config: Parameters.
            controller: One of `app.control.CONTROLLERS`.
            physics: Kind of plant; the default one if not given.
            seed: Of the sensors' noise.
            plant: The robot as it is, where the controller's has what it holds as one more body.
            door: A door that the hand holds, or None.

        Raises:
            UnknownNameError: No controller or plant has that name.
            ConfigError: The plant has no doors.
        """
        self.model, self.data, self.config = model, data, config
        self.kind, self.seed, self.door = chosen_plant(physics), seed, door
        self.loop = ControlLoop(model, data, config, name=controller, dt=DT)
        self.physics: Physics = make_physics(self.kind, plant or model, dt=DT, door=door)
        self._base = model.description.base
        self._disturbances = Disturbances(config.disturbance, DT, seed)
        self._own_state = RobotState(model)  # where sensors say something else
        pairs = [*data.pairs.mobile, *data.pairs.manipulator]
        self._distances = DistanceMonitor(self._own_state, pairs)
        self._watch = BufferWatch(config)
        self._disturb(config.disturbance)
        self.reset(np.array(model.description.arm.ready_position))

    def reset(self, q_m: Array, base_pose: Array | None = None) -> None:
        """Put the robot at rest with the arm at `q_m`; nobody pulls.

        Args:
            q_m: (n_m,) [rad or m] the arm's joints.
            base_pose: (3,) x, y [m] and heading [rad] of the base; the origin if not given.

        Raises:
            TargetError: A joint is beyond its limits.
        """
        _check_within_limits(self.model, q_m)
        self.t = 0.0
        self.physics.reset(np.zeros(3) if base_pose is None else base_pose, q_m)
        self.loop.reset()
        self._disturbances.reset()
        self._people = People(self.model, self.config.hand, DT)
        self.wheel_angles = np.zeros(len(self._base.wheels))
        self.controller.state.update(self.physics.measure())
        self.state = self.controller.state
        self._watch.reset()

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on."""
        self.config = config
        self.loop.configure(config)
        self._people.config = config.hand
        self._watch.config = config
        self._disturb(config.disturbance)

    @property
    def controller(self) -> Controller:
        """The controller under test."""
        return self.loop.controller

    @property
    def T_world_ee(self) -> pin.SE3:
        """Pose of the end-effector at the last step, as the sensors have it."""
        return self.controller.state.T_world_ee

    def step(
        self,
        reference: Reference | None = None,
        pull: Array | None = None,
        door: DoorReading | None = None,
        holds: Sequence[Hold] = (),
        *,
        forces: PersonForces | None = None,
    ) -> Step:
        """Advance by one control step.

        Args:
            reference: What the arm tracks, or None while it is guided.
            pull: (3,) [m] where a person pulls the end-effector, or None.
            door: How the opening of a door goes, for the record only.
            holds: Others who hold the robot, here or elsewhere.
            forces: What acts on the robot instead of those people's own springs; the error is still
                towards where they pull.
        """
        truth = self.physics.measure()
        measurement = self._disturbances.sensed(truth)
        begin = perf_counter()
        _, command, output = self.loop.step(measurement, reference)
        duration = perf_counter() - begin
        state, distances = self._observe(truth, measurement, output)
        p_ee = state.T_world_ee.translation
        if pull is not None:
            holds = (Hold(LEAD, pull), *holds)
        pulls, own = self._people.pull(state, holds if forces is None else ())
        person = own if forces is None else forces
        target = next((hold.target for hold in holds if hold.link is None), None)
        aim = target if target is not None else reference.pose.translation if reference else p_ee
        error = math.dist(p_ee.tolist(), aim.tolist())
        self.physics.step(output.u_a, self._disturbances.arriving(command), *person)
        self.wheel_angles = self._base.turned(
            self.wheel_angles, state.qd[: self.model.n_b], truth.drive, DT
        )
        felt = person.hand if door is None else door.force
        step = Step(
            self.t,
            measurement,
            output,
            command,
            target,
            felt,
            error,
            self.physics.contacts(),
            duration,
            truth,
            distances,
            self._look(output),
            door,
            pulls,
            person,
            reference,
            self.controller.given_up,
            math.hypot(*state.v_ee[:3].tolist()),
        )
        self.t += DT
        return step

    def _observe(
        self, truth: Measurement, sensed: Measurement, output: ControlOutput
    ) -> tuple[RobotState, tuple[float, ...]]:
        """The true state, and [m] of all pairs; without noise both are the controller's."""
        if sensed is truth:
            self.state = self.controller.state
            return self.state, tuple(pair.closest.d for pair in output.avoidance.pairs)
        self.state = self._own_state
        self.state.update_kinematics(truth)
        return self.state, self._distances.distances()

    def _look(self, output: ControlOutput) -> BufferReading:
        closest = [pair.closest for pair in output.avoidance.mobile]
        return self._watch.update(self.state, closest, DT, gives_way=self.controller.name == "dbb")

    def _disturb(self, config: DisturbanceConfig) -> None:
        self._disturbances.config = config
        self.controller.state.scale_arm_inertias(1.0 + config.mass_error)

    def close(self) -> None:
        """Release the plant."""
        self.physics.close()


def _check_within_limits(model: RobotModel, q_m: Array) -> None:
    """Refuse a start from which a plant would throw the arm back.

    Raises:
        TargetError: Names the joint and its limits.
    """
    for name, at, low, high in zip(
        model.description.arm.joints, q_m, model.q_lower, model.q_upper, strict=True
    ):
        if not low - _ROUNDING <= at <= high + _ROUNDING:
            raise TargetError(
                f"start: {name} at {at:.4g} is beyond its limits, {low:g} to {high:g}"
            )
