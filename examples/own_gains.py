"""Your own gains: parameters from a file or by name, also while the loop runs.

`dbb config --out my.toml` writes all parameters with units and ranges.
Run it: python examples/own_gains.py [my.toml]
"""

import sys
from pathlib import Path

import numpy as np

from app import Config, ControlLoop, RobotModel, load_robot, read_config
from app.simulation.plants import make_physics

DT = 0.001  # [s]
PULL = np.array([-20.0, 0.0, -20.0])  # [N] of a person on the end-effector


def main(config: Config | None = None) -> tuple[float, float]:
    """Pull the end-effector twice, with the parameter f_max = 50 N and with f_max = 300 N.

    Returns:
        The displacement [m] of the base along x in each of the two pulls.
    """
    model = RobotModel(load_robot("husky_panda"))
    config = config or Config()
    loop, robot = ControlLoop(model, config=config), make_physics("kinematic", model)
    moved = []
    for f_max in (50.0, 300.0):  # [N] force at contact
        loop.configure(config.replace("force.f_max", f_max))
        robot.reset(np.zeros(3), np.array(model.description.arm.ready_position))
        loop.reset()
        for _ in range(round(1.5 / DT)):
            command = loop.step(robot.measure())
            robot.step(command.u_a, command.base_velocity, hand_force=PULL)
        moved.append(float(robot.measure().base_pose[0]))
    return moved[0], moved[1]


if __name__ == "__main__":
    file = read_config(Path(sys.argv[1])).config if sys.argv[1:] else None
    print("base at x = {:.3f} m with 50 N, {:.3f} m with 300 N".format(*main(file)))
