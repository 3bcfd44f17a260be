"""Random pulls that depend only on the seed and the number of the pull."""

from __future__ import annotations

import math
from functools import cache

import numpy as np
import pinocchio as pin

from app.errors import StudyError
from benchmarks.law.options import Options
from benchmarks.law.pull import Point, Pull
from benchmarks.law.robot import load
from benchmarks.law.starts import place_above, place_beside, posture

Array = np.ndarray
Interval = tuple[float, float]

_PROJECTS_TRIES = 16  # [-] tries of the start solver for each pitch of the end-effector
_TRIES = 200  # [-] largest number of random places for a case
_CONE = math.radians(50.0)  # [rad] largest angle between a pull and the direction inwards
_END = -0.15, 0.10  # [m] range of the distance of a pull's end from the base's box or the column


def named_pull(
    options: Options,
    name: str,
    start: Point,
    move: Point,
    lead_s: float,
    stiffness: float,
    f_max: float,
) -> Pull:
    """A pull from a stated start.

    Raises:
        StudyError: The arm does not reach the start.
    """
    q = posture(options.robot, start, tries=_PROJECTS_TRIES)
    if q is None:
        raise StudyError(f"{name}: the arm of {options.robot} does not reach {start}")
    return Pull(
        name,
        options.robot,
        options.controller,
        tuple(q.tolist()),
        start,
        move,
        lead_s,
        stiffness,
        f_max,
    )


def random_pull(
    options: Options,
    number: int,
    rng: np.random.Generator,
    *,
    f_max: Interval,
    stiffness: Interval,
    lead: Interval | None = None,
    speed: Interval = (0.2, 1.2),
    above: float = 0.0,
    column: float = 0.0,
) -> Pull:
    """A pull from a random start, towards the base within a cone, or towards the arm's own column.

    Args:
        options: Robot and controller.
        number: Number of the case.
        rng: Random generator.
        f_max: [N] range of the largest force of the person.
        stiffness: [N/m] range of the person's stiffness, which is uniform in its logarithm.
        lead: [s] range of the duration of the pull; None means that `speed` determines it.
        speed: [m/s] range of the mean speed of the person's hand.
        above: [-] share of the starts over the base.
        column: [-] share of the pulls that are aimed at the arm's own column.

    Raises:
        StudyError: The arm can reach none of `_TRIES` starts.
    """
    over = rng.random() < above
    folded = column > 0.0 and rng.random() < column
    for _ in range(_TRIES):
        place = (place_above if over else place_beside)(options.robot, rng)
        seed = int(rng.integers(2**31))
        q = posture(options.robot, place.p, seed=seed)
        if q is not None:
            break
    else:
        raise StudyError(f"the arm of {options.robot} can reach none of {_TRIES} starts")
    if folded:
        to_column = rng.uniform(*_column(options.robot)) - np.array(place.p)
        gap = float(np.linalg.norm(to_column))
        inwards = way = to_column / gap
    else:
        gap, inwards = place.gap, np.array(place.inwards)
        way = _in_cone(inwards, rng)
    length = (gap - rng.uniform(*_END)) / float(way @ inwards)
    x, y, z = (length * way).tolist()
    lasting = rng.uniform(*lead) if lead else length / rng.uniform(*speed)
    k = math.exp(rng.uniform(math.log(stiffness[0]), math.log(stiffness[1])))
    return Pull(
        f"{number}{', above' if over else ''}{', column' if folded else ''}",
        options.robot,
        options.controller,
        tuple(q.tolist()),
        place.p,
        (x, y, z),
        float(lasting),
        k,
        float(rng.uniform(*f_max)),
    )


def side(place: Point, robot: str) -> str:
    """Words for the position of a point (3,) [m] relative to the base's box."""
    found = load(robot)
    x, y, _ = place
    beside_x = "front" if x > found.upper[0] else "back" if x < found.lower[0] else ""
    beside_y = not found.lower[1] <= y <= found.upper[1]
    if beside_x:
        return f"{beside_x} corner" if beside_y else beside_x
    return "side" if beside_y else "above"


@cache
def _column(robot: str) -> tuple[Array, Array]:
    """(3,) [m] ends of the arm's column in the base's frame: the arm's mount and its second joint.

    Both do not move with the arm.
    """
    model = load(robot).model
    data, q_m = model.pin.createData(), np.zeros(model.n_m)
    pin.forwardKinematics(model.pin, data, model.configuration((0.0, 0.0, 0.0), q_m))
    return model.p_base(), data.oMi[min(3, model.pin.njoints - 1)].translation.copy()


def _in_cone(axis: Array, rng: np.random.Generator) -> Array:
    """(3,) random unit vector within the angle `_CONE` of `axis`, uniform on the sphere."""
    cosine = rng.uniform(math.cos(_CONE), 1.0)
    side = rng.normal(size=3)
    side -= (side @ axis) * axis
    return cosine * axis + math.sqrt(1.0 - cosine**2) * side / np.linalg.norm(side)
