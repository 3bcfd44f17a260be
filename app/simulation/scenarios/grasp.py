"""The start of the door's opening: an arm configuration with the hand at the handle."""

from __future__ import annotations

from collections import Counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.border.mobile import MobileBody
from app.errors import UnreachableError
from app.robot.link_pairs import LinkPairs
from app.robot.model import RobotModel
from app.simulation.plants.door import Door
from app.simulation.scenarios.posture import Found, PostureSearch, manipulability

Array = np.ndarray

_ROLLS = np.radians([0.0, 90.0, 180.0, -90.0])  # of the hand about its own axis
_SEEDS = 80  # starting points of the search per roll
_TOLERANCE = 1e-4  # [m] and [rad]
_LOOSE = 5e-3  # [m] and [rad] of the look ahead
_JOINT_MARGIN = 0.015  # [-] share of a joint's range kept from its limits
_BUFFER_MARGIN = 0.005  # [m] beyond the buffer
_MOST_INSIDE = 0.07  # [m] that a pair may be inside of its buffer on the way
_AHEAD = np.radians(np.arange(3, 94, 3))  # of the door's turning for which there has to be room
_CORRECTIONS = 4  # [-] steps of Newton's method for each turn of the door
_TO_START = 0.5  # [-] share of the way back to the starting posture in each of them


class Grasp(NamedTuple):
    """The arm at the handle.

    Attributes:
        q_m: (n_m,) [rad or m] the arm's joints.
        T_world_ee: The hand's pose: horizontal, its palm to the door.
    """

    q_m: Array
    T_world_ee: pin.SE3


class GraspSolver:
    """Finds an arm configuration for a hand at a door's handle, with every pair outside its buffer.

    Of those found it takes the one that can follow the door farthest, and of these the one with
    the most room on the way, while the base backs off as far as the door makes it.
    """

    def __init__(self, model: RobotModel, pairs: LinkPairs, d_b: float) -> None:
        """Prepare for a robot and a buffer distance [m]."""
        self._model = model
        self._search = PostureSearch(model, pairs, d_b)
        self._front = float(MobileBody(model).upper[0])

    def solve(self, base_pose: Array, door: Door, angle: float, *, seed: int = 0) -> Grasp:
        """The arm at the handle of a door that is open by `angle` [rad].

        Args:
            base_pose: (3,) x, y [m] and heading [rad] of the base.
            door: The door.
            angle: [rad]
            seed: Of the search.

        Raises:
            UnreachableError: There is none.
        """
        rng = np.random.default_rng(seed)
        best = Found(None, 0.0, Counter())
        target = pin.SE3.Identity()
        for roll in _ROLLS:
            rolled = _rolled(door.handle(angle), roll)
            self._search.stand(base_pose)
            found = self._search.best(
                self._search.guesses(rng, _SEEDS),
                lambda q, roll=roll: self._judge(base_pose, door, angle, roll, q),
                target=rolled,
            )
            if found.quality > best.quality:
                best, target = found, rolled
        if best.q_m is None:
            x, y, z = door.handle(angle).translation
            raise UnreachableError(
                f"no configuration of the arm brings the hand to the handle at "
                f"({x:.2f}, {y:.2f}, {z:.2f}) m from a base at ({base_pose[0]:.2f}, "
                f"{base_pose[1]:.2f}) m; place base and handle 0.7 to 1.1 m from each other"
            )
        return Grasp(best.q_m, target)

    def _judge(self, base_pose: Array, door: Door, angle: float, roll: float, q_m: Array) -> float:
        """What a posture at the handle is worth: the door's turns that it can follow, and room."""
        self._search.stand(base_pose)
        room = self._room(_rolled(door.handle(angle), roll), q_m, _TOLERANCE, _BUFFER_MARGIN)
        if room > 0.0:
            room = self._room_ahead(base_pose, door, angle, roll, q_m, room)
            self._search.stand(base_pose)
        return room

    def _room_ahead(
        self, base_pose: Array, door: Door, angle: float, roll: float, q_start: Array, room: float
    ) -> float:
        """[-] one for each turn of the door that the arm can follow, plus the least room there.

        As the controller does, the arm holds on to its starting posture where the hand lets it.
        """
        q_m, followed = q_start, 0
        for turned in _AHEAD:
            target = _rolled(door.handle(angle + turned), roll)
            self._search.stand(self._backed_off(base_pose, door, angle + turned))
            for _ in range(_CORRECTIONS):
                q_m = self._corrected(target, q_m, q_start)
            if (there := self._room(target, q_m, _LOOSE, -_MOST_INSIDE)) <= 0.0:
                break
            followed, room = followed + 1, min(room, there)
        return followed + room

    def _backed_off(self, base_pose: Array, door: Door, angle: float) -> Array:
        """(3,) the base moved back until the door's free edge is outside of its front's buffer."""
        edge = door.pose(angle).act(np.array([0.0, -door.side * door.width, 0.0]))
        x, y, heading = base_pose
        forwards = np.array([np.cos(heading), np.sin(heading)])
        gap = float((edge[:2] - [x, y]) @ forwards) - self._front
        return np.array(
            [*(np.array([x, y]) + min(gap - self._search.d_b, 0.0) * forwards), heading]
        )

    def _corrected(self, target: pin.SE3, q_m: Array, q_start: Array) -> Array:
        """(n_m,) one step towards the target, and in its null space towards a posture."""
        error, J = self._search.linearised(q_m, target)
        back = _TO_START * (q_start - q_m)
        return q_m + back - np.linalg.pinv(J, 1e-3) @ (error + J @ back)

    def _room(self, target: pin.SE3, q_m: Array, tolerance: float, clearance: float) -> float:
        """[-] above zero and below one if the configuration may be used; more is better.

        Args:
            target: Where the hand has to be.
            q_m: (n_m,) [rad or m] the arm's joints.
            tolerance: [m] and [rad] of the hand's pose.
            clearance: [m] least distance of a pair, beyond its buffer.
        """
        search = self._search
        search.place(q_m)
        if np.abs(pin.log6(search.state.T_world_ee.actInv(target)).vector).max() > tolerance:
            return 0.0
        beyond = min(search.distances()) - search.d_b
        joints = search.joint_room(q_m)
        if beyond < clearance or joints < _JOINT_MARGIN:
            return 0.0
        bending = manipulability(search.J_hand)
        return min(joints, 0.15) + 2 * min(bending, 0.05) + 5 * min(beyond - clearance, 0.1)


def _rolled(pose: pin.SE3, roll: float) -> pin.SE3:
    """A hand's pose turned about its own axis."""
    return pose * pin.SE3(pin.rpy.rpyToMatrix(0.0, 0.0, roll), np.zeros(3))
