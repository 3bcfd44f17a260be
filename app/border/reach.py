"""§2.3.2: reachability map of a body: the mean number of inverse kinematics solutions by position.

No inverse kinematics is solved: joint positions are drawn at random. By the area formula, the
integral of |det J| over the joint positions that lead into a region of poses is the number of
solutions, integrated over the poses in the region.
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

_MIN_JOINTS = 3  # [-] smallest number of joints that move a point within a volume


def reach_bodies(model: RobotModel) -> list[str]:
    """Names of the bodies that at least three joints of the arm move; the outermost is first."""
    names = model.body_names[:0:-1]
    return [name for name in names if len(_moving_joints(model, name)) >= _MIN_JOINTS]


class Chain:
    """The joints that move a body, and the coordinates of the body's pose that they determine.

    The pose is that of the end-effector's frame or, for a body that does not carry the
    end-effector, of the frame of the body's first shape; the base is at the origin. The origin of
    the frame is the body's point. The pose has as many coordinates as the joints can change
    independently: six; five, without the rotation about the z axis; or three, of the position.

    Attributes:
        joints: Indices within the arm of the k joints that move the body.
        pin: pinocchio's model of the chain.
        lower, upper: (k,) [rad or m] joint limits.
        turns: (k,) whether each joint is revolute.
        coordinates: Number of coordinates of the pose: 6, 5 or 3.
        free: Number of joints that must be fixed so that a pose determines the other joints.
    """

    def __init__(self, model: RobotModel, body: str) -> None:
        """Extract the chain; raises a ConfigError if fewer than three joints move the body."""
        joints = _moving_joints(model, body)
        if len(joints) < _MIN_JOINTS:
            why = f"{body}: only {len(joints)} of the arm's joints move this body, but a"
            names = ", ".join(reach_bodies(model)) or "(none)"
            raise ConfigError(f"{why} reachability map needs {_MIN_JOINTS}; choose from: {names}")
        self.body = body
        self.joints = [joint - 2 for joint in joints]
        still = [j for j in range(1, model.pin.njoints) if j not in joints]
        self.pin = pin.buildReducedModel(model.pin, still, pin.neutral(model.pin))
        self._data, self._placement = self.pin.createData(), _carrier(model, body)[1]
        self.lower, self.upper = model.q_lower[self.joints], model.q_upper[self.joints]
        kinds = [joint.shortname() for joint in self.pin.joints][1:]
        self.turns = np.array([kind.startswith("JointModelR") for kind in kinds])
        self.coordinates = next((n for n in (6, 5) if n <= len(joints) and self._meets(n)), 3)
        self.free = len(joints) - self.coordinates

    def pose_and_jacobian(self, q: Array) -> tuple[pin.SE3, Array]:
        """The body's pose T_base_point at q (k,), and its Jacobian (6, k) in the point's axes."""
        J = pin.computeJointJacobians(self.pin, self._data, q)
        at = self._data.oMi[len(self.joints)] * self._placement
        return at, at.inverse().action @ J

    def longest(self, p_base: Array) -> float:
        """[m] upper bound of the distance of the body's point from the mount p_base (3,) [m]."""
        pin.forwardKinematics(self.pin, self._data, np.zeros(len(self.joints)))
        first = float(np.linalg.norm(self._data.oMi[1].translation - p_base))
        links = [*list(self.pin.jointPlacements)[2:], self._placement]
        return first + length_bound(links, np.array([self.lower, self.upper])[:, ~self.turns])

    @property
    def ranges(self) -> tuple[Array, Array]:
        """Lower and upper ends (k,) [rad or m] of the sampled ranges, of at most one turn."""
        turned = np.minimum(self.upper, self.lower + 2 * np.pi)
        return self.lower, np.where(self.turns, turned, self.upper)

    def random(self, rng: np.random.Generator) -> Array:
        """Draw joint positions (k,), uniform within `ranges`."""
        return rng.uniform(*self.ranges)

    def _meets(self, numbers: int) -> bool:
        """Whether the first `numbers` rows of J are independent in at least 1 of 4 postures."""
        rng = np.random.default_rng(0)
        tried = (self.pose_and_jacobian(rng.uniform(-1, 1, self.pin.nq)) for _ in range(4))
        ranks = (np.linalg.matrix_rank(J[:numbers], tol=1e-6) for _, J in tried)  # [m/rad or -]
        return numbers in ranks


def _moving_joints(model: RobotModel, body: str) -> list[int]:
    """Pinocchio's indices of the arm's joints between the base and a body's point."""
    return [joint for joint in model.pin.supports[_carrier(model, body)[0]] if joint > 1]


def _carrier(model: RobotModel, body: str) -> tuple[int, pin.SE3]:
    """Pinocchio's index of the last joint before a body's point, and T_joint_point."""
    if model.description.arm.end_effector_link in model.description.body(body).covers:
        frame = model.pin.frames[model.ee_frame]
        return frame.parentJoint, frame.placement
    shape = model.geometry.geometryObjects[model.shape_ids[body][0]]
    return shape.parentJoint, shape.placement


def free_joints(chain: Chain) -> tuple[int, ...]:
    """Redundant joints, as indices in the chain: if they are fixed, a pose determines the others.

    They are as near to the body as possible. Raises a DescriptionError if the Jacobian of the
    others is singular for each choice of fixed joints.
    """
    k, rng = len(chain.joints), np.random.default_rng(0)
    tried = [chain.pose_and_jacobian(chain.random(rng))[1] for _ in range(20)]
    for free in reversed(list(combinations(range(k), chain.free))):
        square = np.delete(np.array(tried)[:, : chain.coordinates], free, axis=2)
        if np.abs(np.linalg.det(square)).max() > 1e-9:
            return free
    why = f"a pose of {chain.body} does not determine the {k} joints that move this body"
    raise DescriptionError(f"arm.joints: {why}, for any choice of {chain.free} fixed joints")


PEAK = 100.0  # [-] largest mean reachability in a shell around the mount: the paper's C
FINE_SAMPLES, FINE_SPACING = 200_000, 0.05
"""[-] number of joint positions and [m] spacing of `dbb reach`; the error of A is about 1 %."""
_ORIENTATIONS = {6: 8 * np.pi**2, 5: 4 * np.pi, 3: 1.0}
"""[-] volume of the orientations of a pose, by its number of coordinates: 6 for all orientations, 5
for directions, 3 for positions without orientation."""


@dataclass(frozen=True)
class ReachMap:
    """Reachability of one body on a lattice around the arm's mount."""

    body: str
    points: Array  # (N, 3) [m] positions of the body's point (`Chain`) in the base's frame
    found: Array
    """(N,) [-] number of inverse kinematics solutions at each position, within the joint limits and
    without self-collision; the mean over orientations and positions of the fixed joints."""
    samples: int
    reach: Array  # (N,) [-] `found`, scaled to a mean of 100 in the best shell
    p_base: Array  # (3,) [m] the arm's mount in the base's frame
    spacing_m: float  # [m] spacing of the lattice
    seed: int
    free_joints: tuple[str, ...]  # names of the fixed joints; empty if the chain is not redundant

    @property
    def rho(self) -> Array:
        """(N,) [m] ρ of (9): distance of each position from the mount."""
        return np.linalg.norm(self.points - self.p_base, axis=1)


def sample_reach_map(
    model: RobotModel, body: str, *, samples: int = 20_000, spacing: float = 0.08, seed: int = 0
) -> ReachMap:
    """The mean number of inverse kinematics solutions for a body in the whole workspace, from
    `samples` random joint positions, on a lattice with `spacing` [m] in a ball around the mount.

    Raises a DescriptionError if each sample is in self-collision, and the errors of `Chain` and
    `free_joints`.
    """
    chain, p_base = Chain(model, body), model.p_base()
    free, within = free_joints(chain), model.body_names[: model.body_names.index(body) + 1]
    distances = PairDistances(model, [p for p in candidate_pairs(model) if p.b in within])
    posture, moved = model.configuration((0.0, 0.0, 0.0), model.q_lower), np.array(chain.joints) + 4
    solved = [i for i in range(len(chain.joints)) if i not in free]
    rng, size = np.random.default_rng(seed), chain.coordinates
    steps, J = np.zeros((samples, 3), dtype=int), np.zeros((samples, size, size))
    for i in range(samples):
        q = posture[moved] = chain.random(rng)
        distances.update(posture)
        if min(distances.distances(), default=1.0) > 0.0:
            at, jacobian = chain.pose_and_jacobian(q)
            steps[i] = np.round((at.translation - p_base) / spacing)
            J[i] = jacobian[:size, solved]
    cells = lattice(chain.longest(p_base) + spacing, spacing)
    half = int(np.abs(cells).max())
    grid = np.zeros((2 * half + 1,) * 3)
    np.add.at(grid, tuple((steps + half).T), np.abs(np.linalg.det(J)))
    swept = grid[tuple((cells + half).T)]
    profile = radial_profile(spacing * np.linalg.norm(cells, axis=1), swept)
    best = profile.mean[profile.peak()]
    if not best > 0:
        raise DescriptionError(f"{body}: no sampled joint position is free of self-collision")
    low, high = (limits[solved] for limits in chain.ranges)
    poses = samples * spacing**3 * _ORIENTATIONS[size]
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
    """Fit (9) to a map by `fit_parabola`; raises a DescriptionError instead of its ValueError."""
    try:
        return fit_parabola(reach_map.rho, reach_map.reach, share)
    except ValueError as error:
        text = f"{reach_map.body}: (9) does not fit the reachability map: {error}"
        raise DescriptionError(text) from None


def lattice(radius: float, spacing: float) -> Array:
    """(N, 3) int16 steps from the centre of a ball to the points of a cubic lattice in the ball."""
    reach = int(np.ceil(radius / spacing))
    along = np.arange(-reach, reach + 1)
    steps = np.stack(np.meshgrid(along, along, along, indexing="ij"), axis=-1).reshape(-1, 3)
    return steps[(steps**2).sum(axis=1) <= (radius / spacing) ** 2].astype(np.int16)
