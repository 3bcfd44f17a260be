"""`dbb reach`: §2.3.2, the reachability counted, and the coefficients of (9) that fit it."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from app.cli.common import load_model, print_json
from app.cli.options import NO_DEFAULT, Json, check_name, check_seed, make_folder

if TYPE_CHECKING:
    from app.border.reach.map import ReachMap
    from app.border.score import ReachFit
    from app.robot.model import RobotModel

_PAPER = {"A_per_m2": 525.9, "B_m": 0.575, "C": 100.0}  # §2.3.2, of the end-effector


def reach(
    robot: str = "husky_panda",
    body: str = "all",
    seed: int = 0,
    recompute: bool = False,
    out: Annotated[Path | None, NO_DEFAULT] = None,
    json: Json = False,
) -> None:
    """Count the arm's reachability and fit (9) to it (§2.3.2).

    Positions stand on a lattice around the arm's mount, each with random orientations. For the
    hand, p is the end-effector's origin and the pose is its whole pose; for another body, p is the
    middle of its first shape and the pose is that point with the direction of its axis. Solutions
    within the joint limits and without self-collision count. R is scaled so that its mean over the
    best shell of ρ = ‖p − p_base‖ is 100; (9) is fitted where that mean is at least 5. The paper
    leaves the end-effector's frame, the scale and the range of the fit open; A depends on them.

    Args:
        robot: Name of the robot; `dbb robots` lists them.
        body: lEE, l3 or another body that at least three joints move; all for each of those.
        seed: Seed of the poses; another one is another map.
        recompute: Count anew even if there is a file of it.
        out: Folder for two CSV per body: the map, and its means over shells with the fit.
    """
    # Imported here: scipy and the solver would make every other command start later.
    from app.border.config import ReachConfig
    from app.border.reach.chain import reach_bodies
    from app.border.reach.map import load_reach_map
    from app.border.score import fit_reachability

    check_seed(seed)
    model = load_model(robot)
    names = reach_bodies(model)
    check_name("body of a reachability map", body, [*names, "all"])
    make_folder(out)
    begin = perf_counter()
    bodies: dict[str, Any] = {}
    for name in names if body == "all" else [body]:
        reach_map = load_reach_map(
            model, name, config=ReachConfig(seed=seed), recompute=recompute, processes=None
        )
        fit = fit_reachability(reach_map)
        bodies[name] = _figures(model, reach_map, fit)
        if out is not None:
            _write(out, reach_map, fit)
    result = {"robot": robot, "seed": seed, "load_s": perf_counter() - begin, "bodies": bodies}
    if json:
        print_json(result)
        return
    for name, figures in bodies.items():
        _print(robot, name, figures)


def _figures(model: RobotModel, reach_map: ReachMap, fit: ReachFit) -> dict[str, Any]:
    """What is printed of one body."""
    description = model.description
    used = description.reachability.get(reach_map.body)
    carries = description.arm.end_effector_link in description.body(reach_map.body).covers
    fitted = fit._asdict()
    return {
        "positions_fitted": fitted.pop("points"),
        **fitted,
        "paper": _PAPER if carries else None,
        "description": used.model_dump(include=set(_PAPER)) if used else None,
        "positions": len(reach_map.found),
        "poses": reach_map.poses,
        "solutions": int(reach_map.found.sum()),
        "method": reach_map.method,
        "free_joints": list(reach_map.free_joints),
        "origin": reach_map.origin,
    }


def _write(out: Path, reach_map: ReachMap, fit: ReachFit) -> None:
    import numpy as np

    from app.border.score import radial_profile

    profile = radial_profile(reach_map.rho, reach_map.reach)
    fitted = fit.at(profile.rho_m)
    shells = np.column_stack([profile.rho_m, profile.mean, profile.spread, fitted, profile.count])
    positions = np.column_stack([reach_map.points, reach_map.rho, reach_map.reach, reach_map.found])
    for name, header, rows in (
        (f"reach-{reach_map.body}.csv", "x_m,y_m,z_m,rho_m,reach,solutions", positions),
        (f"reach-{reach_map.body}-radial.csv", "rho_m,mean,spread,fit,positions", shells),
    ):
        formats = ["%.4f"] * (rows.shape[1] - 1) + ["%d"]
        filled = rows[~np.isnan(rows).any(axis=1)]
        np.savetxt(out / name, filled, formats, ",", header=header, comments="")


def _print(robot: str, name: str, figures: dict[str, Any]) -> None:
    free = ", ".join(figures["free_joints"])
    print(
        f"{robot} {name}, from {figures['origin']}: {figures['solutions']:,} solutions of "
        f"{figures['poses']:,} poses at {figures['positions']:,} positions "
        f"({figures['method']}{f'; held at random: {free}' if free else ''})"
    )
    columns = {"counted": figures, "paper": figures["paper"], "description": figures["description"]}
    shown = {title: column for title, column in columns.items() if column}
    print("  " + " " * 14 + "".join(f"{title:>13}" for title in shown))
    for key, unit in (("A_per_m2", "/m²"), ("B_m", "m"), ("C", "")):
        values = "".join(f"{column[key]:13.4g}" for column in shown.values())
        print(f"  {key:14}{values} {unit}".rstrip())
    print(
        f"  fitted over {figures['rho_min_m']:.2f} to {figures['rho_max_m']:.2f} m: "
        f"R² {figures['r_squared']:.3f}, RMS residual {figures['rms']:.1f} of the shells' means; "
        f"R² {figures['r_squared_positions']:.3f} of the {figures['positions_fitted']:,} positions"
    )
