"""`dbb border`: §2.2, the distance buffer border of each pair of L_m."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from app.border.cache import BorderData, load_border_data
from app.border.dbb import Border, construct_dbb
from app.border.mobile import MobileBody
from app.border.sampling.config import SamplingConfig
from app.cli.common import load_model, print_json
from app.cli.options import Json, check_parameter, check_seed, make_folder
from app.config import Config
from app.robot.model import RobotModel


def border(
    robot: str = "husky_panda",
    buffer_distance: float = Config().border.d_b,
    tolerance: float = Config().border.eps,
    out: Path | None = None,
    seed: int = 0,
    json: Json = False,
) -> None:
    """Build or load the sampled clouds P_i and select the border for a buffer distance (§2.2).

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        buffer_distance: [m] d_b.
        tolerance: [m] ε.
        out: Folder for one CSV of the border's points per pair (base frame, metres).
        seed: Seed of the sampling; another one is another cloud.
        json: Print one JSON object on standard output and nothing else there.
    """
    check_parameter("--buffer-distance", buffer_distance, "border.d_b")
    check_parameter("--tolerance", tolerance, "border.eps")
    check_seed(seed)
    make_folder(out)
    config = Config().replace("border.d_b", buffer_distance).replace("border.eps", tolerance).border
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
        "borders": {each.pair: _figures(model, data, each) for each in borders},
    }
    if json:
        print_json(result)
        return
    print(f"{robot}, d_b {config.d_b:g} m ± {config.eps:g} m, from {data.origin}")
    for pair, figures in result["borders"].items():
        print(f"  {pair}")
        for key, value in figures.items():
            print(f"    {key:20} {value:.6g}" if value is not None else f"    {key:20} none")


def _figures(model: RobotModel, data: BorderData, border: Border) -> dict[str, object]:
    """Figures of one border; its distances measured again, point by point, by the library."""
    cloud_points = len(data.clouds[border.pair])
    if not len(border):
        return {
            "points": 0,
            "cloud_points": cloud_points,
            "points_beside_base": 0,
            "max_deviation_m": None,
            "lowest_m": None,
            "highest_m": None,
        }
    body = MobileBody(model)
    deviation = np.abs(body.distance(border.points) - border.d_b)
    return {
        "points": len(border),
        "cloud_points": cloud_points,
        "points_beside_base": int(np.count_nonzero(border.heights <= body.upper[2])),
        "max_deviation_m": float(deviation.max()),
        "lowest_m": float(border.heights[0]),
        "highest_m": float(border.heights[-1]),
    }
