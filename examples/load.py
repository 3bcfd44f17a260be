"""A load of 2 kg in the gripper: the loop reports it, and the program then states it as payload.

Run it: python examples/load.py
"""

import numpy as np

from app import Config, ControlLoop, RobotModel, load_robot
from app.robot.state import RobotState
from app.simulation.plants import make_physics
from app.simulation.plants.interface import PointLoad

DT = 0.001  # [s]


def main() -> tuple[float, float]:
    """Hang a load on a guided arm that nobody holds; set `payload.mass` when the loop reports it.

    Returns:
        The reported load [kg], 0 without a report, and the final speed [m/s] of the end-effector.
    """
    model = RobotModel(load_robot("husky_panda"))
    loop, robot, found = ControlLoop(model), make_physics("kinematic", model), 0.0
    load, state = PointLoad(model, 2.0, np.zeros(3), DT), RobotState(model)
    for _ in range(1500):
        command = loop.step(robot.measure())
        state.update_kinematics(robot.measure())
        if "load" in command.faults and not found:
            found = command.load
            loop.configure(Config().changed({"payload.mass": round(found, 1)}))
        robot.step(command.u_a, command.base_velocity, load.push(state).force)
    return found, float(np.linalg.norm(command.step.v_ee[:3]))


if __name__ == "__main__":
    mass, speed = main()
    print(f"load of {mass:.2f} kg; the compensated end-effector moves at {speed:.3f} m/s")
