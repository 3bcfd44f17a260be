"""§2.3.2: the reachability map of a body, from a file if there is one, else counted and kept.

Inverse kinematics solutions of uniformly sampled poses are counted, as jobs for processes; where a
map in seconds is enough, their density is found from random joint positions alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from pydantic import Field

from app.border.cache import Arrays, Header, digest, find_kept, header_of, keep, robot_content
from app.border.config import ReachConfig
from app.border.reach.chain import AnalyticSolver, Chain, free_joints, make_solver, reach_bodies
from app.border.score import radial_profile
from app.errors import DescriptionError, UnknownNameError
from app.jobs.pool import Workers
from app.jobs.progress import progress_bar
from app.robot.description import RobotDescription
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.strict import Positive, Vector3

Array = np.ndarray

FORMAT = 1
"""Number of the file's layout and of the way of counting; a new one outdates all files."""
PEAK = 100.0
"""[-] largest mean reachability over a shell around the mount: the paper's C."""

_JOB_POINTS = 64  # a fixed number, so that the counts do not depend on the number of cores


@dataclass(frozen=True)
class ReachMap:
    """Reachability of one body on a lattice around the arm's mount.

    Attributes:
        body: Name of the body.
        points: (N, 3) [m] positions in the base's frame: of the end-effector for the body that
            carries it, else of the middle of the body's first shape.
        found: (N,) inverse kinematics solutions counted at each position, over all its poses; by
            the area formula a measure of them.
        samples: Poses at each position; by the area formula, all joint positions.
        reach: (N,) [-] density of solutions, scaled so that its mean over the best shell is 100.
        p_base: (3,) [m] the arm's mount in the base's frame.
        spacing_m: [m] of the lattice.
        seed: Of the poses.
        method: analytic, restarts, or area formula.
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
    self-collision count. The same seed gives the same map on any number of processes, all cores if
    not given; the default configuration is what the shipped files were made with. `recompute`
    counts anew even if there is a file, `progress` draws a bar on stderr.

    Raises:
        UnknownNameError: No such body can be asked for.
        DescriptionError: No pose has any solution.
        AssetError: The URDF or a mesh is not there.
    """
    if body not in (choices := reach_bodies(model)):
        raise UnknownNameError("body of a reachability map", body, choices)
    config = config or ReachConfig()
    key = reach_key(model.description, body, config)
    name = f"{model.description.name}-reach-{body}"
    found = None if recompute else find_kept(name, key, partial(_unpack, key=key))
    if found is not None:
        return _as_map(*found)
    counts = _count(model, body, config, key, progress, processes)
    result = _as_map(counts, "counted")
    keep(name, counts.header, {"steps": counts.steps.T, "found": counts.found})
    return result


def sample_reach_map(
    model: RobotModel, body: str, *, samples: int = 20_000, spacing: float = 0.08, seed: int = 0
) -> ReachMap:
    """The same density on a lattice of some spacing [m] by the area formula; not kept.

    The solutions of all poses in a region are counted by the integral of |det J| over the joint
    positions that lead there, J of the joints that are not held.

    Raises:
        DescriptionError: No pose has any solution.
    """
    chain, p_base = Chain(model, body), model.p_base()
    free, clearance = free_joints(chain), _SelfClearance(model, chain)
    rng = np.random.default_rng(seed)
    steps, J = np.zeros((samples, 3), dtype=int), np.zeros((samples, chain.size, chain.size))
    for i in range(samples):
        q = chain.random(rng)
        if clearance.is_free(q):
            q[len(chain.joints) :] = 0.0  # turns of these change no pose that is asked for
            at, jacobian = chain.pose_and_jacobian(q)
            steps[i] = np.round((at.translation - p_base) / spacing)
            J[i, :6] = jacobian
    solved = np.delete(J[:, :6], free, axis=2)
    weight = np.abs(np.linalg.det(solved))
    cells = lattice(chain.longest(p_base) + spacing, spacing)
    most = int(np.abs(cells).max())
    grid = np.zeros((2 * most + 1,) * 3)
    np.add.at(grid, tuple((steps + most).T), weight)
    sampled = {"seed": seed, "spacing_m": spacing, "samples": samples, "method": "area formula"}
    header = _header_of(model, chain, free, key="", **sampled)
    return _as_map(_Counts(header, cells, grid[tuple((cells + most).T)]), "counted")


def reach_key(description: RobotDescription, body: str, config: ReachConfig) -> str:
    """32 hexadecimal digits that change whenever the map could.

    It covers the robot as the border's key does (shapes, joints, limits, URDF), the end-effector's
    frame, the body, and the counting; the way in which borders are sampled does not matter.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    arm = description.arm
    return digest(
        {
            "format": FORMAT,
            "robot": robot_content(description),
            "end_effector": [
                arm.end_effector_link,
                arm.end_effector_xyz_m,
                arm.end_effector_rpy_rad,
                arm.end_effector_link in description.body(body).covers,
            ],
            "body": body,
            "sampling": config.model_dump(),
        }
    )


def lattice(radius: float, spacing: float) -> Array:
    """(N, 3) int16 steps of a cubic lattice about its origin, within a ball."""
    reach = int(np.ceil(radius / spacing))
    along = np.arange(-reach, reach + 1)
    steps = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    return steps[(steps**2).sum(axis=1) <= (radius / spacing) ** 2].astype(np.int16)


class _Header(Header):
    body: str
    p_base: Vector3
    seed: int
    spacing_m: Positive
    samples: int = Field(ge=1)
    method: str
    free_joints: tuple[str, ...]


class _Counts(NamedTuple):
    """Positions (N, 3) int16 in steps of the lattice, and solutions (N,), uint16 in a file."""

    header: _Header
    steps: Array
    found: Array


def _unpack(arrays: Arrays, key: str) -> _Counts:
    return _Counts(header_of(arrays, _Header, key=key), arrays["steps"].T, arrays["found"])


def _count(
    model: RobotModel,
    body: str,
    config: ReachConfig,
    key: str,
    progress: bool,
    processes: int | None,
) -> _Counts:
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
    bar = progress_bar(f"counting the solutions of {body}", len(jobs), shown=progress)
    with bar as update, Workers(make_context, processes) as workers:
        for counts in workers.map(count_solutions, jobs):
            found.append(counts)
            update(len(found))
    solver = context.solver
    sampled = {"spacing_m": context.spacing, "samples": context.orientations}
    sampled |= {"seed": config.seed, "method": solver.method}
    header = _header_of(model, context.chain, solver.free, key=key, **sampled)
    return _Counts(header, steps, np.concatenate(found))


def _header_of(model: RobotModel, chain: Chain, free: Sequence[int], **sampled: Any) -> _Header:
    x, y, z = model.p_base().tolist()
    names = model.description.arm.joints
    held = tuple(names[chain.joints[i]] for i in free)
    return _Header(body=chain.body, p_base=(x, y, z), free_joints=held, **sampled)


def _as_map(content: _Counts, origin: Literal["cache", "shipped", "counted"]) -> ReachMap:
    header, steps, found = content
    p_base = np.array(header.p_base)
    offsets = header.spacing_m * steps
    profile = radial_profile(np.linalg.norm(offsets, axis=1), found.astype(float))
    best = profile.mean[profile.peak()]
    if not best > 0:
        raise DescriptionError(f"{header.body}: no sampled pose has an inverse kinematics solution")
    return ReachMap(
        points=p_base + offsets,
        found=found,
        reach=PEAK * found / best,
        p_base=p_base,
        origin=origin,
        **header.model_dump(exclude={"key", "p_base"}),
    )


class CountJob(NamedTuple):
    """Some positions of the lattice.

    Attributes:
        points: (N, 3) [m] in the base's frame.
        seed: Of their random numbers.
    """

    points: Array
    seed: np.random.SeedSequence


class CountContext:
    """What the jobs of one process share.

    Attributes:
        chain: The body's joints.
        solver: Gives all solutions of a pose.
        spacing: [m] of the lattice that suits the solver.
        orientations: Poses at each position that suit the solver.
    """

    def __init__(self, description: RobotDescription, body: str, config: ReachConfig) -> None:
        model = RobotModel(description)
        self.chain = Chain(model, body)
        self.solver = make_solver(self.chain, config.restarts)
        quick = isinstance(self.solver, AnalyticSolver)
        self.spacing = config.spacing_m if quick else config.restart_spacing_m
        self.orientations = config.orientations if quick else config.restart_orientations
        self._clearance = _SelfClearance(model, self.chain)

    def count(self, point: Array, rng: np.random.Generator) -> int:
        """Solutions of a pose with a random orientation, the free joints held at random.

        Only those within the joint limits and without self-collision count.
        """
        target = pin.SE3(_random_rotation(rng), point)
        held = self.chain.random(rng)[list(self.solver.free)]
        found = self.chain.within(self.solver.solve(target, held, rng))
        return sum(self._clearance.is_free(q) for q in found)


def count_solutions(context: CountContext, job: CountJob) -> Array:
    """(N,) uint16 solutions at each position, summed over its poses."""
    rng = np.random.default_rng(job.seed)
    counts = [
        sum(context.count(point, rng) for _ in range(context.orientations)) for point in job.points
    ]
    return np.array(counts, dtype=np.uint16)


class _SelfClearance:
    """Whether the bodies up to the chain's own, the mobile robot included, keep apart."""

    def __init__(self, model: RobotModel, chain: Chain) -> None:
        names = model.body_names
        known = names[: names.index(chain.body) + 1]
        pairs = [pair for pair in candidate_pairs(model) if pair.b in known]
        self._distances = PairDistances(model, pairs)
        self._arm = [4 + joint for joint in chain.joints]
        self._q = model.configuration((0.0, 0.0, 0.0), np.array(model.q_lower))

    def is_free(self, q: Array) -> bool:
        self._q[self._arm] = q[: len(self._arm)]
        self._distances.update(self._q)
        return min(self._distances.distances(), default=1.0) > 0.0


def _random_rotation(rng: np.random.Generator) -> Array:
    """(3, 3) uniformly distributed."""
    q = rng.standard_normal(4)
    return pin.Quaternion(q / np.linalg.norm(q)).matrix()
