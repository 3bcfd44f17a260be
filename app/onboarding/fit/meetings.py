"""Units (groups of links) that meet in random postures, and joint limits that keep them apart."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import chain, combinations, compress
from typing import NamedTuple

import numpy as np

from app.config import parameter
from app.errors import RobotFileError
from app.jobs.pool import ALONE, Workers
from app.onboarding.fit.convex import directions
from app.onboarding.fit.units import (
    Pairs,
    Unit,
    hull_distances,
    hulls,
    link_gaps,
    moved,
    neighbours,
    placements,
    shape_distances,
)
from app.onboarding.numbers import Limits
from app.onboarding.read.tree import Arm
from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel
from app.strict import Array

ALWAYS = 0.6  # [-] a pair inside its buffer in a larger share of the free postures is always near
MARGIN = 0.015  # [m] distance below which a point of a surface counts as reached by another unit
BUILT_IN = 0.5  # [-] smallest share of the postures in which two nested units touch
NESTED = BUILT_IN**2
"""[-] smallest share of random postures in which nested links touch, unless they are `grazing`: the
product of the shares in which their units touch and, among these postures, the links."""
LEAST = 0.25  # [-] smallest share of its range, or of a turn, that a limited joint retains
GRAZE = 0.003  # [m] largest overlap of two links of the arm that only pass each other
_RARE = 30  # [-] number of colliding random postures of a pair below which more are searched
ENOUGH = 600  # [-] number of colliding postures for shares with an accuracy of 0.5 %
_FAR = 0.3  # [m] smallest distance of two units above which no search is made
_NEAREST, _TRIES = 20, 10  # [-] postures that are varied at a time, and variations of each posture
_SPREADS = (0.1, 0.05, 0.05, 0.02)  # [-] standard deviations, relative to a joint's range
_VALUES = 400  # [-] sampled positions of a joint that may be limited
_OTHERS = 60  # [-] sampled postures of the other joints at each of these positions


class Postures(NamedTuple):
    """Postures of the arm, with the distances of pairs of units."""

    q_m: Array  # (N, n_m) [rad or m]
    distances: Array  # (N, pairs) [m] signed, of hulls; exact below 0.5 m, in `rare` below `MARGIN`
    possible: Array
    """(N,) whether no close pair touches; contacts of nested pairs do not count. The real robot's
    joint limits have to prevent the other postures."""


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

    @cached_property
    def nested(self) -> frozenset[tuple[int, int]]:
        """Close pairs that touch in half of the random postures or more, as in a telescope."""
        often = _touch_mostly(self.random.distances)
        return self.close.intersection(compress(self.pairs, often))

    @cached_property
    def grazing(self) -> frozenset[tuple[int, int]]:
        """Pairs of the arm's units with 30 contacts or more, all of them at most 3 mm deep."""
        return _grazing(self.units, self.pairs, self.random.distances, self.rare.distances)

    @property
    def collides(self) -> Array:
        """(N, pairs) whether hulls touch in a random posture; always False for pairs in `close`."""
        watched = np.array([pair not in self.close for pair in self.pairs], dtype=bool)
        return np.logical_and(self.random.distances <= 0.0, watched)

    def needed(self, unit: int, others: Sequence[int]) -> Array:
        """(N,) for each point of a unit's surface: whether a unit of `others` can reach it."""
        none = np.zeros(len(self.units[unit].surface), dtype=bool)
        return np.any([none, *(self.met.get((unit, k), none) for k in others)], axis=0)

    def touch_within(self, pair: tuple[int, int], lower: Array, upper: Array) -> bool:
        """Whether two units touch in at least one random posture within joint limits (n_m,)."""
        q_m, gaps = self.random.q_m, self.random.distances[:, self.pairs.index(pair)]
        return bool((gaps[((q_m >= lower) & (q_m <= upper)).all(axis=1)] <= 0.0).any())

    def monitored_from(self, pair: tuple[int, int]) -> float:
        """Largest d_b [m] that the distance exceeds in 60 % of free postures; 0 if too small."""
        # The share 1 − `ALWAYS` would be sufficient for the links, but their bodies are larger.
        distances = self.random.distances
        gaps = distances[_free_postures(distances), self.pairs.index(pair)]
        wanted = float(np.floor(100 * np.quantile(gaps, 1.0 - ALWAYS)) / 100)
        return wanted if wanted >= parameter("border.d_b").low else 0.0

    def detectable(self, pair: tuple[int, int]) -> str:
        """Words with the d_b of `monitored_from`, for a message; empty if no d_b is valid."""
        d_b = self.monitored_from(pair)
        return f", which a pair can detect with --buffer-distance {d_b:g} or less" if d_b else ""


def sample_meetings(
    model: RobotModel,
    units: tuple[Unit, ...],
    *,
    samples: int,
    seed: int,
    d_b: float,
    enough: int = 0,
    counted: Collection[tuple[int, int]] | None = None,
    workers: Workers = ALONE,
) -> Meetings:
    """Distances between the hulls of all units that are not neighbours, in random postures.

    First `samples` postures are drawn, then further ones, up to 40,000 in total, until `enough` of
    them are `possible` and have a collision. For a complete robot, `counted` has the pairs whose
    contacts count in plants; otherwise it is None. With `counted`, `met` is empty, `close` has no
    pair of `apart`, and a pair of `counted` is not in `close` for grazing alone.
    """
    rng, shaped = np.random.default_rng(seed), [unit for unit in units if unit.parts]
    distant = [(a, b) for a, b in combinations(shaped, 2) if not neighbours(model, a, b)]
    pairs = tuple((a.index, b.index) for a, b in distant)
    q_m, distances = np.zeros((0, model.n_m)), np.zeros((0, len(pairs)))
    while True:
        more = sample_joints(model, 1000 if len(q_m) else samples, rng)
        q_m = np.vstack([q_m, more])
        parts = [(model, units, pairs, part) for part in np.array_split(more, 4)]
        distances = np.vstack([distances, *workers.map(_look, parts)])
        close, nested = _close_pairs(distances, pairs, d_b), _touch_mostly(distances)
        deep = compress(pairs, (distances.min(axis=0) < -0.005) & ~nested)
        apart = close.intersection(pair for pair in deep if units[pair[0]].joint == 1)
        close = close if counted is None else close - apart
        # The real robot cannot make a close pair touch, unless it is nested.
        barred = [k for k, pair in enumerate(pairs) if pair in close and not nested[k]]
        random = Postures(q_m, distances, np.all(distances[:, barred] > 0.0, axis=1))
        found = Meetings(units, pairs, close, apart, random, random)
        hits = np.count_nonzero(random.possible & found.collides.any(axis=1))
        if hits >= enough or len(q_m) >= 40_000:
            break
    rare_q = _rare_postures(model, found, seed)
    gaps = shape_distances(model, [hulls(model, unit) for unit in units], pairs, rare_q, MARGIN)
    graze = _grazing(units, pairs, distances, gaps).difference(counted or ())
    barred += [k for k, pair in enumerate(pairs) if pair in graze - close]
    both = (q_m, distances), (rare_q, gaps)
    random, rare = (Postures(q, d, np.all(d[:, barred] > 0.0, axis=1)) for q, d in both)
    found = replace(found, close=close | graze, random=random, rare=rare)
    jobs = [] if counted is not None else [(found, model, k) for k in range(len(pairs))]
    return replace(found, met=dict(chain.from_iterable(workers.map(_met, jobs))))


def _grazing(units: Sequence[Unit], pairs: Pairs, *distances: Array) -> frozenset[tuple[int, int]]:
    """Pairs of the arm's units with `_RARE` contacts or more, all of them at most `GRAZE` deep."""
    depths = np.sort(-np.vstack(distances), axis=0)[-_RARE:]
    touching = compress(pairs, (depths[0] >= 0.0) & (depths[-1] <= GRAZE))
    return frozenset((u, v) for u, v in touching if min(units[u].joint, units[v].joint) > 1)


def _look(_: object, arguments: tuple[RobotModel, Sequence[Unit], Pairs, Array]) -> Array:
    return hull_distances(*arguments)


def _touch_mostly(distances: Array) -> Array:
    """(pairs,) whether hulls touch in at least `BUILT_IN` of the postures: distances (N, pairs)."""
    return (distances <= 0.0).mean(axis=0) >= BUILT_IN


def nested_links(model: RobotModel, found: Meetings, u: int, v: int) -> list[tuple[str, str]]:
    """Pairs (link of u, link of v) of nested links of two units; none if these are not nested.

    Units are nested if they are in `found.nested` or `found.grazing`, or are neighbours that touch
    in half of the postures or more. Links of grazing units are nested if they touch in any posture.
    Links of other nested units must touch in half or more of the postures in which the units touch.
    """
    a, b, grazing = found.units[u], found.units[v], (u, v) in found.grazing
    if (u, v) in found.pairs and (u, v) not in found.nested and not grazing:
        return []
    q_m = np.vstack([found.random.q_m, found.rare.q_m]) if grazing else found.random.q_m[:ENOUGH]
    links, gaps = link_gaps(model, a, b, q_m)
    if grazing:
        return [*compress(links, np.any(gaps <= 0.0, axis=0))]
    met = (gaps <= 0.0).any(axis=1)
    if (u, v) not in found.nested and met.mean() < BUILT_IN:
        return []
    return [*compress(links, _touch_mostly(gaps[met]))]


def _rare_postures(model: RobotModel, met: Meetings, seed: int) -> Array:
    """(N, n_m) more colliding postures of pairs that collide in fewer than `_RARE` random postures:
    variations of the nearest ones. Not for pairs in `met.close`, or always more than `_FAR` apart.
    """
    rng, span = np.random.default_rng([seed, 1]), model.q_upper - model.q_lower
    found = [np.zeros((0, model.n_m))]
    for k, (a, b) in enumerate(met.pairs):
        q_m, gaps = met.random.q_m, met.random.distances[:, k]
        if (a, b) in met.close or np.count_nonzero(gaps <= 0.0) >= _RARE or gaps.min() > _FAR:
            continue
        nearest = np.argsort(gaps)[:_NEAREST]
        for spread in _SPREADS:
            q_m, gaps = q_m[nearest], gaps[nearest]
            varied = np.repeat(q_m, _TRIES, axis=0)
            varied = varied + spread * span * rng.standard_normal(varied.shape)
            varied = np.clip(varied, model.q_lower, model.q_upper)
            both = met.units[a], met.units[b]
            found_gaps = hull_distances(model, both, [(0, 1)], varied)[:, 0]
            found.append(varied[found_gaps <= 0.0])
            q_m, gaps = np.vstack([q_m, varied]), np.concatenate([gaps, found_gaps])
            hits = rng.permutation(np.flatnonzero(gaps <= 0.0))
            nearest = hits[:_NEAREST] if len(hits) >= _NEAREST else np.argsort(gaps)[:_NEAREST]
    return np.vstack(found)


def _free_postures(distances: Array) -> Array:
    """(N,) whether no hulls touch, by distances (N, pairs) [m]; all True if under 50 are free."""
    free = np.asarray((distances > 0.0).all(axis=1))
    return free if np.count_nonzero(free) >= 50 else np.ones(len(distances), dtype=bool)


def _close_pairs(distances: Array, pairs: Pairs, d_b: float) -> frozenset[tuple[int, int]]:
    """Pairs within d_b [m] in more than `ALWAYS` of the free postures; see `_free_postures`."""
    near = (distances[_free_postures(distances)] < d_b).mean(axis=0)
    return frozenset(compress(pairs, near > ALWAYS))


def _met(_: object, job: tuple[Meetings, RobotModel, int]) -> list[tuple[tuple[int, int], Array]]:
    """The items of `met` for one pair of units; the job has the index of the pair."""
    found, model, k = job
    units, (a, b), column = found.units, found.pairs[k], found.random.distances[:, k]
    met_in = np.flatnonzero((column <= MARGIN) & found.random.possible)
    # Not all of many postures: a selection that is evenly spread from shallow to deep collisions.
    met_in = met_in[np.argsort(-column[met_in])][:: max(1, len(met_in) // 200)]
    postures = found.random.q_m[met_in]
    if np.count_nonzero(column <= 0.0) < _RARE:
        rare = found.rare.q_m[(found.rare.distances[:, k] <= MARGIN) & found.rare.possible]
        postures = np.vstack([postures, rare])
    if (a, b) in found.close or not len(postures):
        return []
    masks = {(u, v): np.zeros(len(units[u].surface), dtype=bool) for u, v in ((a, b), (b, a))}
    for posture in postures:
        placed = placements(model, posture)
        for (u, v), mask in masks.items():
            T = placed[units[v].joint].actInv(placed[units[u].joint])
            left = np.flatnonzero(~mask)
            along = moved(units[u].surface[left], T) @ directions(2).T
            for part in units[v].parts:  # all its hulls, grown by `MARGIN`
                mask[left] |= (along <= part.reach + MARGIN).all(axis=1)
    return [*masks.items()]


def with_stops(
    limits: Limits,
    model: RobotModel,
    arm: Arm,
    meetings: Meetings,
    ready: Sequence[float] | None = None,
) -> Limits:
    """Joint limits that, if possible, prevent contact of the base with links close to it by design.

    For each of these links that touches the base in a random posture, one joint before the link
    gets narrower limits: the one that keeps most of its range. If none keeps a quarter of its
    range, or of a turn if less, no limit changes. The limits include `ready` (n_m,) if not None.

    Raises:
        RobotFileError: Limits can prevent the contact, but none of them includes `ready`.
    """
    lower, upper = np.array(limits.lower), np.array(limits.upper)
    stops = {}
    for pair in sorted(meetings.close & meetings.apart):
        if not meetings.touch_within(pair, lower, upper):
            continue
        a, b = (meetings.units[k] for k in pair)
        postures = sample_joints(model, _OTHERS, np.random.default_rng(0)).clip(lower, upper)
        stopping, possible = [], False
        for joint in range(b.joint - 1):  # pinocchio's joint 2 is the first one of the arm
            values = np.linspace(lower[joint], upper[joint], _VALUES)
            tried = np.repeat(postures[:, None], _VALUES, axis=1)
            tried[:, :, joint] = values
            found = hull_distances(model, (a, b), [(0, 1)], tried.reshape(-1, model.n_m))
            nearest = found.reshape(_OTHERS, _VALUES).min(axis=0)
            clear = nearest > contact_margin(nearest)
            span = upper[joint] - lower[joint]
            for first, after in np.flatnonzero(np.diff(np.pad(clear, 1))).reshape(-1, 2):
                low, high = values[first], values[after - 1]
                enough = high - low >= LEAST * min(span, 2 * np.pi)
                possible = possible or enough
                if enough and (ready is None or low <= ready[joint] <= high):
                    share = round((high - low) / span / 0.05)  # similar shares are equal
                    stopping.append((share, -abs(low + high), joint, low, high))
        if stopping:
            *_, joint, low, high = max(stopping)
            lower[joint], upper[joint] = np.ceil(100 * low) / 100, np.floor(100 * high) / 100
            name = arm.joints[joint].name
            reason = f"{b.name} reaches {a.name}{meetings.detectable(pair)}"
            stops[name] = f"{stops[name]}, and {reason}" if name in stops else reason
        elif possible:
            why = f"--ready: {b.name} can meet {a.name} near this posture"
            raise RobotFileError(f"{why}; choose another posture")
    return limits._replace(lower=tuple(lower.tolist()), upper=tuple(upper.tolist()), stops=stops)


def contact_margin(distances: Array) -> float:
    """[m] distance up to which two links count as in contact: `MARGIN` or, if less, as for adjacent
    links, half of the largest of their `distances` (N,) [m] in N postures.
    """
    return float(np.clip(distances.max() / 2, 0.0, MARGIN))


def watching_buffer(limits: Limits, meetings: Meetings, d_b: float) -> tuple[float, str]:
    """`d_b` [m] and an empty text, or a smaller multiple of 0.01 m and its reason. With this, pairs
    of bodies detect collisions that no limit prevents, unless these need an invalid `border.d_b`.
    """
    least, why = d_b, ""
    lower, upper = np.array(limits.lower), np.array(limits.upper)
    for pair in sorted(meetings.close & meetings.apart):
        wanted = meetings.monitored_from(pair)
        if meetings.touch_within(pair, lower, upper) and 0.0 < wanted < least:
            a, b = (meetings.units[k].name for k in pair)
            least, why = wanted, f"{b} is nearer than {d_b:g} m to {a} in most postures"
    return least, why
