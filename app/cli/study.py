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
from app.simulation.plants.choice import chosen_plant
from app.studies.pulls.draw_range import Interval, StudyRange, bounds
from app.studies.pulls.parameters import StudyParameters

IntervalOption = Annotated[tuple[float, float], tyro.conf.arg(metavar="LOW HIGH")]


def _also(former: str) -> Any:
    """A former spelling of an option, which goes on working."""
    return tyro.conf.arg(aliases=[former], metavar="LOW HIGH")


_MOST_PROCESSES = 64
_MOST_CASES = 10_000_000
_DEFAULT = StudyRange()


def study(
    cases: int = 2000,
    controller: str = "dbb",
    robot: str = "husky_panda",
    physics: str | None = None,
    speed: IntervalOption = _DEFAULT.speed,
    base_delay: Annotated[IntervalOption, _also("--delay")] = _DEFAULT.base_delay,
    encoder_noise: Annotated[IntervalOption, _also("--noise")] = _DEFAULT.encoder_noise,
    mass_error: IntervalOption = _DEFAULT.mass_error,
    slip: IntervalOption = _DEFAULT.slip,
    v_max: Annotated[IntervalOption, _also("--base-speed")] = _DEFAULT.v_max,
    hand_f_max: Annotated[IntervalOption, _also("--strength")] = _DEFAULT.hand_f_max,
    hand_stiffness: IntervalOption = _DEFAULT.hand_stiffness,
    hand_mass: IntervalOption = _DEFAULT.hand_mass,
    released: float = _DEFAULT.released,
    regrasped: float = _DEFAULT.regrasped,
    height: IntervalOption = _DEFAULT.height,
    duration: float = _DEFAULT.duration,
    inside: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False,
    scheduler: str | None = None,
    processes: int | None = None,
    out: Path = Path("out/study"),
    seed: int = 0,
    json: Json = False,
) -> None:
    """Pull the hand at the base from all around, with noise, delay, slip and a wrong model.

    Weak and strong, soft and stiff, light and heavy hands pull; some let go on the way, and some of
    those take hold again. Each case is kept as soon as it is done: a study that was ended goes on
    where it was when it is called again with the same options, and more cases than before are added
    to it.

    Args:
        cases: How many.
        controller: dbb, one it is compared with (repulsive, barrier), or none for the same stack
            without avoidance.
        robot: Name of the robot; `dbb robots` lists them.
        physics: planar, mujoco, mujoco-contact or kinematic (default: planar where pybullet is
            installed, else mujoco).
        speed: [m/s] largest speed of the person's hand on its way.
        base_delay: [s] between a velocity command and the base's drive.
        encoder_noise: [rad] standard deviation of the noise of each joint's measured position.
        mass_error: [-] by how much the controller takes the arm's masses for too large.
        slip: [-] share of the base's motion that is lost at the ground.
        v_max: [m/s] the largest speed that the admittance law may command.
        hand_f_max: [N] largest force of the person's spring and damper. What is
            exerted is less while the hand gives way, and more while a mass is stopped.
        hand_stiffness: [N/m] of the person's spring; every factor is as likely as every other.
        hand_mass: [kg] of the person's hand and forearm.
        released: [-] share of the pulls in which the person lets go on the way.
        regrasped: [-] share of those in which the person takes hold again.
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
        "speed": speed,
        "base_delay": base_delay,
        "encoder_noise": encoder_noise,
        "mass_error": mass_error,
        "slip": slip,
        "v_max": v_max,
        "hand_f_max": hand_f_max,
        "hand_stiffness": hand_stiffness,
        "hand_mass": hand_mass,
        "height": height,
    }
    shares = {"duration": duration, "released": released, "regrasped": regrasped}
    for name, interval in intervals.items():
        _check_interval(name, interval)
    for name, value in shares.items():
        check_range(f"--{name}", value, *bounds(name))
    parameters = StudyParameters(
        seed=seed,
        robot=robot,
        controller=controller,
        physics=physics,
        inside=inside,
        ranges=StudyRange(duration=duration, released=released, regrasped=regrasped, **intervals),
    )
    load_robot(robot)
    make_folder(out)
    # Imported here: dask and pyarrow would make every other command start later.
    from app.studies.pulls.cluster import default_processes
    from app.studies.pulls.study import study as run_study

    with progress_bar(f"{cases} cases", cases) as on_progress:
        result = run_study(
            parameters,
            cases,
            out,
            scheduler=scheduler,
            processes=processes or default_processes(),
            on_progress=on_progress,
        )
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


def _print_force(counts: dict[str, Any]) -> None:
    if not counts["cases"]:
        return
    high = counts["to_n"]
    name = f"above {counts['from_n']:g}" if high is None else f"{counts['from_n']:g} to {high:g}"
    numbers = (
        f"{counts[key]:{width}}"
        for key, width in (
            ("cases", 5),
            ("failed", 6),
            ("entered_buffer", 6),
            ("bodies_overlap", 7),
            ("contact", 7),
        )
    )
    least, fastest = counts["least_clearance_m"], counts["hand_speed_max_mps"]
    ends = (f"{'–' if value is None else f'{value:.3f}':>10}" for value in (least, fastest))
    print(f"  {name:26} {' '.join(numbers)} {' '.join(ends)}")


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
    print(f"{'came into the buffer':28} {100 * result['entered_buffer_share']:.3g} %")
    if (force := result["hand_force_max_n"]) is not None:
        told = f"{force['0_%']:.3g} to {force['100_%']:.3g} N, median {force['50_%']:.3g}"
        print(f"{'largest force exerted':28} {told}")
    print(f"{'force until near [N]':28} cases failed buffer overlap contact  least [m] hand [m/s]")
    for counts in result["by_force"]:
        _print_force(counts)
    for name, title in (("inside", "inside the stated envelope"), ("outside", "outside of it")):
        told = result["stated_envelope"][name]
        bound = f", at most {100 * told['rate_bound_95']:.2g} % with 95 % confidence"
        print(f"{title:28} {told['failed']} of {told['cases']} failed{bound}")
    print(f"{out / 'report.html'}")
