"""`dbb pairs`, `border`, `config` and `bench`: what the method makes, takes and costs."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from app.cli import options
from app.cli.common import load_model, load_robot_and_border, print_json, say
from app.cli.records import Given
from app.config import Config, sections
from app.config_file import save_config
from app.errors import ConfigError, OutputError
from app.parameters import Tunable
from app.strict import check_range
from app.system import write_whole

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.border.dbb import Border
    from app.robot.link_pairs import LinkPairs
    from app.robot.model import RobotModel

_MOST_SAMPLES = 10_000_000  # [-] about a minute and a gigabyte
_OF_BORDER = {"buffer_distance": "border.d_b", "tolerance": "border.eps"}
_FEWEST_POINTS, _MOST_POINTS = 1_000, 20_000_000


def pairs(
    robot: str = "husky_panda", samples: int = 100_000, seed: int = 0, json: options.Json = False
) -> None:
    """Find the link pairs that can collide, by sampling (§2.1).

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        samples: Number of joint positions.
        seed: Seed of the sampling.
    """
    check_range("--samples", samples, 1, _MOST_SAMPLES)
    options.check_seed(seed)
    from app.robot.link_pairs import find_link_pairs

    found = find_link_pairs(load_model(robot), samples=samples, seed=seed)
    if json:
        print_json(_of_pairs(robot, found))
        return
    for title, group in (
        ("L_m   with the mobile robot", found.mobile),
        ("L_m^c within the arm", found.manipulator),
        ("never", found.never),
    ):
        print(title)
        for pair in group:
            print(
                f"  {pair.name:10} in collision {found.rates[pair.name]:7.3%}, "
                f"least distance {found.least_distance_m[pair.name]:+.3f} m"
            )


def _of_pairs(robot: str, found: LinkPairs) -> dict[str, object]:
    return {
        "robot": robot,
        "samples": found.samples,
        "seed": found.seed,
        "pairs": [pair.name for pair in found.all],
        "L_m": [pair.name for pair in found.mobile],
        "L_m_c": [pair.name for pair in found.manipulator],
        "collision_rate": found.rates,
        "never": [
            {"pair": pair.name, "least_distance_m": found.least_distance_m[pair.name]}
            for pair in found.never
        ],
        "least_distance_m": found.least_distance_m,
    }


def border(
    parameters: Annotated[Given, options.parameter_options(_OF_BORDER)],
    robot: str = "husky_panda",
    out: Annotated[Path | None, options.NO_DEFAULT] = None,
    seed: int = 0,
    json: options.Json = False,
) -> None:
    """Build or load the distance buffer border of each pair (§2.2).

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        out: Folder for one CSV of the border's points per pair (base frame, metres).
        seed: Seed of the sampling; another one is another cloud.
    """
    config = options.configured(None, parameters, _OF_BORDER).border
    options.check_seed(seed)
    options.make_folder(out)
    # Imported here: it takes longer than to find a mistake in what was asked.
    import numpy as np

    from app.border.cache import load_border_data
    from app.border.config import SamplingConfig
    from app.border.dbb import construct_dbb

    begin = perf_counter()
    model = load_model(robot)
    data = load_border_data(model, sampling=SamplingConfig(seed=seed))
    loaded = perf_counter()
    borders = [construct_dbb(cloud, config.d_b, config.eps) for cloud in data.clouds.values()]
    selected = perf_counter()
    if out is not None:
        for each in borders:
            np.savetxt(
                out / f"{each.pair}.csv",
                each.points,
                "%.4f",
                ",",
                header="x_m,y_m,z_m",
                comments="",
            )
    result: dict[str, Any] = {
        "robot": robot,
        "seed": seed,
        "buffer_distance_m": config.d_b,
        "tolerance_m": config.eps,
        "origin": data.origin,
        "load_s": loaded - begin,
        "select_ms": 1e3 * (selected - loaded),
        "borders": {each.pair: _of_border(model, data, each) for each in borders},
    }
    if json:
        print_json(result)
        return
    print(f"{robot}, d_b {config.d_b:g} m ± {config.eps:g} m, from {data.origin}")
    for pair, figures in result["borders"].items():
        print(f"  {pair}")
        for key, value in figures.items():
            print(f"    {key:20} {value:.6g}" if value is not None else f"    {key:20} none")


def _of_border(model: RobotModel, data: BorderData, border: Border) -> dict[str, object]:
    """Figures of one border; its distances measured again, point by point, by the library."""
    import numpy as np

    from app.border.mobile import MobileBody

    body = MobileBody(model)
    deviation = np.abs(body.distance(border.points) - border.d_b)
    counts: dict[str, object] = {
        "points": len(border),
        "cloud_points": len(data.clouds[border.pair]),
        "points_beside_base": int(np.count_nonzero(border.heights <= body.upper[2])),
    }
    if not len(border):
        return counts | dict.fromkeys(("max_deviation_m", "lowest_m", "highest_m"))
    return counts | {
        "max_deviation_m": float(deviation.max()),
        "lowest_m": float(border.heights[0]),
        "highest_m": float(border.heights[-1]),
    }


def config(
    config: options.ConfigOption = None,
    out: Annotated[Path | None, options.NO_DEFAULT] = None,
    json: options.Json = False,
) -> None:
    """Print all parameters as a file that --config takes.

    Each with its unit, range and meaning.

    Args:
        out: File to write instead of printing; one that exists is not written over.
    """
    tuned = options.configured(config)
    if out is not None:
        _write_new(out, save_config(tuned, out.stem))
    if json:
        print_json(
            {"parameters": [_of_parameter(each, tuned) for s in sections() for each in s.tunables]}
        )
    elif out is None:
        print(save_config(tuned), end="")
    else:
        print(out)


def _write_new(out: Path, text: str) -> None:
    if out.exists():
        raise OutputError(f"--out: {out} exists; name another file or remove it")
    write_whole(out, text)


def _of_parameter(about: Tunable, tuned: Config) -> dict[str, Any]:
    row = about.model_dump(exclude={"label", "advanced", "log"})
    return {"path": row.pop("path"), "value": tuned.value(about.path), **row}


def bench(
    robot: str = "husky_panda",
    points: tuple[int, ...] = (50_000, 500_000, 5_000_000),
    no_border: options.Flag = False,
    seed: int = 0,
    json: options.Json = False,
) -> None:
    """Time the control step along recorded hand paths, stage by stage.

    Times depend on the machine and on what else it does; ratios within one run count.

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        points: Points of the synthetic borders whose cost is compared.
        no_border: Leave out the sampling of a border from nothing, which takes half a minute.
        seed: Of the plant and of the synthetic borders.
    """
    options.check_seed(seed)
    for count in points:
        if not _FEWEST_POINTS <= count <= _MOST_POINTS:
            raise ConfigError(
                f"--points: {count} is not between {_FEWEST_POINTS} and {_MOST_POINTS}"
            )
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
    _print_tree(result)


def _print_tree(result: dict[str, Any], indent: str = "") -> None:
    for key, value in result.items():
        if isinstance(value, dict):
            print(f"{indent}{key}")
            _print_tree(value, indent + "  ")
        elif isinstance(value, float):
            print(f"{indent}{key:28} {value:.4g}")
        elif not isinstance(value, list):
            print(f"{indent}{key:28} {value}")
