"""Filter: the loop estimates joint velocities from noisy positions, without velocity readings.

Run it: python examples/filter.py
"""

import numpy as np

from app import ControlLoop, Measurement, RobotModel, load_robot
from app.simulation.plants import make_physics

DT = 0.001  # [s]
NOISE = 2e-4  # [rad] standard deviation of each position
PULL = np.array([-10.0, 0.0, 0.0])  # [N] of a person on the end-effector


def main(duration: float = 2.0) -> tuple[float, float]:
    """Simulate `duration` [s] with a person who pulls the end-effector.

    Returns:
        The standard deviations [rad/s] of the errors of the joint velocities: of those by the
        filter, and of those by finite differences of the positions.
    """
    model = RobotModel(load_robot("husky_panda"))
    loop, robot = ControlLoop(model), make_physics("kinematic", model)
    rng = np.random.default_rng(0)
    none = np.full(model.n_m, np.nan)
    filtered, differences, last = [], [], None

    for _ in range(round(duration / DT)):
        truth = robot.measure()
        noisy = truth.q_m + rng.normal(0.0, NOISE, model.n_m)
        command = loop.step(Measurement(truth.base_pose, truth.base_velocity, noisy, none))
        filtered.append(command.step.qd_m - truth.qd_m)
        if last is not None:
            differences.append((noisy - last) / DT - truth.qd_m)
        last = noisy
        robot.step(command.u_a, command.base_velocity, hand_force=PULL)
    half = len(filtered) // 2  # the noise is estimated in the first half
    return float(np.std(filtered[half:])), float(np.std(differences[half:]))


if __name__ == "__main__":
    print("velocity error: {:.4f} rad/s filtered, {:.4f} rad/s by differences".format(*main()))
