"""Checks of the bodies: what can touch is inside of them, and no pair is on for good."""

from __future__ import annotations

from itertools import combinations
from typing import NamedTuple

import numpy as np

from app.border.mobile import MobileBody
from app.config import Config
from app.onboarding.check.row import Row
from app.onboarding.fit.collision_sampling import (
    close_pairs,
    hull_distances,
    possible_poses,
)
from app.onboarding.fit.rigid_groups import Unit, neighbours, units_of_links
from app.onboarding.read.geometry import read_geometry
from app.onboarding.read.source import read_robot
from app.onboarding.read.tree import make_tree
from app.robot.assets import urdf_path
from app.robot.link_pairs import PairDistances, candidate_pairs, sample_joints
from app.robot.model import RobotModel

Array = np.ndarray

_OUT_OF_BASE = 0.01  # [m] by which a base's mesh may stick out of its body; a buffer has 0.1 m
_POSES = 4000
_MISSED = 0.01  # [-] share of collisions that the pairs of their bodies may not see


class _Seen(NamedTuple):
    collisions: int
    missed: int
    deepest: float  # [m] of those missed


def base_row(model: RobotModel) -> Row:
    """Every point of the meshes of l_m's links above the floor lies inside of l_m."""
    unit = units_of_links(model, _geometry(model))[model.body_names[0]]
    points = np.vstack([np.zeros((0, 3)), *(part.corners for part in unit[0].parts)])
    points = points[points[:, 2] > 0.0]
    if not len(points):
        return Row("base's body", "failed", "the base's links have no shapes", {})
    out = float(MobileBody(model).distance(points).max())
    text = f"the base's meshes stick out of it by {max(out, 0.0):.4f} m at most"
    good = out <= _OUT_OF_BASE
    return Row("base's body", "passed" if good else "failed", text, {"sticks_out_m": out})


def arm_row(model: RobotModel) -> Row:
    """Where the hulls of links of two bodies of a pair collide, the bodies do too."""
    seen = _collisions(model)
    if not seen.collisions:
        return Row("arm's bodies", "passed", f"no links meet in {_POSES:,} random poses", {})
    share = seen.missed / seen.collisions
    text = (
        f"of {seen.collisions} collisions of links in {_POSES:,} random poses the pairs of their "
        f"bodies see all but {seen.missed}"
    )
    if seen.missed:
        text += f", {seen.deepest:.3f} m outside at most"
    numbers = {
        "collisions": float(seen.collisions),
        "missed": float(seen.missed),
        "missed_distance_m": seen.deepest,
    }
    outcome = "passed" if not seen.missed else "warned" if share <= _MISSED else "failed"
    return Row("arm's bodies", outcome, text, numbers)


def _geometry(model: RobotModel) -> dict:
    return read_geometry(make_tree(read_robot(urdf_path(model.description))))


def _collisions(model: RobotModel) -> _Seen:
    """Collisions of links whose bodies are a pair, and those that the bodies do not have."""
    by_body = units_of_links(model, _geometry(model))
    units: list[Unit] = []
    of: dict[str, list[int]] = {}
    for name, parts in by_body.items():
        of[name] = list(range(len(units), len(units) + len(parts)))
        units += [unit._replace(index=of[name][0] + k) for k, unit in enumerate(parts)]
    wanted = [
        (pair, a, b)
        for pair in candidate_pairs(model)
        for a in of[pair.a]
        for b in of[pair.b]
        if units[a].parts and units[b].parts
    ]
    q_m = sample_joints(model, _POSES, np.random.default_rng(2))
    pairs = [
        (a.index, b.index)
        for a, b in combinations(units, 2)
        if a.parts and b.parts and not neighbours(model, a, b)
    ]
    hulls = hull_distances(model, units, pairs, q_m)
    close = close_pairs(hulls, pairs, Config().border.d_b)
    possible = possible_poses(hulls, pairs, close)
    wanted = [each for each in wanted if each[1:] not in close and each[1:] in pairs]
    hulls = hulls[:, [pairs.index(each[1:]) for each in wanted]][possible]
    q_m = q_m[possible]
    watched = list(dict.fromkeys(pair for pair, _, _ in wanted))
    reader = PairDistances(model, watched)
    collisions = missed = 0
    deepest = 0.0
    q = model.configuration((0.0, 0.0, 0.0), model.q_lower)
    for row, pose in zip(hulls, q_m, strict=True):
        hit = {wanted[k][0] for k in np.flatnonzero(row <= 0.0)}
        if not hit:
            continue
        q[4:] = pose
        reader.update(q)
        for pair in hit:
            collisions += 1
            d = reader.distance(watched.index(pair))
            if d > 0.0:
                missed, deepest = missed + 1, max(deepest, d)
    return _Seen(collisions, missed, deepest)
