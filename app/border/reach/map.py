"""§2.3.2: the reachability map of a body: how many joint positions lead to the poses at each place.

The density of a pose's inverse kinematics solutions follows from random joint positions by the area
formula: over the joint positions that lead into a region, the integral of |det J| is the number of
solutions of all poses in it. So none has to be solved for.
"""

from dataclasses import dataclass

import numpy as np

from app.border.reach.chain import Chain, free_joints
from app.border.score import radial_profile
from app.errors import DescriptionError
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel
from app.strict import Array

PEAK = 100.0  # [-] largest mean reachability over a shell around the mount: the paper's C
FINE_SAMPLES, FINE_SPACING = 200_000, 0.05
"""[-] joint positions and [m] the lattice of `dbb reach`: seconds, and A to about a hundredth."""

_ORIENTATIONS = {6: 8 * np.pi**2, 5: 4 * np.pi, 3: 1.0}
"""[-] volume of the orientations of a pose of so many numbers: all, directions, none."""


@dataclass(frozen=True)
class ReachMap:
    """Reachability of one body on a lattice around the arm's mount."""

    body: str
    points: Array
    """(N, 3) [m] positions in the base's frame: of the end-effector for the body that carries it,
    else of the middle of the body's first shape."""
    found: Array
    """(N,) [-] mean number of solutions of a pose there, within the joint limits and without
    self-collision, over random orientations and held joints."""
    samples: int
    """Joint positions that it was made of."""
    reach: Array
    """(N,) [-] the same, scaled so that its mean over the best shell is 100."""
    p_base: Array
    """(3,) [m] the arm's mount in the base's frame."""
    spacing_m: float
    """[m] of the lattice."""
    seed: int
    """Of the joint positions."""
    free_joints: tuple[str, ...]
    """Joints held at random, as the arm has more than the pose has numbers."""

    @property
    def rho(self) -> Array:
        """(N,) [m] ρ of (9): distance of each position from the mount."""
        return np.linalg.norm(self.points - self.p_base, axis=1)


def sample_reach_map(
    model: RobotModel, body: str, *, samples: int = 20_000, spacing: float = 0.08, seed: int = 0
) -> ReachMap:
    """The density of solutions of a body's pose over the arm's whole workspace.

    Positions stand on a lattice of some spacing [m] in a ball around the mount that the arm cannot
    leave. J, of the area formula, is that of the joints that are not held.

    Raises:
        ConfigError: Fewer than three joints move the body.
        DescriptionError: No sampled joint position is free of self-collision.
    """
    chain, p_base = Chain(model, body), model.p_base()
    free, clearance = free_joints(chain), _SelfClearance(model, chain)
    solved = [i for i in range(len(chain.joints)) if i not in free]
    rng, asked = np.random.default_rng(seed), chain.asked
    steps, J = np.zeros((samples, 3), dtype=int), np.zeros((samples, asked, asked))
    for i in range(samples):
        q = chain.random(rng)
        if clearance.is_free(q):
            at, jacobian = chain.pose_and_jacobian(q)
            steps[i] = np.round((at.translation - p_base) / spacing)
            J[i] = jacobian[:asked, solved]
    cells = lattice(chain.longest(p_base) + spacing, spacing)
    most = int(np.abs(cells).max())
    grid = np.zeros((2 * most + 1,) * 3)
    np.add.at(grid, tuple((steps + most).T), np.abs(np.linalg.det(J)))
    swept = grid[tuple((cells + most).T)]
    profile = radial_profile(spacing * np.linalg.norm(cells, axis=1), swept)
    best = profile.mean[profile.peak()]
    if not best > 0:
        raise DescriptionError(f"{body}: no sampled joint position is free of self-collision")
    low, high = (limits[solved] for limits in chain.ranges)
    poses = samples * spacing**3 * _ORIENTATIONS[asked]
    return ReachMap(
        body=body,
        points=p_base + spacing * cells,
        found=swept * (high - low).prod() / poses,
        samples=samples,
        reach=PEAK * swept / best,
        p_base=p_base,
        spacing_m=spacing,
        seed=seed,
        free_joints=tuple(model.description.arm.joints[chain.joints[i]] for i in free),
    )


def lattice(radius: float, spacing: float) -> Array:
    """(N, 3) int16 steps of a cubic lattice about its origin, within a ball."""
    reach = int(np.ceil(radius / spacing))
    along = np.arange(-reach, reach + 1)
    steps = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    return steps[(steps**2).sum(axis=1) <= (radius / spacing) ** 2].astype(np.int16)


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
        self._q[self._arm] = q
        self._distances.update(self._q)
        return min(self._distances.distances(), default=1.0) > 0.0
