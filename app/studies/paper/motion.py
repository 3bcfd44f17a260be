"""Where the robot's parts were in a run, from its log."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np
import pinocchio as pin

from app.border.mobile import MobileBody
from app.robot.link_pairs import Closest, Pair, PairDistances
from app.robot.model import RobotModel
from app.studies.paper.experiments import Run

Array = np.ndarray


def row_at(run: Run, t: float) -> int:
    """Index of the log's row nearest to a time t [s]."""
    return int(np.abs(run.log["t_s"] - t).argmin())


def hand_path(model: RobotModel, run: Run) -> Array:
    """(N, 3) [m] the end-effector in the world, at each row of the log."""
    data = model.pin.createData()
    path = []
    for pose, q_m in zip(run.base_poses, run.q_m, strict=True):
        pin.forwardKinematics(model.pin, data, model.configuration(pose, q_m))
        path.append(pin.updateFramePlacement(model.pin, data, model.ee_frame).translation.copy())
    return np.array(path)


def closest_points(model: RobotModel, pair: Pair, q_m: Iterable[Array]) -> list[Closest]:
    """The closest points of a pair in the base's frame, at each of the arm's postures (n_m,)."""
    distances = PairDistances(model, [pair])
    found = []
    for q in q_m:
        distances.update(model.configuration((0.0, 0.0, 0.0), q))
        found.append(distances.closest(0))
    return found


def to_world(pose: Array, points: Array) -> Array:
    """Points (N, 3) [m] of the base's frame in the world, for the base at `pose` (3,)."""
    x, y, yaw = pose
    c, s = np.cos(yaw), np.sin(yaw)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) + [x, y, 0.0]


def base_corners(model: RobotModel) -> Array:
    """(8, 3) [m] corners of a box around l_m in the base's frame; the first four on the floor."""
    body = MobileBody(model)
    low, high = body.lower, body.upper
    plan = [(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]
    return np.array([(x, y, z) for z, (x, y) in product((0.0, high[2]), plan)])


def extent(model: RobotModel, pose: Array, q_m: Array) -> Array:
    """(N, 3) [m] points around the whole robot, in the world."""
    data = model.pin.createData()
    q = model.configuration(pose, q_m)
    pin.forwardKinematics(model.pin, data, q)
    joints = np.array([placed.translation for placed in list(data.oMi)[2:]])
    hand = pin.updateFramePlacement(model.pin, data, model.ee_frame).translation
    around = np.concatenate([joints, hand[None]])
    spread = np.array(list(product((-1, 1), repeat=3))) * 0.08  # [m] about a link's thickness
    links = (around[:, None] + spread).reshape(-1, 3)
    return np.concatenate([to_world(pose, base_corners(model)), links])
