"""Scenarios on a straight line: a person pulls the end-effector, or it tracks the line."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from typing_extensions import Self

from app.errors import ConfigError, TargetError
from app.simulation.scenarios.leading import Driver, Scenario, Setting, StepInput, check_point
from app.strict import Array

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.config import Config
    from app.control.tasks import Reference
    from app.robot.model import RobotModel
    from app.simulation.session import Session

Point = tuple[float, float, float]


@dataclass(frozen=True)
class LineScenario(Scenario):
    """The target of the end-effector moves on a straight line in the world, with a cubic profile.
    The base starts at the origin and faces +x.
    """

    duration: float
    """[s] duration of the run. Without a release, the motion along the line takes a fixed share of
    it."""
    mode: Literal["guiding", "tracking"]
    """"guiding": a person pulls the end-effector; "tracking": the end-effector tracks the line."""
    start: Point
    """[m] start of the end-effector, in the world; a start in the robot's description replaces the
    default."""
    move: Point
    """[m] displacement of the end-effector, in the world; a displacement in the robot's description
    replaces the default."""
    moving: float
    """[-] ratio of the motion's duration to the run's duration. The target rests after the motion.
    A ratio above 1 requires a release: then the run ends before the motion."""
    release_at: float | None = field(default=None, kw_only=True)
    """[s] time at which the person releases the end-effector. The option `duration` then changes
    only the end of the run, not the speed of the motion."""
    regrasp_at: float | None = field(default=None, kw_only=True)
    """[s] time at which the person grasps the end-effector again, and pulls it to the target. The
    target moves on along the line also between release and new grasp."""

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the options; only the mode "guiding" has those of release and new grasp."""
        released = ("release_at", "regrasp_at") if self.mode == "guiding" else ()
        return ("start", "move", "duration", *released)

    def __post_init__(self) -> None:
        super().__post_init__()
        release, regrasp = self.release_at, self.regrasp_at
        if not 0.0 < self.moving < math.inf or (self.moving > 1.0 and release is None):
            why = f"--moving: {self.moving:g} is not a finite number above 0"
            raise ConfigError(f"{why}, or it is above 1 without a release")
        check_point("--start", self.start)
        check_point("--move", self.move)
        if release is None and regrasp is None:
            return
        if self.mode != "guiding":
            option = "--regrasp-at" if release is None else "--release-at"
            raise ConfigError(f"{option}: no person pulls in {self.name}; use a guiding scenario")
        if release is None:
            raise ConfigError("--regrasp-at: there is no release; set --release-at too")
        if not 0.0 < release < self.duration:
            why = f"--release-at: {release:g} s is not after the run's start, 0 s"
            raise ConfigError(f"{why}, and before its end, {self.duration:g} s")
        if regrasp is not None and not release < regrasp < self.duration:
            why = f"--regrasp-at: {regrasp:g} s is not after the release, {release:g} s"
            raise ConfigError(f"{why}, and before the run's end, {self.duration:g} s")

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        q_m = self._posture(model, data, config, seed)
        if (z := self.start[2] + self.move[2]) < 0.0:
            raise TargetError(f"--move: the line ends at z = {z:.3f} m, below the floor at z = 0")
        return Setting(model, data, np.zeros(3), q_m, config)

    def _posture(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Array:
        # Imported here: scipy would delay the start of every command.
        from app.simulation.scenarios.start import find_start

        move = self.move if self.mode == "tracking" else None  # guiding has no orientation
        x, y, z = self.start
        return find_start(model, data.pairs, config.border.d_b, (x, y, z), seed=seed, move=move)

    def changed(self, **changes: Any) -> Self:
        """As `Scenario.changed`; with a `release_at`, a new duration does not change the speed."""
        duration, release = changes.get("duration"), changes.get("release_at")
        released = (self.release_at if release is None else release) is not None
        if released and isinstance(duration, int | float) and 0.0 < duration < math.inf:
            changes.setdefault("moving", self.moving * self.duration / duration)
        return super().changed(**changes)

    def driver(self, session: Session) -> Driver:
        orientation = session.T_world_ee.rotation.copy()
        if self.mode == "tracking":
            return lambda session: StepInput(reference=self.reference(session.t, orientation))
        return lambda session: StepInput(
            pull=self.place(session.t) if self.holds(session.t) else None
        )

    def place(self, t: float) -> Array:
        """(3,) [m] target of the end-effector at time t [s], in the world."""
        s = self._passed(t)
        return np.array(self.start) + s * s * (3 - 2 * s) * np.array(self.move)

    def holds(self, t: float) -> bool:
        """Whether the person holds the end-effector at time t [s]."""
        if self.release_at is None or t < self.release_at:
            return True
        return self.regrasp_at is not None and t >= self.regrasp_at

    def reference(self, t: float, orientation: Array) -> Reference:
        """The end-effector's reference at time t [s], with a constant orientation (3, 3)."""
        import pinocchio as pin

        from app.control.tasks import Reference

        T, s = self.duration * self.moving, self._passed(t)
        # First and second derivative [1/s, 1/s²] of the share of the displacement.
        rates = (6 * s * (1 - s) / T, 6 * (1 - 2 * s) / T**2) if 0.0 <= t <= T else (0.0, 0.0)
        v, a = (np.array([rate * x for x in self.move] + 3 * [0.0]) for rate in rates)
        return Reference(pin.SE3(orientation, self.place(t)), v, a)

    def _passed(self, t: float) -> float:
        """[-] share of the motion's duration that has passed at time t [s], 0 to 1."""
        return min(max(t / (self.duration * self.moving), 0.0), 1.0)


@dataclass(frozen=True)
class StartedLine(LineScenario):
    """A line that starts at a known posture of the arm, so that no search is necessary."""

    q_m: tuple[float, ...]
    """(n_m,) [rad or m] joint positions of the arm at the start."""

    @property
    def options(self) -> tuple[str, ...]:
        return (*super().options, "moving", "q_m")

    def _posture(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Array:
        del model, data, config, seed
        return np.array(self.q_m)


RANDOM_PULL = StartedLine(  # the template of the cases of a study
    "random-pull", 8.0, "a random pull of a study", "guiding", (0, 0, 0), (0, 0, 0), 1.0, ()
)
