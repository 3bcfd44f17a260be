"""The complete control at 1 kHz in one object, for your own loop and for the simulation."""

import logging
from collections.abc import Sequence
from typing import NamedTuple

from app.border.cache import BorderData, load_border_data
from app.config import Config
from app.control.contract import JointOrder
from app.control.controller import Controller
from app.control.quantities import ControlStep
from app.control.readings import FAULTS
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import Measurement
from app.strict import Array

logger = logging.getLogger(__name__)


class Command(NamedTuple):
    """The commands of one control step.

    `step` and the properties below always refer to the loop's last step. A copy by `copy.deepcopy`
    does not change in later steps.
    """

    u_a: Array
    """(n_m,) [N m or N] torques of the arm, including gravity and Coriolis terms."""
    base_velocity: Array
    """(n_b,) [m/s or rad/s] velocity along the base's axes: v and ω for a differential base. It
    changes once in each command period, at 10 Hz by default."""
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
        """[kg] mass of the load that the fault `load` reports.

        Without this fault, the mass at the end-effector that best explains the external torques,
        including those of a person.
        """
        return float(self.step.unstated or self.step.load)

    @property
    def faults(self) -> tuple[str, ...]:
        """Names of all faults of this step's readings, from `app.control.readings.FAULTS`."""
        return tuple(name for name, is_on in zip(FAULTS, self.step.faults, strict=True) if is_on)


class ControlLoop:
    """The controller with the model of the base's drive and the admittance law."""

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
            data: The robot's link pairs and border; default: read from a file, or sampled now.
            config: Parameters; default: the parameters of the robot.
            name: One of `app.control.CONTROLLERS`.
            dt: [s] control period.
            interpolate: Whether to interpolate references that jump (`app.control.references`).

        Raises:
            UnknownNameError: The controller does not exist.
            ConfigError: The period is invalid, or too long for a gain.
            AssetError: A mesh is missing.
            DescriptionError: The description has no reachability of a body that can meet the mobile
                robot, or the mobile robot is too large for a border.
        """
        config = config or model.description.config
        self.controller = Controller(
            model,
            data or load_border_data(model),
            config,
            name=name,
            dt=dt,
            interpolate=interpolate,
        )
        """Algorithm 2."""
        self.reported: set[str] = set()
        """Names of all faults of the readings since `reset`."""

    def joint_order(self, names: Sequence[str]) -> JointOrder:
        """A function that sorts a driver's joint states; `names` is the driver's order of joints.

        Raises:
            MeasurementError: A joint of the arm is missing in `names`, or appears twice.
        """
        return JointOrder(self.controller.state.model, names)

    def reset(self) -> None:
        """Start again: the next reading is the initial state, and the base's command starts at 0.

        Call it after a protective stop, or after a person has moved the arm. It clears commands,
        posture and estimate.
        """
        self.controller.reset()
        self.reported.clear()

    def configure(self, config: Config) -> None:
        """Use other parameters from the next step on.

        Raises:
            ConfigError: The control period is too long for a gain.
        """
        self.controller.configure(config)

    def step(self, measured: Measurement, reference: Reference | None = None) -> Command:
        """One control step.

        Args:
            measured: The sensors' readings.
            reference: Desired motion of the end-effector, or None while a person guides the arm.

        Raises:
            MeasurementError: A reading or the reference has a wrong number of entries, or the
                first reading has a joint far outside of its limits, for example in degrees; or
                the reference is not a finite motion.
        """
        step = self.controller.step_with_drive(measured, reference)
        command = Command(step.u_cmd.copy(), step.v_cmd.copy(), step)
        if self.controller.faulty:
            self._report(command)
        return command

    def _report(self, command: Command) -> None:
        """Log each fault of the readings once until `reset`."""
        for name in command.faults:
            if name not in self.reported:
                self.reported.add(name)
                more = {
                    "lag": f" ({command.step.lag * self.controller.dt * 1000:.0f} ms)",
                    "period": f" ({self.controller.dt * 1000:.2f} ms)",
                }
                logger.warning("readings, %s: %s%s", name, FAULTS[name], more.get(name, ""))
