"""§2.3.2: reachability map of a body: the number of joint positions for the poses at each place.

The density of a pose's inverse kinematics solutions follows from random joint positions by the area
formula: over the joint positions that lead into a region, the integral of |det J| is the number of
solutions of all poses in it. No inverse kinematics has to be solved.
"""

from dataclasses import dataclass
from itertools import combinations

import numpy as np
import pinocchio as pin

from app.border.score import FLOOR, ReachFit, fit_parabola, radial_profile
from app.errors import ConfigError, DescriptionError
from app.robot.link_pairs import PairDistances, candidate_pairs
from app.robot.model import RobotModel, length_bound
from app.strict import Array

_TRIALS = 4  # [-] configurations for the rank of a chain
_SINGULAR = 1e-6  # [m/rad or -] singular value of a lost direction
_MIN_JOINTS = 3  # fewer do not fill a volume
_FREE_TRIALS = 20  # [-] configurations that test a choice of free joints
_LOST = 1e-9  # determinants below this are zero


def reach_bodies(model: RobotModel) -> list[str]:
    """Names of the bodies that at least three joints of the arm move, the outermost first."""
    names = model.body_names[:0:-1]
    return [name for name in names if len(_moving_joints(model, name)) >= _MIN_JOINTS]


class Chain:
    """A body's joints, with the base at the origin, and the coordinates of its pose that they
    determine.

    The body that carries the end-effector has the end-effector's pose; any other has the position
    of the centre of its first shape and the direction of that shape's z axis, which is a capsule's
    own. With k joints the pose has six numbers (k ≥ 6), five, without the rotation about the
    direction (k = 5), or three, the position (k = 3, 4); fewer if the joints never move in a
    direction.
    """

    def __init__(self, model: RobotModel, body: str) -> None:
        """Cut the chain of a body out of the robot.

        Raises:
            ConfigError: Fewer than three joints move the body; lists the possible ones.
        """
        joints = _moving_joints(model, body)
        if len(joints) < _MIN_JOINTS:
            raise ConfigError(
                f"{body}: only {len(joints)} of the arm's joints move it, a reachability needs "
                f"{_MIN_JOINTS}; choose from: {', '.join(reach_bodies(model)) or '(none)'}"
            )
        self.body = body
        self.joints = [joint - 2 for joint in joints]
        """Indices within the arm of the joints that move the body."""
        still = [j for j in range(1, model.pin.njoints) if j not in joints]
        self.pin = pin.buildReducedModel(model.pin, still, pin.neutral(model.pin))
        """pinocchio's model of the chain."""
        self._data, self._placement = self.pin.createData(), _carrier(model, body)[1]
        self.lower, self.upper = model.q_lower[self.joints], model.q_upper[self.joints]
        """(k,) [rad or m] limits."""
        kinds = [joint.shortname() for joint in self.pin.joints][1:]
        self.turns = np.array([kind.startswith("JointModelR") for kind in kinds])
        """(k,) whether a joint is revolute."""
        self.asked = next((n for n in (6, 5) if n <= len(joints) and self._meets(n)), 3)
        """Number of coordinates of the pose: 6, 5 or 3."""
        self.free = len(joints) - self.asked
        """Number of joints that have to be fixed before the others are determined."""

    def pose_and_jacobian(self, q: Array) -> tuple[pin.SE3, Array]:
        """T_base_point at joint positions (k,), and its Jacobian (6, k), linear over angular.

        It is in the point's own axes, the last of which is the body's: its first five rows exclude
        the rotation about it, its first three are the position's.
        """
        J = pin.computeJointJacobians(self.pin, self._data, q)
        at = self._data.oMi[len(self.joints)] * self._placement
        return at, at.inverse().action @ J

    def longest(self, p_base: Array) -> float:
        """[m] upper bound of the distance between the mount and the body's point."""
        pin.forwardKinematics(self.pin, self._data, np.zeros(len(self.joints)))
        first = float(np.linalg.norm(self._data.oMi[1].translation - p_base))
        links = [*list(self.pin.jointPlacements)[2:], self._placement]
        return first + length_bound(links, np.array([self.lower, self.upper])[:, ~self.turns])

    @property
    def ranges(self) -> tuple[Array, Array]:
        """(k,) [rad or m] each, limits in which a joint reaches each place once: one turn."""
        turned = np.minimum(self.upper, self.lower + 2 * np.pi)
        return self.lower, np.where(self.turns, turned, self.upper)

    def random(self, rng: np.random.Generator) -> Array:
        """(k,) joint positions, uniform within their `ranges`."""
        return rng.uniform(*self.ranges)

    def _meets(self, numbers: int) -> bool:
        """Whether the chain moves its point in that number of directions somewhere."""
        rng = np.random.default_rng(0)
        tried = (self.pose_and_jacobian(rng.uniform(-1, 1, self.pin.nq)) for _ in range(_TRIALS))
        ranks = (np.linalg.matrix_rank(J[:numbers], tol=_SINGULAR) for _, J in tried)
        return numbers in ranks


def _moving_joints(model: RobotModel, body: str) -> list[int]:
    """Pinocchio's joints of the arm between the base and a body's point."""
    return [joint for joint in model.pin.supports[_carrier(model, body)[0]] if joint > 1]


def _carrier(model: RobotModel, body: str) -> tuple[int, pin.SE3]:
    """Pinocchio's joint that moves a body's point, and the pose of the point's frame on it."""
    if model.description.arm.end_effector_link in model.description.body(body).covers:
        frame = model.pin.frames[model.ee_frame]
        return frame.parentJoint, frame.placement
    shape = model.geometry.geometryObjects[model.shape_ids[body][0]]
    return shape.parentJoint, shape.placement


def free_joints(chain: Chain) -> tuple[int, ...]:
    """Indices of the outermost joints that may be fixed while the others reach a pose.

    Raises:
        DescriptionError: No such joints exist.
    """
    k, rng = len(chain.joints), np.random.default_rng(0)
    tried = [chain.pose_and_jacobian(chain.random(rng))[1] for _ in range(_FREE_TRIALS)]
    for free in reversed(list(combinations(range(k), chain.free))):
        square = np.delete(np.array(tried)[:, : chain.asked], free, axis=2)
        if np.abs(np.linalg.det(square)).max() > _LOST:
            return free
    raise DescriptionError(f"arm.joints: no pose determines the {k} joints that move {chain.body}")


PEAK = 100.0  # [-] largest mean reachability over a shell around the mount: the paper's C
FINE_SAMPLES, FINE_SPACING = 200_000, 0.05
"""[-] joint positions and [m] lattice of `dbb reach`: takes seconds, with A to about 1 %."""

_ORIENTATIONS = {6: 8 * np.pi**2, 5: 4 * np.pi, 3: 1.0}
"""[-] volume of the orientations of a pose with that number of coordinates: all, directions,
none."""


@dataclass(frozen=True)
class ReachMap:
    """Reachability of one body on a lattice around the arm's mount."""

    body: str
    points: Array
    """(N, 3) [m] positions in the base's frame: of the end-effector for the body that carries it,
    otherwise of the centre of the body's first shape."""
    found: Array
    """(N,) [-] mean number of solutions of a pose there, within the joint limits and without
    self-collision, over random orientations and fixed joints."""
    samples: int
    """Number of joint positions."""
    reach: Array
    """(N,) [-] the density, scaled so that its mean over the best shell is 100."""
    p_base: Array
    """(3,) [m] the arm's mount in the base's frame."""
    spacing_m: float
    """[m] spacing of the lattice."""
    seed: int
    """Seed of the joint positions."""
    free_joints: tuple[str, ...]
    """Joints fixed at random positions, because the arm has more than the pose has coordinates."""

    @property
    def rho(self) -> Array:
        """(N,) [m] ρ of (9): distance of each position from the mount."""
        return np.linalg.norm(self.points - self.p_base, axis=1)


def sample_reach_map(
    model: RobotModel, body: str, *, samples: int = 20_000, spacing: float = 0.08, seed: int = 0
) -> ReachMap:
    """The density of solutions of a body's pose over the arm's whole workspace.

    Positions form a lattice with a spacing [m] in a ball around the mount that contains the whole
    workspace. J, of the area formula, is that of the joints that are not fixed.

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


def fit_reachability(reach_map: ReachMap, share: float = FLOOR) -> ReachFit:
    """A, B, C of (9) for a map, above a share of its peak; see `fit_parabola`.

    Raises:
        DescriptionError: The map does not rise and fall with the distance from the mount.
    """
    try:
        return fit_parabola(reach_map.rho, reach_map.reach, share)
    except ValueError as error:
        raise DescriptionError(f"{reach_map.body}: (9) does not fit its map: {error}") from None


def lattice(radius: float, spacing: float) -> Array:
    """(N, 3) int16 steps of a cubic lattice about its origin, within a ball."""
    reach = int(np.ceil(radius / spacing))
    along = np.arange(-reach, reach + 1)
    steps = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    return steps[(steps**2).sum(axis=1) <= (radius / spacing) ** 2].astype(np.int16)


class _SelfClearance:
    """Whether the bodies up to the chain's own, including the mobile robot, are free of contact."""

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
