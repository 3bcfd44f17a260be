"""Track a pose: the end-effector moves to a target near the base, and the base drives away.

Run it: python examples/track_pose.py
"""

import numpy as np
import pinocchio as pin

from app import ControlLoop, Reference, RobotModel, load_robot
from app.simulation.plants import make_physics

DT = 0.001  # [s]
MOVE = np.array([-0.15, 0.0, -0.10])  # [m] from the start in the ready posture, in the world
STILL = np.zeros(6)  # velocity and acceleration of a target at rest


def main(duration: float = 4.0) -> float:
    """Simulate `duration` [s]; returns the final position error [m] of the end-effector."""
    model = RobotModel(load_robot("husky_panda"))
    loop, robot = ControlLoop(model), make_physics("kinematic", model)
    loop.step(robot.measure())
    start = loop.controller.state.T_world_ee
    target = pin.SE3(start.rotation, start.translation + MOVE)

    for _ in range(round(duration / DT)):
        command = loop.step(robot.measure(), Reference(target, STILL, STILL))
        robot.step(command.u_a, command.base_velocity, hand_force=np.zeros(3))
    return float(np.linalg.norm(command.step.e_ee[:3]))


if __name__ == "__main__":
    print(f"final error: {1000 * main():.2f} mm")
