"""What all viewers of a dashboard share: the simulation, its record, and what is costly to make."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from app.border.cloud import Cloud
from app.dashboard.job import Job
from app.dashboard.panels.plots import plot_plans
from app.dashboard.record import Record
from app.dashboard.robots.robot_build import RobotBuild
from app.dashboard.robots.robot_switch import RobotSwitch, RunningRobot
from app.dashboard.scene.borders import Borders
from app.dashboard.scene.robot import RobotParts
from app.dashboard.scene.trails import Tracks
from app.dashboard.tuning import Tuning
from app.robot.model import RobotModel
from app.simulation.loop.loop import LoopHandle
from app.simulation.scenarios.leading import Scenario


class Shared:
    """One for all pages; `update` is called by the drawing thread before it draws them.

    Attributes:
        loop: The simulation.
        model: The robot.
        clouds: P_i of every pair of L_m, by the pair's name.
        parts: Its meshes.
        borders: Its borders.
        tuning: The parameters, one set for all viewers.
        plans: The plots.
        record: Their values in the last minute.
        tracks: Where base and hand have been.
        case: A scenario that begins where the loop does, for a button that plays it, or None.
        sweeps: Folder of the maps of sweeps.
        sweep_job: A sweep that a viewer has begun.
        robot_switch: To another robot.
        robot_build: Of a new robot from an uploaded zip.
    """

    def __init__(
        self,
        loop: LoopHandle,
        model: RobotModel,
        clouds: Mapping[str, Cloud],
        case: Scenario | None,
        sweeps: Path,
        parts: RobotParts | None = None,
        *,
        robot_switch: RobotSwitch | None = None,
        before: Shared | None = None,
    ) -> None:
        """Load what pages need.

        Args:
            loop: A started simulation.
            model: The robot that it simulates.
            clouds: P_i of every pair of L_m, by the pair's name.
            case: A scenario that a button plays, or None.
            sweeps: Folder of the maps of sweeps.
            parts: The robot's meshes if they have been read already.
            robot_switch: To another robot; without, it cannot be switched.
            before: What was shared with another robot: of it stay the parameters, with their
                history, and what is under way for new robots.
        """
        first = loop.latest()
        self.loop, self.model, self.case, self.sweeps = loop, model, case, sweeps
        self.clouds = clouds
        self.pairs = [pair.name for pair in first.pairs]
        """Names of all link pairs, in the order of the snapshots."""
        self.mobile = [pair.name for pair in first.pairs if pair.mobile]
        """Names of those of L_m."""
        self.parts = parts or RobotParts(model)
        self.borders = Borders(model, clouds)
        self.tuning = Tuning(loop, first.config) if before is None else before.tuning
        self.robot_switch = before.robot_switch if before else robot_switch or RobotSwitch(None)
        self.robot_build = before.robot_build if before else RobotBuild(self.robot_switch)
        self.plans = plot_plans(model, self.pairs)
        self.record = Record(curve for plan in self.plans for curve in plan.curves)
        self.tracks = Tracks()
        self.sweep_job = Job()

    def followed_by(self, robot: RunningRobot) -> Shared:
        """The same with another robot; what was started for this one ends."""
        self.sweep_job.close()
        after = Shared(
            robot.loop, robot.model, robot.clouds, None, self.sweeps, robot.parts, before=self
        )
        self.tuning.move_to(robot.loop, robot.config)
        return after

    def close(self) -> None:
        """End what was started beside the simulation."""
        for job in (self.sweep_job, self.robot_build, self.robot_switch):
            job.close()

    def update(self) -> None:
        """Take in what is new."""
        newest = self.loop.latest()
        last = self.tracks.last
        new = self.loop.history(last if newest.t >= last else -1.0)
        self.record.extend(new, newest.t)
        self.tracks.extend(new, newest.t)
