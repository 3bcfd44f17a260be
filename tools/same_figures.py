"""Whether two environments give the same figures: `python -m tools.same_figures PYTHON PYTHON`.

Every scenario is run by `dbb run --json` in both, from this checkout, with each plant; figures that
are no times must agree to the bit. Meant for pybullet beside its fork, and for two Pythons.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from itertools import product
from pathlib import Path
from typing import Any

from app.simulation.scenarios.names import SCENARIOS

PROJECT = Path(__file__).resolve().parent.parent
TIMES = {"step_p50_us", "step_p99_us", "realtime_factor"}
"""Figures of how fast a run went."""


def figures(python: str, scenario: str, physics: str) -> dict[str, Any]:
    """What a run of a scenario gives in an environment, times left out.

    Raises:
        SystemExit: The run failed.
    """
    command = [python, "-m", "app", "run", scenario, "--physics", physics, "--json"]
    done = subprocess.run(command, cwd=PROJECT, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{' '.join(command)}: {done.stderr.strip()[-500:]}")
    return {name: value for name, value in json.loads(done.stdout).items() if name not in TIMES}


def differences(first: Any, second: Any, name: str = "") -> list[str]:
    """What differs, as `min_distance_m.lm-l3: 0.1, 0.2`; floats compare to the bit."""
    if isinstance(first, dict) and isinstance(second, dict):
        return [
            text
            for key in sorted({*first, *second})
            for text in differences(first.get(key), second.get(key), f"{name}.{key}".strip("."))
        ]
    return [] if first == second else [f"{name}: {first}, {second}"]


def main() -> int:
    """Print a line a run; 1 if any figure differs."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("python", nargs=2, help="of an environment with this project's libraries")
    parser.add_argument("--scenario", nargs="+", default=sorted(SCENARIOS), choices=SCENARIOS)
    parser.add_argument("--physics", nargs="+", default=["planar", "contact"])
    options = parser.parse_args()
    same = True
    with ThreadPoolExecutor(2) as threads:
        for scenario, physics in product(options.scenario, options.physics):
            runs = list(threads.map(lambda p: figures(p, scenario, physics), options.python))  # noqa: B023
            found = differences(*runs)
            same &= not found
            print(f"{scenario}, {physics}: {'; '.join(found) or 'the same'}", flush=True)
    return int(not same)


if __name__ == "__main__":
    sys.exit(main())
