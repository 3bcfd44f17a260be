"""Shared state of all viewers: the simulation, its parameters and record, and background jobs."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from app.border.cloud import Cloud
from app.dashboard.job import Job
from app.dashboard.panels.plots import plot_plans
from app.dashboard.record import Record
from app.dashboard.robot_build import RobotBuild
from app.dashboard.robot_switch import RobotSwitch, RunningRobot
from app.dashboard.scene.robot import RobotParts
from app.dashboard.scene.scene import SceneData
from app.dashboard.tuning import Tuning
from app.robot.model import RobotModel
from app.simulation.loop.loop import LoopHandle
from app.simulation.scenarios.leading import Scenario
from app.simulation.trace.snapshot import Snapshot


class SharedState(SceneData):
    """One for all pages; the drawing thread calls `update` before it draws them.

    Attributes:
        case: A scenario that begins where the loop does, for a button that plays it, or None.
        sweeps: Folder of the maps of sweeps.
        tuning: The parameters, one set for all viewers.
        plans: The plots.
        record: Their values in the last minute.
        sweep_job: A sweep that a viewer has begun.
        robot_switch: To another robot.
        robot_build: Of a new robot from an uploaded zip.
    """

    def __init__(
        self,
        loop: LoopHandle,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        parts: RobotParts | None = None,
        *,
        case: Scenario | None = None,
        sweeps: Path,
        robot_switch: RobotSwitch | None = None,
        before: SharedState | None = None,
    ) -> None:
        """Load what pages need.

        Args:
            loop: A started simulation.
            model: The robot that it simulates.
            clouds: P_i of every pair of L_m, by the pair's name.
            parts: The robot's meshes if they have been read already.
            case: A scenario that a button plays, or None.
            sweeps: Folder of the maps of sweeps.
            robot_switch: To another robot; without, it cannot be switched.
            before: What was shared with another robot: of it stay the parameters, with their
                history, and the jobs for new robots.
        """
        super().__init__(loop, model, clouds, parts)
        self.case, self.sweeps = case, sweeps
        self.tuning = before.tuning if before else Tuning(loop, loop.latest().config)
        self.robot_switch = before.robot_switch if before else robot_switch or RobotSwitch(None)
        self.robot_build = before.robot_build if before else RobotBuild(self.robot_switch)
        self.plans = plot_plans(model, self.pairs)
        self.record = Record(curve for plan in self.plans for curve in plan.curves)
        self.sweep_job = Job()

    def followed_by(self, robot: RunningRobot) -> SharedState:
        """The same with another robot; what was started for this one ends."""
        self.sweep_job.close()
        after = SharedState(
            robot.loop, robot.model, robot.clouds, robot.parts, sweeps=self.sweeps, before=self
        )
        self.tuning.move_to(robot.loop, robot.config)
        return after

    def close(self) -> None:
        """End the background jobs."""
        for job in (self.sweep_job, self.robot_build, self.robot_switch):
            job.close()

    def update(self) -> list[Snapshot]:
        """Extend record and tracks; see `SceneData.update`."""
        new = super().update()
        self.record.extend(new, self.loop.latest().t)
        return new
