"""`dbb pairs`, `border`, `reach`, `config` and `bench`: single parts of the method."""

from __future__ import annotations

from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Any

from app.cli import options
from app.cli.common import load_model, load_robot_and_border, print_json, print_result, say
from app.config import tunables
from app.config_file import save_config
from app.errors import ConfigError, OutputError, check_name
from app.strict import Array, check_range
from app.system import whole_file, write_whole

if TYPE_CHECKING:
    from app.robot.model import RobotModel

_OF_BORDER = {"buffer_distance": "border.d_b", "tolerance": "border.eps"}
_PAPERS_FIT = {"A_per_m2": 525.9, "B_m": 0.575, "C": 100.0}  # §2.3.2, for the end-effector


def pairs(
    robot: options.Robot = "husky_panda",
    samples: int = 100_000,
    seed: int = 0,
    json: options.Json = False,
) -> None:
    """Find the link pairs that can collide, by sampling (§2.1).

    Args:
        samples: Number of random postures of the arm.
        seed: Seed of the random postures.
    """
    check_range("--samples", samples, 1, 10_000_000)
    options.check_seed(seed)
    from app.robot.link_pairs import find_link_pairs

    found = find_link_pairs(load_model(robot), samples=samples, seed=seed)
    distances, never = found.least_distance_m, [pair.name for pair in found.never]
    result = {
        "robot": robot,
        "samples": found.samples,
        "seed": found.seed,
        "pairs": [pair.name for pair in found.all],
        "L_m": [pair.name for pair in found.mobile],
        "L_m_c": [pair.name for pair in found.manipulator],
        "collision_rate": found.rates,
        "never": [{"pair": name, "least_distance_m": distances[name]} for name in never],
        "least_distance_m": distances,
    }
    print_result(result, json=json)


def border(
    parameters: Annotated[options.Given, options.parameter_options(_OF_BORDER)],
    robot: options.Robot = "husky_panda",
    out: Annotated[Path | None, options.NO_DEFAULT] = None,
    seed: int = 0,
    json: options.Json = False,
) -> None:
    """Load or sample the border of each pair of arm and base (§2.2).

    Args:
        out: Folder for a CSV file of each pair: the border's points in the base's frame [m].
        seed: Seed of the sampling; a different seed gives different points.
    """
    config = options.configured(robot, None, parameters, _OF_BORDER).border
    options.check_seed(seed)
    options.make_folder(out)
    from app.border.cache import load_border_data
    from app.border.dbb import construct_dbb
    from app.border.mobile import MobileBody
    from app.border.sampling import SamplingConfig

    begin = perf_counter()
    model = load_model(robot)
    data = load_border_data(model, sampling=SamplingConfig(seed=seed))
    loaded = perf_counter()
    borders = [construct_dbb(cloud, config.d_b, config.eps) for cloud in data.clouds.values()]
    selected = perf_counter()
    body = MobileBody(model)
    about: dict[str, Any] = {}
    for each in borders:
        if out is not None:
            _write_csv(out / f"{each.pair}.csv", "x_m,y_m,z_m", each.points, "%.4f")
        heights = each.heights.tolist()
        deviations = abs(body.distance(each.points) - each.d_b).tolist()
        about[each.pair] = {
            "points": len(each),
            "cloud_points": len(data.clouds[each.pair]),
            "points_beside_base": int((each.heights <= body.upper[2]).sum()),
            "max_deviation_m": max(deviations, default=None),
            "lowest_m": min(heights, default=None),
            "highest_m": max(heights, default=None),
        }
    result = {
        "robot": robot,
        "seed": seed,
        "buffer_distance_m": config.d_b,
        "tolerance_m": config.eps,
        "origin": data.origin,
        "load_s": loaded - begin,
        "select_ms": 1e3 * (selected - loaded),
        "borders": about,
    }
    print_result(result, json=json)


def reach(
    robot: options.Robot = "husky_panda",
    body: str = "all",
    seed: int = 0,
    out: Annotated[Path | None, options.NO_DEFAULT] = None,
    json: options.Json = False,
) -> None:
    """Compute the arm's reachability R, and fit (9) to R (§2.3.2).

    R is computed for each position p of a lattice around the arm's mount. p is the position of a
    frame: for the body lEE, of the end-effector's frame; for another body, of the frame of the
    body's first shape. The pose of this frame has six coordinates if the joints can change six
    independently, or else five (position, direction of the z axis), or else three (position). R is,
    up to a constant factor, the mean number of inverse kinematics solutions within the joint limits
    and without self-collision for the poses at p. R is computed from random joint positions by the
    area formula: it is the sum of |det J| over the joint positions that lead to the lattice's cell
    at p. J is the square Jacobian of the pose; it has no columns for redundant joints, as if these
    were fixed at their random positions. Then the mean of R is computed in spherical shells
    around the mount, each for an interval of ρ = ‖p − p_base‖. R is scaled so that the largest of
    these means is 100. The fit of (9) uses all positions in the best shell and, on both sides of
    it, in all shells before the first one with a mean below 5. The fitted A depends on the
    end-effector's frame, on this scale, and on the lower bound 5; the paper does not state these.

    Args:
        body: A body that at least three joints move, such as lEE or l3; `all` selects all of them.
        seed: Seed of the random joint positions; a different seed gives a different map.
        out: Folder for two CSV files of each body: its map; and the mean and the fit in each shell.
    """
    from app.border import reach as maps

    options.check_seed(seed)
    model = load_model(robot)
    names = maps.reach_bodies(model)
    check_name("body of a reachability map", body, [*names, "all"])
    options.make_folder(out)
    begin = perf_counter()
    bodies: dict[str, Any] = {}
    for name in names if body == "all" else [body]:
        say(f"computing the reachability of {name}")
        bodies[name] = _reach_of(name, model, seed, out)
    result = {"robot": robot, "seed": seed, "elapsed_s": perf_counter() - begin, "bodies": bodies}
    print_result(result, json=json)


def _reach_of(name: str, model: RobotModel, seed: int, out: Path | None) -> dict[str, Any]:
    """The results for a body; also writes the body's two files if there is a folder `out`."""
    import numpy as np

    from app.border import reach as maps
    from app.border.score import radial_profile

    fine = {"samples": maps.FINE_SAMPLES, "spacing": maps.FINE_SPACING}
    found = maps.sample_reach_map(model, name, **fine, seed=seed)
    fit = maps.fit_reachability(found)
    if out is not None:
        shells = radial_profile(found.rho, found.reach)
        columns = shells.rho_m, shells.mean, shells.spread, fit.at(shells.rho_m), shells.count
        rows, header = np.column_stack(columns), "rho_m,mean,spread,fit,positions"
        _write_csv(out / f"reach-{name}-radial.csv", header, rows, "%.6g")
        rows = np.column_stack([found.points, found.rho, found.reach, found.found])
        _write_csv(out / f"reach-{name}.csv", "x_m,y_m,z_m,rho_m,reach,solutions", rows, "%.6g")
    description = model.description
    used = description.reachability.get(name)
    carries = description.arm.end_effector_link in description.body(name).covers
    numbers = fit._asdict()
    return {
        "positions_fitted": numbers.pop("points"),
        **numbers,
        "paper": _PAPERS_FIT if carries else None,
        "description": used.model_dump(include=set(_PAPERS_FIT)) if used else None,
        "positions": len(found.found),
        "samples": found.samples,
        "solutions": float(found.found.mean()),
        "free_joints": list(found.free_joints),
    }


def _write_csv(path: Path, header: str, rows: Array, form: str) -> None:
    """Write the rows without a NaN as a CSV file; `form` is the format of a number."""
    import numpy as np

    known = rows[~np.isnan(rows).any(axis=1)]
    with whole_file(path) as beside:
        np.savetxt(beside, known, form, ",", header=header, comments="")


def config(
    config: options.ConfigOption = None,
    out: Annotated[Path | None, options.NO_DEFAULT] = None,
    robot: str = "husky_panda",
    json: options.Json = False,
) -> None:
    """Print all parameters, as a file for --config.

    A comment for each parameter states its range and unit, or its choices, and its meaning.

    Args:
        out: File to write instead of standard output; an existing file is not overwritten.
        robot: Robot whose defaults apply to the parameters that are not in the file of --config;
            `dbb robots` lists all names.
    """
    tuned, kept = options.configured(robot, config), options.read(config)
    name = kept.name or ("" if out is None else out.stem)
    text = save_config(tuned, name, kept.hosts)
    if out is not None:
        if out.exists():
            raise OutputError(f"--out: {out} exists; choose another file or remove this one")
        write_whole(out, text)
    if json:
        rows = []
        for path, each in tunables().items():
            names = ("choices", "default") if each.choices else ("low", "high", "default", "unit")
            row = {name: getattr(each, name) for name in ("help", "source", *names)}
            rows.append({"path": path, "value": tuned.value(path)} | row)
        print_json({"parameters": rows})
    elif out is None:
        print(text, end="")
    else:
        print(out)


def bench(
    robot: options.Robot = "husky_panda",
    no_border: options.Flag = False,
    seed: int = 0,
    json: options.Json = False,
) -> None:
    """Time the control step, its stages, and the work with borders.

    The command first simulates some paths and records the controller's inputs; then it measures the
    steps with these inputs. Durations depend on the machine and its other work; compare only ratios
    within one run.

    Args:
        no_border: Do not measure the sampling of a new border, which takes minutes.
        seed: Seed of the simulated paths, of the synthetic borders, and of the QP that a library
            solves for comparison with the control step. Other measurements have fixed seeds.
    """
    options.check_seed(seed)
    try:
        from benchmarks.step.bench import bench as measure
    except ModuleNotFoundError as error:
        if not str(error.name).startswith("benchmarks"):
            raise
        raise ConfigError(
            "dbb bench needs a checkout of the project, and this is an installation: clone the "
            "project, call make run there, and then .venv/bin/dbb bench"
        ) from None
    model, data = load_robot_and_border(robot)
    print_result(measure(model, data, seed=seed, border=not no_border, on_stage=say), json=json)
