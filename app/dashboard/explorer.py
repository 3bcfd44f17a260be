"""A posture of the robot, and the controller's answer there, while the simulation pauses."""

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

CLOSE = 0.002  # [m] from a place the hand counts as there


class Posture(NamedTuple):
    """Where the robot stands."""

    base_pose: Array
    """(3,) x, y [m] and heading [rad] of the base."""
    q_m: Array
    """(n_m,) [rad or m] the arm's joints."""


class Explorer:
    """Asks the control law about postures, by one control step from rest; for one thread."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud], snapshot: Snapshot) -> None:
        """Begin with the posture of a snapshot."""
        pairs = [(Pair(*pair.name.split("-")), pair.mobile) for pair in snapshot.pairs]
        found = LinkPairs(
            tuple(pair for pair, mobile in pairs if mobile),
            tuple(pair for pair, mobile in pairs if not mobile),
            never=(),
            rates={},
            least_distance_m={},
            samples=0,
            seed=0,
        )
        data = BorderData(found, dict(clouds), "cache")
        self._model = model
        self._session = Session(model, data, snapshot.config, physics="kinematic")
        self._search = PostureSearch(model, found, snapshot.d_b)
        self._asked: tuple[object, ...] = ()
        self._answer = snapshot

    def ask(self, posture: Posture, snapshot: Snapshot) -> Snapshot:
        """A snapshot with the robot in a posture; all else is that of another snapshot."""
        asked = (
            posture.base_pose.tobytes(),
            posture.q_m.tobytes(),
            snapshot.config,
            snapshot.controller,
        )
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
        """(n_m,) [rad or m] each, of the arm's joints."""
        return self._model.q_lower, self._model.q_upper

    def reach(self, posture: Posture, place: Array) -> tuple[Posture, float]:
        """The posture near another with the hand at a place (3,) [m], pointing as there if it can.

        Returns:
            The nearest that the arm comes, and [m] how far off it is.
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
