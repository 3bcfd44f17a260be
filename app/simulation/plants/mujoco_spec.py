"""A MuJoCo specification of a robot's bodies, joints and shapes, and of a floor."""

from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin

from app.robot.assets import PLANAR_JOINTS
from app.robot.model import RobotModel
from app.simulation.plants.collision_shapes import FLOOR, CollisionShape, collision_shapes
from app.simulation.plants.interface import Contacts
from app.strict import Array

GRAVITY = 9.81  # [m/s²]
FIRM = (0.004, 1.0)  # [s] time constant and [-] damping ratio of contacts
IMPEDANCE = [0.95, 0.99, 0.001, 0.5, 2.0]  # of contacts and joint limits, in MuJoCo's format

_FLAT = 1e-6  # [-] largest ratio of thickness to length of a flat mesh
_SHEET = 0.0002  # [m] thickness that a flat mesh gets
_STIFFEST = 0.9999  # [-] MuJoCo's largest impedance
_FRICTION = 0.25  # [-] default coefficient of friction of contacts
_ROUND = 100.0  # [-] ratio of the firmness of friction to that of contacts
_GEOM = mujoco.mjtGeom
_JOINT = mujoco.mjtJoint
_PRIMITIVES = {
    coal.Box: (_GEOM.mjGEOM_BOX, lambda box: box.halfSide),
    coal.Sphere: (_GEOM.mjGEOM_SPHERE, lambda ball: [ball.radius]),
    coal.Cylinder: (_GEOM.mjGEOM_CYLINDER, lambda rod: [rod.radius, rod.halfLength]),
    coal.Capsule: (_GEOM.mjGEOM_CAPSULE, lambda rod: [rod.radius, rod.halfLength]),
}


class RobotSpec:
    def __init__(
        self, model: RobotModel, dt: float, *, free_root: pin.Inertia | None = None
    ) -> None:
        """Specify the robot and the floor; `dt` [s] is the duration of one step.

        `free_root` is the inertia of a free root; the plant then adds bodies with the rest of the
        base's mass. Without `free_root`, motors along x, y and yaw move the root.
        """
        self.model, self._dt = model, dt
        tool = model.pin.frames[model.ee_frame]
        self.tip = model.pin.names[tool.parentJoint]  # name of the body that carries the tool
        self.tool = tool.placement.translation.copy()  # (3,) [m] end-effector's origin in this body
        self.spec = _empty_spec(dt)
        self.pairs: dict[frozenset[str], str | None] = {}  # `group` of two geoms, as in `allow`
        self.motors: list[str] = []  # names of the joints that have a motor
        self._inertias: dict[str, tuple[float, Array]] = {}
        self.add_geom(self.spec.worldbody, FLOOR, _GEOM.mjGEOM_PLANE, (0, 0, 1))
        self.shapes, pairs, self.mobile = collision_shapes(model)
        bodies = self._add_joints(free_root)
        self.root = bodies[1]
        self._geoms = {FLOOR: [FLOOR]}
        for i, shape in enumerate(self.shapes):
            name = f"{shape.part}/{i}"
            self._geoms.setdefault(shape.part, []).append(name)
            self._add_shape(bodies[shape.joint], name, shape)
        # Sorted by group and names, because the last digits of the solution depend on the order.
        ordered = sorted(pairs.items(), key=lambda item: (Contacts._fields.index(item[1]), item[0]))
        for (a, b), group in ordered:
            self.allow(group, self.geoms(a), self.geoms(b))

    def geoms(self, *parts: str) -> list[str]:
        """Names of the MuJoCo geoms of some parts: links or bodies, and the floor."""
        return [geom for part in parts for geom in self._geoms.get(part, ())]

    def add_body(self, parent: Any, name: str, T: pin.SE3, inertia: pin.Inertia) -> Any:
        """Add a body at the pose T in a parent body, and return it; `compile` sets its inertia."""
        # MuJoCo's compiler refuses some inertias, such as that of a massless link with a load.
        moments, axes = np.linalg.eigh(inertia.inertia)
        axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
        self._inertias[name] = inertia.mass, moments
        return parent.add_body(
            name=name,
            **_pose(T),
            mass=1.0,
            inertia=[1.0, 1.0, 1.0],
            explicitinertial=True,
            ipos=inertia.lever,
            iquat=_quaternion(axes),
        )

    def add_geom(
        self,
        body: Any,
        name: str,
        kind: mujoco.mjtGeom,
        size: Sequence[float] | Array = (),
        T: pin.SE3 | None = None,
        mesh: str = "",
    ) -> None:
        """Add a shape to a body at the pose T; it can touch only the geoms of its pairs in `allow`.
        `size` [m] has up to three sizes, as MuJoCo defines them; `mesh` is the name of a mesh.
        """
        body.add_geom(
            name=name,
            type=kind,
            size=[*size, 0, 0, 0][:3],
            **_pose(T or pin.SE3.Identity()),
            meshname=mesh,
            contype=0,
            conaffinity=0,
        )

    def add_motor(
        self, body: Any, name: str, kind: mujoco.mjtJoint, axis: Sequence[float], limit: float
    ) -> None:
        """Add a joint with a velocity-controlled motor of limited force or torque.

        The motor is dry friction up to `limit` [N or N m] relative to a moving reference. MuJoCo
        solves this friction together with contacts and limits. `axis` (3,) is in the body's frame.
        """
        body.add_joint(name=name, type=kind, axis=list(axis), **self.friction(limit))
        self.motors.append(name)

    def friction(self, limit: float) -> dict[str, Any]:
        """Options of a joint with dry friction: a force up to `limit` [N or N m] that stops it."""
        return {
            "frictionloss": limit,
            "solref_friction": [-1.0, -_STIFFEST / self._dt],
            "solimp_friction": [_STIFFEST, _STIFFEST, 0.001, 0.5, 2.0],
        }

    def allow(
        self,
        group: str | None,
        some: Iterable[str],
        others: Iterable[str],
        *,
        friction: float = _FRICTION,
        firmness: Sequence[float] = FIRM,
        **contact: Any,
    ) -> None:
        """Let each geom of one list touch each geom of another list.

        `group` is the field of `Contacts` that reports their contact, or None. `friction` [-] is
        the coefficient; `firmness` has the time constant [s] and the damping ratio [-]; `contact`
        has further options of MuJoCo.
        """
        contact = {"solref": list(firmness), "solimp": IMPEDANCE} | contact
        for a, b in product(some, others):
            self.pairs[frozenset((a, b))] = group
            self.spec.add_pair(
                geomname1=a,
                geomname2=b,
                condim=3 if friction else 1,
                friction=[friction, friction, 0.0, 0.0, 0.0],
                **contact,
            )

    def compile(self) -> mujoco.MjModel:
        """Compile the model, and set the inertias of its bodies."""
        compiled = self.spec.compile()
        for name, (mass, moments) in self._inertias.items():
            body = compiled.body(name).id
            compiled.body_mass[body] = mass
            compiled.body_inertia[body] = moments
        mujoco.mj_setConst(compiled, mujoco.MjData(compiled))
        return compiled

    def _add_joints(self, free_root: pin.Inertia | None) -> list[Any]:
        source, bodies = self.model.pin, [self.spec.worldbody]
        base = self.model.description.base
        for i in range(1, source.njoints):
            inertia = source.inertias[i] if i > 1 or free_root is None else free_root
            parent = bodies[source.parents[i]]
            body = self.add_body(parent, source.names[i], source.jointPlacements[i], inertia)
            bodies.append(body)
            if i > 1:
                self._add_arm_joint(body, i)
            elif free_root is not None:
                body.add_freejoint(name="root")
            else:
                kinds = _JOINT.mjJNT_SLIDE, _JOINT.mjJNT_SLIDE, _JOINT.mjJNT_HINGE
                limits = base.traction_limit_n, base.traction_limit_n, base.yaw_limit_nm
                for motor in zip(PLANAR_JOINTS, kinds, np.eye(3).tolist(), limits, strict=True):
                    self.add_motor(body, *motor)
        return bodies

    def _add_arm_joint(self, body: Any, i: int) -> None:
        model, source = self.model, self.model.pin
        J = pin.computeJointJacobian(source, source.createData(), pin.neutral(source), i)
        axis = J[:, source.joints[i].idx_v]  # in the joint's own frame
        slides = bool(np.any(axis[:3]))
        body.add_joint(
            name=source.names[i],
            axis=axis[:3] if slides else axis[3:],
            type=_JOINT.mjJNT_SLIDE if slides else _JOINT.mjJNT_HINGE,
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=[model.q_lower[i - 2], model.q_upper[i - 2]],
            solref_limit=[2.0 * self._dt, 1.0],
            solimp_limit=IMPEDANCE,
        )

    def _add_shape(self, body: Any, name: str, shape: CollisionShape) -> None:
        geometry = shape.geometry
        if isinstance(geometry, np.ndarray):
            convex = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            self.spec.add_mesh(name=name, uservert=_solid(geometry).ravel(), inertia=convex)
            self.add_geom(body, name, _GEOM.mjGEOM_MESH, T=shape.T, mesh=name)
        else:
            kind, size_of = _PRIMITIVES[type(geometry)]
            self.add_geom(body, name, kind, size_of(geometry), shape.T)


def _solid(points: Array) -> Array:
    """(N, 3) [m] points of a hull; a flat hull, which MuJoCo refuses, receives a thickness."""
    extents, axes = np.linalg.svd(points - points.mean(axis=0), full_matrices=False)[1:]
    if extents[2] > _FLAT * extents[0]:
        return points
    return np.vstack([points + _SHEET / 2 * axes[2], points - _SHEET / 2 * axes[2]])


def _empty_spec(dt: float) -> mujoco.MjSpec:
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.compiler.inertiafromgeom = mujoco.mjtInertiaFromGeom.mjINERTIAFROMGEOM_FALSE
    option = spec.option
    option.timestep, option.gravity = dt, [0.0, 0.0, -GRAVITY]
    option.integrator = mujoco.mjtIntegrator.mjINT_EULER  # semi-implicit, as pybullet's
    option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _ROUND
    option.tolerance = 1e-10
    # With islands MuJoCo would copy data before `MujocoWorld.step` changes them.
    option.disableflags = mujoco.mjtDisableBit.mjDSBL_ISLAND | mujoco.mjtDisableBit.mjDSBL_AUTORESET
    return spec


def _pose(T: pin.SE3) -> dict[str, Any]:
    return {"pos": T.translation, "quat": _quaternion(T.rotation)}


def _quaternion(R: Array) -> Array:
    """(4,) quaternion of an orientation R (3, 3) in MuJoCo's order, w first."""
    return pin.Quaternion(np.ascontiguousarray(R)).coeffs()[[3, 0, 1, 2]]
