"""Random curves beside the base that the arm can reach along their whole length."""

from __future__ import annotations

import inspect
import math
import sys
from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import least_squares

from app.errors import StudyError
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest
from benchmarks.law.curves import Curve, Point
from benchmarks.law.options import Options
from benchmarks.law.robot import load
from benchmarks.law.starts import kept, place_beside, posture

Array = np.ndarray

KINDS = "towards", "diagonal", "arc"
_EVALUATIONS = 60  # [-] largest number of evaluations of the residual
_TRIES = 400  # [-] largest number of random curves for a case
_DURATION = 2.0, 10.0  # [s] range of the duration of a curve
_SPEED = 0.25  # [m/s] largest mean speed of the end-effector
_CONE = math.radians(40.0)  # [rad] largest angle between a line and the direction inwards
_LENGTH = 0.08, 0.30  # [m] range of the length of a line towards the base
_RISE = 0.15  # [m] largest difference of height between the ends of a curve
_TURN = 0.3, 1.2  # [rad] range of the angle of an arc about the base's middle
_NEAREST = 0.08  # [m] smallest distance of the end-effector from the base's box
_EE_TURN = 0.5  # [rad] largest angle of the end-effector to the direction away from the mount
_ALONG = np.linspace(0.25, 1.0, 4)  # [-] places on a curve at which reachability is checked
_GUESSES = 6  # [-] random initial guesses of each search for a posture
_REACHED = 1e-4  # [m] and [rad] largest error of a posture


class Task(NamedTuple):
    """A curve, and the posture at its start."""

    curve: Curve
    q_m: tuple[float, ...]


def task_of(options: Options, number: int) -> Task:
    """The task with a number; the result is cached.

    Raises:
        StudyError: The arm can track none of `_TRIES` curves.
    """
    asked = [inspect.getsource(sys.modules[__name__]), options.seed, number]
    found = kept(options.robot, asked, lambda: _drawn(options, number))
    curve, q_m = found
    kind, start, end, centre, duration = curve
    centre = None if centre is None else tuple(centre)
    return Task(Curve(kind, tuple(start), tuple(end), centre, duration), tuple(q_m))


def _drawn(options: Options, number: int) -> list[object]:
    rng = np.random.default_rng([options.seed, number])
    model = load(options.robot).model
    for _ in range(_TRIES):
        curve = _curve(options.robot, rng)
        seed, turn = int(rng.integers(2**31)), float(rng.uniform(-_EE_TURN, _EE_TURN))
        places = [curve.place(float(s))[0] for s in (0.0, *_ALONG)]
        if min(_gap(options.robot, p) for p in places) < _NEAREST:
            continue
        quickest = max(_DURATION[0], _length(places) / _SPEED)
        if quickest > _DURATION[1]:
            continue
        curve = curve._replace(duration=float(rng.uniform(quickest, _DURATION[1])))
        along = [tuple(curve.place(float(s))[0].tolist()) for s in _ALONG]
        q = posture(options.robot, curve.start, seed=seed, turn=turn, along=along)
        if q is not None and _reached(model, curve, q, rng):
            return [list(curve), q.tolist()]
    raise StudyError(f"the arm of {options.robot} can track none of {_TRIES} curves")


def _curve(robot: str, rng: np.random.Generator) -> Curve:
    kind = KINDS[rng.integers(len(KINDS))]
    start, duration = place_beside(robot, rng), 0.0  # the duration depends on the length
    x, y, z = start.p
    end_z = max(z + rng.uniform(-_RISE, _RISE), 0.1)
    if kind == "towards":
        angle, length = rng.uniform(-_CONE, _CONE), rng.uniform(*_LENGTH)
        way = pin.utils.rotate("z", float(angle)) @ np.array(start.inwards)
        end = (x + length * way[0], y + length * way[1], end_z)
        return Curve(kind, start.p, _floats(end), None, duration)
    if kind == "diagonal":
        other = place_beside(robot, rng).p
        return Curve(kind, start.p, _floats((other[0], other[1], end_z)), None, duration)
    found = load(robot)
    centre = (found.lower[:2] + found.upper[:2]) / 2
    turn = rng.uniform(*_TURN) * rng.choice([-1.0, 1.0])
    wider = rng.uniform(0.9, 1.1)
    out = wider * (pin.utils.rotate("z", float(turn))[:2, :2] @ (np.array([x, y]) - centre))
    end = (centre[0] + out[0], centre[1] + out[1], end_z)
    return Curve(kind, start.p, _floats(end), (float(centre[0]), float(centre[1])), duration)


def _floats(p: tuple[float, float, float]) -> Point:
    return float(p[0]), float(p[1]), float(p[2])


def _length(places: list[Array]) -> float:
    """[m] length of the path through some points."""
    return sum(float(np.linalg.norm(b - a)) for a, b in pairwise(places))


def _gap(robot: str, p: Array) -> float:
    """[m] distance from the base's box to a point (3,)."""
    found = load(robot)
    return float(np.linalg.norm(p - np.clip(p, found.lower, found.upper)))


def _reached(model: RobotModel, curve: Curve, q: Array, rng: np.random.Generator) -> bool:
    """Whether the arm on a base at rest reaches the curve's places `_ALONG` from the posture q
    (n_m,), with the orientation of the end-effector in q.
    """
    state = RobotState(model)
    state.update_kinematics(at_rest(model, q))
    orientation = state.T_world_ee.rotation.copy()
    for s in _ALONG:
        target = pin.SE3(orientation, curve.place(float(s))[0])
        guesses = [q, *rng.uniform(model.q_lower, model.q_upper, (_GUESSES, model.n_m))]
        for guess in guesses:
            found = _nearest(state, target, guess)
            if found is not None:
                q = found
                break
        else:
            return False
    return True


def _nearest(state: RobotState, target: pin.SE3, guess: Array) -> Array | None:
    """(n_m,) a posture for an end-effector pose in the world; None if none is found."""
    model = state.model

    def residual(q: Array) -> Array:
        state.update_kinematics(at_rest(model, q))
        return pin.log6(state.T_world_ee.actInv(target)).vector

    def jacobian(q: Array) -> Array:
        error = residual(q)
        R = state.T_world_ee.rotation.T
        J = state.J_ee[:, model.n_b :]
        return -pin.Jlog6(pin.exp6(-error)) @ np.vstack([R @ J[:3], R @ J[3:]])

    low, high = model.q_lower, model.q_upper
    inside = np.clip(guess, low + 1e-6, high - 1e-6)
    q = least_squares(
        residual,
        inside,
        jacobian,  # pyright: ignore[reportArgumentType] - a function is valid
        bounds=(low, high),
        max_nfev=_EVALUATIONS,
    ).x
    return q if float(np.abs(residual(q)).max()) < _REACHED else None
