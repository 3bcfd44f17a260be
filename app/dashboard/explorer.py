"""The controller's response to postures of the robot that a viewer chooses."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from app.border.cache import BorderData
from app.border.dbb import Cloud
from app.robot.link_pairs import LinkPairs, Pair
from app.robot.model import RobotModel
from app.simulation.loop.pacing import Pacer
from app.simulation.scenarios.start import PostureSearch, Target
from app.simulation.session import DT, Session
from app.simulation.trace.snapshot import Snapshot, make_snapshot
from app.strict import Array

CLOSE = 0.002  # [m] tolerance of the end-effector's position


class Posture(NamedTuple):
    base_pose: Array  # (3,) x, y [m] and heading [rad] of the base
    q_m: Array  # (n_m,) [rad or m] joint positions of the arm


class Explorer:
    """Computes the controller's response to a posture by one control step; not thread-safe."""

    def __init__(self, model: RobotModel, clouds: Mapping[str, Cloud], snapshot: Snapshot) -> None:
        """Use pairs and parameters of a snapshot; `clouds` has P_i by the names of pairs of L_m."""
        pairs = {Pair(*each.name.split("-")): each.mobile for each in snapshot.pairs}
        mobile = tuple(pair for pair in pairs if pairs[pair])
        manipulator = tuple(pair for pair in pairs if not pairs[pair])
        found = LinkPairs(mobile, manipulator, (), {}, {}, samples=0, seed=0)
        data = BorderData(found, dict(clouds), "cache")
        self._model = model
        self._session = Session(model, data, snapshot.config, physics="kinematic")
        self._search = PostureSearch(model, found, snapshot.d_b)
        self._request: tuple[object, ...] = ()
        self._response = snapshot

    def respond(self, posture: Posture, snapshot: Snapshot) -> Snapshot:
        """Return a snapshot of one control step from rest in `posture`.

        The joint positions are clipped to the joint limits. Parameters, controller, time, run,
        speed, scenario, scores and real-time statistics are those of `snapshot`.
        """
        request = *map(np.ndarray.tobytes, posture), snapshot.config, snapshot.controller
        if request != self._request:
            session = self._session
            session.controller.use(snapshot.controller)
            q_m = np.clip(posture.q_m, self._model.q_lower, self._model.q_upper)
            session.reset(q_m, posture.base_pose, snapshot.config)
            step = session.step()
            self._response = make_snapshot(session, step, Pacer(DT, 1.0), paused=True)
            self._request = request
        about = ["t", "run", "speed", "scenario", "scores"]
        about += ["step_time_us", "realtime_factor", "overruns"]
        return replace(self._response, **{name: getattr(snapshot, name) for name in about})

    def reach(self, posture: Posture, place: Array) -> tuple[Posture, float]:
        """Return a posture with the end-effector near `place` (3,) [m, world], and the error [m].

        The search starts from `posture`, and keeps the base and the direction of the end-effector's
        z axis. If the error is not below `CLOSE`, a second search lets the axis turn; then the
        result with the smaller error is returned.
        """
        search, found = self._search, []
        search.stand(posture.base_pose)
        search.place(posture.q_m)
        z_axis = search.state.T_world_ee.rotation[:, 2].copy()
        for direction in (z_axis, None):
            q_m = search.reach(Target(place, direction), posture.q_m)
            search.place(q_m)
            error = float(np.linalg.norm(search.state.T_world_ee.translation - place))
            found.append((posture._replace(q_m=q_m), error))
            if error < CLOSE:
                break
        return min(found, key=lambda each: each[1])
