"""Your own kind of base: a carriage on a rail, which can only drive along its x axis.

Run it: python examples/custom_base.py
"""

from typing import ClassVar, Literal

import numpy as np

from app import Config, RobotModel, load_border_data, load_robot
from app.robot.bases.kind import FORWARD, Axis, BaseKind, Measure
from app.robot.description import register_base_kind
from app.simulation.run import run_scenario
from app.simulation.scenarios import LINES


class RailBase(BaseKind):
    """A base with one velocity, v. Its measure is 1, so that the score (10) is the reachability."""

    axes: ClassVar[tuple[Axis, ...]] = (FORWARD,)
    kind: Literal["rail"]

    J_m = property(lambda self: np.eye(1))  # q̇_b → v
    max_velocity = property(lambda self: (self.max_linear_velocity_mps,))
    max_acceleration = property(lambda self: (self.max_linear_acceleration_mps2,))
    yaw_limit_nm = property(lambda self: 1e4)  # [N m] the rail prevents rotation
    measure = property(lambda self: Measure(1.0, 0.0))  # it moves every point equally well


def main(duration: float = 8.0) -> dict[str, object]:
    """Guide the arm from the front towards the carriage; returns the run's results."""
    register_base_kind(RailBase)  # robot.toml may now have: kind = "rail"
    base = {
        "kind": "rail",
        "mass_kg": 60.0,
        "inertia_kgm2": 16.0,
        "max_linear_velocity_mps": 1.0,
        "max_linear_acceleration_mps2": 3.0,
        "traction_limit_n": 300.0,
        "drive_time_constant_s": 0.05,
    }
    base["source"] = {k: "an example" for k, value in base.items() if isinstance(value, float)}
    paper = load_robot("husky_panda")
    robot = RobotModel(paper.model_copy(update={"base": RailBase.model_validate(base)}))
    scenario = LINES["guiding-front"].changed(duration=duration)
    return run_scenario(robot, load_border_data(robot), scenario, Config()).figures


if __name__ == "__main__":
    figures = main()
    print({name: figures[name] for name in ("min_clearance_m", "base_displacement_m")})
