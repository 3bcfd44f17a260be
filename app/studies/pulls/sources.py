"""What all cases of a study share: the robot, its border, and where its hand can be."""

from __future__ import annotations

from functools import cache
from typing import NamedTuple

import numpy as np

from app.border.cache import BorderData, load_border_data
from app.border.mobile import MobileBody
from app.robot.assets import load_robot
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest

Array = np.ndarray

_SAMPLES = 4000  # postures by which the reach is measured
_SIDEWAYS = 0.5  # [-] of a hand's direction beside the way outwards
_UPWARDS = 0.26  # [-] of a hand's direction above the horizon: the start solver's 15°
_SHELL = 0.02, 0.98  # quantiles of the hand's distances from the shoulder


class Outline(NamedTuple):
    """The mobile robot as a box along its axes, in its own frame.

    Attributes:
        lower, upper: (2,) [m] corners of its plan.
        top: [m] above the floor.
    """

    lower: Array
    upper: Array
    top: float

    @property
    def middle(self) -> Array:
        """(2,) [m] of the plan."""
        return (self.lower + self.upper) / 2

    @property
    def half(self) -> Array:
        """(2,) [m] half its length and width."""
        return (self.upper - self.lower) / 2


class Reach(NamedTuple):
    """A shell around the shoulder; outside of it no start need be searched.

    Attributes:
        shoulder: (3,) [m] the arm's second joint in the base's frame.
        near, far: [m] radii.
    """

    shoulder: Array
    near: float
    far: float

    def holds(self, p: Array) -> bool:
        """Whether a place (3,) [m] in the base's frame lies in it."""
        return self.near <= float(np.linalg.norm(p - self.shoulder)) <= self.far


class StudySources(NamedTuple):
    """See the module."""

    model: RobotModel
    data: BorderData
    outline: Outline
    reach: Reach


@cache
def load_sources(robot: str) -> StudySources:
    """Once a process.

    Raises:
        UnknownNameError: No such robot.
        AssetError: Its URDF or a mesh is not there.
    """
    model = RobotModel(load_robot(robot))
    body = MobileBody(model)
    outline = Outline(body.lower[:2], body.upper[:2], float(body.upper[2]))
    return StudySources(model, load_border_data(model, progress=False), outline, _measure(model))


def _measure(model: RobotModel) -> Reach:
    """From random postures whose hand points outwards and not up, as the start solver wants it."""
    state, rng = RobotState(model), np.random.default_rng(0)
    joint = model.pin.getJointId(model.description.arm.joints[min(1, model.n_m - 1)])
    ready = np.array(model.description.arm.ready_position)
    state.update(at_rest(model, ready))
    shoulder, mount = state.data.oMi[joint].translation.copy(), model.p_base()[:2]
    distances = []
    for _ in range(_SAMPLES):
        q = rng.uniform(model.q_lower, model.q_upper)
        state.update(at_rest(model, q))
        p, z = state.T_world_ee.translation, state.T_world_ee.rotation[:, 2]
        out = (p[:2] - mount) / max(float(np.hypot(*(p[:2] - mount))), 1e-6)
        sideways = abs(z[1] * out[0] - z[0] * out[1])
        if sideways < _SIDEWAYS and z[2] < _UPWARDS and z[:2] @ out > 0:
            distances.append(np.linalg.norm(p - shoulder))
    near, far = np.quantile(distances, _SHELL) if distances else (0.0, np.inf)
    return Reach(shoulder, float(near), float(far))
