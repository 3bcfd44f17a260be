"""One pybullet client: a robot over a floor, and nothing touching that is not meant to."""

from __future__ import annotations

import tempfile
from itertools import combinations
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from app.errors import AssetError, ConfigError
from app.simulation.plants.contact_pairs import ContactPairs
from app.simulation.plants.interface import Contacts
from app.simulation.plants.silence import silence


class _NotHere:
    """Stands for pybullet where it is not installed: whatever is asked of it says so."""

    def __getattr__(self, name: str) -> Any:
        raise ConfigError(
            "this needs pybullet, which is not installed and has no wheels for every Python "
            "(docs/install.md)"
        )


if TYPE_CHECKING:
    import pybullet
else:
    try:
        with silence(1, 2):  # it prints the time of its build
            import pybullet
    except ModuleNotFoundError:
        pybullet = _NotHere()

Array = np.ndarray

GRAVITY = 9.81  # [m/s²]
_NO_CONTACTS = Contacts(False, False, False)


class BulletWorld:
    """A pybullet client of its own; all indices below are pybullet's.

    Attributes:
        client: The client; every call of pybullet needs it.
        robot: The robot's body.
        floor: The floor's body, the plane z = 0.
        links: Index of each link by its name; the root's is -1.
        joints: Index of each joint by its name.
    """

    def __init__(self, urdf: str, dt: float) -> None:
        """Load a robot.

        Args:
            urdf: Text of the URDF, meshes by absolute path.
            dt: [s] one step.

        Raises:
            AssetError: pybullet cannot load the URDF.
        """
        with silence(1):  # warnings about the URDF, on standard output
            self.client = pybullet.connect(pybullet.DIRECT)
            try:
                self._load(urdf)
            except pybullet.error as error:
                pybullet.disconnect(physicsClientId=self.client)
                raise AssetError(f"pybullet cannot load the robot: {error}") from None
        pybullet.setGravity(0, 0, -GRAVITY, physicsClientId=self.client)
        # The solver's early exit would leave errors of 1e-5 rad/s a step in the arm.
        pybullet.setPhysicsEngineParameter(
            fixedTimeStep=dt, solverResidualThreshold=0, physicsClientId=self.client
        )
        self._contact_of: dict[tuple[int, int], str] = {}
        self._at_load: int | None = None

    def allow_contacts(self, pairs: ContactPairs) -> None:
        """Let only these links touch; the rest of the robot passes through itself and the floor.

        Args:
            pairs: Pairs of links that may touch, and are reported when they do.
        """
        for a, b in combinations(self.links.values(), 2):
            self._filter(self.robot, a, b, False)
        for a in self.links.values():
            self._filter(self.floor, a, -1, False)
        for group, names in (("arm_base", pairs.arm_base), ("arm_arm", pairs.arm_arm)):
            for pair in names:
                a, b = (self.links[name] for name in pair)
                self._filter(self.robot, a, b, True)
                self._contact_of[a, b] = self._contact_of[b, a] = group
        for name in pairs.arm_floor:
            self._filter(self.floor, self.links[name], -1, True)
        self._reach_floor = {self.links[name] for name in pairs.arm_floor}

    def contacts(self) -> Contacts:
        """Contacts found in the last step."""
        found = pybullet.getContactPoints(self.robot, physicsClientId=self.client)
        if not found:
            return _NO_CONTACTS
        touching = [c for c in found if _touches(c)]
        groups = {self._contact_of.get((c[3], c[4])) for c in touching if c[1] == c[2]}
        return Contacts(
            arm_base="arm_base" in groups,
            arm_arm="arm_arm" in groups,
            arm_floor=any(self._on_floor(c) for c in touching),
        )

    def depths(self) -> dict[str, float]:
        """[m] how deep the contacts of the last step are, by the fields of `Contacts`."""
        deepest: dict[str, float] = {}
        for c in pybullet.getContactPoints(self.robot, physicsClientId=self.client):
            group = "arm_floor" if self._on_floor(c) else self._contact_of.get((c[3], c[4]))
            if group:
                deepest[group] = max(deepest.get(group, 0.0), -c[8])
        return deepest

    def seen(self, begins: Array, ends: Array) -> Array:
        """(n,) [m] from each begin (n, 3) to the robot or the floor, towards its end; else inf."""
        length = np.linalg.norm(ends - begins, axis=1)
        rays = pybullet.rayTestBatch(begins.tolist(), ends.tolist(), physicsClientId=self.client)
        return np.array(
            [
                each * ray[2] if ray[0] >= 0 else np.inf
                for each, ray in zip(length, rays, strict=True)
            ]
        )

    def _on_floor(self, contact: tuple[Any, ...]) -> bool:
        """Whether it is one of the floor with a link that must not touch it."""
        _, a, b, link_a, link_b = contact[:5]
        return (b == self.floor and link_a in self._reach_floor) or (
            a == self.floor and link_b in self._reach_floor
        )

    def rewind(self) -> None:
        """Back to the state of the first call, contacts and solver included.

        Without it, what is remembered of old contacts makes two equal runs differ in the last bits.
        """
        if self._at_load is None:
            self._at_load = pybullet.saveState(physicsClientId=self.client)
        else:
            pybullet.restoreState(self._at_load, physicsClientId=self.client)

    def step(self) -> None:
        """Advance by one step."""
        pybullet.stepSimulation(physicsClientId=self.client)

    def close(self) -> None:
        """End the client; may be called twice."""
        if self.client >= 0:
            pybullet.disconnect(physicsClientId=self.client)
            self.client = -1

    def _load(self, urdf: str) -> None:
        flags = (
            pybullet.URDF_USE_INERTIA_FROM_FILE
            | pybullet.URDF_USE_SELF_COLLISION
            | pybullet.URDF_USE_SELF_COLLISION_EXCLUDE_PARENT
        )
        client = self.client
        with tempfile.TemporaryDirectory(prefix="dbb-") as folder:
            path = Path(folder) / "robot.urdf"
            path.write_text(urdf, encoding="utf-8")
            self.robot = pybullet.loadURDF(
                str(path), useFixedBase=True, flags=flags, physicsClientId=client
            )
        plane = pybullet.createCollisionShape(pybullet.GEOM_PLANE, physicsClientId=client)
        self.floor = pybullet.createMultiBody(0, plane, physicsClientId=client)
        root = pybullet.getBodyInfo(self.robot, physicsClientId=client)[0].decode()
        self.links, self.joints = {root: -1}, {}
        for i in range(pybullet.getNumJoints(self.robot, physicsClientId=client)):
            info = pybullet.getJointInfo(self.robot, i, physicsClientId=client)
            self.joints[info[1].decode()] = self.links[info[12].decode()] = i
        for i in self.links.values():
            pybullet.changeDynamics(
                self.robot,
                i,
                linearDamping=0,
                angularDamping=0,
                jointDamping=0,
                physicsClientId=client,
            )

    def _filter(self, other: int, a: int, b: int, collide: bool) -> None:
        pybullet.setCollisionFilterPair(
            self.robot, other, a, b, int(collide), physicsClientId=self.client
        )


def _touches(contact: tuple) -> bool:
    distance, normal_force = contact[8], contact[9]  # [m], [N]
    return distance <= 0 or normal_force > 0
