"""Speed of the plants: `python -m benchmarks.engines`.

It measures the time of a step, a reading and the contacts of each plant with an engine, alternately
in one process; with `--study`, also the time of a study with each engine. `make results
ARGS=engines` measures the scenarios.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from statistics import median
from time import thread_time
from typing import Any

import numpy as np
import tyro

from app.cli.common import load_robot_and_border, print_result
from app.cli.options import Json
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants import make_physics

PLANTS = ("planar", "mujoco", "mujoco-contact")
_STEPS = 200  # [-] steps of each plant in a round


def main(
    rounds: int = 60,
    study: int = 0,
    json: Json = False,
) -> None:
    """Compare the speed of the engines.

    Args:
        rounds: Number of rounds; each round measures all of `PLANTS`.
        study: Number of cases of a study with each engine; 0 means no study.
        json: Print only one JSON object.
    """
    times = time_plants(load_robot_and_border("husky_panda")[0], rounds)
    result: dict[str, Any] = {"times_us": times}
    if study:
        result["study"] = time_study(study)
    print_result(result, json=json)


def time_plants(model: RobotModel, rounds: int) -> dict[str, dict[str, float]]:
    """[µs] processor time of a step of each of `PLANTS`: median and minimum of the rounds.

    The time includes a reading and the contacts. The torques compensate the arm's gravity, and the
    base drives along a gentle curve.
    """
    ready = np.array(model.description.arm.ready_position)
    plants = {name: make_physics(name, model) for name in PLANTS}
    state = RobotState(model)
    state.update(plants["planar"].measure())
    u_a, nobody, command = state.g[2:].copy(), np.zeros(3), np.array([0.1, 0.1])
    taken: dict[str, list[float]] = {name: [] for name in PLANTS}
    for _ in range(rounds):
        for name, plant in plants.items():
            plant.reset(np.zeros(3), ready)
            begin = thread_time()
            for _ in range(_STEPS):
                plant.step(u_a, command, nobody)
                plant.measure()
                plant.contacts()
            taken[name].append(1e6 * (thread_time() - begin) / _STEPS)
    for plant in plants.values():
        plant.close()
    return {name: {"median": median(t), "least": min(t)} for name, t in taken.items()}


def time_study(cases: int, rounds: int = 3) -> dict[str, Any]:
    """[s] processor time of `dbb study` with each engine: minimum of alternating rounds."""
    taken: dict[str, list[float]] = {"planar": [], "mujoco": []}
    for _ in range(rounds):
        for name, times in taken.items():
            with tempfile.TemporaryDirectory() as folder:
                begin = os.times()
                words = f"--cases {cases} --physics {name} --processes 1 --json"
                subprocess.run(
                    [sys.executable, "-m", "app", "study", "--out", folder, *words.split()],
                    check=True,
                    capture_output=True,
                    env={**os.environ, "OMP_NUM_THREADS": "1"},
                )
                times.append(_of_children(os.times()) - _of_children(begin))
    return {"cases": cases, **{name: min(times) for name, times in taken.items()}}


def _of_children(times: os.times_result) -> float:
    return times.children_user + times.children_system


if __name__ == "__main__":
    tyro.cli(main)
