"""`dbb pairs`: §2.1, the link pairs that can collide."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.cli.common import load_model, print_json
from app.cli.options import Json, check_seed
from app.strict import check_range

if TYPE_CHECKING:
    from app.robot.link_pairs import LinkPairs

_MOST_SAMPLES = 10_000_000  # [-] about a minute and a gigabyte


def pairs(
    robot: str = "husky_panda", samples: int = 100_000, seed: int = 0, json: Json = False
) -> None:
    """Find the link pairs that can collide, by sampling (§2.1).

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        samples: Number of joint positions.
        seed: Seed of the sampling.
    """
    check_range("--samples", samples, 1, _MOST_SAMPLES)
    check_seed(seed)
    from app.robot.link_pairs import find_link_pairs

    found = find_link_pairs(load_model(robot), samples=samples, seed=seed)
    if json:
        print_json(_as_json(robot, found))
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


def _as_json(robot: str, found: LinkPairs) -> dict[str, object]:
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
