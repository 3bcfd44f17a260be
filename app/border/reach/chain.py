"""The joints that move one body of the arm, as a chain that has to meet a full pose."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np
import pinocchio as pin

from app.errors import ConfigError, DescriptionError
from app.robot.model import RobotModel

Array = np.ndarray

_TRIALS = 4  # [-] configurations in which a chain is asked for its rank
_SINGULAR = 1e-6  # [m/rad or -] singular value of a lost direction
_LEAST_JOINTS = 3  # fewer do not fill a volume
_FREE_TRIALS = 20  # [-] configurations with which a choice of free joints is tried out
_LOST = 1e-9  # determinants below this are zero


def reach_bodies(model: RobotModel) -> list[str]:
    """Names of the bodies that at least three joints of the arm move, the outermost first."""
    names = model.body_names[:0:-1]
    return [name for name in names if len(_moving_joints(model, name)) >= _LEAST_JOINTS]


class Chain:
    """A body's joints, the base at the origin, then unlimited ones for what its pose leaves open.

    The body that carries the end-effector has the end-effector's pose; any other has the position
    of the middle of its first shape and the direction of that shape's z axis, which is a capsule's
    own. With k joints the pose has six numbers (k ≥ 6), five, the direction without the turn about
    it (k = 5), or three, the position (k = 3, 4); fewer where the
    joints lose a direction for good. What is not asked for is given to one or three unlimited
    joints at the body's point, so that the chain always has to meet a full pose.

    Attributes:
        body: Name of the body.
        pin: pinocchio's model of the chain: the arm's joints, then the unlimited ones.
        joints: Indices within the arm of the joints that move the body.
        asked: Numbers of the pose: 6, 5 or 3.
        free: How many joints have to be given before the others are determined.
        lower, upper: (n,) [rad or m] limits; infinite for the unlimited joints.
        turns: (n,) whether a joint is revolute.
    """

    def __init__(self, model: RobotModel, body: str) -> None:
        """Cut the chain of a body out of the robot.

        Raises:
            ConfigError: Fewer than three joints move the body; lists those that can be asked for.
        """
        joints = _moving_joints(model, body)
        if len(joints) < _LEAST_JOINTS:
            raise ConfigError(
                f"{body}: only {len(joints)} of the arm's joints move it, a reachability needs "
                f"{_LEAST_JOINTS}; choose from: {', '.join(reach_bodies(model)) or '(none)'}"
            )
        self.body = body
        self.joints = [joint - 2 for joint in joints]
        still = [j for j in range(1, model.pin.njoints) if j not in joints]
        for self.asked in [numbers for numbers in (6, 5, 3) if numbers <= len(joints)]:
            self.pin = pin.buildReducedModel(model.pin, still, pin.neutral(model.pin))
            self._end, self._placement = len(joints), _carrier(model, body)[1]
            self._add_unlimited()
            if self._meets_poses():
                break
        self.free = len(joints) - self.asked
        open_ends = np.full(6 - self.asked, np.inf)
        self.lower = np.concatenate([model.q_lower[self.joints], -open_ends])
        self.upper = np.concatenate([model.q_upper[self.joints], open_ends])
        self.turns = np.array([_is_revolute(joint) for joint in self.pin.joints][1:])
        self._data = self.pin.createData()

    @property
    def size(self) -> int:
        """Joints of the chain, the unlimited ones included."""
        return len(self.lower)

    def pose_and_jacobian(self, q: Array) -> tuple[pin.SE3, Array]:
        """T_base_point at joint positions (n,), and its Jacobian.

        That is (6, n), linear over angular, in the point's own axes.
        """
        J = pin.computeJointJacobians(self.pin, self._data, q)
        at = self._data.oMi[self._end] * self._placement
        return at, at.inverse().action @ J

    def longest(self, p_base: Array) -> float:
        """[m] bound of the distance between the mount and the body's point."""
        pin.forwardKinematics(self.pin, self._data, np.zeros(self.size))
        first = float(np.linalg.norm(self._data.oMi[1].translation - p_base))
        links = [np.linalg.norm(at.translation) for at in self.pin.jointPlacements[2:]]
        slides = np.maximum(np.abs(self.lower), np.abs(self.upper))[~self.turns]
        return first + float(
            sum(links) + slides.sum() + np.linalg.norm(self._placement.translation)
        )

    @property
    def ranges(self) -> tuple[Array, Array]:
        """(n,) [rad or m] each, limits within which a joint is at each place once: one turn."""
        low = np.where(np.isfinite(self.lower), self.lower, -np.pi)
        high = np.where(np.isfinite(self.upper), self.upper, np.pi)
        return low, np.where(self.turns, np.minimum(high, low + 2 * np.pi), high)

    def random(self, rng: np.random.Generator) -> Array:
        """(n,) joint positions, uniform within their `ranges`."""
        return rng.uniform(*self.ranges)

    def _meets_poses(self) -> bool:
        """Whether the chain moves its point in all six directions somewhere."""
        data, rng = self.pin.createData(), np.random.default_rng(0)
        for _ in range(_TRIALS):
            J = pin.computeJointJacobians(self.pin, data, rng.uniform(-1, 1, self.pin.nq))
            if np.linalg.matrix_rank(J, tol=_SINGULAR) == 6:
                return True
        return False

    def _add_unlimited(self) -> None:
        """One joint about the body's axis, or three about its point."""
        kinds = {
            6: (),
            5: (pin.JointModelRZ,),
            3: (pin.JointModelRZ, pin.JointModelRY, pin.JointModelRX),
        }[self.asked]
        for i, kind in enumerate(kinds):
            self._end = self.pin.addJoint(self._end, kind(), self._placement, f"unlimited_{i}")
            self._placement = pin.SE3.Identity()


def _moving_joints(model: RobotModel, body: str) -> list[int]:
    """Pinocchio's joints of the arm between the base and a body's point."""
    return [joint for joint in model.pin.supports[_carrier(model, body)[0]] if joint > 1]


def _carrier(model: RobotModel, body: str) -> tuple[int, pin.SE3]:
    """Pinocchio's joint that carries a body's point, and where the point's frame stands on it."""
    if model.description.arm.end_effector_link in model.description.body(body).covers:
        frame = model.pin.frames[model.ee_frame]
        return frame.parentJoint, frame.placement
    shape = model.geometry.geometryObjects[model.shape_ids[body][0]]
    return shape.parentJoint, shape.placement


def _is_revolute(joint: pin.JointModel) -> bool:
    return joint.shortname().startswith("JointModelR")


def free_joints(chain: Chain) -> tuple[int, ...]:
    """Indices of the outermost joints that may be held while the others meet a pose.

    Raises:
        DescriptionError: There are none with which they do.
    """
    free = next(_choices(chain), None)
    if free is None:
        raise DescriptionError(
            f"arm.joints: no pose determines the {len(chain.joints)} joints that move {chain.body}"
        )
    return free


def _choices(chain: Chain) -> Iterator[tuple[int, ...]]:
    """Free joints that leave the others determined, the outermost first."""
    arm = range(len(chain.joints))
    rng = np.random.default_rng(0)
    jacobians = [chain.pose_and_jacobian(chain.random(rng))[1] for _ in range(_FREE_TRIALS)]
    for free in reversed(list(combinations(arm, chain.free))):
        square = [np.delete(J, free, axis=1) for J in jacobians]
        if max(abs(np.linalg.det(J)) for J in square) > _LOST:
            yield free
