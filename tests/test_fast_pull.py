"""Hard pulls towards the base on the wheel axis and into the arm's column; only the arm resists."""

from __future__ import annotations

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.run import run_from_spec, steps_of
from app.simulation.scenarios import LINES
from app.simulation.scenarios.line import RANDOM_PULL, StartedLine

FAST = RANDOM_PULL.changed(
    start=(-0.0570, -0.6461, 0.4800),
    move=(-0.0130, 0.3770, -0.2684),
    duration=2.6416,
    moving=0.43216,
    q_m=(-1.16541, 1.20024, -1.00743, -1.69302, 2.15291, 2.65320, 0.0),
)
DISTURBED = {
    "disturbance.base_delay": 0.18577,
    "disturbance.encoder_noise": 0.00085,
    "disturbance.mass_error": 0.0131,
    "disturbance.slip": 0.0618,
    "admittance.v_max": 0.3375,
    "hand.f_max": 40.0,
    "hand.stiffness": 300.0,
}
HARD = RANDOM_PULL.changed(
    start=(0.2513, -0.7967, 0.3868),
    move=(-0.0498, 0.5738, -0.1681),
    duration=2.1536,
    moving=0.53565,
    q_m=(-1.60267, 1.18757, -0.10693, -1.41824, -0.30458, 3.40376, 0.0),
)
"""The force exceeds the torque limit of a wrist joint."""
STRONG = {"hand.f_max": 60.0, "hand.stiffness": 1088.0}


@pytest.mark.parametrize(
    ("pull", "speed", "until", "parameters", "seed", "least"),
    [
        pytest.param(FAST, 0.6083, 1.1, DISTURBED, 3141514894, 0.025, id="fast"),
        pytest.param(HARD, 0.7802, 1.5, STRONG, 10952216, 0.02, id="hard"),
    ],
)
def test_the_arm_stops_a_hard_pull_without_contact_or_overspeed(
    robot: RobotModel,
    border_data: BorderData,
    pull: StartedLine,
    speed: float,
    until: float,
    parameters: dict[str, float],
    seed: int,
    least: float,
) -> None:
    """`speed` [m/s] is the largest speed of the person's hand; the pull ends before `until` [s]."""
    config = Config()
    for path, value in parameters.items():
        config = config.replace(path, value)
    nearest, fastest = np.inf, 0.0
    run = RunSpec("husky_panda", pull, config, seed=seed)
    for session, step in steps_of(run, robot, border_data):
        nearest = min(nearest, *step.distances[:2])
        fastest = max(fastest, float(np.linalg.norm(session.state.v_ee[:3])))
        if step.t > until:
            break
    assert nearest > least
    # If a joint limit accelerated the other joints, the end-effector would reach 4.3 m/s.
    assert fastest < 1.1 * speed


@pytest.mark.parametrize("force", [40.0, 60.0, 80.0])
def test_a_pull_into_the_column_leaves_a_gap_and_the_bound_fits_speeds(
    robot: RobotModel, border_data: BorderData, force: float
) -> None:
    """Formerly, 80 N moved the end-effector 16 mm into the shoulder; 60 N was below the bound."""
    pull = LINES["guiding-lateral"].changed(
        start=(0.067, -0.698, 0.392), move=(0.039, 0.758, -0.082), duration=1.16
    )
    config = Config().replace("hand.stiffness", 800.0).replace("hand.f_max", force)
    run = RunSpec("husky_panda", pull, config, physics="kinematic")
    found = run_from_spec(run, robot, border_data).figures
    assert min(found["min_distance_m"].values()) > 0.02
    within = found["hand_force_max_n"] <= found["force_bound_min_n"]
    assert (found["joint_speed_share_max"] <= 1.01) == within == (force == 40.0)
