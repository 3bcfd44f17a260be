"""Random starts of the end-effector around and above the base, and the postures for these starts.

The search for a posture takes a second. The results are stored in the user's cache folder, and are
valid until the start solver or the robot changes.
"""

from __future__ import annotations

import hashlib
import inspect
import json
import math
import os
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import platformdirs

from app.errors import UnreachableError
from app.robot.assets import resolved_urdf
from app.simulation.scenarios import start as start_module
from app.simulation.scenarios.start import StartSolver
from benchmarks.law.robot import load

Array = np.ndarray
Point = tuple[float, float, float]

_GAP = 0.22, 0.45  # [m] horizontal distance of an end-effector beside the base from its outline
_HEIGHT = 0.15, 0.60  # [m] height of an end-effector beside the base above the floor
_RISE = 0.22, 0.45  # [m] height of an end-effector over the base above the base's top


class Place(NamedTuple):
    """A possible start of the end-effector.

    Attributes:
        p: (3,) [m] position in the base's frame.
        inwards: (3,) unit vector towards the base.
        gap: [m] distance from the base's box.
    """

    p: Point
    inwards: Point
    gap: float


def place_beside(robot: str, rng: np.random.Generator) -> Place:
    """A random start around the base's outline; all directions are equally probable."""
    found = load(robot)
    middle, half = (found.lower + found.upper) / 2, (found.upper - found.lower) / 2
    angle = rng.uniform(-math.pi, math.pi)
    gap, z = rng.uniform(*_GAP), rng.uniform(*_HEIGHT)
    out = np.array([math.cos(angle), math.sin(angle)])
    edge = float(np.min(half[:2] / np.maximum(np.abs(out), 1e-9))) * out
    nearest = np.clip(edge + gap * out, -half[:2], half[:2])
    away = edge + gap * out - nearest
    away /= np.linalg.norm(away)
    x, y = middle[:2] + nearest + gap * away
    return Place(
        (float(x), float(y), float(z)), (-float(away[0]), -float(away[1]), 0.0), float(gap)
    )


def place_above(robot: str, rng: np.random.Generator) -> Place:
    """A random start above the base."""
    found = load(robot)
    x, y = rng.uniform(found.lower[:2], found.upper[:2])
    gap = float(rng.uniform(*_RISE))
    return Place((float(x), float(y), float(found.upper[2]) + gap), (0.0, 0.0, -1.0), gap)


def posture(
    robot: str,
    p: Point,
    *,
    seed: int = 0,
    turn: float = 0.0,
    tries: int = 4,
    along: Sequence[Point] = (),
) -> Array | None:
    """(n_m,) a posture outside all buffers with the end-effector at p; None if none is found.

    Args:
        robot: Name of the robot.
        p: (3,) [m] position of the end-effector in the base's frame.
        seed: Seed of the search.
        turn: [rad] horizontal angle of the end-effector from the direction away from the mount,
            positive to the left.
        tries: Number of tries for each pitch of the end-effector.
        along: Later positions (3,) [m] of the end-effector, which the arm must reach too.
    """
    way = [np.array(each) for each in along]

    def search() -> list[float] | None:
        try:
            return _solver(robot).solve(p, seed=seed, turn=turn, tries=tries, along=way).tolist()
        except UnreachableError:
            return None

    found = kept(robot, ["posture", p, seed, turn, tries, along], search)
    return None if found is None else np.array(found)


def kept(robot: str, asked: list[Any], search: Callable[[], Any]) -> Any:
    """The result of a search, from the cache if a former call has stored it.

    Args:
        robot: Name of the robot.
        asked: All other inputs of the search, as JSON values; they determine the cache's file.
        search: Executes the search, and returns the result as a JSON value.
    """
    key = hashlib.sha256(json.dumps([_digest(robot), *asked]).encode()).hexdigest()[:24]
    path = _folder() / f"{key}.json"
    if path.is_file():
        return json.loads(path.read_text(encoding="utf-8"))
    fresh = path.with_suffix(f".{os.getpid()}")
    fresh.write_text(json.dumps(search()), encoding="utf-8")
    fresh.replace(path)
    return json.loads(path.read_text(encoding="utf-8"))


@cache
def _solver(robot: str) -> StartSolver:
    model, data, *_ = load(robot)
    return StartSolver(model, data.pairs, model.description.config.border.d_b)


@cache
def _digest(robot: str) -> str:
    model, data, *_ = load(robot)
    pairs = repr([(pair.name, pair.a, pair.b) for pair in data.pairs.all])
    sources = inspect.getsource(start_module)
    content = (
        sources + resolved_urdf(model.description) + pairs + model.description.model_dump_json()
    )
    return hashlib.sha256(content.encode()).hexdigest()


@cache
def _folder() -> Path:
    folder = platformdirs.user_cache_path("dbb", appauthor=False) / "law-starts"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
