"""Which links form a body together: the grouping that sees collisions and lets go of free poses.

The paper's l_1 … l_EE join neighbouring links of a chain. Every way to cut the chain is judged by
the share of real collisions that its pairs do not see, the share of free poses in which they see
one, and whether a pair stays inside its buffer for good.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.errors import RobotFileError
from app.onboarding.fit.bodies import ArmFitter, FittedBody
from app.onboarding.fit.collision_sampling import ALWAYS, Meetings
from app.onboarding.fit.group_distances import group_distances
from app.robot.model import RobotModel

Array = np.ndarray

_PAPER = 4  # [-] bodies of the paper's arm; others are tried only if that many do not do
_MOST = 5  # [-] bodies
_MISSED = 0.1  # [-] share of collisions that a good grouping may miss
_JUDGED = 1200  # [-] poses in which a fitted grouping is judged
_BODY_COST = 0.03  # [-] of one body more
_FALSE_COST = 2.0  # [-] of free poses in which a task is on for nothing
_SPURIOUS_COST = 0.25  # [-] of a pair that can only meet as bodies, not as links
_APART_COST = 0.1  # [-] of links of the arm that are close as they are built, and no neighbours
_ALWAYS_COST = 1.0  # [-] of a pair that is always near


class Verdict(NamedTuple):
    """How good a grouping is.

    Attributes:
        missed: [-] share of the poses with a collision of links in which no pair of bodies meets.
        false: [-] share of the poses without any in which one does.
        spurious: Pairs of bodies that meet though their links never do.
        always: Pairs that are inside their buffer nearly always.
        rates, near: [-] share of the poses in collision, and of the poses without a collision of
            links inside the buffer, by the pair's name.
        cost: The sum that the best grouping has least of.
    """

    missed: float
    false: float
    spurious: tuple[str, ...]
    always: tuple[str, ...]
    rates: dict[str, float]
    near: dict[str, float]
    cost: float


class Grouping(NamedTuple):
    """The bodies of the arm and how good they are."""

    bodies: list[FittedBody]
    verdict: Verdict


def find_grouping(
    model: RobotModel,
    base: FittedBody,
    meetings: Meetings,
    fitter: ArmFitter,
    *,
    d_b: float,
    count: int | None = None,
) -> Grouping:
    """The best grouping of the arm's units into bodies.

    Args:
        model: The robot.
        base: l_m.
        meetings: Of its links.
        fitter: Fits the bodies.
        d_b: [m] buffer distance.
        count: How many bodies; by default four as the paper has, or two to five where four do not
            do: a pair always near, one that only the bodies make, a tenth of collisions missed.

    Raises:
        RobotFileError: The arm has fewer parts than `count`, or none of a shape.
    """
    units = [u.index for u in meetings.units if u.index > 0 and (u.index > 1 or u.links)]
    search = _Search(model, base, meetings, fitter, d_b, units)
    if count is not None:
        best = search.best([count])
    else:
        best = search.best([min(_PAPER, len(units))])
        if best is None or not _good(best.verdict):
            others = [k for k in range(2, _MOST + 1) if k <= len(units)]
            best = search.best(others) or best
    if best is None:
        raise RobotFileError(f"--bodies: the arm has {len(units)} parts; choose up to that many")
    return best


class _Search:
    """Tries groupings, those that can be best first."""

    def __init__(
        self,
        model: RobotModel,
        base: FittedBody,
        meetings: Meetings,
        fitter: ArmFitter,
        d_b: float,
        units: Sequence[int],
    ) -> None:
        self._model, self._base, self._meetings = model, base, meetings
        self._fitter, self._d_b, self._units = fitter, d_b, units

    def best(self, counts: Sequence[int]) -> Grouping | None:
        """The grouping of the least cost with one of these numbers of bodies."""
        best: Grouping | None = None
        judged: set[tuple[int, ...]] = set()
        for at_least, grouping in _ranked(self._units, counts, self._meetings):
            if best is not None and at_least >= best.verdict.cost:
                break
            bodies = [self._base, *self._fitter.bodies(grouping)]
            shapes = tuple(id(body.fits[0]) for body in bodies)
            if shapes in judged:  # it differs only in links that meet nobody
                continue
            judged.add(shapes)
            tried = Grouping(bodies, judge(self._model, bodies, self._meetings, self._d_b))
            if best is None or tried.verdict.cost < best.verdict.cost:
                best = tried
        return best


def _good(verdict: Verdict) -> bool:
    return not verdict.always and not verdict.spurious and verdict.missed < _MISSED


def judge(
    model: RobotModel, bodies: Sequence[FittedBody], meetings: Meetings, d_b: float
) -> Verdict:
    """How good bodies are, in poses of the meetings."""
    chosen = np.flatnonzero(meetings.possible)[:_JUDGED]
    q_m, hits = meetings.q_m[chosen], meetings.collides[chosen]
    free = (meetings.distances[chosen] > 0).all(axis=1)
    free = free if free.any() else ~free
    pairs = [(i, j) for i, j in combinations(range(len(bodies)), 2) if j - i > 1]
    distances = body_distances(model, bodies, pairs, q_m)
    names = [f"{bodies[i].name}-{bodies[j].name}" for i, j in pairs]
    real, seen = hits.any(axis=1), (distances <= 0).any(axis=1)
    rates = dict(zip(names, (distances <= 0).mean(axis=0).tolist(), strict=True))
    near = dict(zip(names, (distances[free] < d_b).mean(axis=0).tolist(), strict=True))
    truly = {
        name: _truly(meetings, hits, bodies[i], bodies[j])
        for name, (i, j) in zip(names, pairs, strict=True)
    }
    spurious = tuple(n for n in names if rates[n] > 0 and truly[n] == 0)
    always = tuple(n for n in names if rates[n] > 0 and near[n] > ALWAYS)
    missed = float((real & ~seen).sum() / max(1, real.sum()))
    false = float((seen & ~real).sum() / max(1, (~real).sum()))
    apart = sum(_apart(bodies, pair) for pair in meetings.close)
    cost = (
        missed
        + _FALSE_COST * false
        + _BODY_COST * len(bodies)
        + _SPURIOUS_COST * len(spurious)
        + _ALWAYS_COST * len(always)
        + _APART_COST * apart
    )
    return Verdict(missed, false, spurious, always, rates, near, cost)


def body_distances(
    model: RobotModel, bodies: Sequence[FittedBody], pairs: Sequence[tuple[int, int]], q_m: Array
) -> Array:
    """(N, pairs) [m] signed distances between bodies at poses (N, n_m)."""
    geometry = pin.GeometryModel()
    ids = [_add(geometry, model, body) for body in bodies]
    return group_distances(model, geometry, ids, pairs, q_m)


def _add(geometry: pin.GeometryModel, model: RobotModel, body: FittedBody) -> list[int]:
    joint = model.pin.frames[model.pin.getFrameId(body.frame)].parentJoint
    return [
        geometry.addGeometryObject(
            pin.GeometryObject(
                f"{body.name}_{i}", joint, 0, fit.shape.placement(), fit.shape.coal_geometry()
            )
        )
        for i, fit in enumerate(body.fits)
    ]


def _apart(bodies: Sequence[FittedBody], pair: tuple[int, int]) -> bool:
    """Whether two units of the arm stand in bodies that are a pair."""
    of = {unit: k for k, body in enumerate(bodies) for unit in body.units}
    return pair[0] > 1 and abs(of[pair[0]] - of[pair[1]]) > 1


def _truly(meetings: Meetings, hits: Array, a: FittedBody, b: FittedBody) -> int:
    """In how many poses links of both bodies meet."""
    columns = [
        k
        for k, (u, v) in enumerate(meetings.pairs)
        if (u in a.units and v in b.units) or (v in a.units and u in b.units)
    ]
    return int(hits[:, columns].any(axis=1).sum())


def _ranked(
    units: Sequence[int], counts: Sequence[int], meetings: Meetings
) -> list[tuple[float, list[list[int]]]]:
    """All cuts of the chain, with the least cost that each can have, the least one first."""
    hits = meetings.collides[meetings.possible]
    real = hits.any(axis=1)
    ranked = []
    for count in counts:
        for cuts in combinations(range(1, len(units)), count - 1):
            groups = [list(units[a:b]) for a, b in pairwise([0, *cuts, len(units)])]
            of = {unit: k + 1 for k, group in enumerate(groups) for unit in group} | {0: 0}
            watched = [abs(of[u] - of[v]) > 1 for u, v in meetings.pairs]
            missed = (real & ~hits[:, watched].any(axis=1)).sum() / max(1, real.sum())
            uneven = sum(len(group) ** 2 for group in groups)
            apart = _APART_COST * len(
                [1 for u, v in meetings.close if u > 1 and abs(of[u] - of[v]) > 1]
            )
            ranked.append((float(missed) + _BODY_COST * (count + 1) + apart, uneven, groups))
    return [(cost, groups) for cost, _, groups in sorted(ranked)]
