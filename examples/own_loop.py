"""The controller in your own 1 kHz loop: replace `robot` by your robot.

A person pulls the end-effector from the front towards the base, and the base drives backwards.
Run it: python examples/own_loop.py
"""

import numpy as np

from app import Config, ControlLoop, RobotModel, load_border_data, load_robot
from app.simulation.plants import make_physics
from app.simulation.scenarios.start import StartSolver

DT = 0.001  # [s]
PULL = np.array([-12.0, 0.0, 0.0])  # [N] of the person, in the world


def main(duration: float = 2.0) -> float:
    """Simulate `duration` [s]; returns the base's displacement [m], positive forwards."""
    model, config = RobotModel(load_robot("husky_panda")), Config()
    data = load_border_data(model)  # pairs and border: from the cache, or sampled once
    loop = ControlLoop(model, data, config)

    robot = make_physics("kinematic", model)  # your robot needs the methods measure() and step()
    start = StartSolver(model, data.pairs, config.border.d_b).solve((0.92, 0.10, 0.30))
    robot.reset(np.zeros(3), start)

    for k in range(round(duration / DT)):
        measured = robot.measure()  # base pose and velocity, joint positions and velocities
        command = loop.step(measured)  # a Reference as second argument is tracked
        robot.step(command.u_a, command.base_velocity, hand_force=PULL)
        if k % 500 == 0:
            w = command.step
            i = int(w.d[: w.n_mob].argmin())
            print(
                f"{k * DT:.1f} s: {w.pairs[i].name} {w.d[i]:.3f} m apart, "
                f"base at x = {measured.base_pose[0]:.3f} m"
            )
    return float(robot.measure().base_pose[0])


if __name__ == "__main__":
    main()
