"""The compiled robot: pinocchio's model on a planar base, reduced to q̇ = (q̇_b, q̇_m).

The velocity of pinocchio's planar joint is in the base's own frame. Thus the map S from the reduced
velocity to pinocchio's is constant. The reduced terms are Sᵀ M S and Sᵀ h, without M Ṡ q̇.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property, lru_cache, partial, wraps
from hashlib import blake2b
from typing import TYPE_CHECKING, Any, Concatenate, Literal, ParamSpec, TypeVar
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin

from app.errors import DescriptionError
from app.robot.assets import bare_urdf
from app.robot.description import BodyDescription, RobotDescription
from app.robot.shapes import shape_mesh
from app.strict import Array

if TYPE_CHECKING:
    import trimesh

STABLE_STEPS = 3.0  # [-] smallest stable m/(D dt) for a joint with inertia m and damping D
Options = ParamSpec("Options")
Result = TypeVar("Result")
OfModel = Callable[Concatenate["RobotModel", Options], Result]


class RobotModel:
    """The constant data of a robot.

    Attributes:
        description: The description of the robot.
        pin: pinocchio's model: a planar joint, then the joints of the arm; all other joints are
            locked at zero.
        geometry: pinocchio's geometry model with the convex shapes of all bodies.
        shape_ids: Indices of a body's shapes in `geometry`, by the name of the body.
        body_joints: Pinocchio's index of the joint that moves a body, by the name of the body.
        ee_frame, mount_frame: Pinocchio's indices of the frames of end-effector and arm's mount.
        n, n_b, n_m: Degrees of freedom of the reduced velocity (n_b + n_m), the base and the arm.
        n_d: Number of states of the base's drive besides its velocity.
        reading_shapes: Valid shapes of the arrays of a `Measurement`: with and without `drive`.
        J_m, J_m_inv: (n_b, n_b) `BaseKind.J_m`, for a differential base that of (19); its inverse.
        base_rows: (n_b, n) [J_m O] of (19): the rows of ẍ_m and of the base's acceleration limits.
        S: (3 + n_m, n) map from the reduced velocity to pinocchio's: T J_m for the base, the
            identity for the arm.
        base_acceleration_max: (n_b,) [m/s² or rad/s²] limits of the base's axes.
        base_inertia: (n_b,) [kg or kg m²] mass or inertia of each axis.
        joint_damping: (n_m,) [N m s/rad or N s/m] damping of the arm's joints.
        q_lower, q_upper: (n_m,) [rad or m] joint limits of the arm.
        qd_max, tau_max: (n_m,) [rad/s or m/s] and [N m or N] speed and torque limits of the arm.
        q_limits, qd_limits, tau_limits: (2, n_m) lower and upper limits, in the same units.
    """

    def __init__(self, description: RobotDescription) -> None:
        """Compile a description.

        Raises an AssetError if the URDF is missing, the errors of `ConvexMesh.hull`, and a
        DescriptionError if pinocchio cannot read the URDF, it lacks a joint or link, the arm's
        joints are not in the order of the chain, one is neither revolute nor prismatic, a limit is
        invalid, or the ready position is not within the position limits.
        """
        self.description = description
        full = whole_model(description)
        self.pin = _planar_model(description, full)
        self._wheel_signs = _wheel_signs(description, full)
        self.n_m = len(description.arm.joints)
        base = description.base
        self.n_b, self.n_d = base.n_b, len(base.drive_at_rest())
        self.n = self.n_b + self.n_m
        arrays = (3,), (self.n_b,), (self.n_m,), (self.n_m,)
        self.reading_shapes = (*arrays, (self.n_d,)), (*arrays, (0,))
        self.J_m = base.J_m
        self.J_m_inv = np.linalg.inv(self.J_m)
        self.base_rows = np.hstack([self.J_m, np.zeros((self.n_b, self.n_m))])
        self.S = np.zeros((3 + self.n_m, self.n))
        self.S[:3, : self.n_b] = base.T @ self.J_m
        self.S[3:, self.n_b :] = np.eye(self.n_m)
        self._read_limits()
        self._add_end_effector()
        self.mount_frame = self._frame(description.arm.mount_link, "arm.mount_link")
        self.geometry = pin.GeometryModel()
        self.shape_ids: dict[str, list[int]] = {}
        self.body_joints: dict[str, int] = {}
        for body in description.bodies:
            self._add_body(body)

    @property
    def body_names(self) -> list[str]:
        """Names of the bodies: the base l_m, then those of the arm from the base outwards."""
        return [body.name for body in self.description.bodies]

    @property
    def joint_units(self) -> tuple[Literal["rad", "m"], ...]:
        """(n_m,) unit of each joint position of the arm."""
        kinds = (joint.shortname() for joint in self.pin.joints[2:])  # after the planar joint
        return tuple("m" if "JointModelP" in kind else "rad" for kind in kinds)

    def configuration(self, base_pose: Sequence[float] | Array, q_m: Array) -> Array:
        """Pinocchio's configuration (4 + n_m,) from the base's pose (x, y, φ) and q_m (n_m,)."""
        x, y, phi = base_pose
        return np.array([x, y, math.cos(phi), math.sin(phi), *q_m])

    def joint_positions(self, q_m: Array, angles: Sequence[float] | Array) -> dict[str, float]:
        """Positions [rad or m] by joint name, from q_m (n_m,) and wheel angles (n_w,) [rad].

        The angles are those of the base's `wheels`. They grow when the base rolls forward or steers
        to the left.
        """
        signs, arm = self._wheel_signs, self.description.arm
        pairs = zip(self.description.base.wheels, angles, strict=True)
        turned = {name: signs[name] * float(a) for wheels, a in pairs for name in wheels.joints}
        return dict(zip(arm.joints, map(float, q_m), strict=True)) | turned

    def joint_inertia(self, q: Array) -> Array:
        """(n_m,) [kg m² or kg] inertia of each joint at q, if base and other joints can move."""
        return 1.0 / np.diag(np.linalg.inv(self.mass_matrix(q, self.pin.createData())))[3:]

    def mass_matrix(self, q: Array, data: pin.Data) -> Array:
        """(3 + n_m, 3 + n_m) M at pinocchio's configuration q (4 + n_m,), computed in `data`."""
        M = pin.crba(self.pin, data, q)
        return np.triu(M) + np.triu(M, 1).T

    @cached_property
    def ready_inertia(self) -> Array:
        """(n_m,) [kg m² or kg] `joint_inertia` in the ready posture."""
        ready = np.array(self.description.arm.ready_position)
        return self.joint_inertia(self.configuration((0.0, 0.0, 0.0), ready))

    def p_base(self) -> Array:
        """(3,) [m] position of the arm's mount in the base's frame: p_base of (9)."""
        data = self.pin.createData()
        q = self.configuration((0.0, 0.0, 0.0), np.zeros(self.n_m))
        pin.framesForwardKinematics(self.pin, data, q)
        return data.oMf[self.mount_frame].translation.copy()

    def placed_meshes(
        self, base_pose: Sequence[float] | Array, q_m: Array
    ) -> list[tuple[str, trimesh.Trimesh]]:
        """Body's name and mesh, in the world, of each shape, at a base pose and q_m (n_m,)."""
        data, placed = self.pin.createData(), pin.GeometryData(self.geometry)
        q = self.configuration(base_pose, q_m)
        pin.updateGeometryPlacements(self.pin, data, self.geometry, placed, q)
        return [
            (body.name, shape_mesh(shape).apply_transform(placed.oMg[i].homogeneous))
            for body in self.description.bodies
            for i, shape in zip(self.shape_ids[body.name], body.shapes, strict=True)
        ]

    def _read_limits(self) -> None:
        arm, base, model = self.description.arm, self.description.base, self.pin
        self.base_acceleration_max = np.array(base.max_acceleration)
        self.base_inertia = base.T.T @ (base.mass_kg, base.mass_kg, base.inertia_kgm2)
        self.joint_damping = np.array(arm.joint_damping)
        self.q_lower = _chosen(arm.position_lower, model.lowerPositionLimit[4:])
        self.q_upper = _chosen(arm.position_upper, model.upperPositionLimit[4:])
        self.qd_max = _chosen(arm.max_velocity, model.velocityLimit[3:])
        self.tau_max = _chosen(arm.max_effort, model.effortLimit[3:])
        self.q_limits = np.array([self.q_lower, self.q_upper])
        self.qd_limits = np.array([-self.qd_max, self.qd_max])
        self.tau_limits = np.array([-self.tau_max, self.tau_max])
        ready = np.array(arm.ready_position)
        limits = zip(self.q_lower, ready, self.q_upper, self.qd_max, self.tau_max, strict=True)
        for name, (lower, at, upper, speed, effort) in zip(arm.joints, limits, strict=True):
            if not lower < upper:
                wrong = f"arm: {name} has lower limit {lower:g} not below upper {upper:g}"
            elif not lower <= at <= upper:
                wrong = f"arm.ready_position: {name} at {at:g} is outside of [{lower:g}, {upper:g}]"
            elif not (speed > 0 and effort > 0):
                wrong = f"arm: {name} needs a velocity and an effort limit above zero"
            else:
                continue
            raise _error(self.description, wrong)

    def _add_end_effector(self) -> None:
        arm = self.description.arm
        parent = self._frame(arm.end_effector_link, "arm.end_effector_link")
        frame = self.pin.frames[parent]
        R = pin.rpy.rpyToMatrix(*arm.end_effector_rpy_rad)
        T = frame.placement * pin.SE3(R, np.array(arm.end_effector_xyz_m))
        name = "end_effector"
        while self.pin.existFrame(name):  # a link or joint of the robot may have the name
            name += "_"
        made = pin.Frame(name, frame.parentJoint, parent, T, pin.FrameType.OP_FRAME)
        self.ee_frame = self.pin.addFrame(made)

    def _add_body(self, body: BodyDescription) -> None:
        name, ids = body.name, []
        frame_id = self._frame(body.frame, f"bodies.{name}.frame")
        frame = self.pin.frames[frame_id]
        for link in body.covers:
            self._frame(link, f"bodies.{name}.covers")
        for i, shape in enumerate(body.shapes):
            T, geometry = frame.placement * shape.placement(), shape.coal_geometry()
            made = pin.GeometryObject(f"{name}_{i}", frame.parentJoint, frame_id, T, geometry)
            ids.append(self.geometry.addGeometryObject(made))
        self.body_joints[name], self.shape_ids[name] = frame.parentJoint, ids

    def _frame(self, name: str, field: str) -> int:
        if not self.pin.existFrame(name):
            links = [f.name for f in self.pin.frames if f.type == pin.FrameType.BODY]
            text = f"{field}: the URDF has no link {name!r}; links: {', '.join(links)}"
            raise _error(self.description, text)
        return self.pin.getFrameId(name)


def _chosen(stated: Sequence[float] | None, from_urdf: Array) -> Array:
    return np.array(from_urdf if stated is None else stated, dtype=float)


def _error(description: RobotDescription, message: str) -> DescriptionError:
    return DescriptionError(f"{description.name}/robot.toml: {message}")


def kept_per_model(most: int) -> Callable[[OfModel[Options, Result]], OfModel[Options, Result]]:
    """A decorator for functions of a model; it caches the `most` last used results of each model.

    Callers share a result and must not change it. The other arguments are hashable values or
    arrays; the cache keeps only a digest of each array. A result must not refer to the model:
    otherwise neither of the two would ever be freed.
    """

    def keep(function: OfModel[Options, Result]) -> OfModel[Options, Result]:
        kept: WeakKeyDictionary[RobotModel, Callable[[_Call], Any]] = WeakKeyDictionary()

        @wraps(function)
        def asked(model: RobotModel, *args: Options.args, **kwargs: Options.kwargs) -> Result:
            if model not in kept:
                kept[model] = lru_cache(most)(_Call.made)
            call = _Call(
                (x.dtype, x.shape, blake2b(x.tobytes()).digest()) if isinstance(x, Array) else x
                for x in (*args, *kwargs, *kwargs.values())
            )
            call.make = partial(function, model, *args, **kwargs)
            return kept[model](call)

        return asked

    return keep


class _Call(tuple[object, ...]):
    """The arguments of a cached function, with a digest in the place of each array."""

    make: Callable[[], Any]

    def made(self) -> Any:
        """The result; without `make`, the key in the cache refers to no array and no model."""
        return self.__dict__.pop("make")()


def length_bound(links: Sequence[pin.SE3], slides: Array) -> float:
    """[m] upper bound of the distance between the two ends of a chain of joints.

    `links` are the poses of the chain's frames, each in the frame before it. `slides` (2, k) [m]
    are the lower and upper limits of the prismatic joints.
    """
    offsets = sum(float(np.linalg.norm(each.translation)) for each in links)
    return offsets + float(np.abs(slides).max(axis=0).sum())


def whole_model(description: RobotDescription) -> pin.Model:
    """Pinocchio's model on a planar root, with all joints of the URDF; errors: as `RobotModel`."""
    try:
        return pin.buildModelFromXML(bare_urdf(description), pin.JointModelPlanar())
    except (ValueError, RuntimeError) as error:
        raise _error(description, f"urdf: pinocchio cannot read it: {error}") from None


def configured(whole: pin.Model, positions: Mapping[str, float]) -> Array:
    """Pinocchio's configuration with some joints at positions [rad or m], the others at zero."""
    moved = np.zeros(whole.nv)
    for name, position in positions.items():
        moved[whole.joints[whole.getJointId(name)].idx_v] = position
    return pin.integrate(whole, pin.neutral(whole), moved)


def _wheel_signs(description: RobotDescription, full: pin.Model) -> dict[str, float]:
    """For each wheel's joint, 1 if its axis points left (rolling) or up (steering), else -1."""
    data, signs = full.createData(), {}
    pin.computeJointJacobians(full, data, pin.neutral(full))
    for name in (name for wheels in description.base.wheels for name in wheels.joints):
        joint = full.getJointId(name)
        J = pin.getJointJacobian(full, data, joint, pin.LOCAL_WORLD_ALIGNED)
        axis = J[3:, full.joints[joint].idx_v]
        signs[name] = math.copysign(1.0, axis[np.abs(axis).argmax()])
    return signs


def _planar_model(description: RobotDescription, full: pin.Model) -> pin.Model:
    """The model with all joints except the arm's locked at zero."""
    names = list(full.names)[2:]  # after "universe" and the root joint
    wanted = [("arm.joints", name) for name in description.arm.joints]
    wanted += [(f"base.{each.field}", n) for each in description.base.wheels for n in each.joints]
    for field, name in wanted:
        if name not in names:
            text = f"{field}: the URDF has no moving joint {name!r}; joints: {', '.join(names)}"
            raise _error(description, text)
    locked = [full.getJointId(name) for name in names if name not in description.arm.joints]
    try:
        model = pin.buildReducedModel(full, locked, pin.neutral(full))
    except ValueError as error:  # such as a joint with the name of a link
        raise _error(description, f"urdf: pinocchio cannot reduce it: {error}") from None
    chain = tuple(model.names)[2:]
    if chain != description.arm.joints:
        text = f"arm.joints: must be in the order of the chain: {', '.join(chain)}"
        raise _error(description, text)
    if model.nq != 4 + len(chain):
        raise _error(
            description,
            "arm.joints: each must be revolute or prismatic; "
            "write a continuous joint as revolute with wide limits",
        )
    return model
