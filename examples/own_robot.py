"""Your own robot: read its robot.toml, print its data, and take one control step.

`dbb new-robot` makes a robot.toml from a URDF.
Run it: python examples/own_robot.py [robot_assets/husky_panda/robot.toml]
"""

import sys
from pathlib import Path

import numpy as np

from app import ControlLoop, Measurement, RobotModel, load_border_data, load_description

DELIVERED = Path(__file__).parent.parent / "robot_assets/husky_panda/robot.toml"


def main(file: Path = DELIVERED) -> np.ndarray:
    """Print data of the robot; returns the torques [N m or N] at rest in the ready posture."""
    description = load_description(file)
    model = RobotModel(description)
    data = load_border_data(model)  # link pairs and borders: from the cache, or sampled once
    print(f"{description.title}: {description.base.kind} base, {model.n_m} joints")
    for name, cloud in data.clouds.items():
        print(f"{name}: {len(cloud)} points near the base")

    rest = Measurement(
        base_pose=np.zeros(3),
        base_velocity=np.zeros(model.n_b),
        q_m=np.array(description.arm.ready_position),
        qd_m=np.zeros(model.n_m),
    )
    return ControlLoop(model, data).step(rest).u_a


if __name__ == "__main__":
    print("torques:", main(*map(Path, sys.argv[1:])).round(2), "N m")
