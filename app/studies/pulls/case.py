"""A case of a study: the random draw, the run, and the row of a table with both."""

import math
import re
from collections.abc import Mapping
from contextlib import suppress
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from app.border.cache import BorderData, load_border_data
from app.border.mobile import MobileBody
from app.config import parameter
from app.errors import AssetError, DbbError, RobotFileError, StudyError, UnreachableError
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.robot.state import RobotState, at_rest
from app.simulation.case import RunSpec
from app.simulation.run import run_from_spec
from app.simulation.scenarios.line import RANDOM_PULL
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import check_avoidance
from app.strict import Array
from app.studies.pulls.parameters import FAULTS, PARAMETERS, Interval, StudyParameters
from app.studies.runs import Row, flattened, rounded
from app.studies.sweep.plan import exit_distance, point_of

TIMES = ("step_p50_us", "step_p99_us", "realtime_factor")  # they depend on the machine
_ENDINGS = {"-": "", "s": "_s", "rad": "_rad", "m/s": "_mps", "N": "_n", "N/m": "_npm", "kg": "_kg"}
COLUMNS = {
    "speed": "speed_mps",
    "duration": "duration_s",
    "moving": "moving",
    "release_at": "release_at_s",
    "regrasp_at": "regrasp_at_s",
    **{name: name + _ENDINGS[parameter(path).unit] for name, path in PARAMETERS.items()},
    "fault_at": "fault_at_s",
}
"""The column of each random quantity, by the quantity's name in `StudyRange` or, for `_OF_LINE`, in
`LineScenario`. Without a release or new grasp, its time is None. `fault_at_s` is a time."""
_OF_LINE = ("duration", "moving", "release_at", "regrasp_at")
_NOT_STORED = {
    *("scenario", "controller", "robot", "seed", "duration_s", "physics"),  # equal to the inputs
    *("stuck", "left_way"),  # no numbers
    *TIMES,
}
SECTORS = ("front", "front corner", "side", "back", "above", "below")
"""Parts of the sphere of directions from the base to the end-effector, with equal probabilities if
the arm reaches all. "above" is more than 45° above the horizontal, "below" more than 10° below it.
The other sectors are intervals of the angle from the base's heading, on both sides."""
_TRIES = 600  # [-] largest number of positions that are drawn for a case
_ABOVE, _BELOW = math.sin(math.radians(45.0)), -math.sin(math.radians(10.0))
_EDGES = {"front": 30.0, "front corner": 60.0, "side": 120.0}  # [deg] largest angle from the front
_LOWEST = 0.05  # [m] smallest height of targets in the base, and of ends of pulls along the base
_LENGTH = 0.15, 0.60  # [m] length of a pull along the base; the upper end also limits other pulls
_LATER = ("payload", *FAULTS)  # from a separate random stream, so that pulls do not depend on them


class StudySources(NamedTuple):
    """Data that all cases of a study share."""

    model: RobotModel
    data: BorderData
    lower: Array  # (3,) [m] lower corner, on the floor, of a box around the base, in its frame
    upper: Array  # (3,) [m] upper corner of the box
    shoulder: Array  # (3,) [m] the arm's second joint, in the base's frame
    near: float  # [m] smallest distance of a start from the shoulder
    far: float  # [m] largest distance of a start from the shoulder


class Start(NamedTuple):
    """The start of a case, on a ray from a point in the base; in the base's frame."""

    sector: str  # one of `SECTORS`
    p: Array  # (3,) [m] position of the end-effector
    aim: Array  # (3,) [m] target point inside the base
    outwards: Array  # (3,) unit vector from the target to the end-effector


@cache
def load_sources(robot: str) -> StudySources:
    """Load a robot's data once per process; raises the errors of loading and `check_avoidance`.

    `near` and `far` are the quantiles 2 % and 98 % of the end-effector's distance from the shoulder
    in random postures. Only postures count in which the end-effector points outwards, with a
    sideways component below 0.5, and at most 15° upwards. If none of 4000 postures counts, `near`
    is 0 and `far` is infinite.
    """
    model = RobotModel(load_robot(robot))
    body, data = MobileBody(model), load_border_data(model, progress=False)
    check_avoidance(model, data)
    state, rng, distances = RobotState(model), np.random.default_rng(0), []
    joint = model.pin.getJointId(model.description.arm.joints[min(1, model.n_m - 1)])
    state.update(at_rest(model, np.array(model.description.arm.ready_position)))
    shoulder, mount = state.data.oMi[joint].translation.copy(), model.p_base()[:2]
    for _ in range(4000):
        state.update(at_rest(model, rng.uniform(model.q_lower, model.q_upper)))
        p, z = state.T_world_ee.translation, state.T_world_ee.rotation[:, 2]
        out = (p[:2] - mount) / max(float(np.hypot(*(p[:2] - mount))), 1e-6)
        sideways = abs(z[1] * out[0] - z[0] * out[1])
        if sideways < 0.5 and z[2] < 0.26 and z[:2] @ out > 0:
            distances.append(np.linalg.norm(p - shoulder))
    near, far = np.quantile(distances, (0.02, 0.98)) if distances else (0.0, np.inf)
    lower = np.array([*body.lower[:2], 0.0])
    return StudySources(model, data, lower, body.upper, shoulder, float(near), float(far))


def draw_start(
    sources: StudySources, heights: Interval, rng: np.random.Generator
) -> tuple[Start, Array, int]:
    """Draw a start in a range of heights [m]; every pair is outside its buffer there. This returns
    the start, the arm's joint positions (n_m,) there, and the number of rejected starts. If the arm
    reaches none of 600 drawn starts, this raises a StudyError.
    """
    d_b = sources.model.description.config.border.d_b
    solver = StartSolver(sources.model, sources.data.pairs, d_b)
    sector = ""
    for redraws in range(_TRIES):
        if redraws % 60 == 0:  # a sector can be out of reach: draw another one
            sector = SECTORS[rng.integers(len(SECTORS))]
        start, seed = place(sector, sources, rng), int(rng.integers(2**32))
        distance = float(np.linalg.norm(start.p - sources.shoulder))
        high = heights[0] <= start.p[2] <= heights[1]
        if high and sources.near <= distance <= sources.far:
            with suppress(UnreachableError):
                return start, solver.solve(point_of(start.p), seed=seed, tries=2), redraws
    why = f"the arm of {sources.model.description.name} reaches none of {_TRIES} starts"
    where = f"with its end-effector {heights[0]:g} to {heights[1]:g} m above the floor"
    raise StudyError(f"{why} {where}; try other heights")


def place(sector: str, sources: StudySources, rng: np.random.Generator) -> Start:
    """Choose a random start of the end-effector in a sector; it can be out of the arm's reach."""
    lower, upper = sources.lower, sources.upper
    middle, half = (lower + upper)[:2] / 2, (upper - lower)[:2] / 2
    plan = middle + 0.9 * half * rng.uniform(-1, 1, 2)  # in 90 % of the base's length and width
    aim = np.array([*plan, rng.uniform(_LOWEST, float(upper[2]))])
    while True:
        outwards = rng.standard_normal(3)
        outwards /= np.linalg.norm(outwards)
        if sector_of(outwards) == sector:
            break
    distance = exit_distance(aim, outwards, lower, upper) + rng.uniform(0.22, 0.50)  # [m]
    p = aim + distance * outwards
    return Start(sector, p, aim, (p - aim) / np.linalg.norm(p - aim))


def sector_of(direction: Array) -> str:
    """The sector of a unit vector (3,) in the base's frame."""
    x, y, z = direction.tolist()
    if z > _ABOVE:
        return "above"
    if z < _BELOW:
        return "below"
    azimuth = abs(math.atan2(y, x))
    return next((name for name, edge in _EDGES.items() if azimuth < math.radians(edge)), "back")


def draw_case(parameters: StudyParameters, number: int, sources: StudySources) -> Row:
    """Draw the random quantities of a case, by the columns of the study's table.

    They depend only on the parameters and the number, because a case has its own random streams. A
    release is after 30 to 100 % of the pull, and a new grasp is before the end of the run. A case
    has at most three faults; absent faults have the parameters' defaults. If the arm reaches no
    start in the range of heights, this raises a StudyError.
    """
    rng, others = (
        np.random.default_rng(np.random.SeedSequence(parameters.seed, spawn_key=key))
        for key in ((number,), (number, 1))
    )
    ranges = parameters.ranges
    first = ("speed", *(name for name in PARAMETERS if name not in _LATER))
    drawn: dict[str, Any] = {name: ranges.draw(name, rng) for name in first}
    start, q_m, redraws = draw_start(sources, ranges.height, rng)
    move, along, duration, moving = _draw_pull(start, drawn["speed"], ranges.duration, rng)
    released, regrasped = rng.random() < ranges.released, rng.random() < ranges.regrasped
    release_at = duration * moving * rng.uniform(0.3, 1.0)
    regrasp_at = release_at + duration * (1.0 - moving) * rng.uniform(0.1, 0.9)
    drawn |= {"duration": duration, "moving": moving}
    drawn["release_at"] = release_at if released else None
    drawn["regrasp_at"] = regrasp_at if released and regrasped else None
    drawn |= {name: ranges.draw(name, others) for name in _LATER}
    count = int(others.integers(1, 4)) if others.random() < ranges.faulty else 0
    for name in others.permutation(list(FAULTS))[count:]:
        drawn[name] = parameter(PARAMETERS[name]).default
    drawn["fault_at"] = ranges.draw("fault_at", others) * (duration * moving)
    return {
        "case": number,
        "kind": f"{start.sector}, along" if along else start.sector,
        "redraws": redraws,
        "seed": int(rng.integers(2**32)),
        **{f"start_{axis}_m": x for axis, x in zip("xyz", start.p.tolist(), strict=True)},
        **{f"move_{axis}_m": x for axis, x in zip("xyz", move.tolist(), strict=True)},
        **{column: drawn[name] for name, column in COLUMNS.items()},
        **{f"q{i}_rad": q for i, q in enumerate(q_m.tolist(), start=1)},
    }


def _draw_pull(
    start: Start, speed: float, longest: float, rng: np.random.Generator
) -> tuple[Array, bool, float, float]:
    """Draw a pull from a start; `speed` [m/s] is the largest speed of the hand. This returns the
    displacement (3,) [m], whether the pull is along the base, the duration [s] of pull and rest, at
    most `longest`, and the pull's share [-] of the duration.
    """
    length, along = rng.uniform(*_LENGTH), rng.random() < 0.15
    across, turn = rng.standard_normal(3), rng.uniform(0, math.radians(45.0))
    o, move = start.outwards, start.aim - start.p
    if along:  # perpendicular to the line to the target, turned by `turn` towards the target
        across -= (across @ o) * o
        move = length * (math.cos(turn) * across / np.linalg.norm(across) - math.sin(turn) * o)
        move[2] = max(move[2], _LOWEST - start.p[2])
    else:  # the pull ends at the target, or after 0.6 m
        move = move * min(1.0, _LENGTH[1] / float(np.linalg.norm(move)))
    rest = min(1.0, longest / 4)  # [s] collisions are still possible
    pulling = 1.5 * float(np.linalg.norm(move)) / speed  # the cubic's peak is 1.5 times its mean
    if pulling > longest - rest:
        move = move * ((longest - rest) / pulling)
        pulling = longest - rest
    return move, along, pulling + rest, pulling / (pulling + rest)


def spec_of(row: Row, parameters: StudyParameters) -> RunSpec:
    """The run of a case, from the random quantities in its row."""
    drawn = {path: row[COLUMNS[name]] for name, path in PARAMETERS.items()}
    drawn["disturbance.begins"] = row[COLUMNS["fault_at"]]
    drawn["disturbance.time_stamps"] = "yes" if parameters.time_stamps else "no"
    config = load_robot(parameters.robot).config.changed(drawn)
    scenario = RANDOM_PULL.changed(
        start=tuple(row[f"start_{axis}_m"] for axis in "xyz"),
        move=tuple(row[f"move_{axis}_m"] for axis in "xyz"),
        q_m=tuple(row[key] for key in row if re.fullmatch(r"q\d+_rad", key)),
        **{name: row[COLUMNS[name]] for name in _OF_LINE},
    )
    how = parameters.controller, parameters.physics, row["seed"]
    return RunSpec(parameters.robot, scenario, config, *how)


def play_case(drawn: Row, parameters: StudyParameters, model: RobotModel, data: BorderData) -> Row:
    """Run a case with the random quantities `drawn`, and return its row with the results.

    `nan` is true if a torque, a pose of the base or a result is not finite. If the run stops with
    an error, `error` is the reason, without results; AssetError and RobotFileError are raised.
    """
    try:
        result = run_from_spec(spec_of(drawn, parameters), model, data)
    except (AssetError, RobotFileError):
        raise
    except (DbbError, ValueError, ArithmeticError) as error:
        return {**drawn, "nan": False, "error": f"{type(error).__name__}: {error}"}
    results = flat(result.figures)
    bad = {key for key, x in results.items() if isinstance(x, float) and not math.isfinite(x)}
    stored = {key: None if key in bad else rounded(x) for key, x in results.items()}
    return {**drawn, **stored, "nan": bool(bad) or not result.trace.finite, "error": None}


def met_base(row: Row) -> bool:
    """Whether the arm touched the base in the plant, or the convex bodies of both met."""
    return _met(row, "")


def met_itself(row: Row) -> bool:
    """Whether the arm touched itself in the plant, or two bodies of a pair within the arm met."""
    return _met(row, "arm_")


def _met(row: Row, prefix: str) -> bool:
    distance = row.get(f"{prefix}min_clearance_m")
    return bool(row.get(f"{prefix}contacts")) or (distance is not None and distance <= 0.0)


def too_fast(row: Row) -> bool:
    """Whether a joint exceeded 1.05 of its speed limit, except ≤ 0.1 s after a saturated torque."""
    return (row.get("joint_speed_share_unsaturated_max") or 0.0) > 1.05


def entered_buffer(row: Row, d_b: float) -> bool:
    """Whether the arm came nearer to the base than d_b [m]; false for a run without results."""
    distance = row.get("min_clearance_m")
    return distance is not None and distance < d_b


def failed(row: Row) -> bool:
    """Whether the arm met the base or itself, or the run had a fallback command, NaN or error."""
    broken = row["nan"] or row["error"] or row.get("solver_failures")
    return bool(broken) or met_base(row) or met_itself(row)


def flat(results: Mapping[str, Any]) -> Row:
    """The results of a run that a study stores, by the columns of its table."""
    return flattened({key: value for key, value in results.items() if key not in _NOT_STORED})
