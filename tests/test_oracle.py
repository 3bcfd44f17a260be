"""Nothing is changed for speed: the control step agrees with one of straightforward parts."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller, ControlOutput
from app.control.tasks import Reference
from app.robot.model import RobotModel
from app.robot.state import Measurement
from tests.oracle import PlainState, plain_controller, use_plain_parts

STATES = 600
AGREES = 1e-6
"""Relative to the largest entry, or to 1 N m or 1 m/s² if that is more."""
AGREES_LIMITED = 1e-4
"""The same where a limit is met."""


class Moment(NamedTuple):
    """What a control step is given."""

    measurement: Measurement
    reference: Reference | None
    base_acceleration: np.ndarray


def moments(robot: RobotModel, data: BorderData, count: int, seed: int) -> list[Moment]:
    """Random states in which nothing is met yet, every second one near the base."""
    rng = np.random.default_rng(seed)
    finder = Controller(robot, data, Config())
    found: list[Moment] = []
    while len(found) < count:
        q_m = rng.uniform(robot.q_lower, robot.q_upper)
        measurement = Measurement(
            rng.normal(size=3), rng.uniform(-0.5, 0.5, 2), q_m, 0.2 * rng.normal(size=robot.n_m)
        )
        finder.state.update(measurement)
        least = min(c.d for c in finder._avoidance._monitor.find_closest_points())
        if least < 0.01 or (len(found) % 2 and least > 0.2):
            continue
        reference = None
        if rng.random() < 0.5:
            at = finder.state.T_world_ee
            pose = pin.SE3(
                at.rotation @ pin.exp3(0.01 * rng.normal(size=3)),
                at.translation + 0.005 * rng.normal(size=3),
            )
            reference = Reference(pose, 0.1 * rng.normal(size=6), 0.1 * rng.normal(size=6))
        found.append(Moment(measurement, reference, rng.uniform(-0.3, 0.3, 2)))
    return found


def answers(controller: Controller, given: list[Moment]) -> list[ControlOutput]:
    """Each moment's answer."""
    outputs = []
    for measurement, reference, base_acceleration in given:
        controller.reset()
        outputs.append(controller.step(measurement, reference, base_acceleration=base_acceleration))
    return outputs


def met_a_limit(output: ControlOutput) -> bool:
    """Whether the arm's part met one of its limits."""
    assert output.workings is not None
    limits = output.workings.limits
    reached = limits.C @ output.workings.qdd
    return bool(((reached < limits.l + 1e-6) | (reached > limits.u - 1e-6)).any())


@pytest.mark.slow
def test_random_states_are_answered_alike(
    robot: RobotModel, border_data: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = moments(robot, border_data, STATES, seed=0)
    fast = answers(Controller(robot, border_data, Config()), given)
    oracle = plain_controller(robot, border_data, Config(), monkeypatch)
    assert isinstance(oracle.state, PlainState)
    use_plain_parts(monkeypatch)
    plain = answers(oracle, given)
    kinds = dict.fromkeys(("active", "several rows", "tracking", "free", "limited"), 0)
    for a, b in zip(fast, plain, strict=True):
        assert a.solved
        assert b.solved
        limited = met_a_limit(b)
        kinds["active"] += a.avoidance.beta_m > 0
        kinds["several rows"] += len(a.inserted.rows) > 1
        kinds["tracking"] += a.tracking
        kinds["limited" if limited else "free"] += 1
        agree(a.avoidance.xdd_m, b.avoidance.xdd_m)
        agree(a.base_acceleration, b.base_acceleration, AGREES_LIMITED)
        agree(a.u_a, b.u_a, AGREES_LIMITED if limited else AGREES)
    assert min(kinds.values()) > STATES / 50, kinds


def agree(a: np.ndarray, b: np.ndarray, share: float = AGREES) -> None:
    np.testing.assert_allclose(a, b, rtol=0.0, atol=share * max(1.0, float(np.abs(b).max())))
