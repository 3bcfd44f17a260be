"""`dbb serve`: the dashboard in the browser."""

from __future__ import annotations

import ipaddress
import socket
import sys
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

from app.cli import options
from app.cli.common import load_model, say, spec_of_case
from app.config import Config
from app.config_file import checked_host
from app.simulation.case import RunSpec
from app.simulation.scenarios import free_start
from app.simulation.scenarios.leading import Scenario, check_point
from app.simulation.scenarios.line import Point
from app.system import return_freed_memory_early

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.dashboard.server import DashboardServer
    from app.jobs.process import Child
    from app.robot.model import RobotModel
    from app.simulation.loop.process_loop import ProcessLoop

_SWITCH = 0.001  # [s] time after which a thread that serves one viewer lets the drawing thread run


@dataclass(frozen=True)
class Serving:
    """Where the server listens, and from which start or case the simulation begins."""

    host: str = "127.0.0.1"
    """Address to listen on; the default accepts connections only from this machine."""
    port: int = 8080
    """Port to listen on; 0 selects a free port."""
    allow_host: tuple[str, ...] = ()
    """Further name under which browsers reach the server, for example through a proxy; repeat the
    option for several names. The file of --config can also have names:
    [server] allow_host = ["NAME"]."""
    start: Point | None = None
    """[m] start of the end-effector, in the world; default: the start of guiding-front. If
    robot.toml has no [lines.guiding-front], the arm starts in its ready posture."""
    case: Path | None = None
    """File of a case, saved in the dashboard or in the folder `failures` of a study. The case sets
    robot, start, parameters, controller, plant and seed; only --controller, --physics, --border and
    --buffer-distance override the case. A button repeats the case."""

    def __post_init__(self) -> None:
        object.__setattr__(self, "allow_host", tuple(map(checked_host, self.allow_host)))
        if self.start is not None:
            check_point("--start", self.start)


def serve(
    serving: Annotated[options.Given, options.from_record(Serving)],
    setup: options.SetupOptions,
    parameters: options.ParameterOptions,
    config: options.ConfigOption = None,
) -> None:
    """Serve the dashboard, a web page on which you pull the arm."""
    return_freed_memory_early()
    asked = Serving(**serving)
    asked = replace(asked, allow_host=(*asked.allow_host, *options.read(config).hosts))
    chosen: options.Setup | RunSpec
    if asked.case is None:
        chosen, played = options.Setup(**setup), None
        tuned = options.configured(chosen.robot, config, parameters)
    else:
        others = {"start": asked.start, "config": config, **parameters}
        chosen = run = spec_of_case(asked.case, setup, **others)
        tuned, played = options.changed(run.config, parameters), run.scenario
    from app.robot.assets import check_robot_name

    check_robot_name(chosen.robot)
    from app.simulation.loop.process_loop import loop_child

    # The simulation's process imports as much as this one: run both imports in parallel.
    with loop_child() as child:
        _serve(_First(chosen, tuned, asked, played, child))


class _First(NamedTuple):
    """The first robot of the dashboard, and the process for its simulation."""

    setup: options.Setup | RunSpec  # robot, controller, plant and seed
    config: Config
    asked: Serving  # options of the server, and the start
    played: Scenario | None  # the scenario of the case, if any
    child: Child

    def begin_loop(
        self,
        model: RobotModel,
        data: BorderData,
        config: Config,
        controller: str,
        waiting: Child | None = None,
    ) -> ProcessLoop:
        """Begin the first robot's simulation in the process `waiting`, or another robot's in a new
        process (`waiting` is None). The case or --start determines the first robot's start; without
        them, and for another robot, the start is that of `free_start`.
        """
        from app.simulation.loop.process_loop import ProcessLoop
        from app.simulation.session import Session

        seed, given = self.setup.seed, (model, data, config)
        if waiting is not None and self.played is not None:
            q_start = self.played.setting(*given, seed).q_m
        else:
            q_start = free_start(*given, self.asked.start if waiting else None, seed)
        session = partial(
            Session, *given, controller=controller, physics=self.setup.physics, seed=seed
        )
        made = ProcessLoop(session, q_start, waiting)
        made.begin()
        return made


def _serve(first: _First) -> None:
    """Serve the dashboard until Ctrl-C; no variable here keeps a replaced robot in memory."""
    asked, server = first.asked, _opened(first)
    try:
        with suppress(KeyboardInterrupt):  # the regular end, as soon as the address is printed
            print(f"Dashboard at {server.address} (Ctrl-C ends it)", file=sys.stderr, flush=True)
            if not _is_loopback(asked.host):
                say(f"everyone who can reach {asked.host} can move the robot: there is no password")
            server.run_forever()
    finally:
        server.stop()
        server.shared.loop.stop()


def _opened(first: _First) -> DashboardServer:
    from app.dashboard.scene.robot import RobotParts
    from app.dashboard.server import check_address, serve_dashboard

    asked, setup = first.asked, first.setup
    sys.setswitchinterval(_SWITCH)
    check_address(asked.host, asked.port)
    model = load_model(setup.robot)
    data = _border(model)
    simulation = first.begin_loop(model, data, first.config, setup.controller, first.child)
    try:
        parts = RobotParts(model)  # while the simulation starts
        simulation.start()
        return serve_dashboard(
            simulation,
            model,
            data.clouds,
            host=asked.host,
            port=asked.port,
            allowed=asked.allow_host,
            case=first.played,
            parts=parts,
            start_loop=first.begin_loop,
        )
    except BaseException:
        simulation.stop()
        raise


def _border(model: RobotModel) -> BorderData:
    """The stored border. Without it: the stored coarse border, which a background process refines
    for the next start. Without both: a newly sampled full border.
    """
    from app.border.cache import kept_border_data, load_border_data
    from app.border.sampling import QUICK
    from app.dashboard.job import Job, sample_border

    if (kept := kept_border_data(model)) is not None:
        return kept
    if (coarse := kept_border_data(model, QUICK)) is None:
        return load_border_data(model)
    name, job = model.description.name, Job()
    say(f"the border of {name} is coarse; a background process refines it for the next start")
    job.start(name, "refining its border", lambda: job.run(sample_border, name))
    return coarse


def _is_loopback(host: str) -> bool:
    """Whether only programs on this machine can reach `host`, a name or an IP address."""
    found = {info[4][0] for info in socket.getaddrinfo(host, None)}
    return all(ipaddress.ip_address(address).is_loopback for address in found)
