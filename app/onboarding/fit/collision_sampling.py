"""Which parts of the robot meet which: the hulls of its links in random poses of the arm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import pinocchio as pin

from app.onboarding.fit.convex import directions
from app.onboarding.fit.group_distances import group_distances
from app.onboarding.fit.rigid_groups import Unit, add_hulls, neighbours
from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel

Array = np.ndarray

ALWAYS = 0.6
"""[-] A pair inside its buffer in more of the free poses would keep the task on for good."""
_BUILT_IN = 0.5  # [-] close hulls that touch in more of the poses are nested, as a telescope is
_FEWEST = 50  # [-] poses without a collision that say what is near
_MARGIN = 0.015  # [m] within which a point counts as met
_MOST_LOOKS = 200  # [-] poses per pair of units in which the points are looked at


@dataclass(frozen=True)
class Meetings:
    """What random poses brought together.

    Attributes:
        units: The links that move as one.
        q_m: (N, n_m) [rad or m] the poses.
        pairs: Pairs of units, by their indices, that are no neighbours.
        distances: (N, pairs) [m] signed distance of their hulls.
        met: By the pair (u, v): (points of u,) whether v came to that point of u's surface.
        close: Pairs that are within the buffer in most poses, as they are built: no buffer can
            watch them.
    """

    units: tuple[Unit, ...]
    q_m: Array
    pairs: tuple[tuple[int, int], ...]
    distances: Array
    met: dict[tuple[int, int], Array] = field(repr=False)
    close: frozenset[tuple[int, int]]

    @property
    def collides(self) -> Array:
        """(N, pairs) whether the hulls meet; never for the close pairs."""
        watched = np.array([pair not in self.close for pair in self.pairs], dtype=bool)
        return np.logical_and(self.distances <= 0.0, watched)

    @property
    def possible(self) -> Array:
        """(N,) poses in which no close pair touches: joint limits have to prevent the others."""
        return possible_poses(self.distances, self.pairs, self.close)

    def needed(self, unit: int, others: Sequence[int]) -> Array:
        """(K, 3) [m] points of a unit's surface to which any of the others can come."""
        points = self.units[unit].surface
        mask = np.zeros(len(points), dtype=bool)
        for other in others:
            if (found := self.met.get((unit, other))) is not None:
                mask |= found
        return points[mask]


def sample_meetings(
    model: RobotModel, units: Sequence[Unit], *, samples: int, seed: int, d_b: float
) -> Meetings:
    """Distances between the hulls of all units that are no neighbours, in random poses.

    Args:
        model: The robot.
        units: Its links that move as one.
        samples: Poses.
        seed: Of the poses.
        d_b: [m] buffer distance.
    """
    rng = np.random.default_rng(seed)
    q_m = sample_joints(model, samples, rng)
    pairs = tuple(
        (a.index, b.index)
        for a, b in combinations(units, 2)
        if a.parts and b.parts and not neighbours(model, a, b)
    )
    distances = hull_distances(model, units, pairs, q_m)
    close = close_pairs(distances, pairs, d_b)
    met = _met(model, units, pairs, q_m, distances, close)
    return Meetings(tuple(units), q_m, pairs, distances, met, close)


def close_pairs(
    distances: Array, pairs: Sequence[tuple[int, int]], d_b: float
) -> frozenset[tuple[int, int]]:
    """Pairs that are within d_b [m] in most poses without a collision, as they are built."""
    free = np.asarray((distances > 0.0).all(axis=1))
    if np.count_nonzero(free) < _FEWEST:
        free = np.ones(len(distances), dtype=bool)
    near = (distances[free] < d_b).mean(axis=0)
    return frozenset(pair for pair, share in zip(pairs, near, strict=True) if share > ALWAYS)


def possible_poses(
    distances: Array, pairs: Sequence[tuple[int, int]], close: frozenset[tuple[int, int]]
) -> Array:
    """(N,) whether none of the close pairs touches; those built into each other always do."""
    rates = (distances <= 0.0).mean(axis=0)
    columns = [k for k, pair in enumerate(pairs) if pair in close and rates[k] < _BUILT_IN]
    return np.asarray((distances[:, columns] > 0.0).all(axis=1))


def hull_distances(
    model: RobotModel, units: Sequence[Unit], pairs: Sequence[tuple[int, int]], q_m: Array
) -> Array:
    """(N, pairs) [m] signed distances between the hulls of units at poses (N, n_m)."""
    geometry = pin.GeometryModel()
    ids = add_hulls(geometry, units)
    return group_distances(model, geometry, ids, pairs, q_m)


def _met(
    model: RobotModel,
    units: Sequence[Unit],
    pairs: Sequence[tuple[int, int]],
    q_m: Array,
    distances: Array,
    close: frozenset[tuple[int, int]],
) -> dict[tuple[int, int], Array]:
    data = model.pin.createData()
    possible = possible_poses(distances, pairs, close)
    met: dict[tuple[int, int], Array] = {}
    for (a, b), column in zip(pairs, distances.T, strict=True):
        if (a, b) in close:
            continue
        met_in = np.flatnonzero((column <= _MARGIN) & possible)
        # The shallow ones first: deep ones, where arms pass through each other, come last.
        met_in = met_in[np.argsort(-column[met_in])][:: max(1, len(met_in) // _MOST_LOOKS)]
        if not len(met_in):
            continue
        masks = {(u, v): np.zeros(len(units[u].surface), dtype=bool) for u, v in ((a, b), (b, a))}
        for pose in q_m[met_in]:
            q = model.configuration((0.0, 0.0, 0.0), pose)
            pin.forwardKinematics(model.pin, data, q)
            for (u, v), mask in masks.items():
                T = data.oMi[units[v].joint].actInv(data.oMi[units[u].joint])
                mask |= _reached(units[u].surface @ T.rotation.T + T.translation, units[v])
        met |= masks
    return met


def _reached(points: Array, unit: Unit) -> Array:
    """(N,) whether points in a unit's frame lie within the margin of any of its hulls."""
    along = points @ directions(2).T
    inside = np.zeros(len(points), dtype=bool)
    for part in unit.parts:
        inside |= (along <= part.reach + _MARGIN).all(axis=1)
    return inside
