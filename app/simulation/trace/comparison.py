"""Robots side by side under the same input: what each of them came to."""

from __future__ import annotations

import math

from app.simulation.people import Hold, PersonForces
from app.simulation.scenarios.leading import Lead, Leader
from app.simulation.session import Session, Step
from app.simulation.trace.columns import frozen
from app.simulation.trace.metrics import clearance, jumps, largest, path, torque_jump, total
from app.simulation.trace.snapshot import GhostReading, Score
from app.simulation.trace.trace import Recorder, Trace

SAMES = ("path", "force")
"""What robots that are compared have in common: where people pull to, or how strongly."""
MOST_GHOSTS = 2
"""Robots that run beside the one that is led."""

_NEEDED = ("t", "pairs", "ee_error", "in_contact", "u_a", "base_pose", "base_acceleration")
_TOGETHER = 100  # control steps that are looked at together, which is far quicker


class ScoreKeeper:
    """Takes each control step of one robot; keeps its score, in bounded memory."""

    def __init__(self, session: Session) -> None:
        """Begin to count."""
        self._session = session
        self._recorder = Recorder(quantities=_NEEDED)
        self._score = Score("", math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)
        self._rows = 0
        self._frozen = False
        self._clearance = math.inf

    def add(self, step: Step) -> None:
        """Take one control step."""
        self._recorder.add(self._session, step)
        if len(self._recorder) > _TOGETHER:
            self._look()

    @property
    def clearance(self) -> float:
        """[m] least distance of the pairs of L_m at the last step."""
        self._look()
        return self._clearance

    def freeze(self) -> None:
        """Let the score be what it is now; the clearance goes on."""
        self._look()
        self._frozen = True

    def score(self) -> Score:
        """The score so far."""
        self._look()
        return self._score._replace(controller=self._session.controller.name)

    def _look(self) -> None:
        """Add up the rows since the last look; changes are from its last row on."""
        if not len(self._recorder):
            return
        block = self._recorder.taken()
        new = block.rows(slice(1 if self._rows else 0, None))
        self._rows += len(new)
        if not len(new):
            return
        if not self._frozen:
            self._add_up(block, new)
        now = clearance(new.rows(slice(-1, None)), mobile=True)
        self._clearance = math.inf if now is None else now

    def _add_up(self, block: Trace, new: Trace) -> None:
        score, jump = self._score, jumps(block, "base_acceleration")
        least = clearance(new, mobile=True)
        self._score = Score(
            score.controller,
            score.clearance if least is None else min(score.clearance, least),
            float(new.of("ee_error")[-1]),
            largest(new.of("ee_error"), score.error_max),
            score.base_path + path(block),
            max(score.acceleration_jump, jump["linear_mps2"]),
            max(score.angular_jump, jump["angular_radps2"]),
            torque_jump(block, score.torque_jump),
            score.contacts + total(new, "in_contact"),
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
        """Nothing leads it any more; its score is that of being led."""
        if self._leader is not None:
            self.keeper.freeze()
        self._leader = None

    def step(self, holds: tuple[Hold, ...], person: PersonForces) -> None:
        """One control step, with who holds the other robot and their forces on it."""
        lead = Lead() if self._leader is None else self._leader(self.session)
        forces = person if self._same_force else None
        lead = lead._replace(holds=(*lead.holds, *holds))
        self.keeper.add(self.session.step(*lead, forces=forces))

    def reading(self) -> GhostReading:
        """How it stands after the last step; shares no memory with it, and is read-only."""
        session, measured = self.session, self.session.state.measurement
        return GhostReading(
            session.controller.name,
            frozen(measured.base_pose),
            frozen(measured.q_m),
            frozen(session.wheel_angles),
            frozen(session.state.T_world_ee.translation),
            self.keeper.clearance,
        )
