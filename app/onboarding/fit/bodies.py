"""The bodies of a description: convex shapes around units (links that move as one rigid body)."""

from collections.abc import Collection, Mapping, Sequence
from itertools import combinations, product
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from scipy.cluster.hierarchy import fclusterdata
from scipy.spatial import cKDTree

from app.errors import RobotFileError
from app.onboarding.fit.convex import Fit, PointHull, fit_best, hull, lean_corners
from app.onboarding.fit.meetings import ENOUGH, Meetings
from app.onboarding.fit.units import Unit, hulls, moved, shape_distances
from app.robot.model import RobotModel, kept_per_model
from app.robot.shapes import Hull
from app.strict import Array

ARM_WEIGHTS = {"capsule": 1.0, "box": 1.4, "hull": 1.6}
"""[-] weights of volumes for the arm; the closest points on a capsule do not jump."""
_SAVES = 0.03  # [-] contacts per free posture that one more box of l_m has to save
_LEFT = 0.85  # [-] largest share of the volume of an arm's body that one more shape leaves
_APART = 0.1  # [m] smallest distance between the parts of a link that can have separate shapes
_SPOT = 1e-6  # [m³] smallest swept volume of points around which a body is fitted


class FittedBody(NamedTuple):
    """A body of the description."""

    name: str
    frame: str  # link whose frame the shapes use
    links: tuple[str, ...]
    units: tuple[int, ...]  # indices of the units that the body encloses
    fits: tuple[Fit, ...]  # its shapes, in `frame`
    nested: Mapping[str, tuple[str, ...]] = MappingProxyType({})
    """By link of this body: links nested with it, in the bodies before the previous body."""


def fit_base(model: RobotModel, meetings: Meetings, mobile: tuple[int, ...] = (0,)) -> FittedBody:
    """The body l_m around the units with the indices `mobile`: the base, and possibly a mast.

    It has one to four boxes, or one to four polytopes, with the smallest cost: 0.03 for each box,
    0.06 for each polytope, and the mean number of the arm's units that touch l_m. Units close to it
    by design do not count. The mean is over up to 600 free random postures or, without any, others.
    """
    units = meetings.units
    corners = [part.corners for k in mobile for part in units[k].parts]
    tried = [
        [fit_best(around, {kind: 1.0}) for around in groups]
        for groups in _divided(model, corners)
        for kind in ("box", "hull")
    ]
    free = (meetings.random.distances > 0.0).all(axis=1)
    q_m = meetings.random.q_m[free if free.any() else ~free][:ENOUGH]
    ends = {v for u, v in meetings.pairs if u in mobile and (u, v) not in meetings.close}
    arm = [hulls(model, unit) for unit in units if unit.index in ends]
    bases = [[(1, k.shape.placement(), k.shape.coal_geometry()) for k in fits] for fits in tried]
    pairs = [*product(range(len(bases)), range(len(bases), len(bases) + len(arm)))]
    touch = shape_distances(model, [*bases, *arm], pairs, q_m) <= 0.0
    touched = touch.reshape(len(q_m), len(bases), len(arm)).sum(axis=2).mean(axis=0)
    shapes = [sum(1 + isinstance(fit.shape, Hull) for fit in fits) for fits in tried]
    fits = tried[int(np.argmin(touched + _SAVES * np.array(shapes)))]
    links = tuple(link for k in mobile for link in units[k].links)
    return FittedBody("lm", units[0].frame, links, mobile, tuple(fits))


def _divided(model: RobotModel, corners: Sequence[Array]) -> list[list[PointHull]]:
    """Divisions of parts into one to four groups, as lists of the groups' hulls. Each merges the
    two groups of the next finer division whose common hull adds the least volume.
    """
    groups = {k: _hull(model, points) for k, points in enumerate(corners)}
    known: dict[tuple[int, int], tuple[float, PointHull]] = {}  # growth and merged hull
    divisions: list[list[PointHull]] = []
    for new in range(len(groups), 2 * len(groups)):
        if len(groups) <= 4:
            divisions.insert(0, [*groups.values()])
        if len(groups) == 1:
            break
        for pair in combinations(groups, 2):
            if pair not in known:
                a, b = (groups[k] for k in pair)
                merged = _hull(model, a.corners, b.corners)
                known[pair] = merged.volume - a.volume - b.volume, merged
        i, j = min(combinations(groups, 2), key=lambda pair: known[pair][0])
        groups[new] = known[i, j][1]
        del groups[i], groups[j]
    return divisions


@kept_per_model(4096)  # the 13 joints of an RBY1 need 2,449 hulls
def _hull(_: RobotModel, *points: Array) -> PointHull:
    """The convex hull of points (N, 3) [m], cached: many groupings of links need the same one."""
    return hull(np.vstack(points))


class ArmFitter:
    """Fits an arm's bodies for several groupings of its units; the units `mobile` are on l_m."""

    def __init__(
        self, model: RobotModel, meetings: Meetings, mobile: tuple[int, ...] = (0,)
    ) -> None:
        self._model, self._meetings, self._mobile = model, meetings, mobile
        self._known: dict[bytes, tuple[tuple[Fit, ...], int] | None] = {}

    def bodies(self, grouping: Sequence[Sequence[int]]) -> list[FittedBody]:
        """The bodies l_1 … l_EE for groups of units, from the base outwards.

        A body encloses the points of its links that units of bodies other than its neighbours can
        reach. If there are none, or they sweep less than 1 cm³ as its joints move, it encloses all.

        Raises:
            RobotFileError: The links of a group have no shapes, or sweep less than 1 cm³.
        """
        groups, result = [self._mobile, *grouping], []
        for k, group in enumerate(grouping, 1):
            others = [u for j, far in enumerate(groups) if abs(j - k) > 1 for u in far]
            units = [self._meetings.units[u] for u in group]
            needed = [self._meetings.needed(u, others) for u in group]
            whole = [np.ones(len(unit.surface), dtype=bool) for unit in units]
            links = tuple(link for unit in units for link in unit.links)
            if (fitted := self._smallest(units, needed) or self._smallest(units, whole)) is None:
                why = f"the links {', '.join(links)} have no shapes for a body"
                raise RobotFileError(f"{why}; change --bodies")
            fits, joint = fitted
            frame = next(unit.frame for unit in units if unit.joint == joint)
            name = f"l{k}" if k < len(grouping) else "lEE"
            result.append(FittedBody(name, frame, links, tuple(group), fits))
        return result

    def _smallest(
        self, units: Sequence[Unit], masks: Sequence[Array]
    ) -> tuple[tuple[Fit, ...], int] | None:
        """A small fit of one or more shapes in a joint's frame, and the joint's number; None if
        `masks` select no points of the units, or points that sweep less than `_SPOT`.
        """
        pieces = [
            (unit.joint, part)
            for unit, mask in zip(units, masks, strict=True)
            for k in np.unique(unit.owners[mask])
            for part in _distant_parts(unit, mask, k)
        ]
        if not pieces:
            return None
        used = [joint for joint, _ in pieces]
        joints = [unit.joint for unit in units if min(used) <= unit.joint <= max(used)]
        key = b"".join(bytes([joint]) + points.tobytes() for joint, points in pieces)
        if key not in self._known:
            self._known[key] = self._fitted(joints, pieces)
        return self._known[key]

    def _fitted(
        self, joints: Sequence[int], pieces: Sequence[tuple[int, Array]]
    ) -> tuple[tuple[Fit, ...], int] | None:
        none = dict.fromkeys(joints, np.zeros((0, 3)))
        needed = {k: np.vstack([none[k], *(p for j, p in pieces if j == k)]) for k in none}
        tried = sorted(swept(self._model, needed).items(), key=lambda each: each[1].volume)
        if tried[0][1].volume < _SPOT:
            return None
        fits = [(fit_best(around, ARM_WEIGHTS), joint) for joint, around in tried[:2]]
        one, frame = min(fits, key=lambda each: each[0].volume)
        seen = [swept(self._model, {**none, j: p}, [frame])[frame].corners for j, p in pieces]
        ways = _divided(self._model, seen)
        several = min(ways, key=lambda way: sum(h.volume for h in way) / _LEFT ** (len(way) - 1))
        if len(several) == 1:
            return (one,), frame
        return tuple(fit_best(around, ARM_WEIGHTS) for around in several), frame


def _distant_parts(unit: Unit, mask: Array, owner: int) -> list[Array]:
    """The points of link number `owner` in `mask`, in groups (N, 3) [m]. The distance of two groups
    exceeds `_APART`, and twice the largest distance of a surface point from its nearest neighbour.
    """
    surface, points = (unit.surface[chosen & (unit.owners == owner)] for chosen in (True, mask))
    if len(points) < 2:
        return [points]
    spacing = float(cKDTree(surface).query(surface, k=2)[0].max())
    groups = fclusterdata(points, max(_APART, 2 * spacing), criterion="distance")
    return [points[groups == k] for k in np.unique(groups)]


_STEP = np.radians(10.0)  # [rad] step of the sampled angles
_SAGITTA = 1.0 / np.cos(_STEP / 2)  # [-] ratio of a polygon's circumscribed to its inscribed radius


def swept(
    model: RobotModel, points: Mapping[int, Array], frames: Collection[int] | None = None
) -> dict[int, PointHull]:
    """For each joint: a hull, in the joint's frame, around all points at all joint positions.

    `points` has points (N, 3) [m] in the joint's frame by the joints' numbers, which are
    consecutive. `frames` has the numbers of the joints that get a hull (default: all).
    """
    first, last, frames = min(points), max(points), frames or points.keys()
    outer, inner = {last: np.zeros((0, 3))}, {first: np.zeros((0, 3))}
    for joint in range(last, min(frames), -1):
        outer[joint - 1] = _through(model, np.vstack([points[joint], outer[joint]]), joint, True)
    for joint in range(first, max(frames)):
        before = np.vstack([points[joint], inner[joint]])
        inner[joint + 1] = _through(model, before, joint + 1, False)
    return {k: _hull(model, points[k], outer[k], inner[k]) for k in frames}


@kept_per_model(256)
def _through(model: RobotModel, points: Array, joint: int, outwards: bool) -> Array:
    """Corners (M, 3) [m] around the volume that points sweep while a joint moves through its range.

    With `outwards`, the points are in the frame of the joint, and the result is in the frame of the
    joint before it; otherwise the reverse.
    """
    placement = model.pin.jointPlacements[joint]
    corners = hull(points if outwards else moved(points, placement.inverse())).corners
    kind = model.pin.joints[joint]
    of_joint = kind.createData()
    kind.calc(of_joint, pin.neutral(model.pin))
    S = np.asarray(of_joint.S).ravel()
    turns = bool(np.abs(S[3:]).max() > 0.5)
    if turns:  # the polygon of the sampled positions of a point then encloses its circular path
        along = np.outer(corners @ S[3:], S[3:])
        corners = along + (corners - along) * _SAGITTA
    clouds = []
    low, high = model.q_lower[joint - 2], model.q_upper[joint - 2]
    count = max(2, int(np.ceil((high - low) / _STEP)) + 1) if turns else 2
    positions = np.linspace(low, high, count)
    if turns and high - low >= 2 * np.pi:
        positions = np.arange(0.0, 2 * np.pi, _STEP)
    for position in positions:
        motion = pin.SE3(pin.exp3(S[3:] * position), S[:3] * position)
        clouds.append(moved(corners, placement * motion if outwards else motion.inverse()))
    return lean_corners(np.vstack(clouds))
