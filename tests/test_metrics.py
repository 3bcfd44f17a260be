"""The record of a run: units of its columns, and figures recomputed from the raw file."""

from __future__ import annotations

import csv
import math
from itertools import pairwise
from typing import Any

import numpy as np
import pyarrow.parquet as pq
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.errors import AssetError
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.simulation.plants.interface import Contacts
from app.simulation.scenarios import LINES
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import Session, Step
from app.simulation.trace.columns import TraceMeta
from app.simulation.trace.log_file import write_trace
from app.simulation.trace.metrics import NEAR, metrics, sign_changes
from app.simulation.trace.snapshot import QUANTITIES
from app.simulation.trace.trace import Recorder, Trace
from app.simulation.trace.words import number_text
from tests.steps import kept

ARM = ("l1-lEE", "l1-l3", "l2-lEE")
MOBILE = ("lm-lEE", "lm-l3")
Columns = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def recorded(robot: RobotModel, border_data: BorderData) -> tuple[Trace, list[Step]]:
    """A pull into the buffer with a few inserted contacts; the person releases before the end."""
    scenario = LINES["guiding-lateral"].changed(duration=2.0)
    q_m = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(scenario.start)
    session = Session(robot, border_data, Config(), physics="kinematic")
    session.reset(q_m)
    put_in = {700: (1, 0, 0), 701: (1, 1, 1), 702: (0, 1, 1), 703: (0, 0, 1)}
    recorder, steps = Recorder(drawn=True), []
    for k in range(2003):
        pull = scenario.place(session.t) if k < 1551 else None
        step = session.step(pull=pull)
        if k in put_in:
            step = step._replace(contacts=Contacts(*map(bool, put_in[k])))
        recorder.add(session, step)
        steps.append(kept(step))
    return recorder.trace(), steps


@pytest.fixture(scope="module")
def raw(recorded, tmp_path_factory) -> Columns:
    """The columns of the CSV that have a number in every row, read by the csv module."""
    path = tmp_path_factory.mktemp("trace") / "run.csv"
    write_trace(path, recorded[0])
    with path.open(encoding="utf-8", newline="") as file:
        next(file)  # the header of the run
        rows = list(csv.DictReader(file))
    words = {"true": 1.0, "false": 0.0}
    whole = [name for name in rows[0] if all(row[name] for row in rows)]
    return {
        name: np.array([float(words.get(row[name], row[name])) for row in rows]) for name in whole
    }


@pytest.mark.slow
def test_csv_and_parquet_contain_the_numbers_of_the_steps(recorded, raw, tmp_path):
    trace, steps = recorded
    write_trace(tmp_path / "run.parquet", trace)
    table = pq.read_table(tmp_path / "run.parquet")
    for name, values in raw.items():
        np.testing.assert_array_equal(table[name].to_numpy(), values, err_msg=name)
    for k in (0, 1, 777, 2002):
        step = steps[k]
        for i in range(7):
            assert raw[f"q_panda_joint{i + 1}_rad"][k] == step.truth.q_m[i]
            assert raw[f"qd_panda_joint{i + 1}_radps"][k] == step.truth.qd_m[i]
            assert raw[f"u_panda_joint{i + 1}_nm"][k] == step.control.u_cmd[i]
        pose = [raw[name][k] for name in ("base_x_m", "base_y_m", "base_yaw_rad")]
        assert pose == step.truth.base_pose.tolist()
        commanded = [raw["base_a_mps2"][k], raw["base_aw_radps2"][k]]
        assert commanded == step.control.a_base_cmd.tolist()
        w = step.control
        for pair, d, beta in zip(w.pairs, step.distances, w.beta, strict=True):
            assert raw[f"d_{pair.name}_m"][k] == d
            assert raw[f"beta_{pair.name}"][k] == beta


def jump(values: np.ndarray) -> float:
    return max(abs(b - a) for a, b in pairwise(values.tolist()))


def turns(values: np.ndarray, band: float) -> int:
    signs = [math.copysign(1.0, x) for x in values.tolist() if abs(x) > band]
    return sum(a != b for a, b in pairwise(signs))


def recomputed(r: Columns) -> dict[str, Any]:
    """All figures of merit from the columns of the file alone, in plain loops."""
    x, y, yaw = (r[f"base_{name}"].tolist() for name in ("x_m", "y_m", "yaw_rad"))
    steps = [
        math.hypot(b - a, d - c) for (a, b), (c, d) in zip(pairwise(x), pairwise(y), strict=True)
    ]
    u = [r[f"u_panda_joint{i}_nm"] for i in range(1, 8)]
    force = [
        math.hypot(*f) for f in zip(*(r[f"hand_force_{a}_n"].tolist() for a in "xyz"), strict=True)
    ]
    d = {pair: r[f"d_{pair}_m"] for pair in (*MOBILE, *ARM)}
    near = [k for k in range(len(x)) if min(d[pair][k] for pair in d) < NEAR]
    full = [k for k in range(len(x)) if max(r[f"beta_{pair}"][k] for pair in d) >= 1.0]
    held = [k for k, people in enumerate(r["people"].tolist()) if people]

    def smooth(name: str) -> dict[str, Any]:
        linear, angular = r[f"{name}_a_mps2"], r[f"{name}_aw_radps2"]
        return {
            f"{name}_acceleration_jump_max": {
                "linear_mps2": jump(linear),
                "angular_radps2": jump(angular),
            },
            f"{name}_acceleration_sign_changes": {
                "linear": turns(linear, 0.01),
                "angular": turns(angular, 0.01),
            },
        }

    return {
        "min_distance_m": {pair: min(values.tolist()) for pair, values in d.items()},
        "min_clearance_m": min(min(d[pair].tolist()) for pair in MOBILE),
        "arm_min_clearance_m": min(min(d[pair].tolist()) for pair in ARM),
        "contacts": sum(r["contact"]),
        "arm_contacts": sum(r["arm_contact"]),
        "floor_contacts": sum(r["floor_contact"]),
        "ee_error_max_m": max(r["ee_error_m"]),
        "ee_error_final_m": r["ee_error_m"][-1],
        "base_displacement_m": math.hypot(x[-1] - x[0], y[-1] - y[0]),
        "base_path_m": sum(steps),
        "base_path_after_release_m": sum(steps[held[-1] :]),
        "base_speed_final_mps": abs(r["base_v_mps"][-1]),
        "base_yaw_rad": yaw[-1] - yaw[0],
        "activation_max": max(r["activation"]),
        **smooth("base"),
        **smooth("avoidance"),
        "torque_jump_max_nm": max(map(jump, u)),
        "torque_rate_sign_changes": max(turns(np.diff(values), 0.003) for values in u),
        "hand_force_max_n": max(force),
        "hand_force_clear_max_n": max(force[: near[0] + 1] if near else force),
        "force_bound_min_n": min((f for f in r["force_bound_n"] if f == f), default=None),
        "hand_speed_max_mps": max(r["hand_speed_mps"]),
        "clear_since_s": r["t_s"][full[-1]] if full else 0.0,
        "approach_speed_max_mps": r["approach_speed_max_mps"][-1],
        "buffer_needed_m": r["buffer_needed_max_m"][-1],
        "solver_failures": r["solver_failures"][-1],
        "solver_given_up": r["solver_given_up"][-1],
        "step_p50_us": float(np.median(r["duration_us"])),
    }


@pytest.mark.slow
def test_every_figure_of_merit_equals_that_of_the_raw_file(robot: RobotModel, recorded, raw):
    figures, again = metrics(recorded[0]), recomputed(raw)
    speeds = [
        float(np.abs(raw[f"qd_panda_joint{i + 1}_radps"]).max()) / most
        for i, most in enumerate(robot.qd_max)
    ]
    again["joint_speed_share_max"] = again["joint_speed_share_unsaturated_max"] = max(speeds)
    for key, value in again.items():
        assert figures[key] == pytest.approx(value, abs=1e-9), key
    assert set(figures) - set(again) == {"stuck", "left_way", "fault_s", "step_p99_us"}
    assert figures["contacts"] == figures["arm_contacts"] == 2
    assert figures["floor_contacts"] == 3
    assert figures["base_path_m"] > figures["base_path_after_release_m"] > 0.0
    assert figures["activation_max"] > 0.1


def changed(trace: Trace, quantity: str, values: Any) -> Trace:
    """The trace with other values of a quantity."""
    again = trace.rows(slice(None))
    again.table = trace.table.copy()
    again.of(quantity)[:] = values
    return again


def test_without_a_final_release_there_is_no_path_after_release(recorded):
    people = np.ones(len(recorded[0]))
    for held in (people, 0 * people, people * (np.arange(len(people)) // 900 != 1)):
        assert metrics(changed(recorded[0], "people", held))["base_path_after_release_m"] is None


@pytest.mark.parametrize("near", [0, 350, 1204])
def test_the_clear_hand_force_counts_until_two_bodies_are_near(recorded, near: int):
    trace, steps = recorded
    forces = [float(np.linalg.norm(s.hand_force)) for s in steps]
    pairs = np.full(trace.of("pairs").shape, 0.3)
    pairs[near:, 3] = NEAR - 1e-6
    figures = metrics(changed(trace, "pairs", pairs))
    assert figures["hand_force_clear_max_n"] == pytest.approx(max(forces[: near + 1]))
    assert figures["hand_force_max_n"] == pytest.approx(max(forces))


def test_a_single_nan_makes_a_trace_not_finite(recorded):
    torques = recorded[0].of("u_a").copy()
    assert recorded[0].finite
    torques[1234, 3] = np.nan
    assert not changed(recorded[0], "u_a", torques).finite


def test_sign_changes_are_counted_beyond_a_dead_band():
    steps = np.arange(1000)
    for tooth, count in ((0.0, 0), (0.002, 0), (0.1, 998)):
        rates = np.column_stack([0.001 + tooth * (-1.0) ** steps[:-1], np.full(999, -0.01)])
        assert sign_changes(rates, 0.003) == count


KINDS = {"rad": ("rad", "radps", "nm"), "m": ("m", "mps", "n")}


@pytest.mark.parametrize(
    ("name", "base", "lifts"),
    [
        ("husky_panda", ["v_mps", "w_radps"], 0),
        ("frankie_omni", ["vx_mps", "vy_mps", "w_radps"], 0),
        ("stretch_se3", ["v_mps", "w_radps"], 5),
        ("tiago", ["v_mps", "w_radps"], 1),
        ("racecar_panda", ["v_mps", "w_radps"], 0),
    ],
)
def test_each_quantity_has_the_unit_of_its_joint_or_base(name: str, base: list[str], lifts: int):
    try:
        model = RobotModel(load_robot(name))
    except AssetError as error:  # an optional package
        pytest.skip(str(error))
    meta = TraceMeta.of(model, {"lm-lEE": True}, Config())
    columns = {c.name: c for q in QUANTITIES.values() for c in q.columns(meta)}
    assert len(columns) == sum(len(q.columns(meta)) for q in QUANTITIES.values())
    prismatic = 0
    for joint in model.description.arm.joints:
        kind = "m" if "P" in model.pin.joints[model.pin.getJointId(joint)].shortname() else "rad"
        prismatic += kind == "m"
        for stem, unit in zip(("q", "qd", "u"), KINDS[kind], strict=True):
            assert f"{stem}_{joint}_{unit}" in columns
    assert prismatic == lifts
    for axis in base:
        assert f"base_{axis}" in columns
        assert f"command_{axis}" in columns
    floats = [c.name for c in columns.values() if c.kind == "float"]
    units = ("_s", "_m", "_rad", "_nm", "_n", "_us", "_mps", "_radps", "_mps2", "_radps2")
    bare = ("beta_", "q_ee_", "realtime_factor", "speed", "activation")
    assert [n for n in floats if not n.endswith(units) and not n.startswith(bare)] == []
    turning = [n for n in columns if n.startswith(("base_", "command_", "avoidance_"))]
    assert all(("rad" in n) == ("w_" in n or "yaw" in n or "aw_" in n) for n in turning)


def test_missing_and_infinite_numbers_have_the_same_text() -> None:
    value = {"a_m": None, "b_m": [float("nan"), 1.5], "c_m": float("inf")}
    assert number_text(value, "never") == "a_m never, b_m never, 1.5, c_m never"
