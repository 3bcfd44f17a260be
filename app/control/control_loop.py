"""All of the control at 1 kHz in one object: what a robot's own loop and the simulation call."""

from typing import NamedTuple

from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.control.controller import Controller
from app.control.quantities import ControlStep
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.strict import Array


class Command(NamedTuple):
    """What one control step commands."""

    u_a: Array
    """(n_m,) [N m or N] torques of the arm, with gravity and Coriolis terms."""
    base_velocity: Array
    """(n_b,) [m/s or rad/s] along the base's axes: v and ω of a differential one; renewed at the
    base's own slow rate."""
    step: ControlStep
    """All quantities of the step, such as the distances; the next step overwrites them."""


class ControlLoop:
    """The controller with the base's drive and admittance law, for a loop of one's own at 1/dt."""

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
            data: Its link pairs and border; by default from the cache, or sampled now.
            config: Parameters; by default those of the robot.
            name: One of `app.control.CONTROLLERS`.
            dt: [s] control period.

        Raises:
            UnknownNameError: No controller has that name.
            DescriptionError: The mobile robot is too large for its border to be stored.
        """
        config = config or model.description.config
        self.controller = Controller(
            model, data or load_border_data(model), config, name=name, dt=dt
        )
        """Algorithm 2."""

    def reset(self) -> None:
        """Forget posture, torques, estimate and commands: the robot starts anew, at rest."""
        self.controller.reset()

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on."""
        self.controller.configure(config)

    def step(self, measured: Measurement, reference: Reference | None = None) -> Command:
        """One control step.

        Args:
            measured: The sensors' readings.
            reference: Desired motion of the end-effector, or None while a person guides it.

        Raises:
            MeasurementError: A reading has another number of entries.
        """
        step = self.controller.step_with_drive(measured, reference)
        return Command(step.u_cmd.copy(), step.v_cmd.copy(), step)
