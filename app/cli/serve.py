"""`dbb serve`: the dashboard in the browser."""

from __future__ import annotations

import sys
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from app.avoidance.self_collision import BORDERS
from app.cli.common import load_robot_and_border
from app.cli.options import PointOption, check_name, check_point, check_seed, configured, disturbed
from app.config import Config
from app.control.controller import CONTROLLERS
from app.robot.assets import robot_names
from app.robot.model import RobotModel
from app.simulation.loop.process_loop import LoopChild
from app.simulation.plants.choice import chosen_plant
from app.simulation.scenarios.names import LINES

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.simulation.loop.loop import SimulationLoop
    from app.simulation.loop.process_loop import ProcessLoop
    from app.studies.pulls.case import Case

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
        physics: planar, mujoco, mujoco-contact or kinematic, as for `dbb run` (default: planar
            where pybullet is installed, else mujoco; or the replayed case's).
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
    case = None
    if replay_case is not None:
        from app.studies.pulls.case import check_no_others, read_case

        case = read_case(replay_case)
        check_no_others(
            start=start,
            encoder_noise=encoder_noise,
            base_delay=base_delay,
            mass_error=mass_error,
            slip=slip,
            config=config,
        )
        robot, seed = case.robot, case.seed
    controller = controller or (case.controller if case else "dbb")
    physics = chosen_plant(physics or (case.physics if case else None))
    check_name("robot", robot, robot_names())
    check_name("controller", controller, CONTROLLERS)
    check_name("loop", loop, LOOPS)
    if border is not None:
        check_name("border", border, BORDERS)
    check_point("--start", start)
    check_seed(seed)
    tuned = case.config() if case else configured(config)
    if border is not None:
        tuned = tuned.replace("border.kind", border)
    tuned = disturbed(
        tuned, encoder_noise=encoder_noise, base_delay=base_delay, mass_error=mass_error, slip=slip
    )
    first = _First(robot, controller, physics, seed, tuned, start, case)
    # The simulation's process imports as much as this one: both at once.
    with LoopChild() if loop == "process" else nullcontext() as child:
        _serve(first, child, host=host, port=port, sweeps=sweep)


class _First(NamedTuple):
    """What the dashboard shows at first."""

    robot: str
    controller: str
    physics: str
    seed: int
    config: Config
    start: PointOption
    case: Case | None

    def q_start(self, model: RobotModel, data: BorderData) -> np.ndarray:
        """(n_m,) arm configuration."""
        if self.case is not None:
            return self.case.scenario().setting(model, data, self.config, self.seed).q_m
        return _start(model, data, self.config, self.start, self.seed)


def _serve(first: _First, child: LoopChild | None, *, host: str, port: int, sweeps: Path) -> None:
    """Show it until Ctrl-C; without a process for the simulation in a thread of this one."""
    # Imported here: viser and scipy would make every other command start later.
    from app.dashboard.scene.robot import RobotParts
    from app.dashboard.server import check_address, serve_dashboard
    from app.simulation.loop.loop import SimulationLoop
    from app.simulation.loop.process_loop import ProcessLoop
    from app.simulation.session import Session

    check_address(host, port)
    in_process = child is not None
    model, data = load_robot_and_border(first.robot)

    def begin_loop(
        model: RobotModel,
        data: BorderData,
        config: Config,
        controller: str,
        q_start: np.ndarray | None = None,
        waiting: LoopChild | None = None,
    ) -> ProcessLoop | SimulationLoop:
        if q_start is None:  # of a robot that a viewer has chosen
            q_start = _start(model, data, config, None, first.seed)
        make_session = partial(
            Session,
            model,
            data,
            config,
            controller=controller,
            physics=first.physics,
            seed=first.seed,
        )
        made = (
            ProcessLoop(make_session, q_start, waiting)
            if in_process
            else SimulationLoop(make_session, q_start)
        )
        made.begin()
        return made

    q_start = first.q_start(model, data)
    simulation = begin_loop(model, data, first.config, first.controller, q_start, child)
    try:
        parts = RobotParts(model)  # while the simulation starts
        simulation.start()
        server = serve_dashboard(
            simulation,
            model,
            data.clouds,
            host=host,
            port=port,
            case=first.case.scenario() if first.case else None,
            sweeps=sweeps,
            parts=parts,
            start_loop=begin_loop,
        )
        print(f"Dashboard at {server.address} (Ctrl-C ends it)", file=sys.stderr, flush=True)
        server.run_forever()
    finally:
        simulation.stop()


def _start(
    model: RobotModel, data: BorderData, config: Config, start: PointOption, seed: int
) -> np.ndarray:
    """(n_m,) the arm with the hand where it was asked for, before the base, or ready."""
    from app.simulation.scenarios.start import find_start

    own = model.description.lines
    place = own.get(_BEGIN)
    if start is None and own and place is None:  # a robot whose hand does not come there
        return np.array(model.description.arm.ready_position)
    place_m = start or (place.start_m if place else LINES[_BEGIN].start)
    return find_start(model, data.pairs, config.border.d_b, place_m, seed=seed)
