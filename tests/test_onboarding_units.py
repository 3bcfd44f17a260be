"""Which parts of a robot may touch by design."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from app.onboarding.fit.rigid_groups import Unit, neighbours


def chain(joints: list[Any]) -> Any:
    """A robot's model of joints one after the other, the first one its base."""
    model = pin.Model()
    parent = model.addJoint(0, pin.JointModelPlanar(), pin.SE3.Identity(), "base")
    for k, joint in enumerate(joints):
        parent = model.addJoint(parent, joint, pin.SE3.Identity(), f"joint_{k}")
    return SimpleNamespace(pin=model)


def unit(joint: int) -> Unit:
    return Unit(joint, "", (), joint, (), np.zeros((0, 3)))


X, Y, TURN = pin.JointModelPX, pin.JointModelPY, pin.JointModelRZ


@pytest.mark.parametrize(
    ("joints", "a", "b", "expected"),
    [
        ([X(), X(), X(), X()], 2, 5, True),  # the parts of a telescope
        ([X(), X(), X(), X()], 5, 2, True),
        ([X(), Y(), X()], 2, 4, False),  # a gantry
        ([TURN(), X(), X()], 1, 4, False),
        ([X(), X(), TURN()], 2, 4, False),
        ([TURN(), TURN()], 2, 3, True),
        ([TURN(), TURN(), TURN()], 2, 4, False),
    ],
)
def test_next_parts_and_those_of_a_telescope_are_neighbours(
    joints: list[Any], a: int, b: int, expected: bool
) -> None:
    assert neighbours(chain(joints), unit(a), unit(b)) is expected
