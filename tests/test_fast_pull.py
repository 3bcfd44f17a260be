"""A fast pull in on the wheel axis, where the base cannot give way at once: the arm holds alone."""

from __future__ import annotations

import numpy as np

from app.border.cache import BorderData
from app.robot.model import RobotModel
from app.simulation.run import steps_of
from app.studies.pulls.case import Case

UNTIL = 1.1  # [s] the pull ends at 1.14 s
PULL = Case(
    study_seed=1,
    number=6,
    kind="side",
    redraws=0,
    robot="husky_panda",
    controller="dbb",
    physics="planar",
    start=(-0.0570, -0.6461, 0.4800),
    move=(-0.0130, 0.3770, -0.2684),
    speed=0.6083,
    duration=2.6416,
    moving=0.43216,
    q_m=(-1.16541, 1.20024, -1.00743, -1.69302, 2.15291, 2.65320, 0.0),
    base_delay=0.18577,
    encoder_noise=0.00085,
    mass_error=0.0131,
    slip=0.0618,
    v_max=0.3375,
    hand_f_max=40.0,
    hand_stiffness=300.0,
    hand_mass=0.0,
    release_at=None,
    regrasp_at=None,
    seed=3141514894,
)


HARD_PULL = PULL.model_copy(
    update={
        "study_seed": 17,
        "number": 565,
        "start": (0.2513, -0.7967, 0.3868),
        "move": (-0.0498, 0.5738, -0.1681),
        "speed": 0.7802,
        "duration": 2.1536,
        "moving": 0.53565,
        "q_m": (-1.60267, 1.18757, -0.10693, -1.41824, -0.30458, 3.40376, 0.0),
        "hand_f_max": 60.0,
        "hand_stiffness": 1088.0,
        **dict.fromkeys(("base_delay", "encoder_noise", "mass_error", "slip"), 0.0),
        "v_max": 0.5,
        "seed": 10952216,
    }
)
"""The wrist's torque does not hold it."""


def nearest_and_fastest(
    robot: RobotModel, data: BorderData, pull: Case, until: float
) -> tuple[float, float]:
    """[m] least true distance of arm and base, [m/s] largest true speed of the hand."""
    nearest, fastest = np.inf, 0.0
    for session, step in steps_of(robot, data, pull.scenario(), pull.config(), seed=pull.seed):
        nearest = min(nearest, *step.distances[:2])
        fastest = max(fastest, float(np.linalg.norm(session.state.v_ee[:3])))
        if step.t > until:
            break
    return nearest, fastest


def test_the_arm_holds_a_fast_hand_and_does_not_throw_it_back(
    robot: RobotModel, border_data: BorderData
) -> None:
    nearest, fastest = nearest_and_fastest(robot, border_data, PULL, UNTIL)
    assert nearest > 0.025
    assert fastest < 1.1 * PULL.speed  # nothing but the person drives the hand


def test_an_arm_that_is_overpowered_keeps_its_distance_and_is_not_thrown(
    robot: RobotModel, border_data: BorderData
) -> None:
    nearest, fastest = nearest_and_fastest(robot, border_data, HARD_PULL, 1.5)
    assert nearest > 0.02
    assert (
        fastest < 1.1 * HARD_PULL.speed
    )  # 4.3 m/s if joints ask for more than their own torques give
