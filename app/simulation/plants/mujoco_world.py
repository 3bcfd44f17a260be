"""One compiled model of MuJoCo: motors, torques and people's forces in, states and contacts out."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np

from app.simulation.plants.interface import Contacts, Push
from app.simulation.plants.mujoco_robot import RobotSpec

Array = np.ndarray

_NO_CONTACTS = Contacts(False, False, False)
_NO_TORQUE = np.zeros(3)


class MujocoWorld:
    """A specification at work.

    Attributes:
        model, data: MuJoCo's.
        q, v: All positions and velocities, which MuJoCo keeps up to date.
        arm_q, arm_v: Where those of the arm are among them.
    """

    def __init__(self, robot: RobotSpec) -> None:
        """Compile a specification, whose motors have to come before all other dry friction."""
        self.model = model = robot.compile()
        self.data = mujoco.MjData(model)
        self.q, self.v = self.data.qpos, self.data.qvel
        source, arm = robot.model, robot.model.description.arm
        first = model.joint(arm.joints[0])
        self.arm_q = slice(int(first.qposadr[0]), int(first.qposadr[0]) + source.n_m)
        self.arm_v = slice(int(first.dofadr[0]), int(first.dofadr[0]) + source.n_m)
        self._per_step = 1.0 / model.opt.timestep
        self._applied = self.data.qfrc_applied
        self._body_of = {name: model.body(name).id for name in list(source.pin.names)[2:]}
        tool = source.pin.frames[source.ee_frame]
        self._hand = model.body(source.pin.names[tool.parentJoint]).id
        self._tool = tool.placement.translation.copy()
        ids = {model.geom(i).name: i for i in range(model.ngeom)}
        self._group = {}
        for pair, group in robot.pairs.items():
            a, b = (ids[name] for name in pair)
            self._group[a, b] = self._group[b, a] = group

    def rewind(self) -> None:
        """Back to the first state, with nothing remembered of old contacts."""
        mujoco.mj_resetData(self.model, self.data)

    def mass_matrix(self) -> Array:
        """(n_v, n_v) of the last step or forward computation."""
        columns = np.eye(self.model.nv)
        rows = np.empty_like(columns)
        for row, column in zip(rows, columns, strict=True):
            mujoco.mj_mulM(self.model, self.data, row, column)
        return rows

    def step(
        self, u_a: Array, speeds: Sequence[float], hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """Advance by one step.

        Args:
            u_a: (n_m,) [N m or N] torques of the arm.
            speeds: [m/s or rad/s] to which the motors hold their joints.
            hand_force: (3,) [N] on the end-effector's origin, in the world.
            pushes: On other points of the arm.
        """
        data = self.data
        mujoco.mj_step1(self.model, data)
        # Dry friction decelerates by v / dt, against the floor; a motor, against what moves.
        aref = data.efc_aref
        for row, speed in enumerate(speeds, data.ne):  # the motors' rows come after the grasp's
            aref[row] += self._per_step * speed
        self._applied.fill(0.0)
        self._applied[self.arm_v] = u_a
        if any(np.asarray(hand_force).tolist()):
            self._press(self._hand, self._tool, hand_force)
        for push in pushes:
            self._press(self._body_of[push.joint], push.p, push.force)
        mujoco.mj_step2(self.model, data)

    def contacts(self) -> Contacts:
        """Contacts found in the last step."""
        if not self.data.ncon:
            return _NO_CONTACTS
        touching = self.data.contact.geom.tolist()
        found = {self._group[a, b] for a, b in touching} - {None}
        return _NO_CONTACTS._replace(**dict.fromkeys(found, True)) if found else _NO_CONTACTS

    def depths(self) -> dict[str, float]:
        """[m] how deep the contacts of the last step are, by the fields of `Contacts`."""
        deepest: dict[str, float] = {}
        contacts = self.data.contact
        for (a, b), distance in zip(contacts.geom.tolist(), contacts.dist, strict=True):
            if group := self._group[a, b]:
                deepest[group] = max(deepest.get(group, 0.0), -float(distance))
        return deepest

    def seen(self, begins: Array, ends: Array) -> Array:
        """(n,) [m] from each begin (n, 3) to the robot or the floor, towards its end; else inf."""
        mujoco.mj_kinematics(self.model, self.data)
        found, hit = np.full(len(begins), np.inf), np.zeros(1, np.int32)
        for i, (begin, way) in enumerate(zip(begins, ends - begins, strict=True)):
            length = np.linalg.norm(way)
            at = mujoco.mj_ray(self.model, self.data, begin, way / length, None, 1, -1, hit)
            if 0.0 <= at <= length:
                found[i] = at
        return found

    def _press(self, body: int, point: Array, force: Array) -> None:
        """Force (3,) [N] in the world on a point (3,) [m] of a body's frame."""
        data = self.data
        place = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
        mujoco.mj_applyFT(
            self.model, data, np.asarray(force, dtype=float), _NO_TORQUE, place, body, self._applied
        )
