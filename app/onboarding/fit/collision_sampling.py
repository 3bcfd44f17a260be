"""Collision sampling: the units (groups of links) that meet in random postures of the arm."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, compress, product
from typing import NamedTuple

import numpy as np

from app.jobs.pool import ALONE, Workers
from app.onboarding.fit.convex import directions
from app.onboarding.fit.units import (
    Pairs,
    Unit,
    hull_distances,
    link_shapes,
    moved,
    neighbours,
    placements,
    shape_distances,
    units_of_links,
)
from app.onboarding.read.links import Geometry
from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel
from app.strict import Array

ALWAYS = 0.6  # [-] a pair inside its buffer in a larger share of the free postures is always near
MARGIN = 0.015  # [m] distance below which a point of a surface counts as reached by another unit
BUILT_IN = 0.5  # [-] smallest share of the postures in which two nested units touch
NESTED = BUILT_IN**2
"""[-] smallest share of random postures in which nested links touch, unless they are `grazing`: the
product of the shares in which their units touch and, among these postures, the links."""
_FEWEST = 50  # [-] smallest number of free postures for finding close pairs
_MAX_LOOKS = 200  # [-] about this number of postures is searched for touched points of two units
_OVERLAP = 0.005  # [m] largest overlap of adjacent links by design
GRAZE = 0.003  # [m] largest overlap of two links of the arm that only pass each other
_RARE = 30  # [-] number of colliding random postures of a pair below which more are searched
ENOUGH = 600  # [-] number of colliding postures for shares with an accuracy of 0.5 %
_MORE, _MAX_POSTURES = 1000, 40_000  # [-] postures that are sampled at a time, and in total
_PARTS = 4  # [-] parts of the random postures, for parallel processes
_FAR = 0.3  # [m] smallest distance of two units above which no search is made
_NEAREST, _TRIES = 20, 10  # [-] postures that are varied at a time, and variations of each posture
_SPREADS = (0.1, 0.05, 0.05, 0.02)  # [-] standard deviations, relative to a joint's range


class Postures(NamedTuple):
    """Postures of the arm, with the distances of pairs of units."""

    q_m: Array  # (N, n_m) [rad or m]
    distances: Array  # (N, pairs) [m] signed distances of hulls
    possible: Array
    """(N,) whether no close pair touches; contacts of nested pairs do not count. Joint limits have
    to prevent the other postures."""


@dataclass(frozen=True)
class Meetings:
    """Distances and collisions of units in random postures."""

    units: tuple[Unit, ...]
    pairs: tuple[tuple[int, int], ...]  # units that are not neighbours, by their indices
    close: frozenset[tuple[int, int]]
    """Pairs of units that no pair of bodies can monitor: within d_b in most free postures, or units
    of the arm that touch, but overlap by at most 3 mm."""
    apart: frozenset[tuple[int, int]]
    """Pairs of a unit on the base and a unit of the arm, not nested, that are within d_b in most
    free postures and overlap by over 5 mm in some: joint limits have to prevent the overlap."""
    random: Postures
    rare: Postures  # of pairs that rarely collide; see `_rare_postures`
    met: dict[tuple[int, int], Array] = field(repr=False, default_factory=dict)
    """(N,) for units u and v, in both orders: whether v has reached each point on u's surface."""

    @property
    def nested(self) -> frozenset[tuple[int, int]]:
        """Close pairs that touch in half of the random postures or more, as in a telescope."""
        often = _touch_mostly(self.random.distances)
        return self.close.intersection(compress(self.pairs, often))

    @property
    def grazing(self) -> frozenset[tuple[int, int]]:
        """Pairs of the arm's units with 30 contacts or more, all of them at most 3 mm deep."""
        distances = np.vstack([self.random.distances, self.rare.distances])
        return _grazing(self.units, self.pairs, distances)

    @property
    def collides(self) -> Array:
        """(N, pairs) whether hulls touch in a random posture; always False for pairs in `close`."""
        watched = np.array([pair not in self.close for pair in self.pairs], dtype=bool)
        return np.logical_and(self.random.distances <= 0.0, watched)

    def needed(self, unit: int, others: Sequence[int]) -> Array:
        """(N,) for each point of a unit's surface: whether a unit of `others` can reach it."""
        none = np.zeros(len(self.units[unit].surface), dtype=bool)
        return np.any([none, *(self.met.get((unit, k), none) for k in others)], axis=0)


def sample_meetings(
    model: RobotModel,
    units: tuple[Unit, ...],
    *,
    samples: int,
    seed: int,
    d_b: float,
    enough: int = 0,
    stopped: bool = False,
    counted: Collection[tuple[int, int]] = (),
    workers: Workers = ALONE,
) -> Meetings:
    """Distances between the hulls of all units that are not neighbours, in random postures.

    First `samples` postures are drawn, then further ones, up to 40,000 in total, until `enough` of
    them are `possible` and have a collision. `stopped` means that the joint limits already prevent
    collisions of the pairs in `apart`: then these pairs are not in `close`, and `met` is empty.
    Pairs in `counted` never count as `grazing`.
    """
    rng, shaped = np.random.default_rng(seed), [unit for unit in units if unit.parts]
    distant = [(a, b) for a, b in combinations(shaped, 2) if not neighbours(model, a, b)]
    pairs = tuple((a.index, b.index) for a, b in distant)
    q_m, distances = np.zeros((0, model.n_m)), np.zeros((0, len(pairs)))
    while True:
        more = sample_joints(model, _MORE if len(q_m) else samples, rng)
        q_m = np.vstack([q_m, more])
        parts = [(model, units, pairs, part) for part in np.array_split(more, _PARTS)]
        distances = np.vstack([distances, *workers.map(_look, parts)])
        close, apart, barred = _built_near(units, pairs, distances, d_b, stopped)
        random = Postures(q_m, distances, np.all(distances[:, barred] > 0.0, axis=1))
        found = Meetings(units, pairs, close, apart, random, random)
        hits = np.count_nonzero(random.possible & found.collides.any(axis=1))
        if hits >= enough or len(q_m) >= _MAX_POSTURES:
            break
    rare_q = _rare_postures(model, units, pairs, (q_m, distances), close, seed)
    gaps = hull_distances(model, units, pairs, rare_q)
    graze = _grazing(units, pairs, np.vstack([distances, gaps])).difference(counted)
    barred += [k for k, pair in enumerate(pairs) if pair in graze - close]
    random, rare = (
        Postures(q_m, each, np.all(each[:, barred] > 0.0, axis=1))
        for q_m, each in ((q_m, distances), (rare_q, gaps))
    )
    found = replace(found, close=close | graze, random=random, rare=rare)
    jobs = [] if stopped else [(found, model, k) for k in range(len(pairs))]
    met: dict[tuple[int, int], Array] = {}
    for masks in workers.map(_met, jobs):
        met.update(masks)
    return replace(found, met=met)


def _built_near(
    units: Sequence[Unit], pairs: Pairs, distances: Array, d_b: float, stopped: bool
) -> tuple[frozenset[tuple[int, int]], frozenset[tuple[int, int]], list[int]]:
    """The fields `close` and `apart` of `Meetings` by distances (N, pairs) [m], and the indices of
    the close pairs that are not nested: the real robot cannot make them touch.
    """
    close = _close_pairs(distances, pairs, d_b)
    nested = _touch_mostly(distances)
    deep = compress(pairs, (distances.min(axis=0) < -_OVERLAP) & ~nested)
    apart = close.intersection(pair for pair in deep if units[pair[0]].joint == 1)
    if stopped:
        close -= apart
    return close, apart, [k for k, pair in enumerate(pairs) if pair in close and not nested[k]]


def _grazing(units: Sequence[Unit], pairs: Pairs, distances: Array) -> frozenset[tuple[int, int]]:
    """Pairs of the arm's units with `_RARE` contacts or more, at most `GRAZE` deep."""
    depths = np.sort(-distances, axis=0)[-_RARE:]
    shallow = (depths[0] >= 0.0) & (depths[-1] <= GRAZE)
    touching = compress(pairs, shallow)
    return frozenset((u, v) for u, v in touching if min(units[u].joint, units[v].joint) > 1)


def _look(_: object, arguments: tuple[RobotModel, Sequence[Unit], Pairs, Array]) -> Array:
    return hull_distances(*arguments)


def _touch_mostly(distances: Array) -> Array:
    """(pairs,) whether hulls touch in at least `BUILT_IN` of the postures: distances (N, pairs)."""
    return (distances <= 0.0).mean(axis=0) >= BUILT_IN


def nested_links(model: RobotModel, found: Meetings, u: int, v: int) -> list[tuple[str, str]]:
    """Pairs (link of u, link of v) of nested links; none if the units u and v are not nested.

    Units are nested if they are in `found.nested` or `found.grazing`, or are neighbours that touch
    in half of the postures or more. Links of grazing units are nested if they touch in a posture;
    other links, if they touch in half or more of the postures in which their units touch.
    """
    a, b, grazing = found.units[u], found.units[v], (u, v) in found.grazing
    if (u, v) in found.pairs and (u, v) not in found.nested and not grazing:
        return []
    q_m = np.vstack([found.random.q_m, found.rare.q_m]) if grazing else found.random.q_m[:ENOUGH]
    links, gaps = link_gaps(model, a, b, q_m)
    if grazing:
        return [*compress(links, (gaps <= 0.0).any(axis=0))]
    met = (gaps <= 0.0).any(axis=1)
    if (u, v) not in found.nested and met.mean() < BUILT_IN:
        return []
    return [*compress(links, _touch_mostly(gaps[met]))]


def link_gaps(
    model: RobotModel, u: Unit, v: Unit, q_m: Array
) -> tuple[list[tuple[str, str]], Array]:
    """Pairs (link of u, link of v), and their distances (N, pairs) [m] in postures q_m (N, n_m)."""
    own, other = link_shapes([u]), link_shapes([v])
    pairs = [*product(range(len(own)), range(len(own), len(own) + len(other)))]
    gaps = shape_distances(model, [*own.values(), *other.values()], pairs, q_m)
    return [*product(own, other)], gaps


def nested_touches(
    model: RobotModel, geometry: Geometry
) -> dict[tuple[str, str], tuple[float, float]]:
    """For each pair of nested links of a description: the share [-] of random postures in which the
    two touch, and their largest overlap [m] in these. Both are 0 if a link has no shape.
    """
    units = [unit for each in units_of_links(model, geometry).values() for unit in each]
    shapes = link_shapes(units)
    named = sorted((min(pair), max(pair)) for pair in model.description.nested)
    shaped, number = [pair for pair in named if shapes.keys() >= {*pair}], list(shapes).index
    pairs = [(number(a), number(b)) for a, b in shaped]
    q_m = sample_joints(model, ENOUGH, np.random.default_rng(0))
    gaps = shape_distances(model, list(shapes.values()), pairs, q_m)
    touches = zip((gaps <= 0.0).mean(axis=0).tolist(), (-gaps).max(axis=0).tolist(), strict=True)
    return dict.fromkeys(named, (0.0, 0.0)) | dict(zip(shaped, touches, strict=True))


def _rare_postures(
    model: RobotModel,
    units: Sequence[Unit],
    pairs: Pairs,
    sampled: tuple[Array, Array],
    close: frozenset[tuple[int, int]],
    seed: int,
) -> Array:
    """(N, n_m) further colliding postures of pairs that collide in fewer than `_RARE` sampled ones:
    variations of the postures in which the pair is nearest. Pairs in `close`, and pairs always more
    than `_FAR` apart, are left out. `sampled`: postures (N, n_m), distances (N, pairs).
    """
    rng, span = np.random.default_rng([seed, 1]), model.q_upper - model.q_lower
    found = [np.zeros((0, model.n_m))]
    for k, (a, b) in enumerate(pairs):
        q_m, gaps = sampled[0], sampled[1][:, k]
        if (a, b) in close or np.count_nonzero(gaps <= 0.0) >= _RARE or gaps.min() > _FAR:
            continue
        nearest = np.argsort(gaps)[:_NEAREST]
        for spread in _SPREADS:
            q_m, gaps = q_m[nearest], gaps[nearest]
            varied = np.repeat(q_m, _TRIES, axis=0)
            varied = varied + spread * span * rng.standard_normal(varied.shape)
            varied = np.clip(varied, model.q_lower, model.q_upper)
            found_gaps = hull_distances(model, (units[a], units[b]), [(0, 1)], varied)[:, 0]
            found.append(varied[found_gaps <= 0.0])
            q_m, gaps = np.vstack([q_m, varied]), np.concatenate([gaps, found_gaps])
            met = rng.permutation(np.flatnonzero(gaps <= 0.0))
            nearest = met[:_NEAREST] if len(met) >= _NEAREST else np.argsort(gaps)[:_NEAREST]
    return np.vstack(found)


def free_postures(distances: Array) -> Array:
    """(N,) whether no hulls touch, by distances (N, pairs) [m]; all True if under 50 are free."""
    free = np.asarray((distances > 0.0).all(axis=1))
    return free if np.count_nonzero(free) >= _FEWEST else np.ones(len(distances), dtype=bool)


def _close_pairs(distances: Array, pairs: Pairs, d_b: float) -> frozenset[tuple[int, int]]:
    """Pairs within d_b [m] in more than `ALWAYS` of the free postures; see `free_postures`."""
    near = (distances[free_postures(distances)] < d_b).mean(axis=0)
    return frozenset(compress(pairs, near > ALWAYS))


def _met(_: object, job: tuple[Meetings, RobotModel, int]) -> dict[tuple[int, int], Array]:
    """The entries of `met` for one pair of units; the job has the index of the pair."""
    found, model, k = job
    units, (a, b), column = found.units, found.pairs[k], found.random.distances[:, k]
    met_in = np.flatnonzero((column <= MARGIN) & found.random.possible)
    # Not all of many postures: a selection that is evenly spread from shallow to deep collisions.
    met_in = met_in[np.argsort(-column[met_in])][:: max(1, len(met_in) // _MAX_LOOKS)]
    postures = found.random.q_m[met_in]
    if np.count_nonzero(column <= 0.0) < _RARE:
        rare = found.rare.q_m[(found.rare.distances[:, k] <= MARGIN) & found.rare.possible]
        postures = np.vstack([postures, rare])
    if (a, b) in found.close or not len(postures):
        return {}
    masks = {(u, v): np.zeros(len(units[u].surface), dtype=bool) for u, v in ((a, b), (b, a))}
    for posture in postures:
        placed = placements(model, posture)
        for (u, v), mask in masks.items():
            T = placed[units[v].joint].actInv(placed[units[u].joint])
            left = np.flatnonzero(~mask)
            along = moved(units[u].surface[left], T) @ directions(2).T
            for part in units[v].parts:  # all its hulls, grown by `MARGIN`
                mask[left] |= (along <= part.reach + MARGIN).all(axis=1)
    return masks
