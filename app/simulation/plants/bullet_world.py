"""One pybullet client with a robot and a floor; only selected pairs of links can touch."""

from __future__ import annotations

import os
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Any
from weakref import finalize

import numpy as np

from app.errors import AssetError, ConfigError
from app.simulation.plants import MISSING
from app.simulation.plants.collision_shapes import FLOOR, ContactPairs
from app.simulation.plants.interface import Contacts
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
        raise ConfigError(f"this {MISSING}")


if TYPE_CHECKING:
    import pybullet
else:
    try:
        with silence(1, 2):  # pybullet prints the time of its build
            import pybullet
    except ModuleNotFoundError:
        pybullet = _MissingPybullet()

GRAVITY = 9.81  # [m/s²]
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
        self.client = Client()
        # pybullet caches a file by its descriptor, which the system can give to a later file.
        self.client.setPhysicsEngineParameter(enableFileCaching=0)
        try:
            self.robot = self.load(urdf, self_collision=True)
        except pybullet.error as error:
            self.close()
            raise AssetError(f"pybullet cannot load the robot: {error}") from None
        client = self.client
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
        # The system removes a file without a name at the end of this process.
        with tempfile.TemporaryFile() as file, silence(1), decimal_points():  # hides warnings
            file.write(urdf.encode())
            file.seek(0)
            body = self.client.loadURDF(
                f"/dev/fd/{file.fileno()}",
                basePosition=place,
                useFixedBase=self_collision,
                flags=flags,
            )
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
        """Contacts in the last step."""
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
