"""`dbb serve`: the dashboard in the browser."""

from __future__ import annotations

import sys
from functools import partial

from app.avoidance.self_collision import BORDERS
from app.cli.common import load_robot_and_border
from app.cli.options import PointOption, check_name, check_point, check_seed
from app.config import Config
from app.control.controller import CONTROLLERS
from app.simulation.plants import PLANTS
from app.simulation.scenario import LINES

LOOPS = ("process", "thread")
"""Where the simulation may run."""


def serve(
    robot: str = "husky_panda",
    controller: str = "dbb",
    host: str = "127.0.0.1",
    port: int = 8080,
    start: PointOption = None,
    physics: str = "planar",
    seed: int = 0,
    loop: str = "process",
    border: str = "surface",
) -> None:
    """Serve the dashboard: drag the hand, and the base gets out of the way.

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        controller: dbb, one it is compared with (repulsive, barrier), or none for the same stack
            without avoidance.
        host: Address to listen at; the default is this machine only.
        port: Port to listen at; 0 takes a free one.
        start: [m] where the hand starts, in the world (default: in front of the base).
        physics: planar, contact or kinematic.
        seed: Seed of the search for the start.
        loop: process, or thread for the simulation inside the server's process, where drawing
            disturbs its real time.
        border: surface, or points for the paper's way, where the acting point jumps.
    """
    # Imported here: viser and scipy would make every other command start later.
    from app.dashboard.server import check_address, serve_dashboard
    from app.simulation.loop import SimulationLoop
    from app.simulation.process_loop import ProcessLoop
    from app.simulation.session import Session
    from app.simulation.start import StartSolver

    check_name("controller", controller, CONTROLLERS)
    check_name("physics", physics, PLANTS)
    check_name("loop", loop, LOOPS)
    check_name("border", border, BORDERS)
    check_point("--start", start)
    check_seed(seed)
    check_address(host, port)
    config = Config().replace("border.kind", border)
    model, data = load_robot_and_border(robot)
    p_start = start or LINES["guiding-front"].start
    q_start = StartSolver(model, data.pairs, config.border.d_b).solve(p_start, seed=seed)
    make_session = partial(
        Session, model, data, config, controller=controller, physics=physics, seed=seed
    )
    make_loop = ProcessLoop if loop == "process" else SimulationLoop
    simulation = make_loop(make_session, q_start)
    simulation.start()
    try:
        server = serve_dashboard(simulation, model, data.clouds, host=host, port=port)
        print(f"Dashboard at {server.address} (Ctrl-C ends it)", file=sys.stderr, flush=True)
        server.run_forever()
    finally:
        simulation.stop()
