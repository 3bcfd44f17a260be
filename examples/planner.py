"""A planner sends poses at 10 Hz. A person moves the arm during a protective stop; then the loop
starts again from the new posture.

Run it: python examples/planner.py
"""

import numpy as np

from app import ControlLoop, Reference, RobotModel, load_robot
from app.simulation.plants import make_physics

DT, EVERY = 0.001, 100  # [s]; steps between two samples of the planner
SPEED = np.array([0.0, 0.05, 0.0])  # [m/s] of the end-effector
STILL = np.zeros(6)


def main(duration: float = 2.0) -> float:
    """Track poses, stop, and track again; returns the end-effector's largest speed [m/s]."""
    model = RobotModel(load_robot("husky_panda"))
    loop, robot = ControlLoop(model), make_physics("kinematic", model)
    steps, fastest = round(duration / DT), 0.0
    loop.step(robot.measure())
    pose = loop.controller.state.T_world_ee.copy()

    for k in range(steps):
        if k == steps // 2:  # a person has moved the arm during a protective stop
            robot.reset(robot.measure().base_pose, robot.measure().q_m + 0.1)
            loop.reset()  # start again from here
            loop.step(robot.measure())
            pose = loop.controller.state.T_world_ee.copy()
        if k % EVERY == 0:
            pose = pose.copy()
            pose.translation += EVERY * DT * SPEED
        command = loop.step(robot.measure(), Reference(pose, STILL, STILL))
        robot.step(command.u_a, command.base_velocity, hand_force=np.zeros(3))
        fastest = max(fastest, float(np.linalg.norm(command.step.v_ee[:3])))
    return fastest


if __name__ == "__main__":
    print(f"largest speed of the end-effector: {main():.3f} m/s")
