"""Ensemble: the session that a scenario or a person leads, and compared sessions beside it."""

from __future__ import annotations

import numpy as np

from app.config import Config
from app.errors import TargetError
from app.simulation.loop.commands import Compare, Pull
from app.simulation.people import Hold
from app.simulation.scenarios.begin import begin
from app.simulation.scenarios.leading import Lead, Leader, Scenario, Setting
from app.simulation.session import DT, Session, Step
from app.simulation.trace.comparison import Ghost, Score, ScoreKeeper

Array = np.ndarray

MOST_PULLS = 8
"""People who can hold the robot at once."""


class Ensemble:
    """All that the loop steps; commands begin it anew at a scenario's start or at the free one.

    Attributes:
        main: The session of the robot that is led. The free one serves all scenarios but those
            whose hand holds something: these have one of their own.
        scenario: The one at whose start the last beginning was, or None.
        ends: [s] when it ends, while it leads, else None.
        ghosts: Robots that run the same input with other controllers.
        comparison: What was asked to be compared last.
    """

    def __init__(self, free: Session, q_start: Array) -> None:
        """Begin at the free start.

        Args:
            free: The session, whose parameters, plant and seed hold in all scenarios.
            q_start: (n_m,) [rad or m] arm configuration at the free start.
        """
        self.main = self._free = free
        self.scenario: Scenario | None = None
        self.ends: float | None = None
        self._config = free.config
        self.ghosts: list[Ghost] = []
        self.comparison = Compare()
        self._leader: Leader | None = None
        self._holds: dict[int, Hold] = {}
        self._start = Setting(free.model, free.data, np.zeros(3), np.array(q_start), free.config)
        self._found: tuple[Scenario, Config, Setting] | None = None
        self.reset()

    @property
    def leading(self) -> str:
        """Name of the scenario that leads the hand now, or empty."""
        return "" if self.scenario is None or self.ends is None else self.scenario.name

    def reset(self) -> None:
        """Begin anew at the free start."""
        self._enter(self._start, None)

    def restart(self) -> None:
        """Begin anew where the last beginning was.

        Raises:
            DbbError: The scenario cannot begin there with what has been configured since.
        """
        if self.scenario is None:
            self.reset()
        else:
            self.play(self.scenario)

    def play(self, scenario: Scenario) -> None:
        """Begin anew at a scenario's start.

        Raises:
            DbbError: It cannot begin there; then nothing has changed.
        """
        self._enter(self._setting_of(scenario), scenario)

    def configure(self, config: Config) -> None:
        """Use other parameters, which the scenario may adapt, from the next step on."""
        self._config = config
        for session in (self.main, *(ghost.session for ghost in self.ghosts)):
            session.configure(self._adapted(self.scenario))

    def choose(self, controller: str) -> None:
        """Use the controller of that name from the next step on."""
        self.main.controller.use(controller)

    def compare(self, comparison: Compare) -> None:
        """Begin anew with these controllers beside the present one, or end a comparison.

        The beginning is the scenario's start while it leads or its door is held, else where the
        robot stands now, at rest.

        Raises:
            DbbError: It cannot begin so; then nothing has changed.
        """
        before, self.comparison = self.comparison, comparison
        try:
            if not comparison.controllers:
                self._replace_ghosts([])
            elif self.scenario is not None and (self.leading or self.main.door is not None):
                self.play(self.scenario)
            else:
                truth, start = self.main.physics.measure(), self._start
                here = start._replace(base_pose=truth.base_pose, q_m=truth.q_m)
                self._enter(here, None)
        except BaseException:
            self.comparison = before
            raise

    def pull(self, pull: Pull) -> None:
        """Somebody takes the robot or lets go; at the end-effector a scenario leads no longer.

        Raises:
            TargetError: As many as can hold it do so.
        """
        if pull.target is None:
            held = self._holds.pop(pull.who, None)
            if held is None or held.link is None:
                self._let_go()
            return
        if pull.who not in self._holds and len(self._holds) >= MOST_PULLS:
            raise TargetError(f"{MOST_PULLS} people hold the robot already")
        if pull.link is None:
            self._let_go()
        x, y, z = map(float, (0.0, 0.0, 0.0) if pull.point is None else pull.point)
        self._holds[pull.who] = Hold(
            pull.who, np.array(pull.target, dtype=float), pull.link, (x, y, z)
        )

    def release(self, who: int) -> None:
        """Somebody lets go, if he holds the robot."""
        self._holds.pop(who, None)

    def step(self) -> Step:
        """One control step, led by the scenario until it ends; people pull."""
        if self.ends is not None and self.main.t > self.ends - 0.5 * DT:
            self._let_go()
        lead = Lead() if self._leader is None else self._leader(self.main)
        holds = tuple(self._holds.values())
        step = self.main.step(*lead, holds=holds)
        if self.ghosts:
            self._keeper.add(step)
            for ghost in self.ghosts:
                ghost.step(holds, step.person)
        return step

    def scores(self) -> tuple[Score, ...]:
        """Of the robot and its ghosts since the comparison began; none without ghosts."""
        if not self.ghosts:
            return ()
        return tuple(keeper.score() for keeper in (self._keeper, *(g.keeper for g in self.ghosts)))

    def close(self) -> None:
        """Release all plants."""
        self._replace_ghosts([])
        self._free.close()
        if self.main is not self._free:
            self.main.close()

    def _let_go(self) -> None:
        self._leader = self.ends = None
        for ghost in self.ghosts:
            ghost.let_go()

    def _adapted(self, scenario: Scenario | None) -> Config:
        return self._config if scenario is None else scenario.adapted(self._config)

    def _setting_of(self, scenario: Scenario) -> Setting:
        """Where a scenario begins; looked for once as long as nothing else is played."""
        if self._found is None or self._found[:2] != (scenario, self._config):
            free = self._free
            setting = scenario.setting(free.model, free.data, self._config, free.seed)
            self._found = scenario, self._config, setting
        return self._found[2]

    def _enter(self, setting: Setting, scenario: Scenario | None) -> None:
        """Put the robot and its ghosts at the beginning of a setting."""
        setting = setting._replace(config=self._adapted(scenario))
        session = self._session_for(setting)
        others = self._other_sessions(setting)
        for each in (session, *others):
            each.configure(setting.config)
            each.reset(setting.q_m, setting.base_pose)
        if session is not self.main and self.main is not self._free:
            self.main.close()
        self.main, self.scenario = session, scenario
        self._holds.clear()
        same_force = self.comparison.same == "force"
        self._replace_ghosts(
            [
                Ghost(other, scenario and scenario.leader(other), same_force=same_force)
                for other in others
            ]
        )
        self._keeper = ScoreKeeper(session)
        self._leader = scenario and scenario.leader(session)
        self.ends = scenario and scenario.duration

    def _replace_ghosts(self, ghosts: list[Ghost]) -> None:
        """Let these be the ghosts; sessions that none of them has are closed."""
        kept = {id(ghost.session) for ghost in ghosts}
        for ghost in self.ghosts:
            if id(ghost.session) not in kept:
                ghost.session.close()
        self.ghosts = ghosts

    def _other_sessions(self, setting: Setting) -> list[Session]:
        """A session for each ghost, those that are there used again where they can be."""
        free = self._free
        usable = [g.session for g in self.ghosts if g.session.door is None and setting.door is None]
        sessions: list[Session] = []
        for name in self.comparison.controllers:
            if usable:
                sessions.append(usable.pop(0))
                sessions[-1].controller.use(name)
            else:
                sessions.append(
                    begin(setting, free.model, controller=name, physics=free.kind, seed=free.seed)
                )
        return sessions

    def _session_for(self, setting: Setting) -> Session:
        """The free session if it can be that setting's, else a new one, as pybullet's solver keeps
        more of a door that was held than a reset undoes. The controller in use stays in use.
        """
        name = self.main.controller.name
        if setting.door is None and setting.model is self._free.model:
            self._free.controller.use(name)
            return self._free
        free = self._free
        return begin(setting, free.model, controller=name, physics=free.kind, seed=free.seed)
