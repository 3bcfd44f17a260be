"""The robot that is led, in the session that its scenario needs."""

from __future__ import annotations

import numpy as np

from app.config import Config
from app.errors import TargetError
from app.simulation.begin import begin
from app.simulation.commands import Pull
from app.simulation.leading import Lead, Leader, Scenario, Setting
from app.simulation.people import Hold
from app.simulation.session import DT, Session, Step

Array = np.ndarray

MOST_PULLS = 8
"""People who can hold the robot at once."""


class Ensemble:
    """What the loop steps: it begins anew where it is told to, led by a scenario or by the person.

    Attributes:
        main: The session of the robot that is led. The free one serves all scenarios but those
            whose hand holds something: these have one of their own.
        scenario: The one at whose start the last beginning was, or None.
        ends: [s] when it ends, while it leads, else None.
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
        self.main.configure(config if self.scenario is None else self.scenario.adapted(config))

    def choose(self, controller: str) -> None:
        """Use the controller of that name from the next step on."""
        self.main.controller.use(controller)

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
        return self.main.step(*lead, holds=tuple(self._holds.values()))

    def close(self) -> None:
        """Release all plants."""
        self._free.close()
        if self.main is not self._free:
            self.main.close()

    def _let_go(self) -> None:
        self._leader = self.ends = None

    def _setting_of(self, scenario: Scenario) -> Setting:
        """Where a scenario begins; looked for once as long as nothing else is played."""
        if self._found is None or self._found[:2] != (scenario, self._config):
            free = self._free
            setting = scenario.setting(free.model, free.data, self._config, free.seed)
            self._found = scenario, self._config, setting
        return self._found[2]

    def _enter(self, setting: Setting, scenario: Scenario | None) -> None:
        """Put the robot at the beginning of a setting."""
        session = self._session_for(setting)
        if session is not self.main and self.main is not self._free:
            self.main.close()
        session.configure(self._config if scenario is None else scenario.adapted(self._config))
        session.reset(setting.q_m, setting.base_pose)
        self.main, self.scenario = session, scenario
        self._holds.clear()
        self._let_go()
        if scenario is not None:
            self._leader, self.ends = scenario.leader(session), scenario.duration

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
