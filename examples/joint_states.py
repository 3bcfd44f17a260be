"""Joint states of a driver: joints in any order, at 50 Hz, with time stamps, without velocities.

The driver adds gravity compensation to the torques that it receives.

Run it: python examples/joint_states.py
"""

import numpy as np

from app import ControlLoop, Measurement, RobotModel, load_robot
from app.simulation.plants import make_physics

DT, EVERY = 0.002, 10  # [s] of a 500 Hz loop; steps between two joint states
PULL = np.array([-8.0, 0.0, 0.0])  # [N] of a person on the end-effector


def main(duration: float = 1.0) -> tuple[str, ...]:
    """Simulate `duration` [s]; returns the names of all faults of the readings."""
    model = RobotModel(load_robot("husky_panda"))
    loop, robot = ControlLoop(model, dt=DT), make_physics("kinematic", model, dt=DT)
    names = ["gripper", *sorted(model.description.arm.joints, reverse=True)]
    order = loop.joint_order(names)  # called once, with the driver's order of joints
    places = [names.index(name) for name in model.description.arm.joints]
    faults: dict[str, None] = {}

    for k in range(round(duration / DT)):
        now, truth = k * DT, robot.measure()
        if k % EVERY == 0:  # a new message; it has no velocities
            position = np.zeros(len(names))
            position[places] = truth.q_m
            stamp, (q_m, qd_m) = now, order(position)
        base = truth.base_pose, truth.base_velocity
        command = loop.step(Measurement(*base, q_m, qd_m, now=now, time=stamp))
        to_driver = command.u_a - command.gravity  # the driver adds gravity
        faults |= dict.fromkeys(command.faults)
        robot.step(to_driver + command.gravity, command.base_velocity, hand_force=PULL)
    return tuple(faults)


if __name__ == "__main__":
    print("named:", *main())
