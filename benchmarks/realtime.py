"""Real-time behaviour of the dashboard: `python -m benchmarks.realtime --client browser --drag`.

The hard case is a headless browser that draws in software on the same cores while its mouse drags
the end-effector to the base. The setup is that of `dbb serve`; in addition, the session records its
times. `--drag --listeners 9 --seconds 3600` is a test of one hour with ten viewers.
"""

from __future__ import annotations

import json as json_module
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import psutil
import tyro

from app.cli.common import load_robot_and_border, print_result
from app.cli.options import Json
from app.config import Config
from app.dashboard.server import DashboardServer, serve_dashboard
from app.simulation.loop.commands import Compare, Pull, Reset, Watch
from app.simulation.loop.loop import LoopHandle, SimulationLoop
from app.simulation.loop.process_loop import ProcessLoop
from app.simulation.scenarios import scenario_by_name
from app.simulation.scenarios.start import find_start
from app.simulation.session import DT
from benchmarks.client import FAR, NEAR, SWEEP, SWEEPS
from benchmarks.timed_session import TimedSession, read_times

LOOPS = {"process": ProcessLoop, "thread": SimulationLoop}
SETTLE = 2.0  # [s] between the client's connection and the measurement
PULL_EVERY = 0.05  # [s] time between two pulls without a browser, equal to that of a browser
LOOKS = 200  # [-] number of memory measurements


@dataclass(frozen=True)
class Realtime:
    """Measure the real-time factor of the dashboard."""

    seconds: float = 30.0
    """[s] duration of the measurement."""
    client: Literal["browser", "websocket", "none"] = "browser"
    """Kind of client: a headless browser, a client that draws nothing, or none."""
    clients: int = 1
    """Number of clients of this kind; with --drag only the first one drags."""
    listeners: int = 0
    """Further clients that draw nothing."""
    drag: bool = False
    """Whether the end-effector is dragged to the base and back; a browser does this with its
    mouse."""
    loop: Literal["process", "thread"] = "process"
    """Whether the simulation runs in a process or in a thread."""
    layers: bool = False
    """Whether all layers are shown: both complete borders, bodies, labels, arrows, trails."""
    ghosts: int = 0
    """Number of compared robots with other controllers: 0, 1 or 2."""
    json: Json = False


def main(args: Realtime) -> None:
    """Measure and print."""
    with tempfile.TemporaryDirectory() as folder:
        result = measure(args, Path(folder) / "times")
    print_result(result, json=args.json)


def measure(args: Realtime, record: Path) -> dict[str, Any]:
    """Serve, let the clients work, and evaluate the record of the loop's steps."""
    load = os.getloadavg()[0]
    model, data = load_robot_and_border("husky_panda")
    config, scenario = Config(), scenario_by_name("guiding-front")
    q_start = find_start(model, data.pairs, config.border.d_b, scenario.start)
    loop = LOOPS[args.loop](partial(TimedSession, record, model, data, config), q_start)
    loop.start()
    try:
        server = serve_dashboard(loop, model, data.clouds, port=0)
        if args.ghosts:
            loop.send(Compare(("barrier", "none")[: args.ghosts]))
        seen = _observe(args, server, loop)
        overruns, shown = loop.latest().overruns, loop.latest().realtime_factor
        server.stop()
    finally:
        loop.stop()
    if loop.error is not None:
        raise loop.error
    found = figures(read_times(record), seen.begin, seen.end)
    if args.drag and found["activation_max"] == 0.0:
        raise RuntimeError(
            "the drag has not moved the end-effector into the buffer, so this is not the hard case"
        )
    return {
        "loop": args.loop,
        "client": args.client,
        "clients": args.clients,
        "dragged": args.drag,
        "seconds": args.seconds,
        "cores": os.cpu_count(),
        "load_before": load,
        **found,
        "layers": args.layers,
        "ghosts": args.ghosts,
        "pictures_per_s": seen.pictures_per_s,
        "shown_realtime_factor": shown,
        "overruns_since_reset": overruns,
        "memory_mb": float(np.median(seen.memory[-len(seen.memory) // 4 :])),
        "memory_growth": _growth(seen.memory),
        "servers_cpu_percent": seen.servers_cpu,
        "loop_cpu_percent": seen.loop_cpu,
        **(seen.done[0] if seen.done else {}),
        "other_clients": list(seen.done[1:]),
    }


class Seen(NamedTuple):
    """Measurements while the clients worked.

    Attributes:
        begin: [s] beginning of the time span.
        end: [s] end of the time span.
        done: The counts of each client, the first one first.
        servers_cpu: [%] of a core that the server and the loop used.
        loop_cpu: [%] of a core that the loop used; None if the loop has no separate process.
        pictures_per_s: Number of pictures that the server has drawn in a second.
        memory: [MB] memory of the server and the loop, at equal intervals.
    """

    begin: float
    end: float
    done: tuple[dict[str, Any], ...]
    servers_cpu: float
    loop_cpu: float | None
    pictures_per_s: float
    memory: list[float]


def _observe(args: Realtime, server: DashboardServer, loop: LoopHandle) -> Seen:
    """Let the clients work for the stated time, and measure."""
    servers = _servers()
    clients = _clients(args, server.address)
    if args.layers:
        _show_all(server)
    time.sleep(SETTLE)
    loop.send(Watch(True))  # without a viewer the simulation would rest
    begin, before, first = time.perf_counter(), _cpu(servers), server.pictures
    memory = _pass_time(args, begin, loop, servers)
    end, after, last = time.perf_counter(), _cpu(servers), server.pictures
    done = tuple(json_module.loads(client.communicate(timeout=60)[0]) for client in clients)
    share = 100.0 * (np.array(after) - before) / (end - begin)
    of_loop = float(share[1:].max()) if len(share) > 1 else None
    pictures = (last - first) / (end - begin)
    return Seen(begin, end, done, float(share.sum()), of_loop, pictures, memory)


def _clients(args: Realtime, address: str) -> list[subprocess.Popen[str]]:
    """Start the clients, and wait until each is connected."""
    clients: list[subprocess.Popen[str]] = []
    kinds = [args.client] * (args.clients if args.client != "none" else 0)
    if kinds and args.client == "browser" and args.drag:
        kinds[0] = "drag"
    seconds = SETTLE + args.seconds
    for kind in [*kinds, *["websocket"] * args.listeners]:
        command = [sys.executable, "-m", "benchmarks.client", kind, address, str(seconds)]
        clients.append(subprocess.Popen(command, stdout=subprocess.PIPE, text=True))
        ready = clients[-1].stdout
        if ready is None or ready.readline() != "ready\n":
            raise RuntimeError("a client could not connect")
    return clients


def _show_all(server: DashboardServer) -> None:
    """Show all layers on each page."""
    for page in list(server.pages.values()):
        view = page.view
        view.borders = dict.fromkeys(view.borders, "determinant")
        view.whole_border = view.bodies = True
        view.labels = "all"


def _servers() -> list[psutil.Process]:
    """This process, and the loop's process if it is a separate one."""
    own = psutil.Process()
    return [own, *own.children()]


def _cpu(processes: list[psutil.Process]) -> list[float]:
    """[s] processor time of each process."""
    return [sum(process.cpu_times()[:2]) for process in processes]


def _pass_time(
    args: Realtime, begin: float, loop: LoopHandle, servers: list[psutil.Process]
) -> list[float]:
    """Wait, and measure the memory [MB].

    With `--drag` and without a browser, pull the end-effector to the base and back.
    """
    memory: list[float] = []
    scripted = args.drag and args.client != "browser"
    y, z = (float(value) for value in loop.latest().p_ee[1:])
    while (t := time.perf_counter() - begin) < args.seconds:
        if scripted and t % (SWEEPS * SWEEP) < PULL_EVERY:  # the base has to come back
            loop.send(Reset())
        if scripted:
            share = 0.5 + 0.5 * np.cos(2.0 * np.pi * t / SWEEP)
            x = loop.latest().base_pose[0] + NEAR + share * (FAR - NEAR)
            loop.send(Pull((float(x), y, z)))
        if t >= len(memory) * args.seconds / LOOKS:
            memory.append(sum(each.memory_full_info().uss for each in servers) / 1e6)
        time.sleep(PULL_EVERY)
    return memory


def _growth(memory: list[float]) -> float:
    """[-] growth: median of the last quarter divided by that of the second quarter.

    The first quarter does not count, because memory is allocated on first use.
    """
    quarter = max(len(memory) // 4, 1)
    return float(np.median(memory[-quarter:]) / np.median(memory[quarter : 2 * quarter]))


def figures(record: np.ndarray, begin: float, end: float) -> dict[str, float]:
    """Key numbers of the steps that began within a time span.

    Args:
        record: (N, 4) beginning [s], duration [s], controller's part [s] and β_m of each step.
        begin: [s] beginning of the time span.
        end: [s] end of the time span.
    """
    t, whole, control, beta = record[(record[:, 0] >= begin) & (record[:, 0] < end)].T
    period = 1e3 * np.diff(t)  # [ms]
    behind = (t - t[0]) - np.arange(len(t)) * DT  # [s]
    return {
        "realtime_factor": len(t) * DT / (end - begin),
        "period_p50_ms": float(np.percentile(period, 50)),
        "period_p99_ms": float(np.percentile(period, 99)),
        "period_max_ms": float(period.max()),
        "delay_max_ms": 1e3 * float(np.max(behind - np.minimum.accumulate(behind))),
        "step_p50_us": 1e6 * float(np.percentile(whole, 50)),
        "step_p99_us": 1e6 * float(np.percentile(whole, 99)),
        "control_mean_us": 1e6 * float(control.mean()),
        "control_p99_us": 1e6 * float(np.percentile(control, 99)),
        "steps_longer_than_period_percent": 100.0 * float(np.mean(whole > DT)),
        "active_steps_percent": 100.0 * float(np.mean(beta > 0.0)),
        "activation_max": float(beta.max()),
    }


if __name__ == "__main__":
    main(tyro.cli(Realtime))
