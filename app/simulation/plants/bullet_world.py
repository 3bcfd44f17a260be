"""Robots in pybullet: a base on velocity-controlled planar joints, and a torque-controlled arm."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any
from weakref import finalize
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

from app.errors import AssetError, ConfigError
from app.robot.assets import PLANAR_JOINTS, planar_urdf
from app.robot.description import RobotDescription
from app.robot.model import RobotModel
from app.robot.urdf import origin
from app.simulation.plants.collision_shapes import FLOOR, ContactPairs, link_contact_pairs
from app.simulation.plants.door import Cabinet, Door, OpenDoor, T_link_ee
from app.simulation.plants.interface import (
    GRAVITY,
    PYBULLET_MISSING,
    Contacts,
    HeldDoor,
    Push,
    Wrench,
)
from app.strict import Array
from app.system import decimal_points, flush_c_output


@contextmanager
def silence(*descriptors: int) -> Iterator[None]:
    """Discard output to file descriptors of the process during the `with`, also from C code."""
    _flush()  # at both ends, because buffered output would otherwise be lost or appear later
    with ExitStack() as after, open(os.devnull, "wb") as nowhere:
        for fd in descriptors:
            original = os.dup(fd)
            after.callback(os.close, original)
            after.callback(os.dup2, original, fd)
            os.dup2(nowhere.fileno(), fd)
        after.callback(_flush)
        yield


def _flush() -> None:
    for stream in (sys.stdout, sys.stderr):
        if stream is not None:
            stream.flush()
    flush_c_output()


class _MissingPybullet:
    """A substitute for pybullet if pybullet is not installed: each use raises an error."""

    def __getattr__(self, name: str) -> Any:
        raise ConfigError(f"this {PYBULLET_MISSING}")


if TYPE_CHECKING:
    import pybullet
else:
    try:
        with silence(1, 2):  # pybullet prints the time of its build
            import pybullet
    except ModuleNotFoundError:
        pybullet = _MissingPybullet()

_AWAY = (100.0, 0.0)  # [m] place at which the refrigerator is loaded, far from the robot
_SEAL_STIFFNESS = 2e4  # [N/m] contact stiffness of the door's edge
_SEAL_DAMPING = 500.0  # [N s/m] contact damping of the door's edge
_GRASP_FORCE = 1000.0  # [N] largest force of the grasp
_MOMENTS = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
_DOOR = 0  # pybullet's index of the door's link and of its hinge
_UNDAMPED = {"linearDamping": 0, "angularDamping": 0, "jointDamping": 0}


class Client:
    """A pybullet client with the number `id`; its attributes are pybullet's functions for it."""

    def __init__(self) -> None:
        self.id = pybullet.connect(pybullet.DIRECT)
        # `close` acts once; a client without references ends too, as after a failed setup
        self.close = finalize(self, pybullet.disconnect, self.id)
        self.close.atexit = False  # a thread may still use it

    def __getattr__(self, name: str) -> Any:
        function = partial(getattr(pybullet, name), physicsClientId=self.id)
        setattr(self, name, function)
        return function


class BulletWorld:
    """A robot in a separate client; all indices are pybullet's."""

    def __init__(self, urdf: str, dt: float) -> None:
        """Load a robot from the text of a URDF with absolute paths, and a floor. An error of
        pybullet raises an AssetError; a missing pybullet raises a ConfigError.
        """
        self.client = client = Client()
        # pybullet caches a file by its descriptor, which the system can give to a later file.
        client.setPhysicsEngineParameter(enableFileCaching=0)
        try:
            self.robot = self.load(urdf, self_collision=True)
        except pybullet.error as error:
            self.close()
            raise AssetError(f"pybullet cannot load the robot: {error}") from None
        plane = client.createCollisionShape(pybullet.GEOM_PLANE)
        self.floor = client.createMultiBody(0, plane)  # index of the floor's body, the plane z = 0
        # indices by name; the root link has the index -1
        self.links, self.joints = {client.getBodyInfo(self.robot)[0].decode(): -1}, {}
        for i in range(client.getNumJoints(self.robot)):
            info = client.getJointInfo(self.robot, i)
            self.joints[info[1].decode()] = self.links[info[12].decode()] = i
        client.setGravity(0, 0, -GRAVITY)
        # The solver's early exit would leave errors of 1e-5 rad/s per step in the arm.
        client.setPhysicsEngineParameter(fixedTimeStep=dt, solverResidualThreshold=0)
        self._contact_of: dict[tuple[int, ...], str] = {}  # key: bodies and links, in both orders
        self._at_load: int | None = None

    def load(
        self, urdf: str, place: tuple[float, ...] = (0, 0, 0), *, self_collision: bool = False
    ) -> int:
        """Load a body from a URDF's text, with its root at `place` (3,) [m], and return its index.
        With `self_collision`, links that are not neighbours can touch, and the root is fixed.
        """
        flags = pybullet.URDF_USE_INERTIA_FROM_FILE
        if self_collision:
            flags |= pybullet.URDF_USE_SELF_COLLISION
            flags |= pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        # The system removes a file without a name, also if this process is killed.
        with tempfile.TemporaryFile() as file, silence(1), decimal_points():  # hides warnings
            file.write(urdf.encode())
            file.seek(0)
            path = f"/dev/fd/{file.fileno()}"
            body = self.client.loadURDF(path, place, useFixedBase=self_collision, flags=flags)
        for i in range(-1, self.client.getNumJoints(body)):
            self.client.changeDynamics(body, i, **_UNDAMPED)
        return body

    def allow_contacts(self, pairs: ContactPairs) -> None:
        """Let only these pairs touch; other links, or a link and the floor, overlap freely."""
        places = {name: (self.robot, i) for name, i in self.links.items()}
        places[FLOOR] = self.floor, -1
        for a, b in combinations(places, 2):
            self.allow(places[a], places[b], pairs.get((a, b)) or pairs.get((b, a)))

    def allow(self, a: tuple[int, int], b: tuple[int, int], group: str | None) -> None:
        """Let the links `a` and `b` (indices of body and link) touch if `group` is not None."""
        (body_a, link_a), (body_b, link_b) = a, b
        self.client.setCollisionFilterPair(body_a, body_b, link_a, link_b, int(bool(group)))
        if group:
            self._contact_of[body_a, body_b, link_a, link_b] = group
            self._contact_of[body_b, body_a, link_b, link_a] = group

    def contacts(self) -> Contacts:
        found = self.client.getContactPoints(self.robot)
        # without a gap [m], or with a force [N]
        groups = (self._contact_of.get(c[1:5]) for c in found if c[8] <= 0 or c[9] > 0)
        return Contacts.of(filter(None, groups))

    def depths(self) -> dict[str, float]:
        """[m] depth of the deepest contact for each field of `Contacts` that has a contact."""
        deepest: dict[str, float] = {}
        for c in self.client.getContactPoints(self.robot):
            group = self._contact_of.get(c[1:5])
            if group and c[8] <= 0.0:
                deepest[group] = max(deepest.get(group, 0.0), -c[8])
        return deepest

    def seen(self, begins: Array, ends: Array) -> Array:
        """(n,) [m] length of each ray from `begins` to `ends` (n, 3) [m] to the first hit, or ∞."""
        rays = self.client.rayTestBatch(begins.tolist(), ends.tolist())
        shares = np.array([ray[2] if ray[0] >= 0 else np.inf for ray in rays])
        return np.linalg.norm(ends - begins, axis=1) * shares

    def rewind(self) -> None:
        """Save the state at the first call; later calls restore it, with contacts and solver."""
        if self._at_load is None:
            self._at_load = self.client.saveState()
        else:
            self.client.restoreState(self._at_load)

    def close(self) -> None:
        """End the client; a second call has no effect."""
        self.client.close()


class BulletRobot(BulletWorld):
    """A robot with positions q and velocities v (3 + n_m,): x, y, yaw, then the arm's joints."""

    def __init__(self, model: RobotModel, dt: float, door: OpenDoor | None) -> None:
        """Load the robot; a missing mesh, or an error of pybullet, raises an AssetError."""
        description = model.description
        super().__init__(_plant_urdf(description), dt)
        self.allow_contacts(link_contact_pairs(description))
        arm, base = description.arm, description.base
        # These indices ascend: pybullet numbers a joint before the joints that it moves.
        self.moving = [self.joints[name] for name in (*PLANAR_JOINTS, *arm.joints)]
        self._planar, self._arm = self.moving[:3], self.moving[3:]
        self._limits = [base.traction_limit_n, base.traction_limit_n, base.yaw_limit_nm]
        self._tip, self._tool = self.links[arm.end_effector_link], arm.end_effector_xyz_m
        self._control = partial(self.client.setJointMotorControlArray, self.robot)
        # pybullet adds a holding motor to every joint, which must be disabled for torque control.
        self._control(self._arm, pybullet.VELOCITY_CONTROL, forces=[0.0] * len(self._arm))
        self.door = None if door is None else BulletDoor(self, model, door)

    def reset(self, q: Array) -> None:
        """Put the robot at rest at q (3 + n_m,) [m, rad]; the end-effector grasps any `door`."""
        if self.door is not None:
            self.door.release()
        self.rewind()
        for joint, position in zip(self.moving, q.tolist(), strict=True):
            self.client.resetJointState(self.robot, joint, position, 0.0)
        if self.door is not None:
            self.door.reset()

    def read(self) -> tuple[Array, list[float], Array, Array]:
        """Copies of position (3,) and velocity (3,) of x, y, yaw, and of q_m and q̇_m (n_m,)."""
        states = self.client.getJointStates(self.robot, self.moving)
        q, v = [state[0] for state in states], [state[1] for state in states]
        return np.array(q[:3]), v[:3], np.array(q[3:]), np.array(v[3:])

    def step(
        self, u_a: Array, speeds: Sequence[float], hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        """As `Physics.step`; `speeds` (3,) [m/s, m/s, rad/s] command x, y and yaw in the world."""
        self._control(
            self._planar, pybullet.VELOCITY_CONTROL, targetVelocities=speeds, forces=self._limits
        )
        self._control(self._arm, pybullet.TORQUE_CONTROL, forces=u_a.tolist())
        self._press(self._tip, self._tool, hand_force)
        for push in pushes:
            self._press(self.joints[push.joint], push.p.tolist(), push.force)
        self.client.stepSimulation()

    def mass_and_bias(self, q: Array, v: Array) -> tuple[Array, Array]:
        """The engine's mass matrix (3 + n_m, 3 + n_m) and bias forces (3 + n_m,) at q and v."""
        at, speeds, none = q.tolist(), v.tolist(), [0.0] * len(q)
        M = self.client.calculateMassMatrix(self.robot, at)
        h = self.client.calculateInverseDynamics(self.robot, at, speeds, none)
        return np.array(M), np.array(h)

    def _press(self, link: int, point: Sequence[float], force: Array) -> None:
        """Apply a force (3,) [N] in the world to a point (3,) [m] in the frame of a link."""
        fx, fy, fz = np.asarray(force).tolist()
        if fx == fy == fz == 0.0:
            return
        # Without new kinematics, the point and the lever arm would be those of the previous step.
        state = self.client.getLinkState(self.robot, link, computeForwardKinematics=1)
        place, _ = pybullet.multiplyTransforms(state[4], state[5], point, (0, 0, 0, 1))
        self.client.applyExternalForce(self.robot, link, (fx, fy, fz), place, pybullet.WORLD_FRAME)


class BulletDoor(HeldDoor):
    """The refrigerator in pybullet. Of the robot, only links of the base can touch the door."""

    def __init__(self, world: BulletWorld, model: RobotModel, start: OpenDoor) -> None:
        """Load the refrigerator; `reset` puts it in place."""
        self.door, self._start = start
        self._client = client = world.client
        self._robot = world.robot
        arm = model.description.arm
        self._tip = world.links[arm.end_effector_link]
        self._T_link_ee = T_link_ee(arm)
        self._grasp: int | None = None
        self._cabinet = cabinet = Cabinet(self.door)
        height = cabinet.T_world.translation[2]
        self.body = world.load(_refrigerator_urdf(self.door, cabinet), (*_AWAY, height))
        client.changeDynamics(
            self.body, _DOOR, contactStiffness=_SEAL_STIFFNESS, contactDamping=_SEAL_DAMPING
        )
        friction = {"targetVelocity": 0.0, "force": self.door.friction}
        client.setJointMotorControl2(self.body, _DOOR, pybullet.VELOCITY_CONTROL, **friction)
        covered = model.description.mobile_body.covers
        for name, link in world.links.items():
            group = "door_base" if name in covered else None
            world.allow((self._robot, link), (self.body, -1), None)
            world.allow((self._robot, link), (self.body, _DOOR), group)

    def release(self) -> None:
        if self._grasp is not None:
            self._client.removeConstraint(self._grasp)
            self._grasp = None

    def reset(self) -> None:
        """Put the refrigerator in place, and grasp its door; call `release` before."""
        client = self._client
        pose = pin.SE3ToXYZQUAT(self._cabinet.T_world)
        client.resetBasePositionAndOrientation(self.body, pose[:3], pose[3:])
        client.resetBaseVelocity(self.body, (0, 0, 0), (0, 0, 0))
        client.resetJointState(self.body, _DOOR, -self.door.side * self._start, 0.0)
        T_ee = self._tip_pose()
        links = (self._robot, self._tip), (self.body, _DOOR)
        frames = [pin.SE3ToXYZQUAT(self._com_pose(*link).inverse() * T_ee) for link in links]
        self._grasp = client.createConstraint(
            *links[0],
            *links[1],
            pybullet.JOINT_FIXED,
            [0, 0, 0],
            *(frame[:3].tolist() for frame in frames),
            *(frame[3:].tolist() for frame in frames),
        )
        client.changeConstraint(self._grasp, maxForce=_GRASP_FORCE)

    def angle(self) -> float:
        return -self.door.side * self._client.getJointState(self.body, _DOOR)[0]

    def wrench(self) -> Wrench:
        assert self._grasp is not None, "the end-effector does not hold the door"
        rows = self._client.getConstraintState(self._grasp)
        if not rows:  # before the first step
            return Wrench(np.zeros(3), np.zeros(3))
        return Wrench(-np.array(rows[:3]), -self._tip_pose().rotation @ np.array(rows[3:]))

    def _com_pose(self, body: int, link: int) -> pin.SE3:
        """Pose of a link's centre of mass, the reference of a constraint's frames in pybullet."""
        state = self._client.getLinkState(body, link, computeForwardKinematics=1)
        return pin.XYZQUATToSE3([*state[0], *state[1]])

    def _tip_pose(self) -> pin.SE3:
        state = self._client.getLinkState(self._robot, self._tip, computeForwardKinematics=1)
        return pin.XYZQUATToSE3([*state[4], *state[5]]) * self._T_link_ee


def _plant_urdf(description: RobotDescription) -> str:
    """URDF of the robot, without visuals; only its planar joints and the arm's joints move."""
    tree = ElementTree.fromstring(planar_urdf(description))
    for link in tree.iterfind("link"):
        for visual in link.findall("visual"):  # pybullet would load its mesh
            link.remove(visual)
    for joint in tree.iterfind("joint"):
        if joint.get("name") not in (*PLANAR_JOINTS, *description.arm.joints):
            joint.set("type", "fixed")
    _fuse_fixed(tree, description)
    ElementTree.indent(tree)  # pybullet cannot read long lines
    return ElementTree.tostring(tree, encoding="unicode")


def _fuse_fixed(tree: Element, description: RobotDescription) -> None:
    """Merge suitable links on fixed joints into their parents: pybullet loads at most 128 links."""
    nested = description.nested
    touched = {
        link: (body.name, {pair - {link} for pair in nested if link in pair})
        for body in description.bodies
        for link in body.covers
    }
    links = {str(link.get("name")): link for link in tree.iterfind("link")}
    for joint in [each for each in tree.iterfind("joint") if each.get("type") == "fixed"]:
        parent, child = (str(_part(joint, end).get("link")) for end in ("parent", "child"))
        link = links[child]
        # Suitable: both can touch the same parts, or the child has no shape; not the end-effector.
        alike = touched.get(parent) == touched.get(child) or link.find("collision") is None
        if child == description.arm.end_effector_link or not alike:
            continue
        T = origin(joint, child)
        for collision in link.findall("collision"):
            _place(collision, T * origin(collision, child))
            links[parent].append(collision)
        _weigh(links[parent], _inertia(links[parent]) + T.act(_inertia(link)))
        for outer in tree.iterfind("joint"):
            if (end := outer.find("parent")) is not None and end.get("link") == child:
                end.set("link", parent)
                _place(outer, T * origin(outer, child))
        tree.remove(joint)
        tree.remove(link)


def _place(element: Element, T: pin.SE3) -> None:
    at = element.find("origin")
    at = SubElement(element, "origin") if at is None else at
    at.attrib |= {"xyz": _words(T.translation), "rpy": _words(pin.rpy.matrixToRpy(T.rotation))}


def _inertia(link: Element) -> pin.Inertia:
    """The inertia of a link, in the link's frame."""
    inertial = _part(link, "inertial")
    moments = _part(inertial, "inertia")
    xx, xy, xz, yy, yz, zz = (float(moments.get(key, 0.0)) for key in _MOMENTS)
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    mass = float(_part(inertial, "mass").get("value", 0.0))
    return origin(inertial, str(link.get("name"))).act(pin.Inertia(mass, np.zeros(3), tensor))


def _weigh(link: Element, inertia: pin.Inertia) -> None:
    """Write a link's inertia in principal axes, because pybullet computes these axes inexactly."""
    moments, axes = np.linalg.eigh(inertia.inertia)
    axes[:, 2] = np.cross(axes[:, 0], axes[:, 1])
    inertial = _part(link, "inertial")
    _place(inertial, pin.SE3(axes, inertia.lever))
    _part(inertial, "mass").set("value", repr(inertia.mass))
    values = np.diag(moments)[np.triu_indices(3)].tolist()
    _part(inertial, "inertia").attrib |= dict(zip(_MOMENTS, map(repr, values), strict=True))


def _part(element: Element, tag: str) -> Element:
    found = element.find(tag)
    assert found is not None, tag
    return found


def _refrigerator_urdf(door: Door, cabinet: Cabinet) -> str:
    """URDF of the cabinet with the door on a hinge; the root's frame is at the cabinet's centre."""
    lower, upper = door.joint_range
    return f"""<robot name="refrigerator">
<link name="body">{_box(cabinet.size, cabinet.inertia)}</link>
<link name="door">{_box(door.size, cabinet.door_inertia)}</link>
<joint name="hinge" type="revolute">
<limit lower="{lower!r}" upper="{upper!r}" effort="0" velocity="0"/>
<parent link="body"/><child link="door"/>
<origin xyz="{_words(cabinet.T_hinge.translation)}"/><axis xyz="0 0 1"/>
</joint></robot>"""


def _box(size: Sequence[float], inertia: pin.Inertia) -> str:
    moments = zip("xyz", inertia.inertia.diagonal().tolist(), strict=True)
    I = " ".join(f'i{2 * axis}="{i!r}"' for axis, i in moments)
    origin = f'<origin xyz="{_words(inertia.lever)}"/>'
    return f"""<inertial>{origin}<mass value="{inertia.mass!r}"/>
<inertia {I} ixy="0" ixz="0" iyz="0"/></inertial>
<collision>{origin}<geometry><box size="{_words(size)}"/></geometry></collision>"""


def _words(numbers: Sequence[float] | Array) -> str:
    return " ".join(repr(float(number)) for number in numbers)
