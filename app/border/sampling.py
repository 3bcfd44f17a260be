"""Sampling of P_i for all pairs of L_m: random joint positions, then a flood of each sector.

Worker processes execute both stages.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np

from app.border.config import SamplingConfig
from app.border.dbb import POINT_UNIT, Cloud, make_cloud, quantise_distances, quantise_points
from app.border.flood import Flood, PairReader, Voxels
from app.border.mobile import MobileBody
from app.jobs.pool import Workers
from app.jobs.progress import OnProgress, part_of, progress_bar
from app.robot.description import RobotDescription
from app.robot.link_pairs import Pair, sample_joints
from app.robot.model import RobotModel
from app.strict import Array

_SEED_JOBS = 16  # a fixed number, so that the samples do not depend on the number of cores


def sample_clouds(
    model: RobotModel,
    pairs: Sequence[Pair],
    config: SamplingConfig,
    *,
    progress: bool = True,
    processes: int | None = None,
    on_progress: OnProgress = lambda _: None,
) -> dict[str, Cloud]:
    """Sample P_i of Algorithm 1 for each pair: closest points on the arm's body, one per voxel.

    Random sampling alone finds almost no points at the base's sides. Therefore a flood follows:
    from known poses, the arm moves such that its closest point enters an empty neighbouring voxel.
    A pose must satisfy the joint limits, and its distance must be in the sampled range; collisions
    of other pairs are allowed. The result does not depend on the number of processes.

    Args:
        model: The robot.
        pairs: The pairs of L_m.
        config: Parameters of the sampling.
        progress: Whether to draw a progress bar on standard error.
        processes: Number of processes; default: one for each usable core.
        on_progress: Called with the share of the work that is done, 0 to 1.

    Returns:
        P_i by the name of the pair.
    """
    make_context = partial(Context, model.description, config)
    seeds = np.random.SeedSequence(config.seed).spawn(len(pairs))
    bar = progress_bar("sampling the border", 1.0, shown=progress)
    with bar as update, Workers(make_context, processes) as workers:

        def tell(share: float) -> None:
            update(share)
            on_progress(share)

        seed_of = dict(zip(pairs, seeds, strict=True))
        return _Sampler(Context(model.description, config), workers, seed_of, tell).run()


class _Sampler:
    """The stages of the sampling, each for all pairs at once so that no core waits."""

    def __init__(
        self,
        context: Context,
        workers: Workers,
        seed_of: dict[Pair, np.random.SeedSequence],
        on_progress: OnProgress,
    ) -> None:
        self._voxels, self._config = context.voxels, context.config
        self._workers, self._seed_of, self._on_progress = workers, seed_of, on_progress
        self._flood = _SEED_JOBS / (_SEED_JOBS + context.config.sectors)
        """[-] share of the work that is done when the flood starts."""

    def run(self) -> dict[str, Cloud]:
        """Execute all stages; rounds after the first flood start at the borders of the sectors."""
        found = self._starts()
        kept = {pair: start.none() for pair, start in found.items()}
        tell = part_of(self._on_progress, self._flood, 1.0)
        for _ in range(self._config.rounds):
            jobs = [
                job for pair in kept for job in self._sector_jobs(pair, found[pair], kept[pair])
            ]
            results = self._workers.map(flood_sector, jobs, tell)
            for job, result in zip(jobs, results, strict=True):
                kept[job.pair] = kept[job.pair].plus(result)
            found, tell = kept, lambda _: None
        return {pair.name: make_cloud(pair.name, k.points, k.distances) for pair, k in kept.items()}

    def _starts(self) -> dict[Pair, Kept]:
        jobs = [(pair, child) for pair, s in self._seed_of.items() for child in s.spawn(_SEED_JOBS)]
        starts: dict[Pair, Kept] = {}
        tell = part_of(self._on_progress, 0.0, self._flood)
        results = self._workers.map(sample_shell, jobs, tell)
        for (pair, _), result in zip(jobs, results, strict=True):
            starts[pair] = starts[pair].plus(result) if pair in starts else result
        return starts

    def _sector_jobs(self, pair: Pair, given: Kept, kept: Kept) -> list[SectorJob]:
        """One job for each sector with a starting pose.

        In rounds after the first, the starting poses of a sector come from other sectors.
        """
        taken = self._voxels.keys(self._voxels.cells(kept.points))
        free = np.ones(self._voxels.count, dtype=bool)
        free[taken] = False
        sectors = self._voxels.leads_to(given.points, free)
        if len(taken):  # a sector has already used its own poses
            home = self._voxels.sectors(self._voxels.keys(self._voxels.cells(given.points)))
            sectors[sectors == home[:, None]] = -1
        owner = self._voxels.sectors(taken)
        jobs = []
        for sector, child in enumerate(self._seed_of[pair].spawn(self._config.sectors)):
            leads = (sectors == sector).any(axis=1)
            if leads.any():
                sources = given.q_m[leads]
                jobs.append(SectorJob(pair, child, sector, sources, taken[owner == sector]))
        return jobs


class Kept(NamedTuple):
    """Known poses of one pair."""

    q_m: Array
    """(N, n_m) float32 [rad or m] joint positions."""
    points: Array
    """(N, 3) int16 points of the poses, as in `Cloud`."""
    distances: Array
    """(N,) uint16 distances of the points, as in `Cloud`."""

    def none(self) -> Kept:
        """A record without poses."""
        return Kept(*(column[:0] for column in self))

    def plus(self, more: Kept) -> Kept:
        """A record with the poses of both."""
        return Kept(*map(np.concatenate, zip(self, more, strict=True)))


class Context:
    """The data that the jobs of one process share."""

    def __init__(self, description: RobotDescription, config: SamplingConfig) -> None:
        self.model = RobotModel(description)
        self.config = config
        self.body = MobileBody(self.model)
        self.voxels = Voxels(
            self.body.lower,
            self.body.upper,
            reach=config.d_high,
            sectors=config.sectors,
            size=np.array([config.voxel_plan, config.voxel_plan, config.voxel_height]),
        )


class SectorJob(NamedTuple):
    """A job: the flood of one sector."""

    pair: Pair
    seed: np.random.SeedSequence
    sector: int
    """Number of the sector."""
    sources: Array
    """(N, n_m) float32 [rad or m] starting poses."""
    taken: Array
    """(M,) indices of the sector's filled voxels."""


def sample_shell(context: Context, job: tuple[Pair, np.random.SeedSequence]) -> Kept:
    """Draw random poses for a pair, and return those whose points are in the shell around l_m."""
    (pair, seed), config = job, context.config
    count = -(-config.cloud_samples // _SEED_JOBS)
    q_m = sample_joints(context.model, count, np.random.default_rng(seed))
    seen = PairReader(context.model, pair).witnesses(q_m)
    inside = (seen.d > config.d_low) & (seen.d < config.d_high)
    return Kept(
        q_m[inside].astype(np.float32),
        quantise_points(seen.p_b[inside]),
        quantise_distances(seen.d[inside]),
    )


def flood_sector(context: Context, job: SectorJob) -> Kept:
    """Find poses for the open voxels of a sector; d_m is computed at the rounded points."""
    model, config = context.model, context.config
    open_voxels = context.voxels.sector_mask(job.sector)
    open_voxels[job.taken] = False
    flood = Flood(
        model,
        PairReader(model, job.pair),
        context.voxels,
        open_voxels,
        (config.d_low, config.d_high),
        np.random.default_rng(job.seed),
    )
    q_m = np.clip(job.sources.astype(float), model.q_lower, model.q_upper)
    found, points = flood.run(q_m, config.retries)
    distances = context.body.distance(points * POINT_UNIT)
    return Kept(found, points, quantise_distances(distances))
