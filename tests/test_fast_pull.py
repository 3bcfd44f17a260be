"""A fast pull in on the wheel axis, where the base cannot give way at once: the arm holds alone."""

from __future__ import annotations

import numpy as np

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.simulation.run import steps_of
from app.simulation.scenarios.line import RANDOM_PULL

UNTIL = 1.1  # [s] the pull ends at 1.14 s
SPEED = 0.6083  # [m/s] of the person's hand on its way, at most
PULL = RANDOM_PULL.changed(
    start=(-0.0570, -0.6461, 0.4800),
    move=(-0.0130, 0.3770, -0.2684),
    duration=2.6416,
    moving=0.43216,
    q_m=(-1.16541, 1.20024, -1.00743, -1.69302, 2.15291, 2.65320, 0.0),
)
PARAMETERS = {
    "disturbance.base_delay": 0.18577,
    "disturbance.encoder_noise": 0.00085,
    "disturbance.mass_error": 0.0131,
    "disturbance.slip": 0.0618,
    "admittance.v_max": 0.3375,
    "hand.f_max": 40.0,
    "hand.stiffness": 300.0,
    "hand.mass": 0.0,
}
SEED = 3141514894


def nearest_and_fastest(robot: RobotModel, data: BorderData) -> tuple[float, float]:
    """[m] least true distance of arm and base, [m/s] largest true speed of the hand."""
    config = Config()
    for path, value in PARAMETERS.items():
        config = config.replace(path, value)
    nearest, fastest = np.inf, 0.0
    for session, step in steps_of(robot, data, PULL, config, seed=SEED):
        nearest = min(nearest, *step.distances[:2])
        fastest = max(fastest, float(np.linalg.norm(session.state.v_ee[:3])))
        if step.t > UNTIL:
            break
    return nearest, fastest


def test_the_arm_holds_a_fast_hand_and_does_not_throw_it_back(
    robot: RobotModel, border_data: BorderData
) -> None:
    nearest, fastest = nearest_and_fastest(robot, border_data)
    assert nearest > 0.025
    assert fastest < 1.1 * SPEED  # nothing but the person drives the hand
