"""Postures of the robot, and the controller's response to them, while the simulation is paused."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from app.border.cache import BorderData
from app.border.dbb import Cloud
from app.robot.link_pairs import LinkPairs, Pair
from app.robot.model import RobotModel
from app.simulation.loop.pacing import Pacer
from app.simulation.scenarios.posture import PostureSearch, Target
from app.simulation.session import DT, Session
from app.simulation.trace.snapshot import Snapshot, make_snapshot
from app.strict import Array

CLOSE = 0.002  # [m] tolerance of the end-effector's position


class Posture(NamedTuple):
    """Pose of the base and joint positions of the arm."""

    base_pose: Array
    """(3,) x, y [m] and heading [rad] of the base."""
    q_m: Array
    """(n_m,) [rad or m] joint positions of the arm."""


class Explorer:
    """Evaluates the control law for postures, by one control step from rest; not thread-safe."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud], snapshot: Snapshot) -> None:
        """Start with the posture of a snapshot."""
        mobile, manipulator = (
            tuple(Pair(*pair.name.split("-")) for pair in snapshot.pairs if pair.mobile == kind)
            for kind in (True, False)
        )
        found = LinkPairs(mobile, manipulator, (), {}, {}, samples=0, seed=0)
        data = BorderData(found, dict(clouds), "cache")
        self._model = model
        self._session = Session(model, data, snapshot.config, physics="kinematic")
        self._search = PostureSearch(model, found, snapshot.d_b)
        self._asked: tuple[object, ...] = ()
        self._answer = snapshot

    def ask(self, posture: Posture, snapshot: Snapshot) -> Snapshot:
        """Return a snapshot of the robot in `posture`; other values are those of `snapshot`."""
        asked = *map(np.ndarray.tobytes, posture), snapshot.config, snapshot.controller
        if asked != self._asked:
            session = self._session
            if session.config != snapshot.config:
                session.configure(snapshot.config)
            session.controller.use(snapshot.controller)
            session.reset(np.clip(posture.q_m, *self.limits), posture.base_pose)
            step = session.step()
            self._answer = make_snapshot(session, step, Pacer(DT, 1.0), paused=True)
            self._asked = asked
        about = ("t", "speed", "scenario", "scores", "step_time_us", "realtime_factor", "overruns")
        return replace(self._answer, **{name: getattr(snapshot, name) for name in about})

    @property
    def limits(self) -> tuple[Array, Array]:
        """Lower and upper limits (n_m,) [rad or m] of the arm's joints."""
        return self._model.q_lower, self._model.q_upper

    def reach(self, posture: Posture, place: Array) -> tuple[Posture, float]:
        """Find a posture with the end-effector at a position, starting from another posture.

        The end-effector keeps its direction if possible. Returns the posture that comes closest to
        the position `place` (3,) [m] in the world, and its distance [m] to the position.
        """
        search, best = self._search, (posture, np.inf)
        search.stand(posture.base_pose)
        search.place(posture.q_m)
        points = search.state.T_world_ee.rotation[:, 2].copy()
        for direction in (points, None):
            q_m = search.reach(Target(place, direction), posture.q_m)
            search.place(q_m)
            off = float(np.linalg.norm(search.state.T_world_ee.translation - place))
            if off < best[1]:
                best = posture._replace(q_m=q_m), off
            if off < CLOSE:
                break
        return best
