"""`dbb serve`: the dashboard in the browser."""

from __future__ import annotations

import sys
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from app.avoidance.self_collision import BORDERS
from app.cli.common import load_robot_and_border
from app.cli.options import PointOption, check_name, check_point, check_seed, configured, disturbed
from app.config import Config
from app.control.controller import CONTROLLERS
from app.robot.model import RobotModel
from app.simulation.plants import PLANTS
from app.simulation.scenario import LINES

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.simulation.loop import SimulationLoop
    from app.simulation.process_loop import ProcessLoop
    from app.simulation.start import StartSolver

_BEGIN = "guiding-front"  # where the hand stands when the page opens

LOOPS = ("process", "thread")
"""Where the simulation may run."""


def serve(
    robot: str = "husky_panda",
    controller: str | None = None,
    host: str = "127.0.0.1",
    port: int = 8080,
    start: PointOption = None,
    physics: str | None = None,
    seed: int = 0,
    loop: str = "process",
    border: str | None = None,
    config: Path | None = None,
    encoder_noise: float | None = None,
    base_delay: float | None = None,
    mass_error: float | None = None,
    slip: float | None = None,
    replay_case: Path | None = None,
    sweep: Path = Path("out/sweep"),
) -> None:
    """Serve the dashboard: drag the hand, and the base gets out of the way.

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        controller: dbb, one it is compared with (repulsive, barrier), or none for the same stack
            without avoidance (default: dbb, or the replayed case's).
        host: Address to listen at; the default is this machine only.
        port: Port to listen at; 0 takes a free one.
        start: [m] where the hand starts, in the world (default: in front of the base).
        physics: planar, contact or kinematic (default: planar, or the replayed case's).
        seed: Seed of the search for the start and of the noise.
        loop: process, or thread for the simulation inside the server's process, where drawing
            disturbs its real time.
        border: surface, or points for the paper's way, where the acting point jumps (default: the
            configuration's).
        config: File of parameters, TOML, as `dbb config` or the dashboard writes it; what is not in
            it is at its default, and other options come before it.
        encoder_noise: [rad] standard deviation of the noise of each joint's measured position
            (default: 0). This and the next three are sliders too.
        base_delay: [s] from a velocity command to the base's drive, on top of the 10 Hz at which
            commands are renewed (default: 0).
        mass_error: [-] by how much the controller's masses and inertias of the arm are too large
            (default: 0).
        slip: [-] share of the base's commanded motion that is lost at the ground (default: 0).
        replay_case: File of a case, such as those in `failures` of a study: the robot, its start
            and its disturbances are the case's, and a button plays the pull.
        sweep: Folder of `dbb sweep` whose newest map is shown, and where a button writes new ones.
    """
    # Imported here: viser and scipy would make every other command start later.
    from app.dashboard.robot import RobotParts
    from app.dashboard.server import check_address, serve_dashboard
    from app.simulation.loop import SimulationLoop
    from app.simulation.process_loop import ProcessLoop
    from app.simulation.session import Session
    from app.simulation.start import StartSolver
    from app.study.case import check_no_others, read_case

    case = None
    if replay_case is not None:
        case = read_case(replay_case)
        check_no_others(
            start=start, encoder_noise=encoder_noise, base_delay=base_delay,
            mass_error=mass_error, slip=slip, config=config,
        )  # fmt: skip
        robot, seed = case.robot, case.seed
    controller = controller or (case.controller if case else "dbb")
    physics = physics or (case.physics if case else PLANTS[0])
    check_name("controller", controller, CONTROLLERS)
    check_name("physics", physics, PLANTS)
    check_name("loop", loop, LOOPS)
    if border is not None:
        check_name("border", border, BORDERS)
    check_point("--start", start)
    check_seed(seed)
    check_address(host, port)
    tuned = case.config() if case else configured(config)
    if border is not None:
        tuned = tuned.replace("border.kind", border)
    tuned = disturbed(
        tuned, encoder_noise=encoder_noise, base_delay=base_delay, mass_error=mass_error, slip=slip
    )
    model, data = load_robot_and_border(robot)
    make_loop = ProcessLoop if loop == "process" else SimulationLoop

    def begin_loop(
        model: RobotModel, data: BorderData, config: Config, controller: str,
        q_start: np.ndarray | None = None,
    ) -> ProcessLoop | SimulationLoop:  # fmt: skip
        if q_start is None:  # of a robot that a viewer has chosen
            solver = StartSolver(model, data.pairs, config.border.d_b)
            q_start = _start(solver, model, None, seed)
        make_session = partial(
            Session, model, data, config, controller=controller, physics=physics, seed=seed
        )
        made = make_loop(make_session, q_start)
        made.begin()
        return made

    if case is None:
        q_start = _start(StartSolver(model, data.pairs, tuned.border.d_b), model, start, seed)
    else:
        q_start = case.scenario().setting(model, data, tuned, seed).q_m
    simulation = begin_loop(model, data, tuned, controller, q_start)
    try:
        parts = RobotParts(model)  # while the simulation starts
        simulation.start()
        played = case.scenario() if case else None
        server = serve_dashboard(
            simulation, model, data.clouds, host=host, port=port, case=played, sweeps=sweep,
            parts=parts, start_loop=begin_loop,
        )  # fmt: skip
        print(f"Dashboard at {server.address} (Ctrl-C ends it)", file=sys.stderr, flush=True)
        server.run_forever()
    finally:
        simulation.stop()


def _start(solver: StartSolver, model: RobotModel, start: PointOption, seed: int) -> np.ndarray:
    """(n_m,) the arm with the hand where it was asked for, before the base, or ready."""
    own = model.description.lines
    place = own.get(_BEGIN)
    if start is None and own and place is None:  # a robot whose hand does not come there
        return np.array(model.description.arm.ready_position)
    return solver.solve(start or (place.start_m if place else LINES[_BEGIN].start), seed=seed)
