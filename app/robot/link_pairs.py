"""§2.1: link pairs that can meet, found once by random sampling, and their present distances."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import product
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel
from app.robot.state import ShapeDistances
from app.strict import Array, Finite, NonNegative


class Pair(NamedTuple):
    """A link pair <l_a, l_b> of bodies, l_a nearer to the base."""

    a: str
    b: str

    @property
    def name(self) -> str:
        """The names of both bodies, such as `lm-lEE`."""
        return f"{self.a}-{self.b}"


class ClosestPoints(NamedTuple):
    """The closest points of one link pair <a, b> in the world: the result of FindClosestPoints."""

    pair: Pair
    d: float  # [m] signed distance, negative in penetration
    p_a: Array  # (3,) [m] closest point on `a`
    p_b: Array  # (3,) [m] closest point on `b`
    n: Array
    """(3,) normal from `a` to `b`: moving `b` along it increases d, also in penetration. A unit
    vector, or shorter if it is a mean between two convex parts of `a`."""
    core: Array
    """(3,) [m] point of the core of `b` that belongs to p_b: p_b moved along n by the radius of `b`
    around its core. It equals p_b where `b` is not round, and in the results of `PairDistances`."""
    parts: tuple["ClosestPoints", ...] = ()
    """The closest points of each convex part of `a`, if there are several."""


@dataclass(frozen=True)
class LinkPairs:
    """The set L of (1), all pairs that can collide, split as in (2)."""

    mobile: tuple[Pair, ...]  # L_m, the pairs of the mobile base and a body of the arm
    manipulator: tuple[Pair, ...]  # L_m^c, the pairs of two bodies of the arm
    never: tuple[Pair, ...]  # pairs without a sample in collision
    rates: dict[str, NonNegative] = field(hash=False)  # share of samples in collision, by pair
    least_distance_m: dict[str, Finite] = field(hash=False)
    """[m] smallest sampled signed distance, by the name of the pair."""
    samples: int  # number of sampled joint positions
    seed: int

    @property
    def all(self) -> tuple[Pair, ...]:
        """L = L_m ∪ L_m^c: first the pairs of L_m, each part in the order of `candidate_pairs`."""
        return self.mobile + self.manipulator


class PairDistances(ShapeDistances):
    """Distances and closest points of some pairs, by the collision library.

    Call `update` or `update_from` for each configuration, then the other methods; `sampled` needs
    no earlier call. The distance of a body of several shapes is that of its nearest shape. `data`
    is pinocchio's data of the last `update`.
    """

    def __init__(self, model: RobotModel, pairs: Sequence[Pair]) -> None:
        self.pairs, self.data = tuple(pairs), model.pin.createData()
        shapes: list[tuple[int, int]] = []
        groups: list[list[range]] = []
        for pair in self.pairs:
            first, each = len(shapes), len(model.shape_ids[pair.b])
            shapes += product(model.shape_ids[pair.a], model.shape_ids[pair.b])
            whole = range(first, len(shapes))
            parts = [range(k, k + each) for k in whole[::each]]
            groups.append([whole, *parts] if len(parts) > 1 else [whole])
        rows = [whole for whole, *_ in groups] + [part for _, *parts in groups for part in parts]
        super().__init__(model, shapes, rows)
        results = self._placed.distanceResults  # an access takes longer than the computation
        self._results = [[[results[k] for k in one] for one in group] for group in groups]
        """For each pair a list: first the results of all pairs of shapes of `a` and `b`; then, if
        `a` has several shapes, the results of each shape of `a` with the shapes of `b`."""

    def update(self, q: Array) -> None:
        """Compute kinematics and all distances at pinocchio's configuration `q`."""
        pin.updateGeometryPlacements(self._model.pin, self.data, self._geometry, self._placed, q)
        pin.computeDistances(self._geometry, self._placed)

    def distances(self) -> tuple[float, ...]:
        """[m] signed distance of each pair at the last update."""
        rows = np.empty(len(self.firsts) - 1)
        self.write_distances(rows)
        return tuple(rows[: len(self.pairs)].tolist())

    def sampled(self, q_m: Array) -> Array:
        """(N, pairs) [m] signed distances at joint positions q_m (N, n_m) [rad or m]."""
        found = np.empty((len(q_m), len(self.pairs)))
        for row, posture in zip(found, q_m, strict=True):
            self.update(self._model.configuration((0.0, 0.0, 0.0), posture))
            row[:] = self.distances()
        return found

    def closest(self, i: int) -> ClosestPoints:
        """The closest points of the i-th pair at the last update, in the world, as copies."""
        found = []
        for at in map(_nearest, self._results[i]):
            p_a, p_b = at.getNearestPoint1(), at.getNearestPoint2()
            n = at.normal.copy()  # unlike the points, it is a view
            found.append(ClosestPoints(self.pairs[i], at.min_distance, p_a, p_b, n, p_b))
        return found[0]._replace(parts=tuple(found[1:]))

    def nearest_result(self, i: int) -> pin.DistanceResult:
        """The result for the two nearest shapes of the i-th pair; the next update overwrites it."""
        return _nearest(self._results[i][0])


def _nearest(results: list[pin.DistanceResult]) -> pin.DistanceResult:
    return min(results, key=lambda r: r.min_distance)


def candidate_pairs(model: RobotModel) -> tuple[Pair, ...]:
    """All monitored pairs of bodies that are not neighbours in the chain, in the order of (1): by
    `a`, from the base outwards, then by `b`, from the end-effector inwards.
    """
    names = model.body_names
    pairs = (Pair(a, b) for i, a in enumerate(names) for b in names[: i + 1 : -1])
    return tuple(pair for pair in pairs if pair.name not in model.description.unwatched)


def sample_joints(model: RobotModel, count: int, rng: np.random.Generator) -> Array:
    """(count, n_m) [rad or m] joint positions, uniform within the arm's limits."""
    return rng.uniform(model.q_lower, model.q_upper, (count, model.n_m))


def find_link_pairs(model: RobotModel, *, samples: int = 100_000, seed: int = 0) -> LinkPairs:
    """Find the pairs that can collide, by random sampling of the joint positions.

    A pair is in L if at least one of the `samples` has a signed distance of zero or less.

    Paper: Eq. (1), (2).
    """
    pairs, lm = candidate_pairs(model), model.body_names[0]
    q_m = sample_joints(model, samples, np.random.default_rng(seed))
    distances = PairDistances(model, pairs).sampled(q_m)
    names = [pair.name for pair in pairs]
    rates = dict(zip(names, (distances <= 0.0).mean(axis=0).tolist(), strict=True))
    least = dict(zip(names, distances.min(axis=0).tolist(), strict=True))
    met = [pair for pair in pairs if rates[pair.name] > 0]
    mobile = tuple(pair for pair in met if pair.a == lm)
    manipulator = tuple(pair for pair in met if pair.a != lm)
    never = tuple(pair for pair in pairs if pair not in met)
    return LinkPairs(mobile, manipulator, never, rates, least, samples, seed)
