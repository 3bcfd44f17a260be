"""The comparison with other libraries: a common model, one evaluator, and rows for failures."""

from __future__ import annotations

import csv
import json
import sys
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.errors import DescriptionError, UnknownNameError
from app.robot.description import RobotDescription
from app.robot.link_pairs import PairDistances
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.scenarios.line import StartedLine
from benchmarks.peers.__main__ import Peers, main
from benchmarks.peers.drivers import loop
from benchmarks.peers.drivers.capsules import without_capsules
from benchmarks.peers.evaluator import Evaluator, slips
from benchmarks.peers.model import EE, UNICYCLE, CommonModel, common_model
from benchmarks.peers.names import PEERS, Peer, chosen
from benchmarks.peers.paths import PATHS, axis_name, ee_paths
from benchmarks.peers.picture import draw
from benchmarks.peers.plan import DT, arrays_of, run_name, write_plan
from benchmarks.peers.quick import pink_step
from benchmarks.peers.rows import Row, empty_row, flaw, rows_of
from benchmarks.peers.running import Motion, own_python, run_driver
from benchmarks.peers.table import markdown, write_table
from tests.robots import random_measurement

READY = np.array([0.0, -0.7854, 0.0, -2.3562, 0.0, 1.5708, 0.7854])  # [rad]


@pytest.fixture(scope="module")
def common(robot: RobotModel, border_data: BorderData) -> CommonModel:
    return common_model(robot, border_data.pairs.all, (0.5, 1.0))


@pytest.fixture(scope="module")
def judge(common: CommonModel) -> Evaluator:
    return Evaluator(common.planar, common.pairs, EE)


def still(duration: float = 0.05) -> StartedLine:
    """A short path with a known posture, which needs no search."""
    return StartedLine(
        "short",
        duration,
        "",
        "tracking",
        (0.0, 0.0, 0.5),
        (0.01, 0.0, 0.0),
        1.0,
        tuple(READY.tolist()),
    )


# The common model ---------------------------------------------------------------------------------


def test_the_common_model_has_the_projects_kinematics_and_distances(
    robot: RobotModel, border_data: BorderData, judge: Evaluator
) -> None:
    rng, state = np.random.default_rng(0), RobotState(robot)
    reader = PairDistances(robot, border_data.pairs.all)
    assert judge.model.nq == 3 + robot.n_m
    for _ in range(200):
        m = random_measurement(rng)
        q = np.concatenate([m.base_pose, m.q_m])
        state.update(m)
        assert judge.ee(q).isApprox(state.T_world_ee, 1e-9)
        reader.update(robot.configuration(m.base_pose, m.q_m))
        ours = reader.distances()
        np.testing.assert_allclose(judge.distances(q), ours, atol=1e-5)  # tolerance of GJK


def test_the_unicycle_base_has_the_poses_of_the_planar_base(
    common: CommonModel, judge: Evaluator
) -> None:
    unicycle = Evaluator(common.unicycle, common.pairs, EE)
    assert list(unicycle.model.names)[1:3] == list(UNICYCLE)
    rng = np.random.default_rng(1)
    for _ in range(20):
        yaw, ahead = rng.uniform(-2, 2, 2)
        floor = np.concatenate([[ahead * np.cos(yaw), ahead * np.sin(yaw), yaw], READY])
        other = unicycle.ee(np.concatenate([[yaw, ahead], READY]))
        assert judge.ee(floor).isApprox(other, 1e-12)


def test_capsules_as_marked_cylinders_have_the_same_distances(
    common: CommonModel, judge: Evaluator
) -> None:
    text = without_capsules(common.planar)
    assert "<geometry><capsule" not in text.replace("\n", "").replace(" ", "")
    assert "version" not in text
    old, rng = Evaluator(text, common.pairs, EE), np.random.default_rng(2)
    for _ in range(50):
        q = rng.uniform(judge.model.lowerPositionLimit, judge.model.upperPositionLimit)
        np.testing.assert_allclose(old.distances(q), judge.distances(q), atol=1e-12)


def test_the_common_model_has_the_projects_limits(robot: RobotModel, judge: Evaluator) -> None:
    np.testing.assert_array_equal(judge.model.lowerPositionLimit[3:], robot.q_lower)
    np.testing.assert_array_equal(judge.model.upperPositionLimit[3:], robot.q_upper)
    np.testing.assert_array_equal(judge.model.velocityLimit[3:], robot.qd_max)
    np.testing.assert_array_equal(judge.model.velocityLimit[:3], [0.5, 0.5, 1.0])


@pytest.mark.parametrize("kind", ["planar", "unicycle"])
def test_no_link_has_the_name_of_a_joint(common: CommonModel, kind: str) -> None:
    """The library roboplan refuses equal names of a link and a joint."""
    tree = ElementTree.fromstring(getattr(common, kind))
    links, joints = ([e.get("name") for e in tree.iterfind(tag)] for tag in ("link", "joint"))
    assert len({*links, *joints}) == len(links) + len(joints)


def test_a_body_of_two_shapes_is_refused_with_its_name(
    robot: RobotModel, border_data: BorderData
) -> None:
    data = robot.description.model_dump(exclude_unset=True)
    data["bodies"][4]["shapes"] = [*data["bodies"][4]["shapes"]] * 2
    double = RobotModel(RobotDescription.model_validate(data))
    with pytest.raises(DescriptionError, match="panda_link6: has 2 shapes"):
        common_model(double, border_data.pairs.all, (0.5, 1.0))


# The evaluator -----------------------------------------------------------------------------------


def drive(x: np.ndarray, y: np.ndarray, yaw: np.ndarray) -> np.ndarray:
    """(N, 10) configurations: base at x, y [m] and yaw [rad], (N,) each; arm at `READY`."""
    return np.column_stack([x, y, yaw, np.tile(READY, (len(x), 1))])


def test_a_base_that_drives_straight_has_a_path_and_no_slip(judge: Evaluator) -> None:
    s, dt = np.arange(21) * 0.001, 0.005
    q = drive(0.8 * s, 0.6 * s, np.full(21, np.arctan2(0.6, 0.8)))
    poses = [judge.ee(at) for at in q]
    found = judge.figures(q, np.array([T.translation for T in poses]), poses[0].rotation, dt)
    assert found["error_max_m"] == pytest.approx(0.0, abs=1e-12)
    assert found["turn_error_max_rad"] == pytest.approx(0.0, abs=1e-7)
    assert found["base_path_m"] == pytest.approx(0.02)
    assert found["base_turned_rad"] == 0.0
    assert found["slip_m"] == pytest.approx(0.0, abs=1e-12)
    assert found["base_change_max_mps2"] == pytest.approx(0.2 / dt)  # from rest to 0.2 m/s
    assert found["arm_change_max_radps2"] == 0.0
    assert found["clearance_m"] == pytest.approx(judge.distances(q[0]).min())


def test_errors_are_distance_and_rotation_of_the_end_effector(judge: Evaluator) -> None:
    q = drive(np.zeros(3), np.zeros(3), np.zeros(3))
    at = judge.ee(q[0])
    p = at.translation + np.array([[0.0, 0.0, 0.0], [0.0, 0.03, 0.04], [0.01, 0.0, 0.0]])
    found = judge.figures(q, p, at.rotation @ pin.rpy.rpyToMatrix(0.2, 0.0, 0.0), 0.005)
    assert found["error_max_m"] == pytest.approx(0.05)
    assert found["error_final_m"] == pytest.approx(0.01)
    assert found["turn_error_final_rad"] == pytest.approx(0.2)


def test_the_clearance_is_the_minimum_over_all_pairs_and_times(judge: Evaluator) -> None:
    q = drive(np.zeros(40), np.zeros(40), np.zeros(40))
    q[:, 4] = np.linspace(READY[1], 1.7, 40)  # the shoulder lowers the end-effector
    q[30:, 4] = READY[1]  # and raises it again before the end
    least = min(judge.distances(at).min() for at in q)
    assert judge.figures(q, np.zeros((40, 3)), np.eye(3), DT)["clearance_m"] == least
    assert least < judge.distances(q[-1]).min()


def test_slip_is_only_motion_that_no_heading_of_a_step_explains() -> None:
    yaw = np.linspace(0.0, 1.0, 101)
    arc = drive(np.sin(yaw), 1.0 - np.cos(yaw), yaw)
    np.testing.assert_array_equal(slips(arc), 0.0)
    step = 0.01 * np.column_stack([np.cos(yaw), np.sin(yaw)])
    at = np.vstack([np.zeros(2), np.cumsum(step, axis=0)])[:-1]
    np.testing.assert_allclose(slips(drive(*at.T, yaw)), 0.0, atol=1e-15)
    aside = drive(np.zeros(11), np.linspace(0.0, 0.1, 11), np.zeros(11))
    assert slips(aside).sum() == pytest.approx(0.1)


def test_an_unknown_link_is_refused(common: CommonModel) -> None:
    with pytest.raises(ValueError, match="no shape nowhere_0"):
        Evaluator(common.planar, [("base_link", "nowhere")], EE)
    with pytest.raises(ValueError, match="no link nowhere"):
        Evaluator(common.planar, common.pairs, "nowhere")


# The paths ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["side", "front", axis_name(0.010)])
def test_a_path_starts_at_the_end_effector_and_goes_from_rest_to_rest(
    robot: RobotModel, border_data: BorderData, judge: Evaluator, name: str
) -> None:
    line = ee_paths(robot, border_data, [name])[name]
    found = arrays_of(robot, {name: line})
    p, R = found[f"{name}_p"], found[f"{name}_R"]
    at = judge.ee(np.concatenate([np.zeros(3), line.q_m]))
    assert p.shape == (3001, 3)
    np.testing.assert_allclose(p[0], at.translation, atol=1e-5)
    np.testing.assert_allclose(R, at.rotation, atol=1e-9)
    np.testing.assert_allclose(p[-1] - p[0], line.move, atol=1e-12)
    speed = np.linalg.norm(np.diff(p, axis=0), axis=1) / DT
    assert speed[0] < 1e-3 * speed.max() > speed[-1]
    assert speed.max() == pytest.approx(1.5 * np.linalg.norm(line.move) / 15.0, rel=1e-3)
    assert judge.distances(np.concatenate([np.zeros(3), line.q_m])).min() > Config().border.d_b


def test_a_path_on_the_wheel_axis_starts_with_its_closest_point_there(
    robot: RobotModel, border_data: BorderData
) -> None:
    (line,) = ee_paths(robot, border_data, [axis_name(0.010)]).values()
    reader = PairDistances(robot, border_data.pairs.mobile)
    reader.update(robot.configuration(np.zeros(3), np.array(line.q_m)))
    nearest = min((reader.closest(i) for i in range(len(reader.pairs))), key=lambda c: c.d)
    assert nearest.p_b[0] == pytest.approx(0.010, abs=1e-6)
    np.testing.assert_allclose(line.move, [0.0, -0.2, 0.0])


# The drivers --------------------------------------------------------------------------------------


class _Still:
    """A library that does not move and fails at a base cost below 1."""

    def __init__(self, plan: loop.Plan, q: np.ndarray, base_cost: float) -> None:
        self._q, self._fails = q, base_cost < 1.0
        self.targets: list[np.ndarray] = []

    def distances(self) -> list[float]:
        return [0.5]

    def step(self, target: np.ndarray) -> np.ndarray:
        self.targets.append(target[:3, 3].copy())
        if self._fails and len(self.targets) == 3:
            raise RuntimeError("no\nsolution")
        return self._q


def test_a_failed_run_stores_its_reason_and_the_other_runs_continue(
    robot: RobotModel, border_data: BorderData, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_plan(tmp_path, robot, border_data, {"short": still()}, (1.0, 300.0))
    out = tmp_path / "out"
    out.mkdir()
    monkeypatch.setattr(sys, "argv", ["driver", str(tmp_path), str(out)])
    made: list[_Still] = []
    loop.main(lambda *given: made.append(_Still(*given)) or made[-1], "numpy")
    reason = (out / f"{run_name('short', 1.0)}.error").read_text(encoding="utf-8")
    assert reason == "at 0.01 s: RuntimeError: no solution"
    assert not (out / f"{run_name('short', 1.0)}.npz").exists()
    with np.load(out / f"{run_name('short', 300.0)}.npz") as found:
        np.testing.assert_array_equal(found["q"], np.tile([0, 0, 0, *READY], (11, 1)))
        assert found["step_s"].shape == (10,)
        assert (found["step_s"] > 0.0).all()
    assert json.loads((out / "about.json").read_text()) == {"numpy": np.__version__}
    expected = [still().place((k + 1) * DT) for k in range(10)]
    np.testing.assert_allclose(made[1].targets, expected)


@pytest.mark.slow
def test_the_projects_driver_writes_motion_and_step_times(
    robot: RobotModel, border_data: BorderData, judge: Evaluator, tmp_path: Path
) -> None:
    plan = tmp_path / "plan"
    plan.mkdir()
    write_plan(plan, robot, border_data, {"short": still()}, (300.0,), physics="kinematic")
    done = run_driver("none", PEERS["dbb"], own_python(), plan, tmp_path / "out")
    assert done.errors == {}
    (motion,) = done.motions.values()
    assert motion.step_s.shape == (50,)
    assert motion.failures == 0
    assert flaw(motion, 11, judge) == ""
    np.testing.assert_array_equal(motion.q[0], [0, 0, 0, *READY])
    assert np.abs(np.diff(motion.q[:, 3:], axis=0)).max() > 0.0


def test_an_invalid_motion_is_reported_with_the_reason(judge: Evaluator) -> None:
    q = np.tile([0.0, 0.0, 0.0, *READY], (3, 1))
    d, times = judge.distances(q[0]), np.ones(2)
    assert flaw(Motion(q, times, d), 3, judge) == ""
    assert "another model" in flaw(Motion(q, times, d + 1e-3), 3, judge)
    assert "another model" in flaw(Motion(q, times, d * np.nan), 3, judge)
    assert "shape (3, 10), not (4, 10)" in flaw(Motion(q, times, d), 4, judge)
    assert "not finite" in flaw(Motion(np.full_like(q, np.nan), times, d), 3, judge)
    assert flaw(Motion(q, times, d[:0]), 3, judge) == ""  # a library that reports no distances


# The table ----------------------------------------------------------------------------------------


def good_row(name: str, path: str, weight: float) -> Row:
    run = {"path": path, "base_weight": weight}
    return empty_row(name, PEERS[name], run, "ok", "", "9.9") | {
        "clearance_m": 0.0512,
        "error_final_m": 0.055,
        "error_max_m": 0.055,
        "turn_error_final_rad": 0.0,
        "turn_error_max_rad": 0.0,
        "base_path_m": 0.25,
        "base_turned_rad": 0.1,
        "slip_m": 1e-9,
        "base_change_max_mps2": 3.0,
        "base_turn_change_max_radps2": 1.0,
        "arm_change_max_radps2": 40.0,
        "solver_failures": 0,
        "step_p50_us": 450.0,
        "step_p99_us": 900.0,
        "step_max_us": 1500.0,
    }


def test_a_peer_that_cannot_be_installed_gives_a_row_with_the_reason(
    judge: Evaluator, tmp_path: Path
) -> None:
    blocked = tmp_path / "envs"
    blocked.write_text("a file where the folder should be", encoding="utf-8")
    plan = {"runs": [{"name": "side-300", "path": "side", "base_weight": 300.0}]}
    (row,) = rows_of("pink", PEERS["pink"], plan, tmp_path, blocked, judge)
    assert row["status"] == "missing"
    assert "not installed" in row["reason"]
    assert str(blocked) in row["reason"]


def test_a_driver_that_does_not_start_gives_rows_with_the_reason(
    robot: RobotModel, border_data: BorderData, judge: Evaluator, tmp_path: Path
) -> None:
    """The test's interpreter has no placo, so the driver ends with an ImportError."""
    (tmp_path / "plan").mkdir()
    plan, _ = write_plan(tmp_path / "plan", robot, border_data, {"short": still()}, (1.0, 300.0))
    here = Peer("without placo", "placo")  # no requirements: run by the test's interpreter
    rows = rows_of("placo", here, plan, tmp_path, tmp_path / "envs", judge)
    assert [row["status"] for row in rows] == ["failed", "failed"]
    assert "No module named 'placo'" in rows[0]["reason"]


def test_the_table_contains_the_rows_of_a_missing_peer(tmp_path: Path) -> None:
    run = {"path": "side", "base_weight": 300.0}
    rows = [
        good_row("dbb", "side", 300.0),
        empty_row("pink", PEERS["pink"], run, "missing", "no network"),
    ]
    result = write_table(tmp_path, rows, {"cores": 2})
    assert result["all_ran"] is False
    assert json.loads((tmp_path / "table.json").read_text(encoding="utf-8")) == result
    with (tmp_path / "table.csv").open(encoding="utf-8") as file:
        first, second = csv.DictReader(file)
    assert (first["peer"], first["clearance_m"], first["status"]) == ("dbb", "0.0512", "ok")
    assert (second["peer"], second["clearance_m"], second["status"]) == ("pink", "", "missing")
    text = (tmp_path / "table.md").read_text(encoding="utf-8")
    (ours,) = [line for line in text.splitlines() if line.startswith("| proposed (DBB) 9.9 |")]
    for figure in ("0.450 / 0.90 ms", "55 mm", "0.25 m", "51 mm"):
        assert figure in ours
    assert "| pink | missing |" in text
    assert "- pink missing (side at 300): no network" in text


def test_each_line_of_the_table_has_the_same_number_of_cells() -> None:
    rows = [good_row(name, path, 300.0) for name in PEERS for path in PATHS]
    rows[0] |= {"status": "failed", "reason": "why"}
    lines = [line for line in markdown(rows).splitlines() if line.startswith("|")]
    assert len(lines) == 2 + len(PEERS)
    assert len({line.count("|") for line in lines}) == 1


def test_the_picture_is_drawn_despite_missing_rows() -> None:
    run = {"path": "front", "base_weight": 1.0}
    rows = [good_row("dbb", "side", 300.0), good_row("dbb", "side", 1.0)]
    rows += [empty_row("pink", PEERS["pink"], run, "missing", "no network")]
    assert draw(rows).startswith(b"\x89PNG")


# Options ------------------------------------------------------------------------------------------


def test_unknown_peers_and_physics_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UnknownNameError, match=r"unknown peer 'pinc'.*did you mean 'pink'"):
        main(Peers(only=("pinc",), out=tmp_path))
    with pytest.raises(UnknownNameError, match="unknown physics 'moon'"):
        main(Peers(physics="moon", out=tmp_path))
    assert list(chosen(("dbb", "pink"))) == ["pink", "dbb"]
    assert chosen(()) == PEERS


def test_the_step_time_of_a_missing_pink_is_none_with_the_reason(
    robot: RobotModel, border_data: BorderData, tmp_path: Path
) -> None:
    (tmp_path / "envs").write_text("a file in place of the folder", encoding="utf-8")
    step = pink_step(robot, border_data, tmp_path / "envs")
    assert step.p50_us is None
    assert step.p99_us is None
    assert str(tmp_path / "envs") in step.reason


@pytest.mark.slow
def test_a_missing_peer_fails_the_command_unless_it_is_allowed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "envs").write_text("a file where the folder should be", encoding="utf-8")
    assert main(Peers(only=("placo",), out=tmp_path, json=True)) == 1
    result = json.loads(capsys.readouterr().out)
    assert result["all_ran"] is False
    assert [row["path"] for row in result["rows"]] == [*PATHS, *PATHS]
    assert {row["status"] for row in result["rows"]} == {"missing"}
    assert json.loads((tmp_path / "table.json").read_text(encoding="utf-8")) == result
    assert (tmp_path / "peers.png").read_bytes().startswith(b"\x89PNG")
    assert main(Peers(only=("placo",), out=tmp_path, allow_missing=True)) == 0
    assert "- placo missing (all)" in capsys.readouterr().out
