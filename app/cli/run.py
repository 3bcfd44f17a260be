"""`dbb run`: a scenario, headless and faster than real time."""

from __future__ import annotations

import math
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from app.avoidance.self_collision import BORDERS
from app.cli.common import as_json, load_robot_and_border, print_json, progress_bar
from app.cli.options import (
    Json,
    PlaceOption,
    PointOption,
    PoseOption,
    check_file,
    check_name,
    check_parameter,
    check_point,
    check_range,
    check_seed,
    configured,
    disturbed,
    make_folder,
)
from app.control.controller import CONTROLLERS
from app.errors import ConfigError
from app.robot.assets import load_robot
from app.simulation.plants.choice import chosen_plant
from app.simulation.scenarios.names import SCENARIOS, scenario_of

if TYPE_CHECKING:
    from app.simulation.run import RunResult

_DURATIONS = 0.01, 3600.0  # [s] shortest and longest run


def run(
    scenario: Annotated[str | None, tyro.conf.Positional, tyro.conf.arg(metavar="SCENARIO")] = None,
    controller: str | None = None,
    robot: str = "husky_panda",
    start: PointOption = None,
    move: PointOption = None,
    duration: float | None = None,
    release_at: float | None = None,
    physics: str | None = None,
    buffer_distance: float | None = None,
    border: str | None = None,
    config: Path | None = None,
    out: Path | None = None,
    log: Path | None = None,
    seed: int = 0,
    json: Json = False,
    encoder_noise: float | None = None,
    base_delay: float | None = None,
    mass_error: float | None = None,
    slip: float | None = None,
    door_width: float | None = None,
    hinge: Literal["left", "right"] | None = None,
    hinge_position: PlaceOption = None,
    door_friction: float | None = None,
    door_angle: float | None = None,
    door_yaw: float | None = None,
    radial_guess: float | None = None,
    opening_rate: float | None = None,
    base: PoseOption = None,
    begin: Literal["penetration", "buffer", "arm"] | None = None,
    replay_case: Path | None = None,
) -> None:
    """Run a scenario, or a case of a study again, and print its figures.

    Args:
        scenario: guiding-lateral, guiding-front, guiding-above, guiding-fold, tracking, way-out or
            refrigerator. The options from --door-width on are the refrigerator's, --start and
            --move those of the others.
        controller: dbb, one it is compared with (repulsive, barrier), or none for the same stack
            without avoidance (default: dbb, or the replayed case's).
        robot: Name of the robot; `dbb robots` lists them.
        start: [m] where the hand starts, in the world (default: the scenario's).
        move: [m] how far the hand is led, in the world (default: the scenario's).
        duration: [s] of the run (default: the scenario's); a motion along a line scales with it,
            unless the person lets go.
        release_at: [s] when the person lets go of the hand, in the guiding scenarios; the motion
            keeps the scenario's own pace until then, and the run goes on to its duration.
        physics: planar (pybullet, base on velocity motors), mujoco (the same in MuJoCo),
            mujoco-contact (MuJoCo, base on its own wheels) or kinematic (a stand-in without
            physics) (default: planar where pybullet is installed, else mujoco, or the replayed
            case's).
        buffer_distance: [m] d_b (default: the configuration's).
        border: surface, or points for the paper's way, where the acting point jumps (default: the
            configuration's).
        config: File of parameters, TOML, as `dbb config` or the dashboard writes it; what is not in
            it is at its default, and other options come before it.
        out: Folder for `log.csv` and `metrics.json`.
        log: File ending in .csv or .parquet for 50 rows a second with all that the dashboard draws;
            `dbb report` and `dbb replay` take it.
        seed: Seed of everything random in the run.
        json: Print one JSON object on standard output and nothing else there.
        encoder_noise: [rad] standard deviation of the noise of each joint's measured position; its
            velocity is then made from that (default: 0).
        base_delay: [s] from a velocity command to the base's drive, on top of the 10 Hz at which
            commands are renewed (default: 0).
        mass_error: [-] by how much the controller's masses and inertias of the arm are too large;
            negative where they are too small (default: 0).
        slip: [-] share of the base's commanded motion that is lost at the ground (default: 0).
        door_width: [m] from the hinge to the free edge (default: 0.6).
        hinge: Side of the hinge for the robot that stands before the door (default: left).
        hinge_position: [m] of the hinge in the world (default: 1 m ahead and 0.1 m to its side).
        door_friction: [N m] of the hinge (default: 1).
        door_angle: [deg] how far the door is open at the start (default: 0).
        door_yaw: [deg] where one looks who stands before the closed door (default: 0, along x).
        radial_guess: [deg] by how much the first guess of the direction towards the hinge is wrong;
            positive is turned into the door (default: 30).
        opening_rate: [deg/s] how fast the door is opened (default: 2.15).
        base: [m] [m] [deg] where the base starts (default: before the door, farther away from a
            wider one).
        begin: What is wrong at the start of way-out: some pair in penetration, a pair with the base
            inside its buffer, or one within the arm (default: penetration).
        replay_case: File of a case, such as those in `failures` of a study: its start, pull,
            robot, disturbances and seed are the case's, and so are its figures.
    """
    # Imported here: scipy would make every other command start later.
    from app.control.buffer_watch import buffer_warning
    from app.simulation.run import run_scenario
    from app.simulation.trace.run_log import RunLog
    from app.studies.pulls.case import check_no_others, read_case

    case = None
    if replay_case is not None:
        case = read_case(replay_case)
        check_no_others(
            scenario=scenario,
            start=start,
            move=move,
            duration=duration,
            release_at=release_at,
            door_width=door_width,
            hinge=hinge,
            hinge_position=hinge_position,
            door_friction=door_friction,
            door_angle=door_angle,
            door_yaw=door_yaw,
            radial_guess=radial_guess,
            opening_rate=opening_rate,
            base=base,
            begin=begin,
            encoder_noise=encoder_noise,
            base_delay=base_delay,
            mass_error=mass_error,
            slip=slip,
            config=config,
        )
        chosen, robot, seed = case.scenario(), case.robot, case.seed
    elif scenario is not None:
        check_name("scenario", scenario, SCENARIOS)
        chosen = scenario_of(load_robot(robot), scenario)
    else:
        raise ConfigError("Required: a SCENARIO, or --replay-case FILE; see dbb run --help")
    controller = controller or (case.controller if case else "dbb")
    physics = chosen_plant(physics or (case.physics if case else None))
    check_name("controller", controller, CONTROLLERS)
    if border is not None:
        check_name("border", border, BORDERS)
    check_point("--start", start)
    check_point("--move", move)
    check_point("--hinge-position", hinge_position)
    check_point("--base", None if base is None else base[:2])
    check_seed(seed)
    if base is not None:
        check_range("--base", base[2], -360.0, 360.0, "deg")
    if duration is not None:
        check_range("--duration", duration, *_DURATIONS, "s")
    chosen = chosen.changed(
        start=start,
        move=move,
        duration=duration,
        release_at=release_at,
        door_width=door_width,
        hinge=hinge,
        hinge_position=hinge_position,
        door_friction=door_friction,
        door_angle=door_angle,
        door_yaw=door_yaw,
        radial_guess=radial_guess,
        opening_rate=opening_rate,
        begin=begin,
        base=None if base is None else (base[0], base[1], math.radians(base[2])),
    )
    tuned = case.config() if case else configured(config)
    if border is not None:
        tuned = tuned.replace("border.kind", border)
    if buffer_distance is not None:
        check_parameter("--buffer-distance", buffer_distance, "border.d_b")
        tuned = tuned.replace("border.d_b", buffer_distance)
    tuned = disturbed(
        tuned, encoder_noise=encoder_noise, base_delay=base_delay, mass_error=mass_error, slip=slip
    )
    make_folder(out)
    check_file("--log", log, (".csv", ".parquet"))
    model, data = load_robot_and_border(robot)
    recording = None if log is None else RunLog(model, chosen, physics, seed)
    with progress_bar(f"{chosen.name}, {controller}", chosen.duration) as on_progress:
        result = run_scenario(
            model,
            data,
            chosen,
            tuned,
            controller=controller,
            physics=physics,
            seed=seed,
            on_progress=on_progress,
            on_step=recording.add if recording else None,
        )
    if out is not None:
        _write(out, result)
    if log is not None and recording is not None:
        recording.write(log)
    if warning := buffer_warning(result.recorder.buffer, tuned):
        print(f"warning: {warning}", file=sys.stderr)
    if json:
        print_json(result.figures)
        return
    for key, value in result.figures.items():
        print(f"{key:28} {_text(value)}")


def _write(out: Path, result: RunResult) -> None:
    result.recorder.write_log(out / "log.csv")
    (out / "metrics.json").write_text(as_json(result.figures), encoding="utf-8")


def _text(value: object) -> str:
    if isinstance(value, dict):
        return ", ".join(f"{k} {_text(v)}" for k, v in value.items())
    return f"{value:.4g}" if isinstance(value, float) else str(value)
