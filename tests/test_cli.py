"""The commands: one JSON object with `--json`, one clear line for an error."""

from __future__ import annotations

import errno
import json
import logging
import math
import os
import re
import shutil
import signal
import socket
import subprocess
import sys
import time
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from app.cli.common import print_json
from app.cli.main import COMMANDS, main
from app.cli.options import in_order
from app.errors import LogError
from app.robot import assets
from app.robot.state import Measurement, RobotState
from app.simulation.scenarios import SCENARIOS
from app.simulation.trace.log_file import read_trace
from app.simulation.trace.metrics import verdict
from app.studies.runs import write_json
from tests.raw_client import RawClient

pytestmark = pytest.mark.slow

PROJECT = Path(__file__).parent.parent
QUICK = ["run", "guiding-lateral", "--physics", "kinematic", "--duration", "0.05"]
FIGURES = {
    "scenario",
    "controller",
    "robot",
    "seed",
    "duration_s",
    "min_distance_m",
    "min_clearance_m",
    "contacts",
    "arm_min_clearance_m",
    "arm_contacts",
    "ee_error_max_m",
    "ee_error_final_m",
    "base_displacement_m",
    "base_yaw_rad",
    "activation_max",
    "base_acceleration_jump_max",
    "torque_jump_max_nm",
    "solver_failures",
    "step_p50_us",
    "step_p99_us",
    "realtime_factor",
}
RELEASED = {
    "base_path_after_release_m",
    "base_speed_final_mps",
    "hand_force_max_n",
    "joint_speed_share_max",
    "joint_speed_share_unsaturated_max",
    "solver_given_up",
    "stuck",
    "left_way",
}
UNITS = ("_s", "_m", "_rad", "_nm", "_n", "_us", "_mps", "_radps", "_mps2", "_radps2")


class Outcome(NamedTuple):
    status: int
    out: str
    err: str


@pytest.fixture
def dbb(capfd, monkeypatch, loaded_once):
    """Runs the command line in this process; also captures output of C libraries."""
    monkeypatch.setattr(logging, "basicConfig", lambda **_: None)  # pytest owns the logging here

    def run(*args: str) -> Outcome:
        capfd.readouterr()
        try:
            main(list(args))
            status = 0
        except SystemExit as end:
            status = end.code
        return Outcome(status, *capfd.readouterr())

    return run


def refused(outcome: Outcome, *words: str) -> None:
    """Check a refusal: status 2, no standard output, one error line that contains these words."""
    assert outcome.status == 2
    assert outcome.out == ""
    lines = outcome.err.splitlines()
    assert len(lines) == 1, outcome.err
    assert lines[0].startswith("dbb: error: ")
    assert not [word for word in words if word not in lines[0]], lines[0]


@pytest.mark.parametrize(
    ("args", "keys"),
    [
        (["robots"], {"robots"}),
        (["pairs", "--samples", "2000"], {"pairs", "L_m", "L_m_c", "never", "seed", "samples"}),
        (["border"], {"robot", "buffer_distance_m", "tolerance_m", "borders"}),
        (QUICK, FIGURES),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_json_output_is_a_single_object(dbb, args, keys):
    outcome = dbb(*args, "--json")
    assert outcome.status == 0, outcome.err
    assert keys <= set(json.loads(outcome.out))


@pytest.mark.parametrize("args", [["robots"], ["pairs", "--samples", "2000"], ["border"], QUICK])
def test_output_without_json_is_text(dbb, args):
    outcome = dbb(*args)
    assert outcome.status == 0
    assert outcome.out.strip()
    with pytest.raises(json.JSONDecodeError):
        json.loads(outcome.out)


def test_run_reports_the_required_figures_and_others_end_in_their_unit(dbb):
    figures = json.loads(dbb(*QUICK, "--json").out)
    assert set(figures) >= FIGURES | RELEASED
    assert [figures[k] for k in ("base_path_after_release_m", "stuck", "left_way")] == [None] * 3
    accelerations = ("base_acceleration", "avoidance_acceleration")
    by_axis = {f"{name}_{what}" for name in accelerations for what in ("jump_max", "sign_changes")}
    without_unit = {"physics", "floor_contacts", "torque_rate_sign_changes", *by_axis}
    assert not [
        k for k in set(figures) - FIGURES - RELEASED - without_unit if not k.endswith(UNITS)
    ]
    axes = {"linear_mps2", "angular_radps2"}
    assert set(figures["base_acceleration_jump_max"]) == axes
    assert set(figures["avoidance_acceleration_jump_max"]) == axes
    assert set(figures["min_distance_m"]) == {"lm-lEE", "lm-l3", "l1-lEE", "l1-l3", "l2-lEE"}
    assert (figures["scenario"], figures["controller"]) == ("guiding-lateral", "dbb")
    assert (figures["duration_s"], figures["seed"], figures["robot"]) == (0.05, 0, "husky_panda")


def test_releasing_the_end_effector_does_not_change_the_motion_before(dbb):
    """The run ends just after the release, or 0.5 s later."""
    args = ["run", "guiding-front", "--physics", "kinematic", "--json"]
    figures = [
        json.loads(dbb(*args, "--release-at", "0.3", "--duration", duration).out)
        for duration in ("0.301", "0.8")
    ]
    short, long = (each["hand_force_max_n"] for each in figures)
    assert short == long > 0.1
    assert figures[1]["base_path_after_release_m"] >= 0.0
    assert figures[1]["ee_error_final_m"] == 0.0


def test_fail_on_contact_sets_the_status_and_still_prints_figures(dbb):
    args = ("run", "guiding-above", "--controller", "none", "--duration", "2.5", "--json")
    assert dbb(*args).status == 0
    outcome = dbb(*args, "--fail-on-contact")
    assert outcome.status == 1
    assert json.loads(outcome.out)["contacts"] > 0
    assert dbb(*QUICK, "--fail-on-contact").status == 0


def test_controller_option_selects_the_controller(dbb):
    plain = json.loads(dbb(*QUICK, "--controller", "none", "--seed", "3", "--json").out)
    assert (plain["controller"], plain["seed"], plain["activation_max"]) == ("none", 3, 0.0)


@pytest.mark.parametrize("ending", ["csv", "parquet"])
def test_log_option_writes_a_readable_log_to_its_path(dbb, tmp_path, ending):
    path = tmp_path / "new" / f"run.{ending}"
    outcome = dbb(*QUICK, "--seed", "4", "--log", str(path), "--json")
    assert outcome.status == 0, outcome.err
    json.loads(outcome.out)
    log = read_trace(path)
    assert [round(s.t, 3) for s in log.snapshots] == [0.0, 0.02, 0.04]
    assert (log.meta.scenario, log.meta.seed) == ("guiding-lateral", 4)


def test_invalid_log_path_is_rejected_before_the_run(dbb, tmp_path):
    refused(dbb(*QUICK, "--log", str(tmp_path / "run.xlsx")), "--log", ".csv or .parquet")
    (tmp_path / "file").write_text("")
    refused(dbb(*QUICK, "--log", str(tmp_path / "file" / "run.csv")), "--log", "cannot write")


def test_start_and_move_set_the_path_of_the_end_effector(dbb, robot, tmp_path):
    """The log starts with the end-effector at --start; the force points along --move."""
    path = ["--start", "0.35", "0.75", "0.4", "--move", "0", "-0.2", "0"]
    args = [*QUICK[:4], "--duration", "0.2", *path, "--out", str(tmp_path)]
    assert json.loads(dbb(*args, "--json").out)["duration_s"] == 0.2
    log = read_trace(tmp_path / "log.csv")
    state = RobotState(robot)
    state.update(Measurement(np.zeros(3), np.zeros(2), log.of("q_m")[0], np.zeros(7)))
    np.testing.assert_allclose(state.T_world_ee.translation, [0.35, 0.75, 0.4], atol=1e-5)
    force = log.of("hand_force").mean(axis=0)
    assert force[1] < -0.1
    assert abs(force[1]) > 3 * np.hypot(force[0], force[2])


def test_buffer_distance_option_changes_the_buffer(dbb):
    """The same start is outside a narrow buffer and inside a wide one."""
    args = [*QUICK, "--start", "0.3", "0.58", "0.3", "--buffer-distance"]
    assert dbb(*args, "0.06").status == 0
    refused(dbb(*args, "0.3"), "inside its buffer")


@pytest.mark.parametrize(
    ("option", "beyond"),
    [
        ("--encoder-noise", "0.006"),
        ("--base-delay", "0.51"),
        ("--mass-error", "-0.31"),
        ("--slip", "0.6"),
        ("--slip", "nan"),
    ],
)
@pytest.mark.parametrize("command", [["run", "guiding-front"], ["serve"]], ids=["run", "serve"])
def test_disturbance_out_of_range_is_rejected_by_name(dbb, command, option, beyond):
    refused(dbb(*command, option, beyond), option, "is not within")


def test_disturbances_change_the_run_and_zero_is_the_undisturbed_run(dbb, tmp_path):
    args = ["run", "guiding-front", "--physics", "kinematic", "--duration", "0.3", "--json"]

    def torques(*more: str) -> np.ndarray:
        assert dbb(*args, *more, "--out", str(tmp_path)).status == 0
        return read_trace(tmp_path / "log.csv").of("u_a")

    plain = torques()
    nothing = torques("--encoder-noise", "0", "--base-delay", "0", "--slip", "0")
    np.testing.assert_allclose(nothing, plain, atol=1e-9)
    np.testing.assert_allclose(torques("--mass-error", "0.2")[0], 1.2 * plain[0], atol=1e-6)
    noisy = torques("--encoder-noise", "0.002")
    assert np.abs(noisy - plain).max() > 1e-3
    np.testing.assert_allclose(torques("--encoder-noise", "0.002"), noisy, atol=1e-9)
    assert np.abs(torques("--encoder-noise", "0.002", "--seed", "1") - noisy).max() > 1e-3


def test_run_with_too_small_buffer_warns_with_the_required_d_b(dbb):
    args = ["run", "guiding-front", "--physics", "kinematic", "--start", "0.80", "0.10", "0.30"]
    args += ["--move", "-0.2", "0", "0", "--duration", "2", "--buffer-distance", "0.06"]
    outcome = dbb(*args, "--base-delay", "0.2", "--json")
    assert outcome.status == 0
    needed = json.loads(outcome.out)["buffer_needed_m"]
    assert 0.06 < needed < 0.5
    (line,) = outcome.err.splitlines()
    assert line.startswith("warning: d_b = 0.06 m is too small")
    assert f"{math.ceil(needed * 100) / 100:.2f} m needed" in line
    silent = dbb(*QUICK)
    assert (silent.status, silent.err) == (0, "")


def test_out_writes_the_log_and_the_printed_figures(dbb, tmp_path):
    out = tmp_path / "made" / "on demand"
    outcome = dbb(*QUICK, "--out", str(out), "--json")
    assert (out / "metrics.json").read_text(encoding="utf-8") == outcome.out
    log = read_trace(out / "log.csv")
    np.testing.assert_allclose(log.t, np.arange(len(log)) * 0.001, atol=1e-9)
    assert log["d_lm-lEE_m"].min() == json.loads(outcome.out)["min_distance_m"]["lm-lEE"]
    wrote = [f"wrote {out / name}" for name in ("log.csv", "metrics.json")]
    assert outcome.err.splitlines() == wrote
    assert sorted(p.name for p in out.iterdir()) == ["log.csv", "metrics.json"]


def test_border_out_writes_the_counted_points(dbb, tmp_path):
    figures = json.loads(dbb("border", "--out", str(tmp_path), "--json").out)["borders"]
    for pair, border in figures.items():
        lines = (tmp_path / f"{pair}.csv").read_text(encoding="utf-8").splitlines()
        assert lines[0] == "x_m,y_m,z_m"
        assert len(lines) - 1 == border["points"]
    assert {path.stem for path in tmp_path.iterdir()} == set(figures)


REFUSED = {
    "scenario": (["run", "nope"], ["scenario", *SCENARIOS]),
    "controller": ([*QUICK, "--controller", "dbx"], ["did you mean 'dbb'", "dbb, hqp, none"]),
    "robot": ([*QUICK, "--robot", "husky"], ["robot 'husky'", "husky_panda"]),
    "robot of pairs": (["pairs", "--robot", "r2d2"], ["r2d2", "husky_panda"]),
    "robot of border": (["border", "--robot", "r2d2"], ["r2d2", "husky_panda"]),
    "physics": (["run", "tracking", "--physics", "real"], ["kinematic, mujoco", "planar"]),
    "border of run": ([*QUICK, "--border", "cloud"], ["'cloud'", "points, surface"]),
    "served controller": (["serve", "--controller", "x"], ["dbb, hqp, none"]),
    "served physics": (["serve", "--physics", "x"], ["kinematic, mujoco", "planar"]),
    "d_b": ([*QUICK, "--buffer-distance", "0.5"], ["--buffer-distance", "0.05 to 0.3 m"]),
    "d_b nan": ([*QUICK, "--buffer-distance", "nan"], ["--buffer-distance", "nan"]),
    "d_b of border": (["border", "--buffer-distance", "0"], ["--buffer-distance", "0.05"]),
    "eps": (["border", "--tolerance", "-1"], ["--tolerance", "0.002 to 0.02 m"]),
    "duration": ([*QUICK[:4], "--duration", "-1"], ["--duration", "0.01 to 3600 s"]),
    "duration inf": ([*QUICK[:4], "--duration", "inf"], ["--duration", "inf"]),
    "release after the end": (
        ["run", "guiding-front", "--release-at", "9"],
        ["--release-at", "9 s", "before its end, 8 s"],
    ),
    "release before the start": (
        ["run", "guiding-front", "--release-at", "-1"],
        ["--release-at", "-1 s", "before its end, 8 s"],
    ),
    "release of nobody": (
        ["run", "tracking", "--release-at", "1"],
        ["--release-at", "no such option", "duration, move, start"],
    ),
    "release of no line": (
        ["run", "way-out", "--release-at", "1"],
        ["--release-at", "no such option"],
    ),
    "seed": ([*QUICK, "--seed", "-1"], ["--seed", "-1"]),
    "seed of pairs": (["pairs", "--seed", "-1"], ["--seed"]),
    "seed of border": (["border", "--seed", "-1"], ["--seed"]),
    "seed of serve": (["serve", "--seed", "-1"], ["--seed"]),
    "samples": (["pairs", "--samples", "-5"], ["--samples", "-5"]),
    "no samples": (["pairs", "--samples", "0"], ["--samples"]),
    "too far": ([*QUICK, "--start", "3", "0", "0.5"], ["(3, 0, 0.5) m", "out of the arm's reach"]),
    "served too far": (["serve", "--start", "3", "0", "1", "--port", "0"], ["arm's reach"]),
    "below the floor": ([*QUICK, "--start", "0.7", "0", "-0.1"], ["above the floor"]),
    "start nan": ([*QUICK, "--start", "nan", "0", "1"], ["--start", "nan"]),
    "in the base": ([*QUICK, "--start", "0.3", "0.2", "0.2"], ["no posture"]),
    "led below": ([*QUICK, "--move", "0", "0", "-1"], ["below the floor"]),
    "tracked below": (
        ["run", "tracking", "--duration", "0.1", "--move", "0", "0", "-1"],
        ["below the floor"],
    ),
    "led away": ([*QUICK, "--move", "1e9", "0", "0"], ["--move", "-10 to 10 m"]),
    "port": (["serve", "--port", "70000"], ["70000", "between 0 and 65535"]),
}


@pytest.mark.parametrize("case", REFUSED)
def test_invalid_arguments_are_rejected_with_the_valid_values(dbb, case):
    args, words = REFUSED[case]
    refused(dbb(*args), *words)


def test_unwritable_output_is_rejected_before_the_run(dbb, tmp_path):
    file = tmp_path / "file"
    file.touch()
    refused(dbb("run", "tracking", "--out", str(file)), "--out", str(file))
    refused(dbb("run", "tracking", "--out", str(file / "in")), "--out", "Not a directory")
    refused(dbb("border", "--out", str(file)), "--out", str(file))


@pytest.mark.parametrize("args", [["run", "tracking", "--bogus"], ["run"], ["nope"], []])
def test_wrong_usage_points_to_the_help(dbb, args):
    outcome = dbb(*args)
    assert (outcome.status, outcome.out) == (2, "")
    assert "--help" in outcome.err
    assert "Traceback" not in outcome.err


@pytest.mark.parametrize(
    ("line", "written", "words"),
    [
        ("mass_kg", "", ["base.mass_kg: missing"]),
        ("wheel_radius_m", "wheel_radus_m = 0.165", ["unknown field", "wheel_radius_m"]),
        ("half_track_m", "half_track_m = -0.51", ["base.half_track_m", "greater than 0", "-0.51"]),
    ],
)
@pytest.mark.parametrize("command", ["pairs", "border", QUICK], ids=str)
def test_invalid_description_error_names_file_and_field(
    dbb, tmp_path, monkeypatch, command, line, written, words
):
    folder = tmp_path / "husky_panda"
    shutil.copytree(assets.ASSETS / "husky_panda", folder)
    path = folder / "robot.toml"
    lines = path.read_text(encoding="utf-8").splitlines()
    changed = [written if each.split("=")[0].strip() == line else each for each in lines]
    assert changed != lines
    path.write_text("\n".join(changed), encoding="utf-8")
    monkeypatch.setattr(assets, "ASSETS", tmp_path)
    refused(dbb(*([command] if isinstance(command, str) else command)), str(path), *words)
    listed = dbb("robots")  # one invalid robot does not hide the others
    assert listed.status == 0
    assert all(word in listed.out for word in (str(path), *words))


def test_unknown_joint_is_an_error_but_a_missing_mesh_is_not(dbb, tmp_path, monkeypatch):
    folder = tmp_path / "husky_panda"
    shutil.copytree(assets.ASSETS / "husky_panda", folder)
    monkeypatch.setattr(assets, "ASSETS", tmp_path)
    description, urdf = folder / "robot.toml", folder / "robot.urdf"
    good, drawn = description.read_text(encoding="utf-8"), urdf.read_text(encoding="utf-8")
    description.write_text(good.replace('"panda_joint3"', '"panda_joint33"'), encoding="utf-8")
    refused(dbb("pairs"), "arm.joints", "panda_joint33", "panda_joint3")
    description.write_text(good, encoding="utf-8")
    urdf.write_text(drawn.replace("/hand.obj", "/no_hand.obj"), encoding="utf-8")
    assert dbb("pairs").status == 0  # the robot is drawn by its convex bodies


def test_port_in_use_is_one_line(dbb):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        refused(dbb("serve", "--port", str(port)), str(port), "in use", "--port")


def test_help_lists_every_command_and_the_units_of_options(dbb):
    text = dbb("--help").out
    assert not [c for group in COMMANDS.values() for c in group if c not in text]
    assert len(text.splitlines()) <= 24  # rows of a terminal
    assert max(map(len, text.splitlines())) <= 80
    text = dbb("run", "guiding-lateral", "--help").out
    for option, unit in {
        "--start X Y Z": "[m]",
        "--move X Y Z": "[m]",
        "--duration FLOAT": "[s]",
        "--buffer-distance FLOAT": "[m]",
    }.items():
        assert unit in text.partition(option)[2][:120]
    assert "--door-width" not in text
    assert "--door-width" in dbb("run", "refrigerator", "--help").out


@pytest.mark.parametrize(
    "command", [*(name for group in COMMANDS.values() for name in group), "run guiding-front"]
)
def test_help_shows_each_default_once_and_no_python_literals(dbb, command):
    text = " ".join(dbb(*command.split(), "--help").out.replace("│", " ").split())
    assert not re.search(r"\(default: (None|True|False)?\)", text)
    assert not re.search(r"\(default: [^()]*\)\W*\(default", text)


def test_help_uses_the_width_of_the_terminal(dbb, monkeypatch):
    monkeypatch.setenv("COLUMNS", "70")
    lines = dbb("reach", "--help").out.partition("options")[0].splitlines()
    described = [line for line in lines if not line.startswith("usage")]
    assert 60 < max(map(len, described)) <= 70


@pytest.mark.parametrize(
    "args", [["run", "guiding-front", "--start", "1", "2"], ["serve", "--start", "1", "x", "3"]]
)
def test_argument_of_wrong_type_is_rejected_without_markup(dbb, args):
    outcome = dbb(*args)
    assert (outcome.status, outcome.out) == (2, "")
    assert "--start" in outcome.err
    assert "[bold]" not in outcome.err


@pytest.mark.parametrize("args", [["--help"], ["run", "nope"], ["run", "tracking", "--help"]])
def test_commands_without_a_robot_do_not_import_robot_libraries(args):
    """Such commands must take well below a second; the imports would take longer."""
    code = (
        "import sys\nfrom app.cli.main import main\n"
        f"try:\n    main({args})\nexcept SystemExit:\n    pass\n"
        "print('loaded:', *{'pinocchio', 'coal', 'numba', 'scipy', 'viser', 'rich', 'trimesh'}"
        " & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=PROJECT, capture_output=True, text=True)
    assert done.stdout.splitlines()[-1].strip() == "loaded:"


def test_run_without_scenario_lists_one_scenario_per_line(dbb):
    outcome = dbb("run")
    assert (outcome.status, outcome.out) == (2, "")
    for name, scenario in SCENARIOS.items():
        assert re.search(f"^ *{name} .*{scenario.about}$", outcome.err, re.M)


def test_version_option_prints_the_package_version(dbb):
    assert dbb("--version").out == f"dbb {metadata.version('dbb-mobile-manipulator')}\n"


def test_repeated_option_is_rejected_with_the_correct_spelling(dbb):
    args = ["screenshot", "guiding-front", "--out", "x.png"]
    refused(dbb(*args, "--at", "0", "--at", "3", "--at", "6"), "3 times", "--at 0 3 6")
    refused(dbb("sweep", "--height", "0.3", "0.4", "--height=0.5"), "--height 0.3 0.4 0.5")


def test_options_may_precede_the_scenario_and_use_former_names(dbb):
    """--noise and --delay are former names of disturbances."""
    before = json.loads(dbb("run", *QUICK[2:], "--json", "--seed", "3", QUICK[1]).out)
    assert (before["scenario"], before["seed"]) == ("guiding-lateral", 3)
    refused(dbb(*QUICK, "--noise", "0.1"), "--encoder-noise: 0.1 rad")
    refused(dbb("study", "--delay", "0", "9"), "--base-delay: 9 s")


def test_run_prints_the_verdict_first_and_the_written_files_last(dbb, tmp_path):
    log = tmp_path / "run.csv"
    first, *others = dbb(*QUICK, "--out", str(tmp_path), "--log", str(log)).out.splitlines()
    assert re.fullmatch(
        r"No contact; smallest distance \d+ mm \([^)]+\); final end-effector error .* mm\.", first
    )
    written = [tmp_path / "log.csv", tmp_path / "metrics.json", log]
    assert others[-3:] == [f"wrote {path}" for path in written]
    assert all(path.is_file() for path in written)
    assert not [line for line in others[:-3] if re.search(r"\de[+-]\d", line)]


FIGURES_OF_A_RUN = {
    "physics": "planar",
    "contacts": 0,
    "arm_contacts": 0,
    "floor_contacts": 0,
    "min_distance_m": {"lm-lEE": 0.05, "l1-l3": 0.2},
    "ee_error_final_m": 0.0123,
}


@pytest.mark.parametrize(
    ("changes", "text"),
    [
        ({}, "No contact; smallest distance 50 mm (lm-lEE); final end-effector error 12.3 mm."),
        (
            {"contacts": 7, "floor_contacts": 1},
            "The arm touched the base and the floor; smallest distance 50 mm (lm-lEE)",
        ),
        ({"door_contacts": 3}, "The door touched the base; smallest distance 50 mm (lm-lEE)"),
        (
            {"arm_contacts": 1, "door_contacts": 3},
            "The arm touched itself, and the door touched the base; smallest distance 50 mm",
        ),
        (
            {"min_distance_m": {"lm-lEE": -0.008}},
            "Overlap; bodies overlapped by 8.0 mm (lm-lEE); final end-effector error 12.3 mm. "
            "Distances are between convex bodies that enclose the links",
        ),
        ({"min_distance_m": {}}, "No contact; final end-effector error"),
        *(
            (
                {"min_distance_m": {"lm-lEE": none, "l1-l3": 0.2}, "ee_error_final_m": none},
                "No contact; smallest distance 200 mm (l1-l3); without a distance: lm-lEE; "
                "final end-effector error is missing.",
            )
            for none in (None, math.nan)
        ),
    ],
)
def test_verdict_names_contact_distance_and_end_effector_error(changes, text):
    assert verdict(FIGURES_OF_A_RUN | changes).startswith(text)


def command(*args: str, **options) -> subprocess.Popen[str]:
    """The command in a separate process."""
    return subprocess.Popen(
        [sys.executable, "-m", "app", *args],
        cwd=PROJECT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        **options,
    )


def test_python_m_app_is_the_dbb_command():
    script = Path(sys.executable).parent / "dbb"
    if not script.exists():
        pytest.skip("the package is not installed in this environment")
    installed = subprocess.run([script, "robots", "--json"], capture_output=True, text=True)
    module, errors = command("robots", "--json").communicate(timeout=60)
    assert module == installed.stdout
    assert "husky_panda" in [robot["name"] for robot in json.loads(module)["robots"]]
    assert errors == ""


def test_ctrl_c_ends_a_run_cleanly(tmp_path):
    out = tmp_path / "out"
    process = command("run", "guiding-lateral", "--duration", "3000", "--out", str(out))
    deadline = time.monotonic() + 60
    while not out.exists() and time.monotonic() < deadline:  # created just before the run
        time.sleep(0.05)
    time.sleep(0.5)
    process.send_signal(signal.SIGINT)
    printed, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert printed == ""
    without = find_spec("pybullet") is None  # adds a line: meshes are missing
    assert len(err.splitlines()) == 1 + without
    assert err.endswith("dbb: interrupted\n")
    assert list(out.iterdir()) == []


def test_ctrl_c_ends_the_dashboard_cleanly():
    """With a connected client; the command prints nothing after the address."""
    process = command("serve", "--port", "0")
    wait_for(process.stderr, "Dashboard at ")
    address = process.stderr.readline().split()[0]
    with RawClient(address) as viewer:
        deadline = time.monotonic() + 60
        while not viewer.received and time.monotonic() < deadline:
            time.sleep(0.05)
        process.send_signal(signal.SIGINT)
        assert process.communicate(timeout=30) == ("", "")
    assert process.returncode == 0


def test_closed_pipe_causes_no_error_message():
    read, write = os.pipe()
    os.close(read)
    process = subprocess.run(
        [sys.executable, "-m", "app", "robots"],
        cwd=PROJECT,
        stdout=write,
        stderr=subprocess.PIPE,
        text=True,
        timeout=60,
    )
    os.close(write)
    assert process.stderr == ""
    assert process.returncode == 1


@pytest.mark.parametrize(
    ("words", "closed", "status"),
    [
        ("robots", "0<&-", 0),
        ("robots", "0<&- 2>&-", 0),
        ("robots --json", "1>&-", 2),
        ("robots", "0<&- 1>&- 2>&-", 2),
        ("--help", "1>&-", 2),
        ("robots --help", "1>&-", 1),
        ("config --out {}", "0<&- 2>&-", 0),
    ],
)
def test_command_without_an_input_works_and_without_an_output_fails(
    words, closed, status, tmp_path
):
    line = f'exec "{sys.executable}" -m app {words.format(tmp_path / "a.toml")} {closed}'
    done = subprocess.run(["sh", "-c", line], cwd=PROJECT, timeout=60, stderr=subprocess.PIPE)
    assert done.returncode == status
    assert (b"standard output: Bad file" in done.stderr) == (status == 2 and "2>" not in closed)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="this system has no full device")
@pytest.mark.parametrize(
    ("words", "error"),
    [
        ("config > /dev/full", b"dbb: error: a file or the standard output: No space left"),
        ("x 2> /dev/full", b""),
    ],
)
def test_full_output_is_named_and_the_status_is_2(words, error):
    line = f'exec "{sys.executable}" -m app {words}'
    done = subprocess.run(["sh", "-c", line], cwd=PROJECT, timeout=60, stderr=subprocess.PIPE)
    assert (done.returncode, done.stderr[: len(error)]) == (2, error)


def test_full_disk_can_also_be_a_full_output(monkeypatch, capsys):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(sys.modules["app.cli.main"], "_run", full)
    with pytest.raises(SystemExit):
        main(["study"])
    assert capsys.readouterr().err == (
        "dbb: error: a file or the standard output: No space left on device\n"
    )


def test_parameters_are_known_without_docstrings():
    words = [sys.executable, "-OO", "-m", "app", "config"]
    done = subprocess.run(words, cwd=PROJECT, timeout=60, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")
    assert "d_b = 0.15" in done.stdout


@pytest.mark.parametrize(
    "words",
    [["border", "--out", ""], ["config", "--out="], ["report", ""], ["run", "--case", ""]],
)
def test_empty_value_is_refused(dbb, words, tmp_path, monkeypatch):
    """An unset variable of the shell would otherwise stand for the working folder."""
    monkeypatch.chdir(tmp_path)
    refused(dbb(*words), "an argument" if words[0] == "report" else words[1].strip("="), "is empty")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("columns", ["1", "5", "0"])
def test_help_ends_in_a_narrow_terminal(columns):
    process = command("reach", "--help", env={**os.environ, "COLUMNS": columns})
    assert "--seed" in process.communicate(timeout=60)[0]


@pytest.mark.parametrize("form", ["--out=~/a.toml", "--out ~/a.toml"])
def test_home_is_expanded_in_a_path(dbb, form, tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.chdir(tmp_path)
    assert dbb("config", *form.split()).status == 0
    assert [path.name for path in tmp_path.iterdir()] == ["a.toml"]
    assert dbb("config", "--config=~/a.toml").status == 0
    refused(dbb("screenshot", "~/no.json", "--at", "1", "--out=~/a.png"), f"{tmp_path}/no.json")


def test_home_is_expanded_in_no_free_text(monkeypatch):
    monkeypatch.setenv("HOME", "/home/ann")
    texts = ["--title=~/arm", "--licence", "~"]
    assert in_order(["--log", "~/a", *texts, "--out=~"]) == [
        "--log",
        "/home/ann/a",
        *texts,
        "--out=/home/ann",
    ]


def test_output_encoding_without_a_character_gets_its_escape_code():
    process = subprocess.run(
        [sys.executable, "-m", "app", "--help"],
        cwd=PROJECT,
        env={**os.environ, "PYTHONIOENCODING": "latin-1"},
        capture_output=True,
        timeout=60,
    )
    assert process.returncode == 0
    assert rb"\u2026" in process.stdout


def wait_for(stream, text: str) -> None:
    """Read until the text appears; fails if the stream ends first."""
    seen = ""
    while text not in seen:
        character = stream.read(1)
        assert character, f"ended before {text!r}: {seen}"
        seen += character


@pytest.mark.parametrize(
    ("error", "message"),
    [
        (MemoryError("of 9 GB"), "too little memory: of 9 GB"),
        (ImportError("a.so: failed to map segment", path="/x/a.so"), "a.so: failed to map segment"),
        (LogError("a\x1b[31m.csv: no such file"), r"a\x1b[31m.csv: no such file"),
    ],
    ids=["memory", "library", "escape"],
)  # as under `ulimit -v`, or without a system library
def test_system_errors_are_one_line(error, message, monkeypatch, capsys):
    def fails(_):
        raise error

    monkeypatch.setattr(sys.modules[main.__module__], "_run", fails)
    with pytest.raises(SystemExit) as end:
        main(["run"])
    said = capsys.readouterr().err
    assert end.value.code == 2
    assert said.startswith("dbb: error: ")
    assert said.endswith(f"{message}\n")


def test_import_error_within_the_package_keeps_its_traceback(monkeypatch):
    def fails(_):
        raise ImportError("cannot import name 'x'", path="/x/app/a.py")

    monkeypatch.setattr(sys.modules[main.__module__], "_run", fails)
    with pytest.raises(ImportError):
        main(["run"])


def test_printed_and_written_json_have_null_for_a_number_that_is_not_finite(tmp_path, capsys):
    content = {"a": [math.nan, np.float64(math.inf), 1.5], "b": np.array([0.0, -math.inf])}
    print_json(content)
    write_json(tmp_path / "a.json", content)
    for text in (capsys.readouterr().out, (tmp_path / "a.json").read_text()):
        assert json.loads(text) == {"a": [None, None, 1.5], "b": [0.0, None]}
