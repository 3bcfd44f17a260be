"""All of the control at 1 kHz in one object: what a robot's own loop and the simulation call."""

from typing import NamedTuple

from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.control.admittance import AdmittanceLaw
from app.control.controller import Controller, ControlOutput
from app.control.drive import Drive
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import Measurement, checked
from app.strict import Array


class Command(NamedTuple):
    """What the robot is told in one step."""

    u_a: Array
    """(n_m,) [N m or N] torques of the arm, gravity's and velocities' share included."""
    base_velocity: Array
    """(n_b,) [m/s or rad/s] along the base's axes: v and ω of a differential one; renewed at the
    base's own slow rate."""
    output: ControlOutput
    """The controller's own output, such as the distances and how they came about."""


class ControlLoop:
    """The controller with the base's admittance law, for one's own loop at 1/dt."""

    def __init__(
        self,
        model: RobotModel,
        data: BorderData | None = None,
        config: Config | None = None,
        *,
        name: str = "dbb",
        dt: float = 0.001,
    ) -> None:
        """Prepare.

        Args:
            model: The robot.
            data: Its link pairs and border; from the cache, or sampled now, if not given.
            config: Parameters; the robot's defaults if not given.
            name: One of `app.control.CONTROLLERS`.
            dt: [s] between two steps.

        Raises:
            UnknownNameError: No controller has that name.
            DescriptionError: The mobile robot is too large for its border to be kept.
        """
        config, base = config or model.description.config, model.description.base
        self._dt = dt
        data = data or load_border_data(model)
        self.controller = Controller(model, data, config, name=name, dt=dt)
        """Algorithm 2."""
        self.admittance = AdmittanceLaw(base, config.admittance)
        """Makes velocity commands of the accelerations that the base is asked for."""
        self._drive = Drive(base, dt)

    def reset(self) -> None:
        """Forget posture, torques and commands: the robot begins anew, at rest."""
        self.controller.reset()
        self.admittance.reset()

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on."""
        self.controller.configure(config)
        self.admittance.config = config.admittance

    def step(self, measured: Measurement, reference: Reference | None = None) -> Command:
        """One control step.

        Args:
            measured: The sensors' readings.
            reference: Where the end-effector shall be, or None while it is guided by hand.

        Raises:
            MeasurementError: A reading is not that many numbers.
        """
        measured = checked(measured, self.controller.state.model)
        coming = self._drive.expected_acceleration(
            self.admittance.command, measured.base_velocity, measured.drive
        )
        output = self.controller.step(measured, reference, base_acceleration=coming)
        velocity = self.admittance.update(output.base_acceleration, self._dt)
        return Command(output.u_a, velocity, output)
