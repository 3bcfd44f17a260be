"""§2.3.2: the reachability map of a body, from a file if there is one, else counted and kept."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Literal

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

from app.border.checked_file import DamagedFileError
from app.border.reach import archive as reach_archive
from app.border.reach.chain import reach_bodies
from app.border.reach.config import ReachConfig
from app.border.reach.count import CountContext, CountJob, count_solutions
from app.border.reach.key import reach_key
from app.border.reach.radial import radial_profile
from app.errors import DescriptionError, UnknownNameError
from app.jobs.pool import Workers
from app.robot import assets
from app.robot.model import RobotModel

Array = np.ndarray

PEAK = 100.0
"""[-] largest mean reachability over a shell around the mount: the paper's C."""

_JOB_POINTS = 64  # a fixed number, so that the counts do not depend on the number of cores
_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class ReachMap:
    """Reachability of one body on a lattice around the arm's mount.

    Attributes:
        body: Name of the body.
        points: (N, 3) [m] positions in the base's frame: of the end-effector for the body that
            carries it, else of the middle of the body's first shape.
        found: (N,) inverse kinematics solutions counted at each position, over all its poses.
        samples: Poses at each position.
        reach: (N,) [-] density of solutions, scaled so that its mean over the best shell is 100.
        p_base: (3,) [m] the arm's mount in the base's frame.
        spacing_m: [m] of the lattice.
        seed: Of the poses.
        method: analytic, or restarts.
        free_joints: Joints held at random while the others are solved for.
        origin: Where it came from: the cache, a file shipped with the project, or counted now.
    """

    body: str
    points: Array
    found: Array
    samples: int
    reach: Array
    p_base: Array
    spacing_m: float
    seed: int
    method: str
    free_joints: tuple[str, ...]
    origin: Literal["cache", "shipped", "counted"]

    @property
    def rho(self) -> Array:
        """(N,) [m] ρ of (9): distance of each position from the mount."""
        return np.linalg.norm(self.points - self.p_base, axis=1)

    @property
    def poses(self) -> int:
        """How many poses were solved."""
        return self.samples * len(self.found)


def load_reach_map(
    model: RobotModel,
    body: str,
    *,
    config: ReachConfig | None = None,
    recompute: bool = False,
    progress: bool = True,
    processes: int | None = None,
) -> ReachMap:
    """The density of inverse kinematics solutions of a body's pose over the arm's whole workspace.

    Positions stand on a lattice in a ball around the mount that the arm cannot leave, each with the
    same number of uniformly random orientations; an arm with more joints than the pose has numbers
    has the rest of them held at random for each pose. Solutions within the joint limits and without
    self-collision count. The same seed gives the same map on any number of processes.

    Args:
        model: The robot.
        body: Name of a body of the arm that at least three joints move.
        config: How to sample; the default is what the shipped files were made with.
        recompute: Whether to count anew even if there is a file.
        progress: Whether to draw a bar on stderr while counting.
        processes: How many to count with; all cores if not given.

    Raises:
        UnknownNameError: No such body can be asked for.
        DescriptionError: No pose has any solution.
        AssetError: The URDF or a mesh is not there.
    """
    if body not in (choices := reach_bodies(model)):
        raise UnknownNameError("body of a reachability map", body, choices)
    config = config or ReachConfig()
    key = reach_key(model.description, body, config)
    name = f"{model.description.name}-reach-{body}-{key}.npz"
    kept = assets.cache_folder() / name
    if not recompute:
        if content := _read(kept, key):
            return _as_map(content, "cache")
        if content := _read(assets.SHIPPED_CACHE / name, key):
            return _as_map(content, "shipped")
    content = _count(model, body, config, key, progress, processes)
    result = _as_map(content, "counted")
    _write(kept, content)
    return result


def lattice(radius: float, spacing: float) -> Array:
    """(N, 3) int16 steps of a cubic lattice about its origin, within a ball."""
    reach = int(np.ceil(radius / spacing))
    along = np.arange(-reach, reach + 1)
    steps = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    return steps[(steps**2).sum(axis=1) <= (radius / spacing) ** 2].astype(np.int16)


def _count(
    model: RobotModel,
    body: str,
    config: ReachConfig,
    key: str,
    progress: bool,
    processes: int | None,
) -> reach_archive.Counts:
    make_context = partial(CountContext, model.description, body, config)
    context, p_base = make_context(), model.p_base()
    steps = lattice(context.chain.longest(p_base), context.spacing)
    parts = np.array_split(steps, -(-len(steps) // _JOB_POINTS))
    seeds = np.random.SeedSequence(config.seed).spawn(len(parts))
    jobs = [
        CountJob(p_base + context.spacing * part, seed)
        for part, seed in zip(parts, seeds, strict=True)
    ]
    found = []
    with _bar(progress) as bar, Workers(make_context, processes) as workers:
        task = bar.add_task(f"counting the solutions of {body}", total=len(jobs))
        for counts in workers.map(count_solutions, jobs):
            found.append(counts)
            bar.advance(task)
    names = model.description.arm.joints
    header = reach_archive.Header(
        key=key,
        body=body,
        p_base=(p_base[0], p_base[1], p_base[2]),
        seed=config.seed,
        spacing_m=context.spacing,
        samples=context.orientations,
        method=context.solver.method,
        free_joints=tuple(names[context.chain.joints[i]] for i in context.solver.free),
    )
    return reach_archive.Counts(header, steps, np.concatenate(found))


def _as_map(
    content: reach_archive.Counts, origin: Literal["cache", "shipped", "counted"]
) -> ReachMap:
    header, steps, found = content
    p_base = np.array(header.p_base)
    offsets = header.spacing_m * steps
    profile = radial_profile(np.linalg.norm(offsets, axis=1), found.astype(float))
    best = profile.mean[profile.peak()]
    if not best > 0:
        raise DescriptionError(f"{header.body}: no sampled pose has an inverse kinematics solution")
    return ReachMap(
        body=header.body,
        points=p_base + offsets,
        found=found,
        samples=header.samples,
        reach=PEAK * found / best,
        p_base=p_base,
        spacing_m=header.spacing_m,
        seed=header.seed,
        method=header.method,
        free_joints=header.free_joints,
        origin=origin,
    )


def _read(path: Path, key: str) -> reach_archive.Counts | None:
    try:
        return reach_archive.read(path, key)
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        _log.warning("%s is not used: %s", path, error)
        return None


def _write(path: Path, content: reach_archive.Counts) -> None:
    try:
        reach_archive.write(path, content)
    except OSError as error:
        _log.warning("%s cannot be kept (%s); it will be counted again", path, error.strerror)


def _bar(shown: bool) -> Progress:
    console = Console(stderr=True)
    # Without a terminal a bar that vanishes would leave an empty line behind.
    hidden = not (shown and console.is_terminal)
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeRemainingColumn(),
        console=console,
        disable=hidden,
        transient=True,
    )
