"""Scenarios on a straight line: a person pulls the hand along it, or the arm tracks it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
import pinocchio as pin
from typing_extensions import Self

from app.border.cache import BorderData
from app.config import Config
from app.control.tasks import Reference
from app.errors import ConfigError
from app.robot.model import RobotModel
from app.simulation.person import checked_target
from app.simulation.scenarios.leading import Lead, Leader, Scenario, Setting

if TYPE_CHECKING:
    from app.simulation.session import Session

Array = np.ndarray
Point = tuple[float, float, float]
MODES = ("guiding", "tracking")


@dataclass(frozen=True)
class LineScenario(Scenario):
    """The hand is led on a straight line in the world, along a cubic in time, and then held.

    The base starts at the origin facing +x.
    """

    mode: Literal["guiding", "tracking"]
    """Whether a person pulls the hand or the arm tracks the line."""
    start: Point
    """[m] where the hand starts, in the world."""
    move: Point
    """[m] how far it is led, in the world."""
    moving: float
    """[-] share of the duration in which the hand is led; then it is held. Above 1 if the person
    lets go and the run ends before the hand's way does."""
    release_at: float | None = field(default=None, kw_only=True)
    """[s] when the person lets go of the hand, or None."""
    regrasp_at: float | None = field(default=None, kw_only=True)
    """[s] when the person takes hold again, to go on with the motion where it is by then."""

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.mode not in MODES:
            raise ConfigError(f"--mode: {self.mode!r} is none of {', '.join(MODES)}")
        if not 0.0 < self.moving <= (1.0 if self.release_at is None else math.inf):
            raise ConfigError(f"--moving: {self.moving:g} is not within 0 to 1")
        self._check_release()
        for name in ("start", "move"):
            point = np.array(getattr(self, name), dtype=float)
            if point.shape != (3,) or not np.isfinite(point).all():
                raise ConfigError(f"--{name}: {getattr(self, name)!r} is not three finite numbers")

    def setting(self, model: RobotModel, data: BorderData, config: Config, seed: int) -> Setting:
        """See `Scenario.setting`.

        Raises:
            UnreachableError: No start of the arm for this scenario.
            TargetError: The hand would be led below the floor.
        """
        # Imported here: scipy would make every command start later.
        from app.simulation.scenarios.start import find_start

        q_m = find_start(model, data.pairs, config.border.d_b, self.start, seed=seed)
        checked_target(np.add(self.start, self.move))
        return Setting(model, data, np.zeros(3), q_m, config)

    def _check_release(self) -> None:
        """Whether somebody holds the hand who can let go within the run, and take hold after it."""
        release, regrasp = self.release_at, self.regrasp_at
        if release is None and regrasp is None:
            return
        if self.mode != "guiding":
            raise ConfigError(
                f"--release-at: nobody holds the hand in {self.name}, only in guiding scenarios"
            )
        if release is None or not 0.0 < release < self.duration:
            raise ConfigError(
                f"--release-at: {release} s is not within the run, 0 to {self.duration:g} s"
            )
        if regrasp is not None and not release < regrasp < self.duration:
            raise ConfigError(
                f"--regrasp-at: {regrasp:g} s is not within {release:g} to {self.duration:g} s, "
                "from the release to the run's end"
            )

    def changed(self, **changes: Any) -> Self:
        """See `Scenario.changed`; a duration stretches the motion unless the person lets go.

        With `release_at` the motion keeps its pace, and the run ends at the duration.
        """
        duration, release = changes.get("duration"), changes.get("release_at")
        released = (self.release_at if release is None else release) is not None
        if released and duration is not None and math.isfinite(duration) and duration > 0.0:
            changes.setdefault("moving", self.moving * self.duration / duration)
        return super().changed(**changes)

    def leader(self, session: Session) -> Leader:
        """See `Scenario.leader`."""
        orientation = session.T_world_ee.rotation.copy()
        leaders: dict[str, Callable[[float], Lead]] = {
            "tracking": lambda t: Lead(reference=self.reference(t, orientation)),
            "guiding": lambda t: Lead(pull=self.place(t) if self.holds(t) else None),
        }
        at = leaders[self.mode]
        return lambda session: at(session.t)

    def place(self, t: float) -> Array:
        """(3,) [m] the leading point at time t [s]."""
        s = self._passed(t)
        share = s * s * (3 - 2 * s)
        moves = zip(self.start, self.move, strict=True)
        return np.array([begin + share * move for begin, move in moves])

    def holds(self, t: float) -> bool:
        """Whether the person holds the hand at time t [s]."""
        if self.release_at is None or t < self.release_at:
            return True
        return self.regrasp_at is not None and t >= self.regrasp_at

    def position(self, t: float) -> tuple[Array, Array, Array]:
        """Position [m], velocity [m/s], acceleration [m/s²] of the leading point at time t [s]."""
        T, s = self.duration * self.moving, self._passed(t)
        inside = 0.0 <= t <= T
        move = np.array(self.move)
        return (
            self.place(t),
            (6 * s * (1 - s) / T if inside else 0.0) * move,
            (6 * (1 - 2 * s) / T**2 if inside else 0.0) * move,
        )

    def reference(self, t: float, orientation: Array) -> Reference:
        """The end-effector's reference with a constant orientation, (3, 3)."""
        p, v, a = self.position(t)
        zero = np.zeros(3)
        return Reference(
            pin.SE3(orientation, p), np.concatenate([v, zero]), np.concatenate([a, zero])
        )

    def _passed(self, t: float) -> float:
        """[-] of the time in which the point moves, 0 to 1."""
        return min(max(t / (self.duration * self.moving), 0.0), 1.0)
