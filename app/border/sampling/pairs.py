"""Sampling of P_i for all pairs of L_m: random joints first, then a flood, sector by sector."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from app.border.cloud import Cloud, make_cloud
from app.border.sampling.config import SamplingConfig
from app.border.sampling.jobs import Context, Kept, SectorJob, SeedJob, flood_sector, sample_shell
from app.jobs.pool import Workers
from app.robot.link_pairs import Pair
from app.robot.model import RobotModel

_SEED_JOBS = 16  # a fixed number, so that the samples do not depend on the number of cores


def sample_clouds(
    model: RobotModel,
    pairs: Sequence[Pair],
    config: SamplingConfig,
    *,
    progress: bool = True,
    processes: int | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> dict[str, Cloud]:
    """P_i of Algorithm 1 for each pair: closest points on the arm's body, one a voxel.

    Random sampling alone leaves the base's sides almost empty. From every pose found, the flood
    steps to the voxels beside its point. Only the joint limits and the pair's own distance restrict
    the poses. The same seed gives the same points on any number of processes.

    Args:
        model: The robot.
        pairs: L_m.
        config: How to sample.
        progress: Whether to draw a bar on stderr.
        processes: How many; all cores if not given.
        on_progress: Called with the share that is done, 0 to 1.

    Returns:
        By the name of the pair.
    """
    make_context = partial(Context, model.description, config)
    seeds = np.random.SeedSequence(config.seed).spawn(len(pairs))
    with _bar(progress) as bar, Workers(make_context, processes) as workers:
        total = len(pairs) * (_SEED_JOBS + config.sectors)  # later rounds are short and not counted
        task = bar.add_task("sampling the border", total=total)
        done = 0

        def advance() -> None:
            nonlocal done
            done += 1
            bar.advance(task)
            if on_progress is not None:
                on_progress(min(done / max(total, 1), 1.0))

        sampler = _Sampler(Context(model.description, config), workers, advance)
        return sampler.run(pairs, seeds)


class _Sampler:
    """The stages of the sampling, over all pairs at once so that no core waits."""

    def __init__(self, context: Context, workers: Workers, advance: Callable[[], None]) -> None:
        self._voxels, self._config = context.voxels, context.config
        self._workers, self._advance = workers, advance

    def run(
        self, pairs: Sequence[Pair], seeds: Sequence[np.random.SeedSequence]
    ) -> dict[str, Cloud]:
        """All stages; rounds after the first start at the seams between sectors."""
        found = self._starts(pairs, seeds)
        kept = {pair: start.none() for pair, start in found.items()}
        for _ in range(self._config.rounds):
            jobs = [
                job
                for pair, seed in zip(pairs, seeds, strict=True)
                for job in self._sector_jobs(pair, seed, found[pair], kept[pair])
            ]
            for job, result in zip(jobs, self._workers.map(flood_sector, jobs), strict=True):
                kept[job.pair] = kept[job.pair].plus(result)
                self._advance()
            found = kept
        return {pair.name: make_cloud(pair.name, k.points, k.distances) for pair, k in kept.items()}

    def _starts(
        self, pairs: Sequence[Pair], seeds: Sequence[np.random.SeedSequence]
    ) -> dict[Pair, Kept]:
        """The poses of random sampling that lie in the shell."""
        count = -(-self._config.cloud_samples // _SEED_JOBS)
        jobs = [
            SeedJob(pair, child, count)
            for pair, seed in zip(pairs, seeds, strict=True)
            for child in seed.spawn(_SEED_JOBS)
        ]
        starts: dict[Pair, Kept] = {}
        for job, result in zip(jobs, self._workers.map(sample_shell, jobs), strict=True):
            so_far = starts.get(job.pair)
            starts[job.pair] = result if so_far is None else so_far.plus(result)
            self._advance()
        return starts

    def _sector_jobs(
        self, pair: Pair, seed: np.random.SeedSequence, given: Kept, kept: Kept
    ) -> list[SectorJob]:
        """One job for each sector into which a pose leads; later on only poses of other sectors."""
        taken = self._voxels.keys(self._voxels.cells(kept.points))
        free = np.ones(self._voxels.count, dtype=bool)
        free[taken] = False
        sectors = self._voxels.leads_to(given.points, free)
        if len(taken):  # a sector has done what it could from its own poses
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


def _bar(shown: bool) -> Progress:
    return Progress(
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f} %"),
        TimeElapsedColumn(),
        console=Console(stderr=True),
        disable=not shown,
        transient=True,
    )
