"""`dbb bench`: how long a control step takes, by stage, beside the bare calls of the libraries."""

from __future__ import annotations

from typing import Any

from app.cli.common import load_robot_and_border, print_json, say
from app.cli.options import Flag, Json, check_seed
from app.errors import ConfigError

_FEWEST, _MOST = 1_000, 20_000_000


def bench(
    robot: str = "husky_panda",
    points: tuple[int, ...] = (50_000, 500_000, 5_000_000),
    no_border: Flag = False,
    seed: int = 0,
    json: Json = False,
) -> None:
    """Time the control step along recorded hand paths, stage by stage.

    Times depend on the machine and on what else it does; ratios within one run count.

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        points: Points of the synthetic borders whose cost is compared.
        no_border: Leave out the sampling of a border from nothing, which takes half a minute.
        seed: Of the plant and of the synthetic borders.
    """
    check_seed(seed)
    for count in points:
        if not _FEWEST <= count <= _MOST:
            raise ConfigError(f"--points: {count} is not between {_FEWEST} and {_MOST}")
    try:
        from benchmarks.step.bench import bench as measure
    except ModuleNotFoundError:
        raise ConfigError(
            "dbb bench measures in a checkout of the project, which this is not: "
            "clone the project, and call .venv/bin/dbb bench there after make run"
        ) from None
    model, data = load_robot_and_border(robot)
    result = measure(model, data, seed=seed, points=points, border=not no_border, on_stage=say)
    if json:
        print_json(result)
        return
    _print(result)


def _print(result: dict[str, Any], indent: str = "") -> None:
    for key, value in result.items():
        if isinstance(value, dict):
            print(f"{indent}{key}")
            _print(value, indent + "  ")
        elif isinstance(value, float):
            print(f"{indent}{key:28} {value:.4g}")
        elif not isinstance(value, list):
            print(f"{indent}{key:28} {value}")
