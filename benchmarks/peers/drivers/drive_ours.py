"""Our own controllers at 1 kHz, with a plant between torques and motion."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from app.border.cache import load_border_data
from app.config import Config
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.simulation.scenarios.line import StartedLine
from app.simulation.session import DT, Session, Step

Array = np.ndarray


class Watch:
    """Records the motion at each step of the libraries, and the time of every control step."""

    def __init__(self, duration: float, every: int) -> None:
        """Prepare for a run of `duration` [s].

        The motion is stored at every `every`-th control step and at the end of the run, the
        computing time at every control step.
        """
        self._every, self._last = every, round(duration / DT) - 1
        self._q: list[Array] = []
        self._times: list[float] = []
        self._d_start: tuple[float, ...] = ()

    def __call__(self, session: Session, step: Step) -> None:
        """Record one control step."""
        k = len(self._times)
        self._times.append(step.duration)
        if k == 0:
            self._d_start = step.distances
        if k % self._every == 0:
            self._q.append(np.concatenate([step.truth.base_pose, step.truth.q_m]))
        if k == self._last:
            end = session.physics.measure()
            self._q.append(np.concatenate([end.base_pose, end.q_m]))

    def arrays(self) -> dict[str, Array]:
        """The arrays of `RUN.npz`, which the module `loop` describes."""
        return {
            "q": np.array(self._q),
            "step_s": np.array(self._times),
            "d_start": np.array(self._d_start),
        }


def main(source: Path, out: Path, controller: str) -> None:
    """Run all paths of a plan with one controller."""
    plan: dict[str, Any] = json.loads((source / "plan.json").read_text(encoding="utf-8"))
    model = RobotModel(load_robot(plan["robot"]))
    data = load_border_data(model, progress=False)
    every = round(plan["dt_s"] / DT)
    for run in plan["runs"]:
        given = plan["lines"][run["path"]]
        line = StartedLine(
            run["path"],
            given["duration_s"],
            "the end-effector is tracked",
            "tracking",
            tuple(given["start_m"]),
            tuple(given["move_m"]),
            1.0,
            tuple(given["q_m_rad"]),
        )
        config = Config().replace("task.base_weight", run["base_weight"])
        config = config.replace("barrier.d_min", plan["d_min_m"])
        config = config.replace("barrier.rate", plan["rate_per_s"])
        watch = Watch(line.duration, every)
        figures = run_scenario(
            model, data, line, config, controller=controller, physics=plan["physics"], on_step=watch
        ).figures
        np.savez(out / f"{run['name']}.npz", failures=figures["solver_failures"], **watch.arrays())


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])
