"""Sampling of P_i for all pairs of L_m: random joints first, then a flood, sector by sector.

Both stages consist of jobs for worker processes.
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
    """P_i of Algorithm 1 for each pair: closest points on the arm's body, one per voxel.

    Random sampling alone leaves the base's sides almost empty. From every known pose, the flood
    steps to the voxels beside its point. Only the joint limits and the pair's own distance restrict
    the poses. The same seed gives the same points on any number of processes; default: all cores.
    `progress` draws a bar on stderr; `on_progress` takes the share that is done.

    Returns:
        By the name of the pair.
    """
    make_context = partial(Context, model.description, config)
    seeds = np.random.SeedSequence(config.seed).spawn(len(pairs))
    bar = progress_bar("sampling the border", 1.0, shown=progress)
    with bar as update, Workers(make_context, processes) as workers:

        def tell(share: float) -> None:
            update(share)
            on_progress(share)

        sampler = _Sampler(Context(model.description, config), workers, tell)
        return sampler.run(pairs, seeds)


class _Sampler:
    """The stages of the sampling, over all pairs at once so that no core waits."""

    def __init__(self, context: Context, workers: Workers, on_progress: OnProgress) -> None:
        self._voxels, self._config = context.voxels, context.config
        self._workers, self._on_progress = workers, on_progress
        self._flood = _SEED_JOBS / (_SEED_JOBS + context.config.sectors)
        """[-] share of the work after which the flood starts."""

    def run(
        self, pairs: Sequence[Pair], seeds: Sequence[np.random.SeedSequence]
    ) -> dict[str, Cloud]:
        """All stages; the short rounds after the first start at the seams of sectors."""
        found = self._starts(pairs, seeds)
        kept = {pair: start.none() for pair, start in found.items()}
        tell = part_of(self._on_progress, self._flood, 1.0)
        for _ in range(self._config.rounds):
            jobs = [
                job
                for pair, seed in zip(pairs, seeds, strict=True)
                for job in self._sector_jobs(pair, seed, found[pair], kept[pair])
            ]
            results = self._workers.map(flood_sector, jobs, tell)
            for job, result in zip(jobs, results, strict=True):
                kept[job.pair] = kept[job.pair].plus(result)
            found, tell = kept, lambda _: None
        return {pair.name: make_cloud(pair.name, k.points, k.distances) for pair, k in kept.items()}

    def _starts(
        self, pairs: Sequence[Pair], seeds: Sequence[np.random.SeedSequence]
    ) -> dict[Pair, Kept]:
        count = -(-self._config.cloud_samples // _SEED_JOBS)
        jobs = [
            SeedJob(pair, child, count)
            for pair, seed in zip(pairs, seeds, strict=True)
            for child in seed.spawn(_SEED_JOBS)
        ]
        starts: dict[Pair, Kept] = {}
        tell = part_of(self._on_progress, 0.0, self._flood)
        results = self._workers.map(sample_shell, jobs, tell)
        for job, result in zip(jobs, results, strict=True):
            so_far = starts.get(job.pair)
            starts[job.pair] = result if so_far is None else so_far.plus(result)
        return starts

    def _sector_jobs(
        self, pair: Pair, seed: np.random.SeedSequence, given: Kept, kept: Kept
    ) -> list[SectorJob]:
        """One job for each sector with a pose; later rounds use only poses of other sectors."""
        taken = self._voxels.keys(self._voxels.cells(kept.points))
        free = np.ones(self._voxels.count, dtype=bool)
        free[taken] = False
        sectors = self._voxels.leads_to(given.points, free)
        if len(taken):  # a sector has already used its own poses
            home = self._voxels.sectors(self._voxels.keys(self._voxels.cells(given.points)))
            sectors[sectors == home[:, None]] = -1
        owner = self._voxels.sectors(taken)
        jobs = []
        for sector, child in enumerate(seed.spawn(self._config.sectors)):
            leads = (sectors == sector).any(axis=1)
            if leads.any():
                sources = given.q_m[leads]
                jobs.append(SectorJob(pair, child, sector, sources, taken[owner == sector]))
        return jobs


class Kept(NamedTuple):
    """Known poses (N, n_m) of one pair, their points (N, 3) and distances (N,)."""

    q_m: Array
    points: Array
    distances: Array

    def none(self) -> Kept:
        """An empty one of the same shapes."""
        return Kept(*(column[:0] for column in self))

    def plus(self, more: Kept) -> Kept:
        """Both, one after the other."""
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


class SeedJob(NamedTuple):
    """Random sampling of the joints for poses in the shell."""

    pair: Pair
    seed: np.random.SeedSequence
    count: int


class SectorJob(NamedTuple):
    """The flood of one sector."""

    pair: Pair
    seed: np.random.SeedSequence
    """Seed of the sector."""
    sector: int
    sources: Array
    """(N, n_m) float32, starting poses."""
    taken: Array
    """(M,) indices of its filled voxels."""


def sample_shell(context: Context, job: SeedJob) -> Kept:
    """Random poses whose points are in the shell around l_m."""
    rng = np.random.default_rng(job.seed)
    q_m = sample_joints(context.model, job.count, rng)
    seen = PairReader(context.model, job.pair).witnesses(q_m)
    inside = (seen.d > context.config.d_low) & (seen.d < context.config.d_high)
    return Kept(
        q_m[inside].astype(np.float32),
        quantise_points(seen.p_b[inside]),
        quantise_distances(seen.d[inside]),
    )


def flood_sector(context: Context, job: SectorJob) -> Kept:
    """Poses that fill the voxels of a sector; d_m is measured again at the rounded points."""
    model, config = context.model, context.config
    wanted = context.voxels.sector_mask(job.sector)
    wanted[job.taken] = False
    flood = Flood(
        model,
        PairReader(model, job.pair),
        context.voxels,
        (config.d_low, config.d_high),
        np.random.default_rng(job.seed),
    )
    q_m = np.clip(job.sources.astype(float), model.q_lower, model.q_upper)
    found, points = flood.run(wanted, q_m, config.retries)
    distances = context.body.distance(points * POINT_UNIT)
    return Kept(found, points, quantise_distances(distances))
