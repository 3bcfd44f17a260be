"""pybullet and MuJoCo beside each other: `python -m benchmarks.engines --write docs/engines.md`.

The scenarios of the README on both engines and on real wheels, how long a plant's step and reading
takes, all of them in turn in one process, and how long a study takes with each.
"""

from __future__ import annotations

import json as json_module
import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from statistics import median
from time import thread_time
from typing import Annotated, Any

import numpy as np
import tyro

from app.cli.common import load_robot_and_border
from app.config import Config
from app.errors import DbbError
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.choice import make_physics
from app.simulation.run import run_scenario
from app.simulation.scenarios.names import scenario_of
from app.studies.pulls.parameters import code_digest

PLANTS = ("planar", "mujoco", "mujoco-contact")
SCENARIOS = {
    "husky_panda": (
        "guiding-lateral",
        "guiding-front",
        "guiding-above",
        "guiding-fold",
        "tracking",
        "refrigerator",
    ),
    "husky_ur5": ("guiding-lateral", "guiding-front", "tracking"),
    "tiago": ("guiding-lateral", "guiding-front", "tracking"),
}
BEGIN, END = "<!-- begin: python -m benchmarks.engines -->", "<!-- end -->"
_STEPS = 40  # of each plant in a round


def main(
    robots: tuple[str, ...] = tuple(SCENARIOS),
    rounds: int = 300,
    study: int = 0,
    keep: Path = Path("out/engines.json"),
    write: Path | None = None,
    json: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
) -> None:
    """Compare the engines.

    Args:
        robots: Which; those that are not installed are left out.
        rounds: How often the plants' steps are timed in turn.
        study: How many cases of a study are timed with each engine; 0 for none.
        keep: Where results are kept, so that what was ended goes on; of other code they are not
            used.
        write: A page between whose two markers the tables are put.
        json: Print one JSON object.
    """
    kept: dict[str, Any] = {}
    if keep.is_file():
        kept = json_module.loads(keep.read_text(encoding="utf-8"))
    if kept.get("code") != code_digest():
        kept = {"code": code_digest(), "runs": {}}

    def store() -> None:
        keep.parent.mkdir(parents=True, exist_ok=True)
        keep.write_text(json_module.dumps(kept, indent=1), encoding="utf-8")

    for key, figures in _runs(robots, kept["runs"]):
        kept["runs"][key] = figures
        print(key, *figures.values(), file=sys.stderr, flush=True)
        store()
    if "times_us" not in kept:
        kept["times_us"] = time_plants(load_robot_and_border("husky_panda")[0], rounds)
        store()
    if study and kept.get("study", {}).get("cases") != study:
        kept["study"] = time_study(study)
        store()
    if json:
        print(json_module.dumps(kept))
    else:
        print(tables(kept))
    if write is not None:
        before, _, rest = write.read_text(encoding="utf-8").partition(BEGIN)
        _, _, after = rest.partition(END)
        write.write_text(f"{before}{BEGIN}\n{tables(kept)}\n{END}{after}", encoding="utf-8")


def _runs(
    robots: tuple[str, ...], done: dict[str, Any]
) -> Iterator[tuple[str, dict[str, float | int | None]]]:
    """Figures of each scenario that is not done yet, by robot, scenario and plant."""
    for robot in robots:
        wanted = [
            (scenario, plant)
            for scenario in SCENARIOS[robot]
            for plant in PLANTS
            if f"{robot} {scenario} {plant}" not in done
        ]
        if not wanted:
            continue
        try:
            model, data = load_robot_and_border(robot)
        except DbbError as error:
            print(f"{robot}: {error}", file=sys.stderr)
            continue
        for name, plant in wanted:
            scenario = scenario_of(model.description, name)
            figures = run_scenario(model, data, scenario, Config(), physics=plant).figures
            least = "arm_min_clearance_m" if name == "guiding-fold" else "min_clearance_m"
            if name == "refrigerator":
                least = "door_min_distance_m"
            yield (
                f"{robot} {name} {plant}",
                {
                    "least_m": figures[least],
                    "off_m": figures["ee_error_final_m"],
                    "most_off_m": figures["ee_error_max_m"],
                    "base_m": figures["base_displacement_m"],
                    "contacts": figures["contacts"] + figures["arm_contacts"],
                    "opened_s": figures.get("door_opened_80deg_at_s"),
                },
            )


def time_plants(model: RobotModel, rounds: int) -> dict[str, dict[str, float]]:
    """[µs] of the processor for a step and a reading of each plant, median and least of the rounds.

    The arm hangs in its own gravity's torques, the base drives a gentle curve.
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
    """[s] of the processor for `dbb study` with each engine, in turn, on one process."""
    taken: dict[str, list[float]] = {"planar": [], "mujoco": []}
    for seed in range(rounds):
        for name, times in taken.items():
            with tempfile.TemporaryDirectory() as folder:
                begin = os.times()
                subprocess.run(
                    [
                        sys.executable,
                        "-m",
                        "app",
                        "study",
                        "--cases",
                        str(cases),
                        "--physics",
                        name,
                        "--processes",
                        "1",
                        "--seed",
                        str(seed),
                        "--out",
                        folder,
                        "--json",
                    ],
                    check=True,
                    capture_output=True,
                    env={**os.environ, "OMP_NUM_THREADS": "1"},
                )
                times.append(_of_children(os.times()) - _of_children(begin))
    return {"cases": cases, **{name: min(times) for name, times in taken.items()}}


def _of_children(times: os.times_result) -> float:
    return times.children_user + times.children_system


def tables(kept: dict[str, Any]) -> str:
    """What was measured, as Markdown."""
    lines = [
        "| robot, scenario | least distance: pybullet | MuJoCo | wheels | "
        "hand off at the end: pybullet | MuJoCo | wheels | contacts |",
        "|---|---|---|---|---|---|---|---|",
    ]
    for robot, names in SCENARIOS.items():
        for name in names:
            rows = [kept["runs"].get(f"{robot} {name} {plant}") for plant in PLANTS]
            cells = [f"{row['least_m']:.4f} m" if row else "" for row in rows]
            for row in rows:
                off = f"{1e3 * row['off_m']:.2f} mm" if row else ""
                if row and row["opened_s"] is not None:
                    off = f"80° at {row['opened_s']:.1f} s"
                cells.append(off)
            cells.append(", ".join(str(row["contacts"]) if row else "" for row in rows))
            lines.append(f"| `{robot}`, `{name}` | " + " | ".join(cells) + " |")
    times = kept["times_us"]
    lines += [
        "",
        "| plant | step and reading, median | least | of pybullet's least |",
        "|---|---|---|---|",
    ]
    for name, t in times.items():
        share = t["least"] / times["planar"]["least"]
        lines.append(f"| `{name}` | {t['median']:.1f} µs | {t['least']:.1f} µs | {share:.2f} |")
    if study := kept.get("study"):
        factor = study["planar"] / study["mujoco"]
        lines += [
            "",
            f"A study of {study['cases']} cases on one process took "
            f"{study['planar']:.0f} s with pybullet, {study['mujoco']:.0f} s with MuJoCo: "
            f"{factor:.2f} times as fast (the least of three each, in turn).",
        ]
    return "\n".join(lines)


if __name__ == "__main__":
    tyro.cli(main)
