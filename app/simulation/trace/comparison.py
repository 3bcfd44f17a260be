"""Robots side by side under the same input: what each of them came to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from app.simulation.people import Hold, PersonForces
from app.simulation.scenarios.leading import Lead, Leader
from app.simulation.session import Session, Step
from app.simulation.trace.changes import Batch, Changes, Smoothness

Array = np.ndarray

SAMES = ("path", "force")
"""What robots that are compared have in common: where people pull to, or how strongly."""
MOST_GHOSTS = 2
"""Robots that run beside the one that is led."""


class GhostReading(NamedTuple):
    """A robot beside the one that is led, at one instant."""

    controller: str
    base_pose: Array
    """(3,) x, y [m], φ [rad]."""
    q_m: Array
    """(n_m,) arm joints."""
    wheel_angles: Array
    """(2,) [rad] of the right and the left side, for drawing."""
    p_ee: Array
    """(3,) [m] end-effector in the world."""
    clearance: float
    """[m] least distance of the pairs of L_m now."""


class Score(NamedTuple):
    """What a robot came to since the comparison began."""

    controller: str
    clearance: float
    """[m] least distance of any pair of L_m."""
    error: float
    """[m] from the end-effector to its reference, or to where a person pulls it, now."""
    error_max: float
    """[m] the largest."""
    base_path: float
    """[m] way of the base's centre."""
    acceleration_jump: float
    """[m/s²] largest change in one step of the v̇ that is asked of the base."""
    angular_jump: float
    """[rad/s²] the same of ω̇."""
    torque_jump: float
    """[N m] largest change of a torque of the arm in one step."""
    contacts: int
    """Control steps in which arm and base touched."""


class _Taken(NamedTuple):
    """What the score needs of a control step."""

    clearance: float
    ee_error: float
    contact: bool
    u_a: Array
    base_pose: Array
    base_acceleration: Array


class ScoreKeeper:
    """Takes each control step of one robot; keeps its score."""

    def __init__(self, session: Session) -> None:
        """Begin to count."""
        self._session = session
        self._base = session.model.body_names[0]
        self._least, self._error_max = float("inf"), 0.0
        self._last: Step | None = None
        self._batch: Batch[_Taken] = Batch(self._take)
        self._changes, self._asked = Changes(), Smoothness(session.model.description.base)
        self._contacts = 0

    def add(self, step: Step) -> None:
        """Take one control step."""
        self._last = step
        self._batch.add(
            _Taken(
                self._clearance(step),
                step.ee_error,
                step.contacts.arm_base,
                step.output.u_a,
                step.truth.base_pose,
                step.output.base_acceleration,
            )
        )

    def _take(self, steps: Sequence[_Taken]) -> None:
        clearances, errors, contacts, torques, poses, asked = zip(*steps, strict=True)
        self._least = min(self._least, *clearances)
        self._error_max = max(self._error_max, *errors)
        self._contacts += sum(contacts)
        self._changes.add(np.array(torques), np.array(poses))
        self._asked.add(np.array(asked))

    def _clearance(self, step: Step) -> float:
        pairs = zip(step.output.avoidance.pairs, step.distances, strict=True)
        mobile = (d for pair, d in pairs if pair.closest.pair.a == self._base)
        return min(mobile, default=float("inf"))

    @property
    def clearance(self) -> float:
        """[m] least distance of the pairs of L_m at the last step."""
        return float("inf") if self._last is None else self._clearance(self._last)

    def score(self) -> Score:
        """The score so far."""
        self._batch.flush()
        return Score(
            self._session.controller.name,
            self._least,
            0.0 if self._last is None else self._last.ee_error,
            self._error_max,
            self._changes.path,
            *self._asked.jumps,
            self._changes.torque_jump,
            self._contacts,
        )


class Ghost:
    """A robot that runs the same input beside the one that is led, with a plant of its own."""

    def __init__(self, session: Session, leader: Leader | None, *, same_force: bool) -> None:
        """Stand where the other one stands.

        Args:
            session: Its own, at the beginning.
            leader: What leads it, its own sensors read, or None.
            same_force: Whether people act on it with the forces that they have on the other robot,
                rather than pull it to the same places.
        """
        self.session = session
        self.keeper = ScoreKeeper(session)
        self._leader, self._same_force = leader, same_force

    def let_go(self) -> None:
        """Nothing leads it any more."""
        self._leader = None

    def step(self, holds: tuple[Hold, ...], person: PersonForces) -> None:
        """One control step.

        Args:
            holds: People who hold the other robot, and where to.
            person: Their forces on it in this step.
        """
        lead = Lead() if self._leader is None else self._leader(self.session)
        forces = person if self._same_force else None
        self.keeper.add(self.session.step(*lead, holds=holds, forces=forces))

    def reading(self) -> GhostReading:
        """How it stands after the last step."""
        session, measured = self.session, self.session.state.measurement
        return GhostReading(
            session.controller.name,
            measured.base_pose,
            measured.q_m,
            session.wheel_angles,
            session.state.T_world_ee.translation,
            self.keeper.clearance,
        )
