"""A compiled MuJoCo model of a robot, with its motors, torques, external forces and contacts."""

import logging
from collections.abc import Sequence
from functools import partial
from typing import Any

import mujoco
import numpy as np
import pinocchio as pin

from app.simulation.plants.collision_shapes import FLOOR
from app.simulation.plants.door import Cabinet, OpenDoor
from app.simulation.plants.interface import Contacts, HeldDoor, Push, Wrench
from app.simulation.plants.mujoco_spec import RobotSpec
from app.strict import Array

# Otherwise MuJoCo writes a file into the working directory.
mujoco.set_mju_user_warning(partial(logging.getLogger(__name__).warning, "MuJoCo: %s"))

_AWAY = 100.0  # [m] displacement of the refrigerator while a base settles on its wheels
_SEAL = 0.02, 1.0  # [s] time constant and [-] damping ratio of the door's edge
_GRASP: dict[str, Any] = {"solref": [0.002, 1.0], "solimp": [0.999, 0.9999, 0.001, 0.5, 2.0]}
_BODY, _DOOR, _HINGE, _GRIP = "refrigerator", "door", "hinge", "grip"


class MujocoWorld:
    """A compiled `RobotSpec`; for a robot on planar joints, it can replace a `BulletRobot`."""

    def __init__(self, robot: RobotSpec, door: OpenDoor | None) -> None:
        """Compile a specification that has all motors, with a door if there is one."""
        self.door = None if door is None else MujocoDoor(robot, door)
        self.model = model = robot.compile()
        self.data = mujoco.MjData(model)
        self.q, self.v = self.data.qpos, self.data.qvel  # views that MuJoCo updates
        source = robot.model
        first = model.joint(source.description.arm.joints[0])
        self.arm_q, self.arm_v = (
            slice(int(begin), int(begin) + source.n_m) for begin in (*first.qposadr, *first.dofadr)
        )
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
        """Put the robot at rest at q, as `BulletRobot.reset`."""
        self.rewind()
        self._planar_q[:] = q
        if self.door is not None:
            self.door.take_hold(self)

    def read(self) -> tuple[Array, list[float], Array, Array]:
        """Copies of the positions and velocities, as `BulletRobot.read`."""
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
        # That of a motor is (speed - v) / dt; the solver starts from it, because from the solution
        # of the last step it would need three iterations.
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
        """Contacts in the last step."""
        touching = self.data.contact.geom.tolist()
        return Contacts.of(filter(None, {self._group[a, b] for a, b in touching}))

    def depths(self) -> dict[str, float]:
        """[m] depths of the contacts, as `BulletWorld.depths`."""
        deepest: dict[str, float] = {}
        contacts = self.data.contact
        for (a, b), distance in zip(contacts.geom.tolist(), contacts.dist, strict=True):
            if group := self._group[a, b]:
                deepest[group] = max(deepest.get(group, 0.0), -float(distance))
        return deepest

    def seen(self, begins: Array, ends: Array) -> Array:
        """(n,) [m] lengths of rays up to the first hit, as `BulletWorld.seen`."""
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
        box = mujoco.mjtGeom.mjGEOM_BOX
        body = robot.add_body(robot.spec.worldbody, _BODY, cabinet.T_world, cabinet.inertia)
        body.add_freejoint(name=_BODY)
        robot.add_geom(body, _BODY, box, np.array(cabinet.size) / 2)
        door = robot.add_body(body, _DOOR, cabinet.T_hinge, cabinet.door_inertia)
        door.add_joint(
            name=_HINGE,
            type=mujoco.mjtJoint.mjJNT_HINGE,
            axis=[0, 0, 1],
            limited=mujoco.mjtLimited.mjLIMITED_TRUE,
            range=self.door.joint_range,
            **robot.friction(self.door.friction),
        )
        robot.add_geom(door, _DOOR, box, np.array(self.door.size) / 2, cabinet.T_centre)
        robot.allow(None, [FLOOR], [_BODY])
        robot.allow("door_base", [_DOOR], robot.geoms(*robot.mobile), firmness=_SEAL)
        robot.add_body(door, _GRIP, pin.SE3.Identity(), pin.Inertia.Zero()).add_site(name=_GRIP)
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
