"""The stages of the sampling as jobs for worker processes: random joints, then a sector's flood."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from app.border.cloud import POINT_UNIT, quantise_distances, quantise_points
from app.border.mobile import MobileBody
from app.border.sampling.config import SamplingConfig
from app.border.sampling.flood import Flood
from app.border.sampling.poses import PairReader
from app.border.sampling.voxels import Voxels
from app.robot.description import RobotDescription
from app.robot.link_pairs import Pair, sample_joints
from app.robot.model import RobotModel

Array = np.ndarray


class Kept(NamedTuple):
    """What is known of one pair: poses (N, n_m), their points (N, 3) and distances (N,)."""

    q_m: Array
    points: Array
    distances: Array

    def none(self) -> Kept:
        """The same without any row."""
        return Kept(*(column[:0] for column in self))

    def plus(self, more: Kept) -> Kept:
        """Both, one after the other."""
        return Kept(*map(np.concatenate, zip(self, more, strict=True)))


class Context:
    """What the jobs of one process share."""

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
    """Random sampling of the joints; gives the poses in the shell."""

    pair: Pair
    seed: np.random.SeedSequence
    count: int


class SectorJob(NamedTuple):
    """The flood of one sector.

    Attributes:
        pair: The pair of L_m.
        seed: Of the sector's random numbers.
        sector: Its number.
        sources: (N, n_m) float32, poses to start from.
        taken: (M,) numbers of its voxels that are filled already.
    """

    pair: Pair
    seed: np.random.SeedSequence
    sector: int
    sources: Array
    taken: Array


def sample_shell(context: Context, job: SeedJob) -> Kept:
    """Random poses whose points lie in the shell around l_m."""
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
    """Poses that fill the voxels of a sector; d_m is measured anew at the points as kept."""
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
    found = flood.run(wanted, q_m, config.retries)
    distances = context.body.distance(found.points * POINT_UNIT)
    return Kept(found.q_m, found.points, quantise_distances(distances))
