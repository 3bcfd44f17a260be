"""Runs the libraries and our controllers along the same paths, with the same evaluation."""

from __future__ import annotations

import os
import platform
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from app.cli.common import load_robot_and_border, print_json
from app.cli.options import Flag, Json, make_folder
from app.errors import DbbError, check_name
from app.jobs.progress import progress_bar
from app.simulation.plants import PLANTS
from benchmarks.peers.evaluator import Evaluator
from benchmarks.peers.model import EE
from benchmarks.peers.names import chosen
from benchmarks.peers.paths import ee_paths
from benchmarks.peers.plan import write_plan
from benchmarks.peers.quick import pink_step
from benchmarks.peers.rows import Row, rows_of
from benchmarks.peers.table import markdown, write_table


@dataclass(frozen=True)
class Peers:
    """Compare with pink, mink, placo and roboplan, each in a separate environment."""

    only: tuple[str, ...] = ()
    """Names among pink, mink, placo, roboplan, dbb, barrier, repulsive and none; default: all."""
    out: Path = Path("out/peers")
    """Folder for table.json, table.csv, table.md and peers.png, and for the environments."""
    physics: str = "planar"
    """Plant of our own controllers; `dbb run guiding-front --help` lists all names."""
    allow_missing: Flag = False
    """End with status 0 even if a library could not be installed or run."""
    quick: Flag = False
    """Measure only the step of pink along one path."""
    json: Json = False


def main(args: Peers) -> int:
    """Run the comparison, write and print the results; return the status."""
    peers = chosen(args.only)
    check_name("physics", args.physics, PLANTS)
    make_folder(args.out)
    return _quick(args) if args.quick else _compare(args, peers)


def _compare(args: Peers, peers: dict[str, Any]) -> int:
    # Imported here: matplotlib would delay the error for an unknown name.
    from benchmarks.peers.picture import draw

    model, data = load_robot_and_border("husky_panda")
    plan_folder = args.out / "plan"
    plan_folder.mkdir(exist_ok=True)
    rows: list[Row] = []
    with progress_bar("peers", len(peers) + 1) as on_progress:
        paths = ee_paths(model, data)
        plan, common = write_plan(plan_folder, model, data, paths, physics=args.physics)
        judge = Evaluator(common.planar, common.pairs, EE)
        for k, (name, peer) in enumerate(peers.items(), start=1):
            on_progress(k)
            rows += rows_of(name, peer, plan, args.out, args.out / "envs", judge)
    result = write_table(args.out, rows, machine())
    (args.out / "peers.png").write_bytes(draw(rows))
    if args.json:
        print_json(result)
    else:
        print(markdown(rows))
        print(args.out / "peers.png")
    return 0 if result["all_ran"] or args.allow_missing else 1


def _quick(args: Peers) -> int:
    model, data = load_robot_and_border("husky_panda")
    step = pink_step(model, data, args.out / "envs")
    if args.json:
        print_json(
            {
                "pink_step_p50_us": step.p50_us,
                "pink_step_p99_us": step.p99_us,
                "reason": step.reason,
            }
        )
    elif step.p50_us is None:
        print(f"pink: {step.reason}")
    else:
        print(f"pink's step: median {step.p50_us:.0f} µs, 99th percentile {step.p99_us:.0f} µs")
    return 0 if step.p50_us is not None or args.allow_missing else 1


def machine() -> dict[str, Any]:
    """The conditions of the times: the machine, its load and the version of Python."""
    name = platform.processor() or platform.machine()
    try:
        with Path("/proc/cpuinfo").open(encoding="utf-8") as lines:
            models = (line.partition(":")[2].strip() for line in lines if "model name" in line)
            name = next(models, name)
    except OSError:
        pass
    return {
        "processor": name,
        "cores": os.cpu_count(),
        "load_1min": os.getloadavg()[0],
        "python": platform.python_version(),
    }


if __name__ == "__main__":
    try:
        sys.exit(main(tyro.cli(Peers, prog="python -m benchmarks.peers")))
    except DbbError as error:
        print(f"peers: error: {error}", file=sys.stderr)
        sys.exit(2)
