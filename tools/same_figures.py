"""Compare the results of runs between two environments, or before and after a change.

`python -m tools.same_figures keep FILE` runs scenarios by `dbb run --json` and stores the results
in FILE; runs that are already in FILE are not repeated. `python -m tools.same_figures compare FILE`
runs the scenarios of FILE again, and prints differences above `--tolerance` (0: bit by bit). With
`--python` the runs use another environment. Durations are not compared. Both commands run the code
of the current folder, so two checkouts can be compared.
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

TIMES = {"step_p50_us", "step_p99_us", "realtime_factor"}
"""Results that depend on the machine's speed."""
SCENARIOS = (
    "guiding-lateral",
    "guiding-front",
    "guiding-above",
    "guiding-fold",
    "tracking",
    "refrigerator",
    "way-out",
)


def figures(python: str, case: str) -> dict[str, Any]:
    """The results of a run in an environment, without durations, or its error.

    Args:
        python: The interpreter.
        case: Options of `dbb run`, separated by spaces.
    """
    command = [python, "-m", "app", "run", *case.split(), "--json"]
    done = subprocess.run(command, capture_output=True, text=True)
    if not done.stdout.strip():
        return {"error": done.stderr.strip()[-300:]}
    return {name: value for name, value in json.loads(done.stdout).items() if name not in TIMES}


def differences(first: Any, second: Any, tolerance: float, name: str = "") -> list[str]:
    """The differences, each as a text such as `min_distance_m.lm-l3: 0.1, 0.2`."""
    if isinstance(first, dict) and isinstance(second, dict):
        return [
            text
            for key in sorted({*first, *second})
            for text in differences(
                first.get(key), second.get(key), tolerance, f"{name}.{key}".strip(".")
            )
        ]
    if isinstance(first, list) and isinstance(second, list) and len(first) == len(second):
        pairs = enumerate(zip(first, second, strict=True))
        return [text for i, each in pairs for text in differences(*each, tolerance, f"{name}.{i}")]
    if isinstance(first, int | float) and isinstance(second, int | float):
        same = abs(first - second) <= tolerance
    else:
        same = first == second
    return [] if same else [f"{name}: {first}, {second}"]


def _cases(options: argparse.Namespace) -> list[str]:
    return [
        f"{scenario} --controller {controller} --robot {robot} --physics {physics}"
        for scenario, controller, robot, physics in product(
            options.scenario, options.controller, options.robot, options.physics
        )
    ]


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("do", choices=["keep", "compare"])
    parser.add_argument("file", type=Path)
    parser.add_argument("--python", default=sys.executable, help="interpreter of the environment")
    parser.add_argument("--scenario", nargs="+", default=SCENARIOS)
    parser.add_argument("--controller", nargs="+", default=["dbb"])
    parser.add_argument("--robot", nargs="+", default=["husky_panda"])
    parser.add_argument("--physics", nargs="+", default=["planar"])
    parser.add_argument("--tolerance", type=float, default=0.0)
    parser.add_argument("--jobs", type=int, default=2)
    return parser.parse_args()


def main() -> int:
    """Print a line for each run; return 1 if any result differs."""
    options = _options()
    kept = json.loads(options.file.read_text()) if options.file.exists() else {}
    cases = list(kept) if options.do == "compare" else [c for c in _cases(options) if c not in kept]
    same = True
    with ThreadPoolExecutor(options.jobs) as threads:
        runs = threads.map(lambda case: figures(options.python, case), cases)
        for case, run in zip(cases, runs, strict=True):
            if options.do == "keep":
                kept[case] = run
                options.file.write_text(json.dumps(kept, indent=1))
                print(case, flush=True)
            else:
                found = differences(kept[case], run, options.tolerance)
                same &= not found
                print(f"{case}: {'; '.join(found) or 'the same'}", flush=True)
    return int(not same)


if __name__ == "__main__":
    sys.exit(main())
