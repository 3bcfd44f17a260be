"""Ensemble: the main robot, which a scenario or a person moves, and the compared robots."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import ExitStack

import numpy as np

from app.config import Config
from app.control.contract import check_gains
from app.errors import TargetError
from app.simulation.case import RunCase, RunSpec
from app.simulation.loop.commands import Compare, Pull
from app.simulation.people import Hold, PersonForces
from app.simulation.run import begin
from app.simulation.scenarios.leading import Driver, Scenario, Setting, StepInput
from app.simulation.session import DT, Session, Step, check_posture
from app.simulation.trace.columns import frozen
from app.simulation.trace.metrics import largest
from app.simulation.trace.snapshot import GhostReading, Score
from app.strict import Array

_SAID = 1.0  # [s] simulated time for which snapshots contain a new case
MAX_PULLS = 8  # largest number of people who hold the robot at the same time, without a scenario's


class Ensemble:
    """All robots of the live loop: the main robot, and the compared robots, called ghosts."""

    def __init__(self, free: Session, q_start: Array) -> None:
        """Start the free motion of the main robot, whose session is `free`, at the joint positions
        `q_start` (n_m,) [rad or m]. All scenarios use the plant and the seed of `free`.
        """
        self._free, self._config = free, free.config
        self._led = Runner(free, None)
        self.scenario: Scenario | None = None  # of the last start; None without one
        self.ends: float | None = None  # [s] end of the present scenario; None in free motion
        self.ghosts: list[Runner] = []  # compared robots: equal input, own controllers
        self.comparison = Compare()  # the last `Compare` that started or ended a comparison
        self._holds: dict[int, Hold] = {}
        self._case: RunCase | None = None  # of the scenario of the last start
        self._start = Setting(free.model, free.data, np.zeros(3), np.array(q_start), free.config)
        self._found: tuple[Scenario, Config, Setting] | None = None
        self.reset()

    @property
    def main(self) -> Session:
        """The main robot's session: the argument `free`, or another if a scenario has a door."""
        return self._led.session

    @property
    def leading(self) -> str:
        """Name of the present scenario; empty during free motion."""
        return "" if self.scenario is None or self.ends is None else self.scenario.name

    @property
    def changing(self) -> str:
        """A text about d_b while it changes to its configured value, otherwise empty."""
        now, final = self.main.controller.d_b, self.main.config.border.d_b
        if abs(now - final) < 1e-6:
            return ""
        return f"Buffer d_b: {now:.3f} m, changing to {final:.3f} m"

    @property
    def case(self) -> RunCase | None:
        """Case of the scenario that started in the last simulated second, or None."""
        return self._case if self.main.t < _SAID else None

    def reset(self, q_m: Sequence[float] = (), base_pose: Sequence[float] = (0, 0, 0)) -> None:
        """Start again, as the command `Reset`; a DbbError leaves the present run unchanged."""
        begun = self._start
        if q_m:
            begun = begun._replace(q_m=np.array(q_m), base_pose=np.array(base_pose, float))
        self._enter(begun, None)
        self._begun = begun

    def restart(self) -> None:
        """Play the last scenario again; if the last start had none, repeat the last `reset`."""
        if self.scenario is None:
            self._enter(self._begun, None)
        else:
            self.play(self.scenario)

    def play(self, scenario: Scenario) -> None:
        """Start a scenario; if it cannot start, this raises a DbbError before any change."""
        self._enter(self._setting_of(scenario), scenario)

    def configure(self, config: Config) -> None:
        """Use other parameters, adapted to the scenario; raises as `Session.configure`."""
        adapted = self.scenario.adapted(config) if self.scenario else config
        for runner in (self._led, *self.ghosts):  # of equal periods: only the first can fail
            runner.session.configure(adapted)
        self._config = config

    def compare(self, comparison: Compare) -> None:
        """Start a comparison with the named controllers; if none is named, end the comparison.
        During a scenario, or while the end-effector still holds the door of one, all robots play
        this scenario from its start. Otherwise they start at rest with the present base pose and
        posture of the main robot. If they cannot start, this raises a DbbError before any change.
        """
        if not comparison.controllers:
            self.comparison = comparison
            self._replace_ghosts([])
        elif self.scenario is not None and (self.leading or self.main.door is not None):
            self._enter(self._setting_of(self.scenario), self.scenario, comparison)
        else:
            truth, start = self.main.physics.measure(), self._start
            here = start._replace(base_pose=truth.base_pose, q_m=truth.q_m)
            self._enter(here, None, comparison)

    def pull(self, pull: Pull) -> None:
        """As `Pull`; raises a TargetError if `MAX_PULLS` other people already hold the robot."""
        if pull.who not in self._holds and len(self._holds) >= MAX_PULLS:
            raise TargetError(f"{MAX_PULLS} people already hold the robot, the largest number")
        if pull.link is None:
            self._let_go()
        x, y, z = map(float, (0.0, 0.0, 0.0) if pull.point is None else pull.point)
        target = np.array(pull.target, dtype=float)
        self._holds[pull.who] = Hold(pull.who, target, pull.link, (x, y, z))

    def release(self, who: int) -> None:
        self._holds.pop(who, None)

    def step(self) -> Step:
        """Execute a control step of all robots by scenario and pulls; return the main robot's."""
        if self.ends is not None and self.main.t > self.ends - 0.5 * DT:
            self._let_go()
        holds = tuple(self._holds.values())
        step = self._led.step(holds, scored=bool(self.ghosts))
        for ghost in self.ghosts:
            ghost.step(holds, step.person if self.comparison.same == "force" else None)
        return step

    def scores(self) -> tuple[Score, ...]:
        """Scores of main robot and ghosts in the present comparison; empty without a comparison."""
        compared = (self._led, *self.ghosts) if self.ghosts else ()
        return tuple(runner.score() for runner in compared)

    def close(self) -> None:
        self._replace_ghosts([])
        self._free.close()
        if self.main is not self._free:
            self.main.close()

    def _let_go(self) -> None:
        self.ends = None
        for runner in (self._led, *self.ghosts):
            runner.let_go()

    def _setting_of(self, scenario: Scenario) -> Setting:
        """The start of a scenario, cached until the scenario or the configuration changes."""
        if self._found is None or self._found[:2] != (scenario, self._config):
            free = self._free
            setting = scenario.setting(free.model, free.data, self._config, free.seed)
            self._found = scenario, self._config, setting
        return self._found[2]

    def _enter(
        self, setting: Setting, scenario: Scenario | None, comparison: Compare | None = None
    ) -> None:
        """Start all robots at a setting; a DbbError leaves the present run unchanged."""
        comparison = comparison or self.comparison
        config = scenario.adapted(self._config) if scenario else self._config
        setting, free = setting._replace(config=config), self._free
        names = (self.main.controller.name, *comparison.controllers)
        # A session with a door is not used again, because pybullet's reset does not remove the
        # whole state of the grasp.
        usable = [free, *(g.session for g in self.ghosts if g.session.door is None)]
        old = usable[: len(names)] if setting.door is None else []
        check_posture(setting.model, setting.q_m)
        check_gains(config, config.disturbance.stated_period)
        new: list[Runner] = []
        with ExitStack() as on_error:
            for name in names[len(old) :]:
                session = begin(setting, free.model, name, free.kind, free.seed)
                on_error.callback(session.close)
                new.append(Runner(session, scenario and scenario.driver(session)))
            run = self._config, names[0], free.kind, free.seed
            case = scenario and RunCase.of(RunSpec(free.model.description.name, scenario, *run))
            on_error.pop_all()
        # Nothing below can fail, so the present run continues unchanged after an error.
        for name, session in zip(names, old, strict=False):
            session.controller.use(name)
            session.reset(setting.q_m, setting.base_pose, config)
        again = [Runner(session, scenario and scenario.driver(session)) for session in old]
        led, *ghosts = again + new
        if led.session is not self.main and self.main is not free:
            self.main.close()
        self._led, self.scenario, self.comparison = led, scenario, comparison
        self.ends, self._case = scenario and scenario.duration, case
        self._holds.clear()
        self._replace_ghosts(ghosts)

    def _replace_ghosts(self, ghosts: list[Runner]) -> None:
        former, self.ghosts = self.ghosts, ghosts
        continuing = [ghost.session for ghost in ghosts]
        for ghost in former:
            if ghost.session not in continuing:
                ghost.session.close()


class Runner:
    """One robot of the ensemble: its session, its driver and its results (`Score`)."""

    def __init__(self, session: Session, driver: Driver | None) -> None:
        """Use a session at its start, and the driver of its scenario; None without a scenario."""
        self.session, self._driver = session, driver
        self._score = Score("", math.inf, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0)
        self._complete = False
        self._clearance = math.inf  # [m] smallest distance of the pairs of L_m at the last step
        self._before: tuple[Array, ...] | None = None  # quantities of the last counted step
        self._angular = np.array([axis.angular for axis in session.model.description.base.axes])

    def let_go(self) -> None:
        """End the scenario's motion, if any; later steps then do not count in the score."""
        self._complete = self._complete or self._driver is not None
        self._driver = None

    def step(
        self, holds: tuple[Hold, ...], forces: PersonForces | None = None, *, scored: bool = True
    ) -> Step:
        """Execute one `Session.step` with the driver's input and `holds`; `forces` replace
        theirs. If `scored`, the step counts in the score until the scenario's motion ends.
        """
        lead = StepInput() if self._driver is None else self._driver(self.session)
        step = self.session.step(*lead._replace(holds=(*lead.holds, *holds)), forces=forces)
        if scored:
            self._clearance = step.distances[: step.control.n_mob].min().item()
            if not self._complete:
                self._count(step)
        return step

    def reading(self) -> GhostReading:
        """The robot's state at the last step, in separate, read-only memory."""
        session, measured = self.session, self.session.state.measurement
        return GhostReading(
            session.controller.name,
            frozen(measured.base_pose),
            frozen(measured.q_m),
            frozen(session.wheel_angles),
            frozen(session.state.T_world_ee.translation),
            self._clearance,
        )

    def score(self) -> Score:
        """The score of all steps that count (see `step`)."""
        return self._score._replace(controller=self.session.controller.name)

    def _count(self, step: Step) -> None:
        score, w = self._score, step.control
        now = step.truth.base_pose[:2], w.a_base_cmd.copy(), w.u_cmd.copy()
        before, self._before = self._before or now, now
        moved, acceleration, torque = (np.abs(a - b) for a, b in zip(now, before, strict=True))
        self._score = Score(
            "",
            min(score.clearance, self._clearance),
            step.ee_error,
            max(score.error_max, step.ee_error),
            score.base_path + math.hypot(*moved.tolist()),
            largest(acceleration[~self._angular], score.acceleration_jump),
            largest(acceleration[self._angular], score.angular_jump),
            largest(torque, score.torque_jump),
            score.contacts + any(step.contacts),
        )
