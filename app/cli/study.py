"""`dbb study`: random pulls by the thousand, and where safety ends."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import tyro

from app.cli.common import print_json, progress_bar
from app.cli.options import Json, check_name, check_range, check_seed, make_folder
from app.control.controller import CONTROLLERS
from app.errors import ConfigError
from app.robot.assets import load_robot
from app.simulation.plants import chosen_plant
from app.study.parameters import StudyParameters
from app.study.study_range import Interval, StudyRange, bounds

IntervalOption = Annotated[tuple[float, float], tyro.conf.arg(metavar="LOW HIGH")]

_MOST_PROCESSES = 64
_MOST_CASES = 10_000_000
_DEFAULT = StudyRange()


def study(
    cases: int = 2000,
    controller: str = "dbb",
    robot: str = "husky_panda",
    physics: str | None = None,
    speed: IntervalOption = _DEFAULT.speed,
    delay: IntervalOption = _DEFAULT.delay,
    noise: IntervalOption = _DEFAULT.noise,
    mass_error: IntervalOption = _DEFAULT.mass_error,
    slip: IntervalOption = _DEFAULT.slip,
    base_speed: IntervalOption = _DEFAULT.base_speed,
    strength: IntervalOption = _DEFAULT.strength,
    height: IntervalOption = _DEFAULT.height,
    duration: float = _DEFAULT.duration,
    inside: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    scheduler: str | None = None,
    processes: int | None = None,
    out: Path = Path("out/study"),
    seed: int = 0,
    json: Json = False,
) -> None:
    """Pull the hand at the base from random starts, with noise, delay, slip and a wrong model.

    Each case is kept as soon as it is done: a study that was ended goes on where it was when it is
    called again with the same options, and more cases than before are added to it.

    Args:
        cases: How many.
        controller: dbb, one it is compared with (repulsive, barrier), or none for the same stack
            without avoidance.
        robot: Name of the robot; `dbb robots` lists them.
        physics: planar, mujoco, mujoco-contact or kinematic (default: planar where pybullet is
            installed, else mujoco).
        speed: [m/s] largest speed of the person's hand on its way.
        delay: [s] between a velocity command and the base's drive.
        noise: [rad] standard deviation of the noise of each joint's measured position.
        mass_error: [-] by how much the controller takes the arm's masses for too large.
        slip: [-] share of the base's motion that is lost at the ground.
        base_speed: [m/s] v_max, the largest speed that the admittance law may command.
        strength: [N] largest force of the person.
        height: [m] of the hand above the floor, at the start.
        duration: [s] longest run of a case; a slow pull is cut short to fit.
        inside: Draw only cases inside of the envelope that the project states.
        scheduler: Address of a running dask scheduler, whose workers have this project installed
            (default: processes on this machine).
        processes: How many on this machine (default: 2, or as many as there are cores).
        out: Folder for `results.parquet`, `study.json`, `report.html` and `failures/`.
        seed: Seed of the study; case k follows from it and k alone.
        json: Print one JSON object on standard output and nothing else there.
    """
    check_range("--cases", cases, 1, _MOST_CASES)
    check_name("controller", controller, CONTROLLERS)
    physics = chosen_plant(physics)
    check_seed(seed)
    if processes is not None:
        check_range("--processes", processes, 1, _MOST_PROCESSES)
    intervals = {
        "speed": speed, "delay": delay, "noise": noise, "mass_error": mass_error, "slip": slip,
        "base_speed": base_speed, "strength": strength, "height": height,
    }  # fmt: skip
    for name, interval in intervals.items():
        _check_interval(name, interval)
    check_range("--duration", duration, *bounds("duration"))
    parameters = StudyParameters(
        seed=seed, robot=robot, controller=controller, physics=physics, inside=inside,
        ranges=StudyRange(duration=duration, **intervals),
    )  # fmt: skip
    load_robot(robot)
    make_folder(out)
    # Imported here: dask and pyarrow would make every other command start later.
    from app.study.cluster import default_processes
    from app.study.study import study as run_study

    with progress_bar(f"{cases} cases", cases) as on_progress:
        result = run_study(
            parameters, cases, out, scheduler=scheduler,
            processes=processes or default_processes(), on_progress=on_progress,
        )  # fmt: skip
    if json:
        print_json(result)
    else:
        _print(result, out)


def _check_interval(name: str, interval: Interval) -> None:
    option = f"--{name.replace('_', '-')}"
    for value in interval:
        check_range(option, value, *bounds(name))
    if interval[0] > interval[1]:
        raise ConfigError(f"{option}: LOW {interval[0]:g} is above HIGH {interval[1]:g}")


def _print(result: dict[str, Any], out: Path) -> None:
    for key in (
        "cases",
        "failed",
        "contact",
        "bodies_overlap",
        "arm_contact",
        "arm_bodies_overlap",
        "solver_failure",
        "nan",
        "error",
    ):
        print(f"{key.replace('_', ' '):28} {result[key]}")
    if (least := result["min_clearance_m"]) is not None:
        print(f"{'least distance to the base':28} {least['0_%']:.4g} m, median {least['50_%']:.4g}")
    for name, title in (("inside", "inside the stated envelope"), ("outside", "outside of it")):
        told = result["stated_envelope"][name]
        bound = f", at most {100 * told['rate_bound_95']:.2g} % with 95 % confidence"
        print(f"{title:28} {told['failed']} of {told['cases']} failed{bound}")
    print(f"{out / 'report.html'}")
