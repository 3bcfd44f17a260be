"""Starts inside a buffer or in penetration: `python -m benchmarks.way_out --starts 100 --json`.

The results are the time until no pair is fully active, and the torques' changes in one step.
"""

from __future__ import annotations

from collections import Counter
from typing import Literal

import tyro

from app.cli.common import load_robot_and_border, print_result
from app.cli.options import Json
from app.config import Config
from app.jobs.progress import progress_bar
from app.simulation.run import run_scenario
from app.simulation.scenarios.way_out import WayOutScenario


def main(
    starts: int = 100,
    begin: Literal["penetration", "buffer", "arm"] = "penetration",
    robot: str = "husky_panda",
    physics: str = "planar",
    seed: int = 0,
    json: Json = False,
) -> None:
    """Run many starts inside a buffer or in penetration.

    Args:
        starts: Number of starts.
        begin: Kind of start, as for `dbb run way-out`.
        robot: Name of the robot.
        physics: Name of the plant.
        seed: Seed of the first start; each further start has the next seed.
        json: Print only one JSON object.
    """
    model, data = load_robot_and_border(robot)
    scenario, config = WayOutScenario(begin=begin), Config()
    rows = []
    with progress_bar(f"starts with {begin}", starts) as on_progress:
        for k in range(starts):
            figures = run_scenario(
                model, data, scenario, config, physics=physics, seed=seed + k
            ).figures
            rows.append(figures)
            on_progress(k + 1)
    left = [row["clear_since_s"] for row in rows]
    result = {
        "robot": robot,
        "physics": physics,
        "begin": begin,
        "starts": starts,
        "seed": seed,
        "left": sum(t is not None for t in left),
        "stayed_seeds": [seed + k for k, t in enumerate(left) if t is None],
        "slowest_s": max((t for t in left if t is not None), default=None),
        "solver_failures": sum(row["solver_failures"] for row in rows),
        "torque_jump_max_nm": max(row["torque_jump_max_nm"] for row in rows),
        "nearest_pairs": Counter(_nearest(row["min_distance_m"]) for row in rows),
    }
    print_result(result, json=json)


def _nearest(distances: dict[str, float]) -> str:
    return min(distances, key=lambda pair: distances[pair])


if __name__ == "__main__":
    tyro.cli(main)
