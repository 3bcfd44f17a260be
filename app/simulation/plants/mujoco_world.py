"""A MuJoCo model of a robot with bodies, joints, shapes and a floor, and its simulation."""

import logging
from collections.abc import Iterable, Sequence
from functools import partial
from itertools import product
from typing import Any

import coal
import mujoco
import numpy as np
import pinocchio as pin

from app.robot.assets import PLANAR_JOINTS
from app.robot.model import RobotModel
from app.simulation.plants.collision_shapes import FLOOR, CollisionShape, collision_shapes
from app.simulation.plants.door import Cabinet, OpenDoor
from app.simulation.plants.interface import GRAVITY, Contacts, HeldDoor, Push, Wrench
from app.strict import Array

# Otherwise MuJoCo writes a file into the working directory.
mujoco.set_mju_user_warning(partial(logging.getLogger(__name__).warning, "MuJoCo: %s"))

_AWAY = 100.0  # [m] displacement of the refrigerator while a base settles on its wheels
_SEAL = [0.02, 1.0]  # [s] time constant and [-] damping ratio of the door's edge
_GRASP: dict[str, Any] = {"solref": [0.002, 1.0], "solimp": [0.999, 0.9999, 0.001, 0.5, 2.0]}
_BODY, _DOOR, _HINGE, _GRIP = "refrigerator", "door", "hinge", "grip"
_FIRM = [0.004, 1.0]  # [s] time constant and [-] damping ratio of contacts
_IMPEDANCE = [0.95, 0.99, 0.001, 0.5, 2.0]  # of contacts and joint limits, in MuJoCo's format
_ORIGIN = pin.SE3.Identity()
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
        """Specify the robot and the floor; `dt` [s] is the duration of one step. `free_root` is the
        inertia of a free root; the plant then adds bodies with the rest of the base's mass. Without
        `free_root`, motors along x, y and yaw move the root.
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
            for one, other in product(self.geoms(a), self.geoms(b)):
                self.allow(one, other, group)

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
        size: Iterable[float] = (),
        T: pin.SE3 = _ORIGIN,
    ) -> None:
        """Add a shape to a body at the pose T; it can touch only the geoms of its pairs in `allow`.
        `size` [m] has up to three sizes, as MuJoCo defines them; a mesh has the name of its geom.
        """
        body.add_geom(
            name=name,
            type=kind,
            size=[*size, 0, 0, 0][:3],
            **_pose(T),
            meshname=name if kind == _GEOM.mjGEOM_MESH else "",
            contype=0,
            conaffinity=0,
        )

    def add_motor(
        self, body: Any, name: str, kind: mujoco.mjtJoint, axis: Sequence[float], limit: float
    ) -> None:
        """Add a joint with a velocity-controlled motor, about or along `axis` (3,) in the body's
        frame. The motor is dry friction, up to `limit` [N or N m], relative to a commanded speed.
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
        self, a: str, b: str, group: str | None = None, friction: float = _FRICTION, **contact: Any
    ) -> None:
        """Let two geoms touch. The field `group` of `Contacts`, if any, reports their contact.
        `friction` [-] is the coefficient; `contact` has further options of MuJoCo's `add_pair`.
        """
        contact = {"solref": _FIRM, "solimp": _IMPEDANCE} | contact
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
            solimp_limit=_IMPEDANCE,
        )

    def _add_shape(self, body: Any, name: str, shape: CollisionShape) -> None:
        geometry = shape.geometry
        if isinstance(geometry, np.ndarray):
            convex = mujoco.mjtMeshInertia.mjMESH_INERTIA_CONVEX
            self.spec.add_mesh(name=name, uservert=_solid(geometry).ravel(), inertia=convex)
            self.add_geom(body, name, _GEOM.mjGEOM_MESH, T=shape.T)
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


class MujocoWorld:
    """A compiled `RobotSpec`; with planar joints, it can replace a `BulletRobot` in `Planar`."""

    def __init__(self, robot: RobotSpec, door: OpenDoor | None) -> None:
        """Compile a specification that has all motors, with a door if there is one."""
        self.door = None if door is None else MujocoDoor(robot, door)
        self.model = model = robot.compile()
        self.data = mujoco.MjData(model)
        self.q, self.v = self.data.qpos, self.data.qvel  # views that MuJoCo updates
        source = robot.model
        first = model.joint(source.description.arm.joints[0])
        self.arm_q = slice(int(first.qposadr[0]), int(first.qposadr[0]) + source.n_m)
        self.arm_v = slice(int(first.dofadr[0]), int(first.dofadr[0]) + source.n_m)
        self._planar_q = self.q[: self.arm_q.stop]
        self._read = self.q[:3], self.v[:3], self.q[self.arm_q], self.v[self.arm_v]
        self._body_of = {name: model.body(name).id for name in list(source.pin.names)[2:]}
        self._motors = [int(model.joint(name).dofadr[0]) for name in robot.motors]
        self._per_step = 1.0 / model.opt.timestep
        self._tip, self._tool = robot.tip, robot.tool
        ids = {model.geom(i).name: i for i in range(model.ngeom)}
        self._group = {}
        for pair, group in robot.pairs.items():
            a, b = (ids[name] for name in pair)
            self._group[a, b] = self._group[b, a] = group

    def rewind(self) -> None:
        """Restore the initial state, and remove stored contacts."""
        mujoco.mj_resetData(self.model, self.data)

    def reset(self, q: Array) -> None:
        self.rewind()
        self._planar_q[:] = q
        if self.door is not None:
            self.door.take_hold(self)

    def read(self) -> tuple[Array, list[float], Array, Array]:
        base_q, base_v, q_m, qd_m = self._read
        return base_q.copy(), base_v.tolist(), q_m.copy(), qd_m.copy()

    def mass_matrix(self) -> Array:
        """(n_v, n_v) mass matrix after the last step or forward computation."""
        M = np.empty((self.model.nv, self.model.nv))
        for row, unit in zip(M, np.eye(len(M)), strict=True):
            mujoco.mj_mulM(self.model, self.data, row, unit)
        return M

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """As `BulletRobot.mass_and_bias`, only without a door; also moves the robot to q and v."""
        self.rewind()
        self.q[:], self.v[:] = q, v
        mujoco.mj_forward(self.model, self.data)
        return self.mass_matrix(), self.data.qfrc_bias

    def step(
        self, u_a: Array, speeds: Sequence[float], hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """Advance by one step, as in `BulletRobot`; `speeds` has the command of each motor."""
        data = self.data
        mujoco.mj_step1(self.model, data)
        # MuJoCo has set the reference acceleration of dry friction, -v / dt, which stops a joint.
        # That of a motor is (speed - v) / dt. The solver starts from these accelerations of the
        # motors; from the solution of the last step it would need three iterations.
        row = 0 if self.door is None else data.ne  # the motors' rows follow the grasp's
        motors = data.efc_aref[row : row + len(self._motors)]
        motors += self._per_step * np.asarray(speeds)
        data.qacc_warmstart[self._motors] = motors
        data.qfrc_applied[self.arm_v] = u_a
        data.xfrc_applied[:] = 0.0
        for name, point, force in (Push(self._tip, self._tool, hand_force), *pushes):
            body, (fx, fy, fz) = self._body_of[name], np.asarray(force).tolist()
            turned = (data.xmat[body].reshape(3, 3) * point).sum(axis=1)
            x, y, z = (data.xpos[body] + turned - data.xipos[body]).tolist()
            torque = y * fz - z * fy, z * fx - x * fz, x * fy - y * fx
            data.xfrc_applied[body] += (fx, fy, fz, *torque)
        mujoco.mj_step2(self.model, data)

    def close(self) -> None:
        """Do nothing: the plant has no resources to release."""

    def contacts(self) -> Contacts:
        touching = self.data.contact.geom.tolist()
        return Contacts.of(filter(None, {self._group[a, b] for a, b in touching}))

    def depths(self) -> dict[str, float]:
        deepest: dict[str, float] = {}
        contacts = self.data.contact
        for (a, b), distance in zip(contacts.geom.tolist(), contacts.dist, strict=True):
            if group := self._group[a, b]:
                deepest[group] = max(deepest.get(group, 0.0), -float(distance))
        return deepest

    def seen(self, begins: Array, ends: Array) -> Array:
        mujoco.mj_kinematics(self.model, self.data)
        found, hit = np.full(len(begins), np.inf), np.zeros(1, np.int32)
        for i, (begin, way) in enumerate(zip(begins, ends - begins, strict=True)):
            length = np.linalg.norm(way)
            at = mujoco.mj_ray(self.model, self.data, begin, way / length, None, 1, -1, hit)
            if 0.0 <= at <= length:
                found[i] = at
        return found


class MujocoDoor(HeldDoor):
    """The refrigerator in MuJoCo; of the robot, only links of the base can touch the door. The
    end-effector is welded to a body on the door, with a sensor of the wrench between them.
    """

    def __init__(self, robot: RobotSpec, start: OpenDoor) -> None:
        """Add the refrigerator to a specification that has all motors."""
        self.door, self._start = start
        self._tip, self._tool = robot.tip, robot.tool
        self._cabinet = cabinet = Cabinet(self.door)
        body = robot.add_body(robot.spec.worldbody, _BODY, cabinet.T_world, cabinet.inertia)
        body.add_freejoint(name=_BODY)
        robot.add_geom(body, _BODY, _GEOM.mjGEOM_BOX, np.array(cabinet.size) / 2)
        door = robot.add_body(body, _DOOR, cabinet.T_hinge, cabinet.door_inertia)
        door.add_joint(
            name=_HINGE,
            type=_JOINT.mjJNT_HINGE,
            axis=[0, 0, 1],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=self.door.joint_range,
            **robot.friction(self.door.friction),
        )
        half = np.array(self.door.size) / 2
        robot.add_geom(door, _DOOR, _GEOM.mjGEOM_BOX, half, cabinet.T_centre)
        robot.allow(FLOOR, _BODY)
        for geom in robot.geoms(*robot.mobile):
            robot.allow(_DOOR, geom, "door_base", solref=_SEAL)
        robot.add_body(door, _GRIP, _ORIGIN, pin.Inertia.Zero()).add_site(name=_GRIP)
        robot.spec.add_equality(
            name=_GRIP,
            type=mujoco.mjtEq.mjEQ_WELD,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            name1=self._tip,
            name2=_GRIP,
            **_GRASP,
        )
        for kind in (mujoco.mjtSensor.mjSENS_FORCE, mujoco.mjtSensor.mjSENS_TORQUE):
            robot.spec.add_sensor(type=kind, objtype=mujoco.mjtObj.mjOBJ_SITE, objname=_GRIP)

    def put_away(self, world: MujocoWorld) -> None:
        """Move the refrigerator far away, and end the grasp."""
        world.data.eq_active[0] = 0
        world.data.joint(_BODY).qpos[0] += _AWAY

    def take_hold(self, world: MujocoWorld) -> None:
        """Put the refrigerator in place, with its door at the initial angle, and grasp the door."""
        model, data = world.model, world.data
        self._data = data
        data.joint(_BODY).qpos[:] = pin.SE3ToXYZQUAT(self._cabinet.T_world)[[0, 1, 2, 6, 3, 4, 5]]
        data.joint(_BODY).qvel[:] = 0.0
        data.joint(_HINGE).qpos[0] = -self.door.side * self._start
        data.joint(_HINGE).qvel[0] = 0.0
        data.eq_active[0] = 1
        mujoco.mj_kinematics(model, data)
        tip, grip = (_placement(data.body(name)) for name in (self._tip, _GRIP))
        p_grip = grip.actInv(tip.act(self._tool))
        sensor = model.site(_GRIP).id
        model.site_pos[sensor], model.site_sameframe[sensor] = p_grip, 0
        between = pin.Quaternion(tip.rotation.T @ grip.rotation).coeffs()[[3, 0, 1, 2]]
        model.eq_data[0, :10] = [*p_grip, *self._tool, *between]

    def angle(self) -> float:
        return -self.door.side * float(self._data.joint(_HINGE).qpos[0])

    def wrench(self) -> Wrench:
        R = self._data.site(_GRIP).xmat.reshape(3, 3)
        read = self._data.sensordata  # force and torque of the door on the end-effector
        return Wrench(-R @ read[:3], -R @ read[3:])


def _placement(body: Any) -> pin.SE3:
    return pin.SE3(body.xmat.reshape(3, 3).copy(), body.xpos.copy())
