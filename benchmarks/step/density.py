"""Synthetic borders of many points, which show the cost of a search among the points."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from app.border.cache import BorderData
from app.border.dbb import DISTANCE_UNIT, make_cloud, quantise_points
from app.border.nearest import OffsetContours
from app.border.offset import RAYS, offset_contours
from app.config import Config
from app.control.controller import ControlLoop
from app.robot.model import RobotModel
from benchmarks.step.paths import Path
from benchmarks.step.timing import time_steps

Array = np.ndarray

KINDS = ("surface", "points")
_ROUNDS = 3


def by_points(
    model: RobotModel, data: BorderData, paths: Sequence[Path], counts: Sequence[int], seed: int
) -> dict[str, dict[str, float]]:
    """[µs] median duration of the steps of `Times.both`, by kind of border and number of points.

    The points are on the exact offset of the mobile base. The borders are measured in turn, several
    times, and the smallest median of each counts, because the machine's speed varies.
    """
    offset = offset_contours(model, Config().border.d_b)
    loops = {}
    for count in counts:
        dense = _dense(data, offset, count, seed)
        for kind in KINDS:
            config = Config().replace("border.kind", kind)
            loops[kind, count] = ControlLoop(model, dense, config)
    medians: dict[tuple[str, int], list[float]] = {key: [] for key in loops}
    for _ in range(_ROUNDS):
        for key, loop in loops.items():
            times = time_steps(loop, paths)
            medians[key].append(float(np.median(times.step[times.both])))
    return {kind: {str(count): min(medians[kind, count]) for count in counts} for kind in KINDS}


def _dense(data: BorderData, offset: OffsetContours, count: int, seed: int) -> BorderData:
    """The same pairs with clouds of `count` points each, all at the distance d_b."""
    points = quantise_points(points_on(offset, count, np.random.default_rng(seed)))
    distance = np.full(count, round(Config().border.d_b / DISTANCE_UNIT), np.uint16)
    clouds = {pair.name: make_cloud(pair.name, points, distance) for pair in data.pairs.mobile}
    return replace(data, clouds=clouds)


def points_on(offset: OffsetContours, count: int, rng: np.random.Generator) -> Array:
    """(count, 3) [m] random points of the contours, and between them."""
    rows = slice(offset.firsts[1])  # those of the first shape
    heights, corners = offset.heights[rows], offset.vertices[rows]
    vertices = np.stack([corners.real, corners.imag], axis=-1)
    level = rng.uniform(0.0, len(heights) - 1.0, count)
    k = level.astype(int)
    up = (level - k)[:, None]
    ray = rng.integers(0, RAYS, count)
    along = rng.random((count, 1))
    below = vertices[k, ray] + along * (vertices[k, ray + 1] - vertices[k, ray])
    above = vertices[k + 1, ray] + along * (vertices[k + 1, ray + 1] - vertices[k + 1, ray])
    z = heights[k] + up[:, 0] * (heights[k + 1] - heights[k])
    return np.column_stack([below + up * (above - below), z])
