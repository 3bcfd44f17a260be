"""Grouping of links into bodies whose pairs detect collisions and do not react in free postures.

Like the paper's l_1 … l_EE, each body joins neighbouring links of the chain. A pair of bodies
detects a collision of links if the bodies overlap in the posture of this collision. Bodies that
are neighbours are not a pair; the pairs in `Verdict.unwatched` are not monitored.
"""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations, compress, pairwise, product
from operator import itemgetter
from typing import NamedTuple

import numpy as np

from app.errors import RobotFileError
from app.jobs.pool import ALONE, Workers
from app.jobs.progress import OnProgress
from app.onboarding.fit.bodies import ArmFitter, FittedBody, fit_base
from app.onboarding.fit.meetings import (
    ALWAYS,
    BUILT_IN,
    ENOUGH,
    LEAST,
    Meetings,
    contact_margin,
    nested_links,
    sample_meetings,
)
from app.onboarding.fit.travel import held_by
from app.onboarding.fit.units import (
    Unit,
    hull_distances,
    link_gaps,
    meshes_meet,
    shape_distances,
    units_of_links,
)
from app.onboarding.read.links import Geometry
from app.onboarding.read.tree import Tree
from app.onboarding.request import BOUNDS
from app.robot.link_pairs import Pair, PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.strict import Array

MAX_UNDETECTED = 0.01  # [-] largest share of the links' collisions that their own bodies may miss
TEST_POSTURES = 4000  # [-] smallest number of random postures for testing the chosen bodies
_FEWEST_CONTACTS = 30  # [-] smallest number of postures for naming a range without a contact
_MISSED = 0.1 * MAX_UNDETECTED  # [-] largest share of colliding postures that a grouping may miss
_BODY_COST = 0.03  # [-] cost of each body
_MISSED_COST = 40.0  # [-] cost of missed collisions, per share above `_MISSED`

BY_LINKS = "chosen: some of its links are nearer than d_b by design"
BY_BODIES = "chosen: its bodies are within d_b in most postures; other pairs detect the collisions"
"""Reasons why a pair is not monitored."""


class Verdict(NamedTuple):
    """The quality of a grouping."""

    missed: float  # [-] share of colliding postures in which no monitored pair of bodies overlaps
    false: float  # [-] share of free postures in which a monitored pair of bodies overlaps
    overlap: dict[str, float]  # [-] share of free postures in which a pair overlaps, by its name
    spurious: tuple[str, ...]  # monitored pairs whose bodies overlap although their links never do
    always: tuple[str, ...]
    """Monitored pairs that overlap in a posture, and are inside their buffer in most free ones."""
    unwatched: dict[str, str]  # `BY_LINKS` or `BY_BODIES`, by the pair that is not monitored
    near: dict[str, float]  # [-] share of free postures inside the buffer, by monitored pair
    cost: float  # [-] total cost; the best grouping has the smallest


class Grouping(NamedTuple):
    """The bodies, l_m first, and their quality."""

    bodies: list[FittedBody]
    verdict: Verdict


def find_grouping(
    model: RobotModel,
    meetings: Meetings,
    d_b: float,
    count: int | None = None,
    on_progress: OnProgress = lambda _: None,
    separate: Collection[tuple[str, str]] = (),
) -> Grouping:
    """The best grouping of the robot's units into bodies.

    The unit that is fixed to the base below the arm belongs to l_1, like the paper's link 0. If the
    pairs then miss over 0.1 % of its collisions, as for a mast, it belongs to l_m instead.

    `count` is the number of bodies of the arm. None means four, as in the paper, if sufficient, and
    otherwise the best number from two to six. Four are not sufficient if `Verdict.always` or
    `Verdict.spurious` has a pair, or `Verdict.missed` is over 0.1 %. If possible for all links in
    `separate`, each entry's bodies are a pair. `on_progress` gets each search's finished share.

    Raises:
        RobotFileError: No grouping has `count` bodies; or as for `ArmFitter.bodies`.
    """
    fixed = meetings.units[1]
    own = {link: unit.index for unit in meetings.units for link in unit.links}
    how = d_b, count, on_progress, [(own[a], own[b]) for a, b in separate]
    found = _arm_grouping(model, meetings, (0,), *how)
    if fixed.links and not _detects(model, found, meetings, fixed.index):
        found = _arm_grouping(model, meetings, (0, fixed.index), *how)
    bodies = []
    for k, body in enumerate(found.bodies):
        inner = [unit for each in found.bodies[: max(0, k - 1)] for unit in each.units]
        nested: dict[str, tuple[str, ...]] = {}
        for u, v in product(inner, body.units):
            for link, own in nested_links(model, meetings, u, v):
                nested[own] = (*nested.get(own, ()), link)
        bodies.append(body._replace(nested=nested))
    return found._replace(bodies=bodies)


def _detects(model: RobotModel, grouping: Grouping, meetings: Meetings, unit: int) -> bool:
    """Whether monitored pairs overlap in ≥ 99.9 % of the postures in which a unit meets another."""
    own = [unit in pair and pair not in meetings.close for pair in meetings.pairs]
    q_m = [
        postures.q_m[np.any(postures.distances[:, own] <= 0.0, axis=1) & postures.possible]
        for postures in (meetings.random, meetings.rare)
    ]
    names, distances = _body_distances(model, grouping.bodies, np.vstack(q_m))
    watched = [name not in grouping.verdict.unwatched for name in names]
    return _share(np.all(distances[:, watched] > 0.0, axis=1)) <= _MISSED


def _arm_grouping(
    model: RobotModel,
    meetings: Meetings,
    mobile: tuple[int, ...],
    d_b: float,
    count: int | None,
    on_progress: OnProgress,
    apart: Collection[tuple[int, int]],
) -> Grouping:
    """The best grouping if l_m encloses the units `mobile`; for `apart` see `_ranked`."""
    base, fitter = fit_base(model, meetings, mobile), ArmFitter(model, meetings, mobile)
    units = [u.index for u in meetings.units if u.index not in mobile and (u.index > 1 or u.links)]
    arm = (unit for unit in meetings.units if unit.joint > 1)
    slides = frozenset(u.index for u in arm if model.joint_units[u.joint - 2] == "m")
    judged: set[tuple[int, ...]] = set()

    def best(found: Grouping | None, *counts: int) -> Grouping | None:
        """The best of `found` and the 60 most promising groupings into `counts` bodies, or None."""
        ranked = _ranked(units, counts, meetings, mobile, slides, apart)[:60]
        for k, (at_least, grouping) in enumerate(ranked):
            on_progress(k / len(ranked))
            if found is not None and at_least >= found.verdict.cost:
                continue
            bodies = [base, *fitter.bodies(grouping)]
            shapes = tuple(id(body.fits[0]) for body in bodies)
            if shapes in judged:  # the bodies of another grouping have the same shapes
                continue
            judged.add(shapes)
            tried = Grouping(bodies, judge(model, bodies, meetings, d_b))
            if found is None or tried.verdict.cost < found.verdict.cost:
                found = tried
        return found

    chosen = best(None, min(4, len(units)) if count is None else count)
    verdict = chosen and chosen.verdict
    good = verdict and not (verdict.always or verdict.spurious or verdict.missed > _MISSED)
    if count is None and not good:
        chosen = best(chosen, *(k for k in range(2, 7) if k <= len(units)))
    if chosen is None:
        shaped = [unit for unit in units if meetings.units[unit].parts]
        least = 1 + (1 in shaped and bool(slides))  # see `_ranked`
        text = f"--bodies: the arm has {len(shaped)} groups of links; choose a number from {least}"
        raise RobotFileError(f"{text} to {min(len(shaped), int(BOUNDS['bodies'].high))}")
    return chosen


def judge(model: RobotModel, bodies: list[FittedBody], meetings: Meetings, d_b: float) -> Verdict:
    """The quality of bodies in up to 600 colliding and 600 free random postures of the meetings."""
    possible, collides = meetings.random.possible, meetings.collides
    real = np.asarray(collides.any(axis=1))
    parts = (possible & real, possible & ~real)
    chosen = np.concatenate([np.flatnonzero(part)[:ENOUGH] for part in parts])
    q_m, hits, real = meetings.random.q_m[chosen], collides[chosen], real[chosen]
    free = np.ones_like(real) if real.all() else ~real
    names, distances = _body_distances(model, bodies, q_m)
    owner = {unit: k for k, body in enumerate(bodies) for unit in body.units}
    ends = [sorted((owner[u], owner[v])) for u, v in meetings.pairs]
    owners = [f"{bodies[i].name}-{bodies[j].name}" for i, j in ends]
    near, meet = (distances[free] < d_b).mean(axis=0), distances <= 0.0
    built = {owners[meetings.pairs.index(pair)] for pair in meetings.close}
    kept, unwatched = np.ones(len(names), dtype=bool), {}
    for k in np.argsort(-near):  # the nearest pair first: without it, others may be needed
        without = kept & (np.arange(len(names)) != k)
        blind = _share(~np.any(meet[real][:, without], axis=1))
        if near[k] > ALWAYS and (names[k] in built or blind <= _MISSED):
            kept, unwatched[names[k]] = without, BY_LINKS if names[k] in built else BY_BODIES
    truly = {*compress(owners, np.any(hits, axis=0))}
    met = [*compress(names, kept & np.any(meet, axis=0))]
    near = dict(compress(zip(names, near.tolist(), strict=True), kept))
    overlap = {name: _share(flags) for name, flags in zip(names, meet[~real].T, strict=True)}
    spurious = tuple(name for name in met if name not in truly)
    always = tuple(name for name in met if near[name] > ALWAYS)
    seen = np.any(meet[:, kept], axis=1)
    missed, false = _share(~seen[real]), _share(seen[~real])
    cost = (
        _MISSED_COST * max(0.0, missed - _MISSED)
        + 2.0 * false  # bodies overlap in free postures
        + _BODY_COST * len(bodies)
        + 0.25 * len(spurious)  # bodies overlap although their links never do
        + len(always)
        + 0.05 * len(unwatched)
    )
    return Verdict(missed, false, overlap, spurious, always, unwatched, near, cost)


def _share(flags: Array) -> float:
    """[-] share of True in flags (N,); 0 if N is 0."""
    return float(flags.sum() / max(1, len(flags)))


class Detection(NamedTuple):
    """Link collisions in postures that the fit has not used, and those that no pair detects."""

    looked_at: int  # number of random postures
    postures: int  # number of postures in which hulls of links collide
    undetected: int  # those in which meshes collide, but no pair of bodies overlaps
    watched: int  # collisions of links whose bodies are a pair, once for each pair and posture
    missed: int  # number of the `watched` collisions in which the bodies do not overlap
    deepest: float  # [m] largest distance of the bodies in a missed collision; 0 without one
    blind: tuple[str, ...]  # pairs that miss over half of their links' random and rare collisions
    unseen: dict[tuple[str, str], float]
    """[-] share of all random postures, by the two links that meet in the undetected postures. Of
    the links of two units, only the two that come nearest are included."""
    left_out: int
    """Number of postures in which no pair of bodies overlaps, but links meet that are neighbours or
    close by design. It is extrapolated if more than 300 postures qualify."""
    rule: str
    """Up to four pairs of links that meet in the `left_out` postures, the most frequent first, with
    their share of all random postures and the held joints that carry them; one pair of links for
    two units. If possible, each has a d_b with which a pair of bodies detects the contacts, and a
    joint range without contacts."""

    @property
    def share(self) -> float:
        """[-] share of the colliding postures that are `undetected`."""
        return self.undetected / max(1, self.postures)

    @property
    def worst(self) -> str:
        """The links with the largest share in `unseen`, and this share; `unseen` is not empty."""
        (a, b), share = max(self.unseen.items(), key=itemgetter(1))
        return f"{a} and {b} ({share:.2%} of the postures)"

    @property
    def fails(self) -> bool:
        """Whether a collision is undetected, or `blind` has a pair."""
        return bool(self.undetected or self.blind)


def detection_of(
    model: RobotModel, tree: Tree, geometry: Geometry, d_b: float, workers: Workers = ALONE
) -> Detection:
    """The collisions of links in random postures, and those that the bodies of a description miss.

    Contacts of `neighbours`, and of the pairs in `Meetings.close` for the buffer distance d_b [m],
    do not count; a close pair that is in `Meetings.apart` does count. `workers` share the work.
    """
    by_body = units_of_links(model, geometry)
    units = tuple(unit for each in by_body.values() for unit in each)
    met = sample_meetings(
        model,
        units,
        samples=TEST_POSTURES,
        seed=2**31,  # postures that the fit has not used
        d_b=d_b,
        enough=ENOUGH,
        counted=_counted(model, by_body),
        workers=workers,
    )
    owner = {unit.index: name for name, each in by_body.items() for unit in each}
    pairs = candidate_pairs(model)
    left_out, rule = _left_out(model, met, pairs, tree, geometry)
    random = met.random.possible & met.collides.any(axis=1)
    hits, count = met.collides[random], int(random.sum())
    rare = np.logical_and(met.rare.distances <= 0.0, met.rare.possible[:, None])
    q_m = np.vstack([met.random.q_m[random], met.rare.q_m])
    gaps = PairDistances(model, pairs).sampled(q_m)
    undetected = np.all(gaps[:count] > 0.0, axis=1)
    for k in np.flatnonzero(hits[undetected].any(axis=0)):  # few postures: meshes are compared
        rows = np.flatnonzero(undetected & hits[:, k])
        a, b = (units[u] for u in met.pairs[k])
        hits[rows, k] = meshes_meet(model, a, b, geometry, q_m[rows])[1].any(axis=1)
    undetected &= hits.any(axis=1)
    owners = [{owner[u], owner[v]} if (u, v) not in met.close else set() for u, v in met.pairs]
    own = np.array([[each == set(pair) for each in owners] for pair in pairs], dtype=bool)
    there = np.vstack([hits, rare]) @ own.reshape(len(pairs), len(owners)).T
    late = there & (gaps > 0.0)
    blind = compress(pairs, late.sum(axis=0) > 0.5 * there.sum(axis=0))
    unseen: dict[tuple[str, str], float] = {}
    for k in np.flatnonzero(hits[undetected].any(axis=0)):
        rows, (u, v) = undetected & hits[:, k], met.pairs[k]
        links, near = link_gaps(model, units[u], units[v], q_m[:count][rows])
        unseen[links[int(near.min(axis=0).argmin())]] = float(rows.sum() / len(random))
    return Detection(
        looked_at=len(random),
        postures=count,
        undetected=int(undetected.sum()),
        watched=int(there[:count].sum()),
        missed=int(late[:count].sum()),
        deepest=float(gaps[:count][late[:count]].max(initial=0.0)),
        blind=tuple(pair.name for pair in blind),
        unseen=unseen,
        left_out=left_out,
        rule=rule,
    )


def _counted(model: RobotModel, by_body: Mapping[str, Sequence[Unit]]) -> list[tuple[int, int]]:
    """Pairs of units, without nested links, whose bodies are a monitored pair."""
    nested = model.description.nested
    return [
        (u.index, v.index)
        for a, b in candidate_pairs(model)
        for u, v in product(by_body[a], by_body[b])
        if nested.isdisjoint(map(frozenset, product(u.links, v.links)))
    ]


def _left_out(
    model: RobotModel, met: Meetings, pairs: Sequence[Pair], tree: Tree, geometry: Geometry
) -> tuple[int, str]:
    """`left_out` and `rule` of `Detection`, without units that touch in most postures."""
    units, q_m = met.units, met.random.q_m
    near, distant = sorted(met.close - met.nested), set(met.pairs)
    shaped = combinations([unit for unit in units if unit.parts], 2)
    separate = [(a.index, b.index) for a, b in shaped if a.joint != b.joint]
    beside = [pair for pair in separate if pair not in distant]
    sampled = met.random.distances[:, [met.pairs.index(pair) for pair in near]]
    gaps = np.hstack([sampled, hull_distances(model, units, beside, q_m)])
    touch = (gaps <= 0.0) & ((gaps <= 0.0).mean(axis=0) < BUILT_IN)
    rows = np.flatnonzero(touch.any(axis=1))
    rows = rows[(PairDistances(model, pairs).sampled(q_m[rows]) > 0.0).all(axis=1)]
    looked = rows[:: -(-len(rows) // 300)] if len(rows) else rows
    real, both = touch[looked], [(units[u], units[v]) for u, v in (*near, *beside)]
    scale, found = len(rows) / max(1, len(looked)), []
    for k, (a, b) in enumerate(both):  # hulls of adjacent links often overlap
        if not (own := touch[looked, k]).any():
            continue
        links, meet = meshes_meet(model, a, b, geometry, q_m[looked[own]])
        real[own, k] = meet.any(axis=1)
        count, pair = max(zip(meet.sum(axis=0), links, strict=True), key=itemgetter(0))
        if count:
            found.append((count * scale / len(q_m), k, pair))
    said, held = [], held_by(tree, [tree.joints[name] for name in model.description.arm.joints])
    for share, k, pair in sorted(found, key=itemgetter(0), reverse=True)[:4]:
        (a, b), touching = both[k], gaps[:, k] <= contact_margin(gaps[:, k])
        free = _free_range(model, range(a.joint - 1, b.joint - 1), q_m[touching])
        if k < len(near) and near[k] not in met.grazing:
            free = met.detectable(near[k]) + free
        joints = " and ".join(held[link] for link in pair if link in held)
        where = f" with {joints} held" if joints else ""
        said.append(f"{pair[0]} and {pair[1]}{where} ({share:.1%}{free})")
    return round(float(real.any(axis=1).sum()) * scale), ", ".join(said)


def _free_range(model: RobotModel, joints: Sequence[int], q_m: Array) -> str:
    """Text on the interval of one of the `joints` without a posture of q_m (N, n_m) that is widest
    relative to the joint's range (or a turn); empty below `LEAST`, or if N < `_FEWEST_CONTACTS`.
    """
    found = [(LEAST, "")]
    for joint in joints if len(q_m) >= _FEWEST_CONTACTS else ():
        low, high = model.q_lower[joint], model.q_upper[joint]
        values = np.sort([low, *q_m[:, joint], high])
        k = int(np.diff(values).argmax())
        first, last = np.ceil(100 * values[k]) / 100, np.floor(100 * values[k + 1]) / 100
        name = model.description.arm.joints[joint]
        share = (last - first) / min(high - low, 2 * np.pi)
        found.append((share, f"; none with {name} from {first:g} to {last:g}"))
    return max(found)[1]


def _body_distances(
    model: RobotModel, bodies: Sequence[FittedBody], q_m: Array
) -> tuple[list[str], Array]:
    """Names of all pairs of bodies that are not neighbours, and their distances (N, pairs) [m]."""
    pairs = [(i, j) for i, j in combinations(range(len(bodies)), 2) if j - i > 1]
    frames = [model.pin.frames[model.pin.getFrameId(body.frame)] for body in bodies]
    shapes = [
        [(frame.parentJoint, fit.shape.placement(), fit.shape.coal_geometry()) for fit in body.fits]
        for frame, body in zip(frames, bodies, strict=True)
    ]
    names = [f"{bodies[i].name}-{bodies[j].name}" for i, j in pairs]
    return names, shape_distances(model, shapes, pairs, q_m)


def _ranked(
    units: Sequence[int],
    counts: Sequence[int],
    meetings: Meetings,
    mobile: Sequence[int],
    slides: frozenset[int],
    apart: Collection[tuple[int, int]] = (),
) -> list[tuple[float, list[list[int]]]]:
    """All valid divisions of the chain into groups, each with the cost of its number of bodies.

    The sort key is this cost plus that of the collisions missed by bodies that overlap exactly if
    their links do. Each group has a shape. If unit 1 has shapes, its group has none of `slides`,
    units on prismatic joints. If possible for all of `apart`, the groups of each entry are a pair.
    """
    shaped = {unit.index for unit in meetings.units if unit.parts}
    hits = meetings.collides[meetings.random.possible]
    hits = hits[hits.any(axis=1)]
    ranked = []
    for count in counts:
        for cuts in combinations(range(1, len(units)), count - 1):
            groups = [list(units[a:b]) for a, b in pairwise([0, *cuts, len(units)])]
            fixed = next((group for group in groups if 1 in group), []) if 1 in shaped else []
            if any(map(shaped.isdisjoint, groups)) or not slides.isdisjoint(fixed):
                continue
            owner = {unit: k for k, group in enumerate([mobile, *groups]) for unit in group}
            watched = [abs(owner[u] - owner[v]) > 1 for u, v in meetings.pairs]
            missed = _share(np.all(~hits[:, watched], axis=1))
            uneven = sum(len(group) ** 2 for group in groups)
            least = _BODY_COST * (count + 1)
            close = any(abs(owner[u] - owner[v]) < 2 for u, v in apart)
            ranked.append((close, least + _MISSED_COST * missed, uneven, groups, least))
    ranked.sort()
    return [(least, groups) for close, *_, groups, least in ranked if close == ranked[0][0]]
