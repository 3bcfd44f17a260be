"""Figures and log of a run against the steps themselves, counted again in another way."""

from __future__ import annotations

import csv

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import ControlOutput
from app.control.force_bound import force_bound
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.interface import Contacts
from app.simulation.scenarios.names import LINES
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import Session, Step
from app.simulation.trace.changes import Changes
from app.simulation.trace.recording import NEAR, Recorder


@pytest.fixture(scope="module")
def steps(robot: RobotModel, border_data: BorderData) -> list[Step]:
    """A pull into the buffer, with a few contacts and failures put in by hand."""
    scenario = LINES["guiding-lateral"].changed(duration=2.0)
    q_m = StartSolver(robot, border_data.pairs, Config().border.d_b).solve(scenario.start)
    session = Session(robot, border_data, Config(), physics="kinematic")
    session.reset(q_m)
    steps = [session.step(pull=scenario.position(session.t)[0]) for _ in range(2003)]
    for k, contacts in ((700, (1, 0, 0)), (701, (1, 1, 0)), (702, (0, 1, 1)), (703, (0, 0, 1))):
        steps[k] = steps[k]._replace(contacts=Contacts(*map(bool, contacts)))
    steps[701] = steps[701]._replace(contacts=Contacts(True, True, True))
    failed: ControlOutput = steps[900].output._replace(solved=False)
    steps[900] = steps[900]._replace(output=failed)
    return steps


@pytest.fixture(scope="module")
def recorder(robot: RobotModel, steps: list[Step]) -> Recorder:
    recorder = Recorder(robot)
    for step in steps:
        recorder.add(step)
    return recorder


@pytest.mark.slow
def test_figures_are_those_of_the_steps(recorder: Recorder, steps: list[Step]):
    figures = recorder.figures()
    names = [pair.closest.pair.name for pair in steps[0].output.avoidance.pairs]
    d = np.array([[pair.closest.d for pair in s.output.avoidance.pairs] for s in steps])
    least = dict(zip(names, d.min(axis=0).tolist(), strict=True))
    assert figures["min_distance_m"] == least
    assert figures["min_clearance_m"] == min(least["lm-lEE"], least["lm-l3"])
    assert figures["arm_min_clearance_m"] == min(least["l1-lEE"], least["l1-l3"], least["l2-lEE"])
    assert figures["contacts"] == 2
    assert figures["arm_contacts"] == 2
    assert figures["floor_contacts"] == 3
    assert figures["solver_failures"] == 1
    errors = [s.ee_error for s in steps]
    assert (figures["ee_error_max_m"], figures["ee_error_final_m"]) == (max(errors), errors[-1])
    assert figures["activation_max"] == max(s.output.activation for s in steps) > 0.0
    assert figures["hand_force_max_n"] == max(float(np.linalg.norm(s.hand_force)) for s in steps)


def test_ways_and_jumps_are_those_of_the_steps(recorder: Recorder, steps: list[Step]):
    figures = recorder.figures()
    pose = np.array([s.measurement.base_pose for s in steps])
    way = np.linalg.norm(np.diff(pose[:, :2], axis=0), axis=1).sum()
    assert figures["base_path_m"] == pytest.approx(way)
    assert figures["base_displacement_m"] == pytest.approx(np.linalg.norm((pose[-1] - pose[0])[:2]))
    assert figures["base_yaw_rad"] == pytest.approx(pose[-1, 2] - pose[0, 2])
    assert figures["base_path_m"] >= figures["base_displacement_m"] > 1e-3
    asked = np.array([s.output.base_acceleration for s in steps])
    jump = np.abs(np.diff(asked, axis=0)).max(axis=0)
    assert list(figures["base_acceleration_jump_max"].values()) == pytest.approx(jump.tolist())
    torques = np.array([s.output.u_a for s in steps])
    assert figures["torque_jump_max_nm"] == np.abs(np.diff(torques, axis=0)).max()


def test_a_torque_that_goes_to_and_fro_is_counted_by_the_turns_of_its_rate():
    poses, steps = np.zeros((1000, 3)), np.arange(1000)
    ramp = np.column_stack([0.01 * steps, 5.0 - 0.01 * steps])
    for tooth, turns in ((0.0, 0), (0.002, 0), (0.1, 998)):
        changes = Changes()
        for k in range(0, 1000, 100):
            swing = np.outer((-1.0) ** steps[k : k + 100], [tooth, 0.0])
            changes.add(ramp[k : k + 100] + swing, poses[k : k + 100])
        assert changes.torque_rate_sign_changes == turns


def test_times_are_percentiles_in_microseconds(recorder: Recorder, steps: list[Step]):
    figures = recorder.figures()
    durations = sorted(1e6 * s.duration for s in steps)
    assert figures["step_p50_us"] == pytest.approx(durations[len(steps) // 2])
    assert durations[1960] <= figures["step_p99_us"] <= durations[2000]


def test_the_log_has_every_tenth_step_as_it_was(recorder: Recorder, steps: list[Step], tmp_path):
    path = tmp_path / "log.csv"
    recorder.write_log(path)
    with path.open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 201
    for row, step in zip(rows, steps[::10], strict=True):
        assert float(row["t_s"]) == step.t
        m, out = step.measurement, step.output
        for i in range(7):
            assert float(row[f"q{i + 1}_rad"]) == m.q_m[i]
            assert float(row[f"qd{i + 1}_radps"]) == m.qd_m[i]
            assert float(row[f"u{i + 1}_nm"]) == out.u_a[i]
        assert [float(row[k]) for k in ("base_x_m", "base_y_m", "base_yaw_rad")] == list(
            m.base_pose
        )
        asked = [float(row["base_a_mps2"]), float(row["base_aw_radps2"])]
        assert asked == list(out.base_acceleration)
        assert [float(row[f"hand_f{axis}_n"]) for axis in "xyz"] == list(step.hand_force)
        for pair in out.avoidance.pairs:
            assert float(row[f"d_{pair.closest.pair.name}_m"]) == pair.closest.d
            assert float(row[f"beta_{pair.closest.pair.name}"]) == pair.beta
    assert [int(row["contact"]) for row in rows][70] == 1
    assert sum(int(row["arm_contact"]) for row in rows) == 0  # no tenth step had one


@pytest.mark.parametrize("released", [700, 1500, 1551, 2002])
def test_the_path_after_the_release_is_that_since_anybody_last_held_the_robot(
    robot: RobotModel, steps: list[Step], released: int
):
    recorder = Recorder(robot)
    for k, step in enumerate(steps):
        recorder.add(step if k < released else step._replace(pulls=()))
    pose = np.array([s.truth.base_pose[:2] for s in steps[released - 1 :]])
    way = np.linalg.norm(np.diff(pose, axis=0), axis=1).sum()
    figures = recorder.figures()
    assert figures["base_path_after_release_m"] == pytest.approx(way, abs=1e-12)
    whole = np.array([s.truth.base_pose[:2] for s in steps])
    assert figures["base_path_m"] == pytest.approx(
        np.linalg.norm(np.diff(whole, axis=0), axis=1).sum()
    )


def test_without_a_release_or_with_another_grasp_at_the_end_there_is_no_path_after_it(
    robot: RobotModel, recorder: Recorder, steps: list[Step]
):
    assert recorder.figures()["base_path_after_release_m"] is None
    again = Recorder(robot)
    for k, step in enumerate(steps):
        again.add(step._replace(pulls=()) if 900 <= k < 1800 else step)
    assert again.figures()["base_path_after_release_m"] is None
    nobody = Recorder(robot)
    for step in steps:
        nobody.add(step._replace(pulls=()))
    assert nobody.figures()["base_path_after_release_m"] is None


def test_speeds_forces_and_what_was_given_up_are_those_of_the_steps(
    robot: RobotModel, recorder: Recorder, steps: list[Step]
):
    figures = recorder.figures()
    shares = np.abs([s.truth.qd_m for s in steps]) / robot.qd_max
    assert figures["joint_speed_share_max"] == shares.max() > 0.01
    assert figures["base_speed_final_mps"] == abs(steps[-1].truth.base_velocity[0])
    assert figures["hand_speed_max_mps"] == max(s.hand_speed for s in steps) > 0.1
    assert figures["solver_given_up"] == steps[-1].given_up


def test_what_the_arm_can_bear_is_looked_at_where_it_is_held_inside_a_buffer(
    robot: RobotModel, recorder: Recorder, steps: list[Step]
):
    state, bounds = RobotState(robot), []
    for step in steps[::10]:
        near = [pair.closest for pair in step.output.avoidance.mobile if pair.beta > 0.0]
        state.update(step.measurement)
        bounds += [force_bound(state, closest) for closest in near]
    assert recorder.figures()["force_bound_min_n"] == min(bounds)
    assert 10.0 < min(bounds) < 500.0  # [N]
    nobody = Recorder(robot)
    for step in steps:
        nobody.add(step._replace(pulls=()))
    assert nobody.figures()["force_bound_min_n"] is None


@pytest.mark.parametrize("near", [0, 350, 1204])
def test_a_persons_force_counts_until_two_bodies_are_near(
    robot: RobotModel, steps: list[Step], near: int
):
    forces = [float(np.linalg.norm(s.hand_force)) for s in steps]
    recorder = Recorder(robot)
    for k, step in enumerate(steps):
        close = (0.3, 0.3, 0.3, NEAR - 1e-6, 0.3) if k >= near else step.distances
        recorder.add(step._replace(distances=close))
    figures = recorder.figures()
    assert figures["hand_force_clear_max_n"] == max(forces[: near + 1])
    assert figures["hand_force_max_n"] == max(forces)


def test_without_a_log_the_figures_are_the_same(
    robot: RobotModel, recorder: Recorder, steps: list[Step]
):
    plain = Recorder(robot, log=False)
    for step in steps:
        plain.add(step)
    assert plain.figures() == recorder.figures()
    assert (plain.rows, len(recorder.rows)) == ([], 201)


def test_what_is_not_a_number_is_noticed_wherever_it_is(robot: RobotModel, steps: list[Step]):
    recorder = Recorder(robot, log=False)
    for step in steps[:250]:
        recorder.add(step)
    assert recorder.finite
    broken = np.full_like(steps[250].output.u_a, np.nan)
    recorder.add(steps[250]._replace(output=steps[250].output._replace(u_a=broken)))
    assert not recorder.finite
