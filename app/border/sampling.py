"""Sampling of P_i for all pairs of arm and base: random postures, then a flood of each sector.

In a flood, the arm's closest point moves from known postures into empty neighbouring voxels.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from itertools import islice
from typing import NamedTuple, TypeVar

import numpy as np
import pinocchio as pin
from pydantic import Field

from app.border import dbb
from app.border.dbb import POINT_UNIT, Cloud, quantise_points
from app.border.mobile import MobileBody
from app.errors import DescriptionError
from app.jobs.pool import Workers
from app.jobs.progress import OnProgress, part_of, progress_bar
from app.robot.description import RobotDescription
from app.robot.link_pairs import Pair, PairDistances, sample_joints
from app.robot.model import RobotModel
from app.strict import Array, Strict


class SamplingConfig(Strict):
    """Parameters of the sampling of joint positions, for the pairs of (1) and for P_i."""

    seed: int = Field(default=0, ge=0)  # [-] seed of all random numbers of the sampling
    pair_samples: int = Field(default=100_000, ge=100)  # [-] number of joint positions for (1)
    cloud_samples: int = Field(default=200_000, ge=100)
    """[-] number of random joint positions per pair; those in range start the flood of P_i."""
    d_low: float = Field(default=0.03, ge=0.0, le=0.3)  # [m] smallest distance d_m of P_i
    d_high: float = Field(default=0.32, ge=0.05, le=0.6)  # [m] largest distance d_m of P_i
    voxel_plan: float = Field(default=0.008, ge=0.002, le=0.1)  # [m] horizontal side of a voxel
    voxel_height: float = Field(default=0.005, ge=0.002, le=0.1)  # [m] height of a voxel
    sectors: int = Field(default=16, ge=1, le=64)  # [-] number of sectors around the base's centre
    rounds: int = Field(default=4, ge=1, le=16)
    """[-] largest number of floods of a sector; the second and later floods start at the borders to
    the neighbouring sectors."""
    retries: int = Field(default=6, ge=0, le=16)
    """[-] number of further attempts of a batch of postures to step into open voxels."""


_FEWER = {"pair_samples": 20_000, "cloud_samples": 20_000, "rounds": 1, "retries": 2, "sectors": 8}
QUICK = SamplingConfig(**_FEWER, voxel_plan=0.03, voxel_height=0.03)
"""A coarse sampling, which takes seconds on one core: fewer samples, and voxels of 3 cm."""

_SEED_JOBS = 16  # [-] jobs of random postures per pair; fixed: cores do not change the samples
_BATCH = 2048  # [-] smallest number of postures in a batch, if there are enough postures
_DAMPING = 0.03  # [m] damping of the pseudo-inverse; entries of an arm's Jacobian are around 0.5 m
_FREE_STEP = 0.10  # [rad] random self-motion of the first retry; it grows with each retry
_MAX_STEP = 0.25  # [rad or m] largest step of a joint; the Jacobian is valid up to about this step


def sample_clouds(
    model: RobotModel,
    pairs: Sequence[Pair],
    config: SamplingConfig,
    *,
    progress: bool = True,
    processes: int | None = None,
    on_progress: OnProgress = lambda _: None,
) -> dict[str, Cloud]:
    """P_i of Algorithm 1 by the name of the pair, for `pairs` of arm and base: sampled points.

    The points are closest points on the arm's body, at most one per voxel. Random sampling alone
    finds almost no points at the base's sides; therefore floods follow. The postures satisfy the
    joint limits, with distances in the sampled range; collisions of other pairs are allowed.

    `progress` displays a progress bar on standard error. `on_progress` gets the finished share of
    the work until the first floods end, 0 to 1. `processes` is the number of parallel processes, by
    default one for each usable core; it has no effect on the result. Raises a DescriptionError if
    the base is too large for the stored points, and the LoopError of `Workers.map`.
    """
    make_context = partial(Context, model.description, config)
    children = np.random.SeedSequence(config.seed).spawn(len(pairs))
    seeds = dict(zip(pairs, children, strict=True))
    begun = _SEED_JOBS / (_SEED_JOBS + config.sectors)  # share of the work before the floods
    bar = progress_bar("sampling the border", 1.0, shown=progress)
    with bar as update, Workers(make_context, processes) as workers:

        def tell(share: float) -> None:
            update(share)
            on_progress(share)

        starts = [(pair, child) for pair in pairs for child in seeds[pair].spawn(_SEED_JOBS)]
        shells = iter(workers.map(sample_shell, starts, part_of(tell, 0.0, begun)))
        found = {pair: _joined(list(islice(shells, _SEED_JOBS))) for pair in pairs}
        kept = {pair: _rows(start, slice(0)) for pair, start in found.items()}
        context, report = make_context(), part_of(tell, begun, 1.0)
        for _ in range(config.rounds):
            jobs = _flood_jobs(context.voxels, seeds, found, kept)
            for job, result in zip(jobs, workers.map(flood_sector, jobs, report), strict=True):
                kept[job.pair] = _joined([kept[job.pair], result])
            found, report = kept, lambda _: None
    clouds = {}
    for pair, (_, points) in kept.items():
        distances = dbb.quantise_distances(context.body.distance(points * POINT_UNIT))
        clouds[pair.name] = dbb.make_cloud(pair.name, points, distances)
    return clouds


def _flood_jobs(
    voxels: Voxels,
    seeds: Mapping[Pair, np.random.SeedSequence],
    found: Mapping[Pair, Kept],
    kept: Mapping[Pair, Kept],
) -> list[SectorJob]:
    """A job for each pair and sector with an open voxel at or next to a point of `found`. After the
    first flood, only points in other sectors count. `kept` has the results of previous floods.
    """
    jobs = []
    for pair, seed in seeds.items():
        taken, given = voxels.keys(voxels.cells(kept[pair].points)), found[pair]
        free = np.ones(voxels.count, dtype=bool)
        free[taken] = False
        around = voxels.keys(voxels.cells(given.points)[:, None, :] + AROUND)
        sectors = np.where((around >= 0) & free[around], voxels.sectors(around), -1)
        if len(taken):  # a sector has already used its own postures
            sectors[sectors == voxels.sectors(around[:, :1])] = -1
        owner = voxels.sectors(taken)
        for sector, child in enumerate(seed.spawn(voxels.sector_count)):
            leads = (sectors == sector).any(axis=1)
            if leads.any():
                sources = given.q_m[leads]
                jobs.append(SectorJob(pair, child, sector, sources, taken[owner == sector]))
    return jobs


class Kept(NamedTuple):
    """Known postures of one pair."""

    q_m: Array  # (N, n_m) float32 [rad or m] joint positions
    points: Array  # (N, 3) int16 points of the postures, as in `Cloud`


Columns = TypeVar("Columns", Kept, "Witnesses")


class Context:
    """The data that the jobs of one process share."""

    def __init__(self, description: RobotDescription, config: SamplingConfig) -> None:
        self.model, self.config = RobotModel(description), config
        self.body = MobileBody(self.model)
        size = np.array([config.voxel_plan, config.voxel_plan, config.voxel_height])
        box = self.body.lower, self.body.upper
        self.voxels = Voxels(*box, reach=config.d_high, size=size, sectors=config.sectors)


class SectorJob(NamedTuple):
    """A job: the flood of one sector."""

    pair: Pair
    seed: np.random.SeedSequence
    sector: int
    sources: Array  # (N, n_m) float32 [rad or m] starting postures
    taken: Array  # (M,) indices of the sector's filled voxels


def sample_shell(context: Context, job: tuple[Pair, np.random.SeedSequence]) -> Kept:
    """Draw random postures; return those with the pair's distance in (`d_low`, `d_high`)."""
    (pair, seed), config = job, context.config
    count = -(-config.cloud_samples // _SEED_JOBS)
    q_m = sample_joints(context.model, count, np.random.default_rng(seed))
    found = PairReader(context.model, pair).witnesses(q_m)
    return _kept(_rows(found, (found.d > config.d_low) & (found.d < config.d_high)))


def flood_sector(context: Context, job: SectorJob) -> Kept:
    """Find postures for the open voxels of a sector."""
    q_m = np.clip(job.sources.astype(float), context.model.q_lower, context.model.q_upper)
    return _kept(_Flood(context, job).run(q_m))


class Witnesses(NamedTuple):
    """Closest points of many postures."""

    q_m: Array  # (N, n_m) [rad or m] the postures
    d: Array  # (N,) [m] signed distance of the pair
    p_b: Array  # (N, 3) [m] closest point on the arm's body, in the base's frame
    normal: Array  # (N, 3) unit vectors from l_m to the body


def _kept(found: Witnesses) -> Kept:
    return Kept(found.q_m.astype(np.float32), quantise_points(found.p_b))


class PairReader:
    """Closest points of a pair in many postures, with the base at the origin."""

    def __init__(self, model: RobotModel, pair: Pair) -> None:
        self._model = model
        self._distances = PairDistances(model, [pair])
        self._joint = model.body_joints[pair.b]
        self._q = model.configuration((0.0, 0.0, 0.0), model.q_lower)

    def witnesses(self, q_m: Array) -> Witnesses:
        """The closest points in postures q_m (N, n_m) [rad or m]."""
        found = Witnesses(q_m, np.empty(len(q_m)), np.empty((len(q_m), 3)), np.empty((len(q_m), 3)))
        for i, posture in enumerate(q_m):
            self._q[4:] = posture
            self._distances.update(self._q)
            result = self._distances.nearest_result(0)
            found.d[i], found.normal[i] = result.min_distance, result.normal
            found.p_b[i] = result.getNearestPoint2()
        return found

    def jacobians(self, q_m: Array, p_b: Array) -> Array:
        """(N, 3, n_m) Jacobians of points p_b (N, 3) [m] on the body in postures q_m."""
        model, data, axes = self._model.pin, self._distances.data, pin.LOCAL_WORLD_ALIGNED
        J, origin = np.empty((len(q_m), 6, model.nv)), np.empty((len(q_m), 3))
        for i, posture in enumerate(q_m):
            self._q[4:] = posture
            pin.computeJointJacobians(model, data, self._q)
            J[i] = pin.getJointJacobian(model, data, self._joint, axes)
            origin[i] = data.oMi[self._joint].translation
        J = J[:, :, 3:]
        return J[:, :3] + np.cross(J[:, 3:], (p_b - origin)[:, :, None], axis=1)


class _Flood:
    """Finds at most one point for each open (empty) voxel of one pair in one sector."""

    def __init__(self, context: Context, job: SectorJob) -> None:
        self._model, self._voxels, config = context.model, context.voxels, context.config
        self._low, self._high, self._retries = config.d_low, config.d_high, config.retries
        self._reader = PairReader(context.model, job.pair)
        self._rng = np.random.default_rng(job.seed)
        self._open = self._voxels.sectors(np.arange(self._voxels.count)) == job.sector
        self._open[job.taken] = False
        # Scale of a joint's random step: 1 for a full turn, small for a short travel.
        travel = self._model.q_upper - self._model.q_lower
        self._scale = np.minimum(travel, 2 * np.pi) / (2 * np.pi)

    def run(self, sources: Array) -> Witnesses:
        """Flood the open voxels from postures (N, n_m); return one posture for each filled voxel.

        Up to `retries` + 1 times for each batch of postures, one posture of the batch makes a step
        into each open voxel next to the batch.
        """
        found = self._reader.witnesses(sources)
        accepted = [self._accepted(found)]
        waiting = [[found]] + [[] for _ in range(self._retries)]
        while (round_ := next((k for k, queue in enumerate(waiting) if queue), None)) is not None:
            found = _take(waiting[round_])
            fresh = self._accepted(self._expand(found, round_))
            if len(fresh.d):
                accepted.append(fresh)
                waiting[0].append(fresh)
            if round_ < self._retries:
                waiting[round_ + 1].append(found)
        return _joined(accepted)

    def _accepted(self, found: Witnesses) -> Witnesses:
        """For each open voxel with postures in range, select one of them and close the voxel."""
        keys = self._voxels.keys(self._voxels.cells(quantise_points(found.p_b)))
        fits = (keys >= 0) & (found.d > self._low) & (found.d < self._high)
        candidates = np.flatnonzero(fits & self._open[keys])
        fresh = candidates[np.unique(keys[candidates], return_index=True)[1]]
        self._open[keys[fresh]] = False
        return _rows(found, fresh)

    def _expand(self, found: Witnesses, round_: int) -> Witnesses:
        """Step into each open voxel that is probably in range, from the first posture beside it."""
        cells = self._voxels.cells(quantise_points(found.p_b))[:, None, :] + AROUND[1:]
        keys = self._voxels.keys(cells)
        step = self._voxels.centres(cells) - found.p_b[:, None]
        ahead = found.d[:, None] + (step * found.normal[:, None]).sum(axis=2)
        useful = (keys >= 0) & self._open[keys] & (ahead > self._low) & (ahead < self._high)
        source, side = np.nonzero(useful)
        # Without this selection, two postures would try the same voxel in nearly half of all tries.
        first = np.unique(keys[source, side], return_index=True)[1]
        source, side = source[first], side[first]
        needed, row = np.unique(source, return_inverse=True)
        J = self._reader.jacobians(found.q_m[needed], found.p_b[needed])[row]
        tried = self._step(found.q_m[source], J, step[source, side], round_)
        return self._reader.witnesses(tried)

    def _step(self, q: Array, J: Array, step: Array, round_: int) -> Array:
        """Postures (N, n_m) whose closest points have moved by about `step` (N, 3) [m] from q, with
        random self-motion in retries; joints that would leave their limits do not move.
        """
        lower, upper = self._model.q_lower, self._model.q_upper
        free = self._rng.standard_normal(q.shape) * (_FREE_STEP * round_ * self._scale)
        dq = _damped(J, step, free)
        held = (q + dq < lower) | (q + dq > upper)
        dq = _damped(np.where(held[:, None, :], 0.0, J), step, np.where(held, 0.0, free))
        return np.clip(q + np.clip(dq, -_MAX_STEP, _MAX_STEP), lower, upper)


def _damped(J: Array, step: Array, free: Array) -> Array:
    """Damped least-squares joint steps (N, n_m), ξ + Jᵀ (J Jᵀ + λ² I)⁻¹ (s − J ξ), for the steps s
    = `step` (N, 3) [m] of a point, with ξ = `free` (N, n_m) and λ = `_DAMPING`.
    """
    J_T = J.transpose(0, 2, 1)
    missing = step[:, :, None] - J @ free[:, :, None]
    weight = np.linalg.solve(J @ J_T + _DAMPING**2 * np.eye(3), missing)
    return free + (J_T @ weight)[:, :, 0]


def _take(queue: list[Witnesses]) -> Witnesses:
    """Remove and return the last postures of a queue: at least `_BATCH`, or all if it has fewer."""
    taken, count = [], 0
    while queue and count < _BATCH:
        taken.append(queue.pop())
        count += len(taken[-1].d)
    return _joined(taken)


def _joined(parts: list[Columns]) -> Columns:
    return type(parts[0])(*map(np.concatenate, zip(*parts, strict=True)))


def _rows(columns: Columns, which: Array | slice) -> Columns:
    return type(columns)(*(column[which] for column in columns))


AROUND = np.array(
    [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]]
)  # steps from a voxel to itself and to the six that share a face with it


class Voxels:
    """A grid of voxels in the base's frame, above the floor and around a box that encloses l_m.
    Points are int16 in units of 0.1 mm, so that all machines have the same voxels.
    """

    def __init__(
        self, lower: Array, upper: Array, *, reach: float, size: Array, sectors: int
    ) -> None:
        """Create the grid up to the distance `reach` [m] from the box with the corners `lower` and
        `upper` (3,) [m]. A voxel has the sides `size` (3,) [m]. Around the base's centre are
        `sectors` equal sectors. Raises a DescriptionError if the base is too large for int16.
        """
        low, high = lower - reach, upper + reach
        if max(np.abs(low).max(), np.abs(high).max()) > dbb.POINT_RANGE:
            why = f"bodies: the base extends more than {dbb.POINT_RANGE - reach:g} m"
            raise DescriptionError(f"{why} from the base's centre, too far for a stored border")
        low[2] = 0.0  # no points below the floor
        self._size = np.rint(size / POINT_UNIT).astype(int)
        self._origin = np.floor(low / POINT_UNIT / self._size).astype(int) * self._size
        span = np.ceil(high / POINT_UNIT).astype(int) - self._origin
        self.shape = np.maximum(-(-span // self._size), 1)  # (3,) voxels along x, y and z
        self.count, self.sector_count = int(self.shape.prod()), sectors
        # Turned by half a sector: if 4 divides `sectors`, no edge of a sector is on the wheel axis.
        x, y = ((np.arange(self.shape[i]) + 0.5) * self._size[i] + self._origin[i] for i in (0, 1))
        turn = np.arctan2(y[:, None], x[None, :]).ravel() / (2 * np.pi) + 0.5 / sectors
        self._sectors = np.floor(turn % 1.0 * sectors).astype(int) % sectors  # of each column

    def cells(self, points: Array) -> Array:
        """Cells (N, 3), also outside of the grid, of points (N, 3) int16 as in `Cloud`."""
        return (points - self._origin) // self._size

    def keys(self, cells: Array) -> Array:
        """(…) index of the voxel at each cell (…, 3), or −1 outside of the grid."""
        inside = ((cells >= 0) & (cells < self.shape)).all(axis=-1)
        nx, ny, _ = self.shape
        return np.where(inside, (cells[..., 2] * ny + cells[..., 1]) * nx + cells[..., 0], -1)

    def centres(self, cells: Array) -> Array:
        """(…, 3) [m] centre of each cell (…, 3)."""
        return ((cells + 0.5) * self._size + self._origin) * POINT_UNIT

    def sectors(self, keys: Array) -> Array:
        """(…) sector of the voxels with the indices `keys` (…)."""
        return self._sectors[keys % len(self._sectors)]
