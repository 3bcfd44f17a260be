"""Cargo on the base: a box on the deck behind the arm.

A shape on the base becomes part of l_m: the link pairs, the border and the controller then
include it. A person pulls the end-effector backwards towards the cargo, and the base drives away.
Run it: python examples/cargo.py
"""

from app.border.cache import load_border_data
from app.border.sampling import SamplingConfig
from app.config import Config
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.robot.shapes import Box
from app.simulation.run import run_scenario
from app.simulation.scenarios import scenario_by_name

CARGO = Box(type="box", size_m=(0.20, 0.40, 0.70), xyz_m=(-0.38, 0.0, 0.60))
"""Size and centre [m] in the frame of l_m, which is base_link, 0.13 m above the floor."""

COARSE = SamplingConfig(
    pair_samples=20_000,
    cloud_samples=20_000,
    voxel_plan=0.03,
    voxel_height=0.02,
    rounds=1,
    retries=1,
)
"""Options for a coarse border in seconds; the standard border takes minutes, once."""


def main(controller: str = "dbb") -> dict[str, object]:
    """Pull the end-effector towards the cargo; returns the results of the run."""
    model = RobotModel(load_robot("husky_panda").with_mobile_shapes(CARGO))
    data = load_border_data(model, sampling=COARSE)
    pull = scenario_by_name("guiding-above").changed(
        start=(0.05, 0.35, 0.95), move=(-0.45, -0.25, 0.0), duration=3.0
    )
    return run_scenario(model, data, pull, Config(), controller=controller).figures


if __name__ == "__main__":
    for name in ("none", "dbb"):
        figures = main(name)
        print(
            f"{name}: smallest distance {figures['min_clearance_m']:.3f} m, "
            f"the base drove {figures['base_path_m']:.2f} m"
        )
