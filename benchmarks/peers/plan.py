"""The common input of all drivers: the model, the paths, the weights."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from app.border.cache import BorderData
from app.config import Config
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.scenarios.line import StartedLine
from benchmarks.peers.model import EE, PLANAR, UNICYCLE, CommonModel, common_model

Array = np.ndarray

BASE_WEIGHTS = (300.0, 1.0)
"""[-] costs of base motion relative to arm motion; a library's objective has their squares."""
DT = 0.005
"""[s] time between two steps of a library, and between two samples of all motions."""
D_MIN = 0.05
"""[m] minimum distance of all pairs, also for the barriers of our own controllers."""
RATE = 20.0
"""[1/s] largest approach speed divided by the remaining distance, also for our own barriers."""
_EE_COST = 10.0  # [1/m and 1/rad] cost of the end-effector's error; the objective has its square
_ARM_COST = 0.1  # [1/rad] cost of a step of each joint of the arm; the objective has its square
_DETECTION = 0.3  # [m] distance above which a library can ignore a pair


def run_name(path: str, base_weight: float) -> str:
    """The name of a run, such as `side-300`."""
    return f"{path}-{base_weight:g}"


def write_plan(
    folder: Path,
    model: RobotModel,
    data: BorderData,
    paths: Mapping[str, StartedLine],
    base_weights: tuple[float, ...] = BASE_WEIGHTS,
    *,
    physics: str = "planar",
) -> tuple[dict[str, Any], CommonModel]:
    """Write `plan.json`, `paths.npz` and the URDFs into a folder that exists.

    Args:
        folder: The folder.
        model: The robot.
        data: Its pairs.
        paths: The paths by their names.
        base_weights: [-] costs of base motion; each path runs with each of them.
        physics: The plant of our own controllers.

    Returns:
        The content of the JSON, and the common model.
    """
    limits = Config().admittance
    common = common_model(model, data.pairs.all, (limits.v_max, limits.omega_max))
    (folder / "robot.urdf").write_text(common.planar, encoding="utf-8")
    (folder / "unicycle.urdf").write_text(common.unicycle, encoding="utf-8")
    plan = {
        "planar_urdf": "robot.urdf",
        "unicycle_urdf": "unicycle.urdf",
        "paths": "paths.npz",
        "ee": EE,
        "planar_joints": PLANAR,
        "unicycle_joints": UNICYCLE,
        "arm_joints": common.joints,
        "pairs": common.pairs,
        "base_velocity": [limits.v_max, limits.omega_max],
        "arm_velocity": model.qd_max.tolist(),
        "dt_s": DT,
        "d_min_m": D_MIN,
        "rate_per_s": RATE,
        "detection_m": _DETECTION,
        "ee_cost": _EE_COST,
        "arm_cost": _ARM_COST,
        "robot": model.description.name,
        "physics": physics,
        "lines": {name: _line(line) for name, line in paths.items()},
        "runs": [
            {"name": run_name(path, weight), "path": path, "base_weight": weight}
            for weight in base_weights
            for path in paths
        ],
    }
    (folder / "plan.json").write_text(json.dumps(plan, indent=1), encoding="utf-8")
    arrays: dict[str, Any] = arrays_of(model, paths)
    np.savez(folder / "paths.npz", **arrays)
    return plan, common


def arrays_of(model: RobotModel, paths: Mapping[str, StartedLine]) -> dict[str, Array]:
    """The content of `paths.npz`.

    For each path, `NAME_p` (N + 1, 3) [m] has the targets of the end-effector every `DT` from the
    start, and `NAME_R` (3, 3) is the constant orientation.
    """
    state, found = RobotState(model), {}
    for name, line in paths.items():
        zero = np.zeros(model.n_m)
        state.update(Measurement(np.zeros(3), np.zeros(2), np.array(line.q_m), zero))
        count = round(line.duration / DT)
        found[f"{name}_p"] = np.array([line.place(k * DT) for k in range(count + 1)])
        found[f"{name}_R"] = state.T_world_ee.rotation.copy()
    return found


def _line(line: StartedLine) -> dict[str, Any]:
    return {
        "q_m_rad": line.q_m,
        "start_m": line.start,
        "move_m": line.move,
        "duration_s": line.duration,
    }
