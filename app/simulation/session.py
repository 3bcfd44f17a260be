"""One run: plant, controller, base command and person, stepped together at the control rate."""

from __future__ import annotations

from time import perf_counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.border.cache import BorderData
from app.config import Config
from app.control.admittance import AdmittanceLaw
from app.control.controller import Controller, ControlOutput
from app.control.drive import Drive
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.simulation.person import PersonHand
from app.simulation.physics import Contacts, Physics
from app.simulation.plants import make_physics

Array = np.ndarray

DT = 0.001  # [s] control step, the paper's 1 kHz


class Step(NamedTuple):
    """What happened in one control step.

    Attributes:
        t: [s] simulated time at the step's begin.
        measurement: The sensors' readings.
        output: The controller's answer.
        base_command: (2,) v [m/s] and ω [rad/s] in force.
        hand_target: (3,) [m] where the person pulls, or None.
        hand_force: (3,) [N] the person's force in the world.
        ee_error: [m] distance of the end-effector from its reference, or from where the person
            pulls; 0 if there is neither.
        contacts: What touched in the step.
        duration: [s] real time that the controller took.
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


class Session:
    """A robot with its controller in a plant.

    Attributes:
        t: [s] simulated time since the last reset.
        controller: The controller under test.
        physics: The plant.
        wheel_angles: (2,) [rad] how far the right and the left wheels have turned, for drawing.
    """

    def __init__(
        self,
        model: RobotModel,
        data: BorderData,
        config: Config,
        *,
        controller: str = "dbb",
        physics: str = "planar",
        seed: int = 0,
    ) -> None:
        """Set up; call `reset` before the first step.

        Raises:
            UnknownNameError: No controller or plant has that name.
        """
        self.model = model
        self.config = config
        self.controller = Controller(model, data, config, name=controller)
        self.physics: Physics = make_physics(physics, model, dt=DT, seed=seed)
        base = model.description.base
        self._drive = Drive(base, DT)
        self._admittance = AdmittanceLaw(base, config.admittance)
        self.reset(np.array(model.description.arm.ready_position))

    def reset(self, q_m: Array) -> None:
        """Put the robot at rest at the origin with the arm at `q_m`; nobody pulls."""
        self.t = 0.0
        self.physics.reset(np.zeros(3), q_m)
        self.controller.reset()
        self._admittance.reset()
        self._person = PersonHand(self.config.hand, DT)
        self.wheel_angles = np.zeros(2)
        self.controller.state.update(self.physics.measure())

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on."""
        self.config = config
        self.controller.configure(config)
        self._admittance.config = config.admittance
        self._person.config = config.hand

    @property
    def T_world_ee(self) -> pin.SE3:
        """Pose of the end-effector at the last step."""
        return self.controller.state.T_world_ee

    def step(self, reference: Reference | None = None, pull: Array | None = None) -> Step:
        """Advance by one control step.

        Args:
            reference: What the arm tracks, or None while it is guided.
            pull: (3,) [m] where a person pulls the end-effector, or None.
        """
        measurement = self.physics.measure()
        expected = self._drive.expected_acceleration(
            self._admittance.command, measurement.base_velocity
        )
        begin = perf_counter()
        output = self.controller.step(measurement, reference, base_acceleration=expected)
        duration = perf_counter() - begin
        command = self._admittance.update(output.base_acceleration, DT)
        state = self.controller.state
        p_ee = state.T_world_ee.translation
        force = self._person.force(p_ee, state.v_ee[:3], pull)
        aim = pull if pull is not None else reference.pose.translation if reference else p_ee
        error = float(np.linalg.norm(p_ee - aim))
        self.physics.step(output.u_a, command, force)
        self.wheel_angles = self.wheel_angles + state.qd[:2] * DT
        step = Step(
            self.t, measurement, output, command.copy(), pull, force, error,
            self.physics.contacts(), duration,
        )  # fmt: skip
        self.t += DT
        return step

    def close(self) -> None:
        """Release the plant."""
        self.physics.close()
