"""Counting the inverse kinematics solutions of uniformly sampled poses, as jobs for processes."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.border.reach.chain import Chain
from app.border.reach.config import ReachConfig
from app.border.reach.solver import AnalyticSolver, make_solver
from app.robot.description import RobotDescription
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel

Array = np.ndarray


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
        self._count = len(pairs)
        self._arm = [4 + joint for joint in chain.joints]
        self._q = model.configuration((0.0, 0.0, 0.0), np.array(model.q_lower))

    def is_free(self, q: Array) -> bool:
        self._q[self._arm] = q[: len(self._arm)]
        self._distances.update(self._q)
        return all(self._distances.distance(i) > 0.0 for i in range(self._count))


def _random_rotation(rng: np.random.Generator) -> Array:
    """(3, 3) uniformly distributed."""
    q = rng.standard_normal(4)
    return pin.Quaternion(q / np.linalg.norm(q)).matrix()
