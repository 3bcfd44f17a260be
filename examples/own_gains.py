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
PULL = np.array([-12.0, 0.0, 0.0])  # [N] of a person on the end-effector


def main(config: Config | None = None) -> tuple[float, float]:
    """Returns the base's displacement [m] under a pull, with a small and with a large d_b."""
    model = RobotModel(load_robot("husky_panda"))
    config = config or Config()
    loop, robot = ControlLoop(model, config=config), make_physics("kinematic", model)
    moved = []
    for d_b in (0.10, 0.20):  # [m]
        loop.configure(config.changed({"border.d_b": d_b, "force.f_max": 400.0}))
        robot.reset(np.zeros(3), np.array(model.description.arm.ready_position))
        loop.reset()
        for _ in range(round(1.5 / DT)):
            command = loop.step(robot.measure())
            robot.step(command.u_a, command.base_velocity, hand_force=PULL)
        moved.append(float(robot.measure().base_pose[0]))
    return moved[0], moved[1]


if __name__ == "__main__":
    file = read_config(Path(sys.argv[1])).config if sys.argv[1:] else None
    print("base at x = {:.3f} m with d_b = 0.10 m, {:.3f} m with 0.20 m".format(*main(file)))
