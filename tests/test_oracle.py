"""Nothing is changed for speed: the control step agrees with one of straightforward parts."""

from __future__ import annotations

from typing import Any, NamedTuple

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

STATES = 3_000
AGREES = 1e-6
"""Relative to the largest entry, or to 1 N m or 1 m/s² if that is more."""


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
            pose = pin.SE3(at.rotation @ pin.exp3(0.01 * rng.normal(size=3)),
                           at.translation + 0.005 * rng.normal(size=3))  # fmt: skip
            reference = Reference(pose, 0.1 * rng.normal(size=6), 0.1 * rng.normal(size=6))
        found.append(Moment(measurement, reference, rng.uniform(-0.3, 0.3, 2)))
    return found


def answers(controller: Controller, given: list[Moment]) -> list[tuple[ControlOutput, int]]:
    """Each moment's answer, and how many QPs it took."""
    solver, outputs = controller._transition._solver, []
    count = 0

    def counted(*args: Any, **options: Any) -> Any:
        nonlocal count
        count += 1
        return solve_qp(*args, **options)

    solve_qp, solver._solve_qp = solver._solve_qp, counted
    for measurement, reference, base_acceleration in given:
        controller.reset()
        count = 0
        output = controller.step(measurement, reference, base_acceleration=base_acceleration)
        outputs.append((output, count))
    return outputs


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
    kinds = dict.fromkeys(("active", "several rows", "tracking", "limited"), 0)
    differ = 0
    for (a, _), (b, qps) in zip(fast, plain, strict=True):
        assert a.solved == b.solved
        if a.workings is None or b.workings is None:
            continue
        mine, theirs = a.workings.arm, b.workings.arm
        kinds["active"] += a.avoidance.beta_m > 0
        kinds["several rows"] += len(a.inserted.rows) > 1
        kinds["tracking"] += a.tracking
        agree(a.avoidance.xdd_m, b.avoidance.xdd_m)
        kinds["limited"] += qps > 0
        if qps > 0 and not (alike(mine.u_a, theirs.u_a) and alike(*both_base(a, b))):
            differ += 1  # where several levels meet limits, each magnifies the QPs' own accuracy
            continue
        agree(mine.u_a, theirs.u_a)
        agree(*both_base(a, b))
    assert min(kinds.values()) > STATES / 50, kinds
    assert differ < 0.03 * kinds["limited"], (differ, kinds)


def alike(a: np.ndarray, b: np.ndarray) -> bool:
    return float(np.abs(a - b).max()) <= AGREES * max(1.0, float(np.abs(b).max()))


def agree(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(a, b, rtol=0.0, atol=AGREES * max(1.0, float(np.abs(b).max())))


def both_base(a: ControlOutput, b: ControlOutput) -> tuple[np.ndarray, np.ndarray]:
    return a.base_acceleration, b.base_acceleration
