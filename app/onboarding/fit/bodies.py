"""Convex bodies for groups of links: around what can meet others, and as little else as can be."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.errors import RobotFileError
from app.onboarding.fit.collision_sampling import Meetings
from app.onboarding.fit.convex import Fit, fit_best, hull_corners, hull_volume
from app.onboarding.fit.rigid_groups import Unit
from app.onboarding.fit.swept_hull import swept
from app.robot.model import RobotModel

Array = np.ndarray

ARM_WEIGHTS = {"capsule": 1.0, "box": 1.4, "hull": 1.6}
"""[-] by which volumes are compared on the arm: around a capsule the closest points never jump."""
BASE_WEIGHTS = {"box": 1.0, "hull": 1.3}
"""[-] the same on the base."""
_ONE_BOX = 1.6  # [-] a base whose box has more than this of its hulls' volume gets several
_WORTH = 0.75  # [-] share of the one box's volume that several bodies may have at most
_MERGE = 1.15  # [-] two shapes become one if that adds less than this to their volume


class FittedBody(NamedTuple):
    """A body of the description.

    Attributes:
        name: As in `lm`.
        frame: Link in whose frame the shapes are.
        links: The links it stands for.
        units: Their units' indices.
        fits: Its shapes, with what they over-cover.
        points: (N, 3) [m] what they had to hold, in the frame.
    """

    name: str
    frame: str
    links: tuple[str, ...]
    units: tuple[int, ...]
    fits: tuple[Fit, ...]
    points: Array


def fit_base(base: Unit) -> FittedBody:
    """l_m around the whole base: one shape, or several where one would be mostly empty.

    Raises:
        RobotFileError: The base has no shapes.
    """
    if not base.parts:
        raise RobotFileError(f"--base: no link of {base.frame!r} has a shape")
    corners = [part.corners for part in base.parts]
    everything = np.vstack(corners)
    one = fit_best(everything, BASE_WEIGHTS)
    fits = (one,)
    if one.volume > _ONE_BOX * sum(hull_volume(c) for c in corners):
        several = _merged(corners)
        if sum(fit.volume for fit in several) < _WORTH * one.volume:
            fits = tuple(several)
    return FittedBody("lm", base.frame, base.links, (0,), fits, everything)


def _merged(corners: Sequence[Array]) -> list[Fit]:
    """One shape a link, then neighbours together as long as that costs little volume."""
    groups = [(c, fit_best(c, BASE_WEIGHTS)) for c in corners]
    while len(groups) > 1:
        best: tuple[float, int, int, Array, Fit] | None = None
        for i in range(len(groups)):
            for j in range(i + 1, len(groups)):
                points = hull_corners(np.vstack([groups[i][0], groups[j][0]]))
                fit = fit_best(points, {"box": 1.0})
                cost = fit.volume / (groups[i][1].volume + groups[j][1].volume)
                if best is None or cost < best[0]:
                    best = (cost, i, j, points, fit)
        assert best is not None
        cost, i, j, points, fit = best
        if cost > _MERGE and len(groups) <= 4:
            break
        groups = [g for k, g in enumerate(groups) if k not in (i, j)]
        groups.append((points, fit_best(points, BASE_WEIGHTS) if cost <= _MERGE else fit))
    return [fit for _, fit in groups]


class ArmFitter:
    """Fits the bodies of an arm for one grouping of its units after the other."""

    def __init__(self, model: RobotModel, meetings: Meetings) -> None:
        self._model, self._meetings = model, meetings
        self._known: dict[bytes, tuple[Fit, int, Array]] = {}

    def bodies(self, grouping: Sequence[Sequence[int]]) -> list[FittedBody]:
        """The bodies l_1 … l_EE for groups of units, from the base outwards."""
        names = [*(f"l{k}" for k in range(1, len(grouping))), "lEE"]
        result = []
        for k, group in enumerate(grouping):
            others = [u for j, far in enumerate(grouping) if abs(j - k) > 1 for u in far]
            if k > 0:
                others.append(0)
            result.append(self._body(names[k], tuple(group), tuple(sorted(others))))
        return result

    def _body(self, name: str, group: tuple[int, ...], others: tuple[int, ...]) -> FittedBody:
        units = self._meetings.units
        needed: dict[int, Array] = {}
        for index in group:
            points = self._meetings.needed(index, others)
            joint = units[index].joint
            needed[joint] = np.vstack([needed.get(joint, np.zeros((0, 3))), points])
        if not any(map(len, needed.values())):  # it meets nobody: what it looks like will do
            needed = {units[i].joint: units[i].surface for i in group}
        # Links at either end that meet nobody do not change the body.
        used = [joint for joint, points in needed.items() if len(points)]
        if not used:
            links = ", ".join(link for i in group for link in units[i].links)
            raise RobotFileError(f"the links {links} have no shapes to fit a body to")
        needed = {j: p for j, p in needed.items() if min(used) <= j <= max(used)}
        key = b"".join(bytes([j]) + p.tobytes() for j, p in sorted(needed.items()))
        if key not in self._known:
            self._known[key] = self._smallest(needed)
        fit, joint, points = self._known[key]
        frame = next(u.frame for u in units if u.joint == joint)
        links = tuple(link for i in group for link in units[i].links)
        return FittedBody(name, frame, links, group, (fit,), points)

    def _smallest(self, needed: dict[int, Array]) -> tuple[Fit, int, Array]:
        """The smallest fit in the frame of any of the joints, with that joint and the points."""
        tried = []
        for joint in needed:
            points = swept(self._model, needed, joint)
            tried.append((hull_volume(points), joint, points))
        tried.sort(key=lambda each: each[0])
        fits = [(fit_best(points, ARM_WEIGHTS), joint, points) for _, joint, points in tried[:2]]
        return min(fits, key=lambda each: each[0].volume)
