"""The robot as it is, where its controller's sensors say something else."""

from __future__ import annotations

from app.avoidance.distances import DistanceMonitor
from app.avoidance.self_collision import PairState
from app.border.cache import BorderData
from app.control.controller import Controller
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState


class Truth:
    """Kinematics and distances of the true configuration.

    While the sensors say the truth, the controller has computed both already, and its own are used.

    Attributes:
        state: The robot as it is at the last `update`.
        distances: [m] signed distances of all pairs, in the order of the controller's.
    """

    def __init__(self, model: RobotModel, data: BorderData, controller: Controller) -> None:
        """Follow the controller; `update` comes after each of its steps."""
        self._controller = controller
        self._own = RobotState(model)
        self._monitor = DistanceMonitor(self._own, [*data.pairs.mobile, *data.pairs.manipulator])
        self.state = controller.state
        self.distances: tuple[float, ...] = ()

    def reset(self) -> None:
        """The controller's state has been set to the truth."""
        self.state = self._controller.state

    def update(self, truth: Measurement, sensed: Measurement, pairs: tuple[PairState, ...]) -> None:
        """Take over one control step.

        Args:
            truth: The robot as it is.
            sensed: What its sensors said, which the controller has been given.
            pairs: The pairs at that.
        """
        if sensed is truth:
            self.state = self._controller.state
            self.distances = tuple(pair.closest.d for pair in pairs)
            return
        self._own.update_kinematics(truth)
        self.state = self._own
        self.distances = self._monitor.distances()
