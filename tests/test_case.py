"""A case repeats its run bit for bit and reports differences of version and parameters."""

import json

import numpy as np
import pytest

from app.cli.main import main
from app.config import FORMER_NAMES, Config
from app.errors import CaseError, DbbError, TargetError
from app.simulation.case import RunCase, RunSpec
from app.simulation.loop.commands import Pull
from app.simulation.loop.ensemble import Ensemble
from app.simulation.run import steps_of
from app.simulation.scenarios import SCENARIOS
from app.simulation.scenarios.line import RANDOM_PULL
from app.simulation.session import Session

Q_START = (0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8)


PULL = RANDOM_PULL.changed(
    duration=0.9,
    start=(0.5, 0.2, 0.4),
    move=(0.1 / 3, -0.4, 0.0),
    moving=0.6,
    release_at=0.65,
    q_m=Q_START,
)


@pytest.fixture(scope="module")
def played(robot, border_data):
    """The last state of a scenario in the live loop, and its case."""
    config = Config().replace("border.d_b", 0.2).replace("disturbance.encoder_noise", 1e-4)
    session = Session(robot, border_data, config, physics="planar", seed=3)
    ensemble = Ensemble(session, np.array(Q_START))
    ensemble.pull(Pull((0.5, 0.2, 0.4)))
    for _ in range(150):  # earlier steps must have no effect
        ensemble.step()
    ensemble.play(PULL)
    for _ in range(900):
        ensemble.step()
    state, case = state_of(session), ensemble.case
    ensemble.close()
    assert case is not None
    return state, case


def state_of(session: Session) -> bytes:
    """Positions and velocities of base and arm as bytes."""
    truth = session.physics.measure()
    return b"".join(np.ascontiguousarray(a).tobytes() for a in (*truth[:2], truth.q_m, truth.qd_m))


def test_case_file_repeats_a_scenario_of_the_live_loop_bit_for_bit(played, robot, border_data):
    state, case = played
    read = RunCase.read(case.text(), "case.json")
    assert read.differences() == []
    *_, last = (state_of(s) for s, _ in steps_of(read.spec(), robot, border_data))
    assert last == state


def test_robot_ends_elsewhere_without_the_pull(played, robot, border_data):
    """If the pull did not change the motion, the previous test could not fail."""
    state, case = played
    still = case.spec()._replace(scenario=case.scenario().changed(release_at=0.001))
    *_, last = (state_of(s) for s, _ in steps_of(still, robot, border_data))
    assert last != state


def test_reset_removes_the_case_of_the_scenario(robot, border_data):
    ensemble = Ensemble(Session(robot, border_data, Config(), physics="kinematic"), Q_START)
    ensemble.play(SCENARIOS["way-out"])
    assert ensemble.case is not None
    assert ensemble.case.played == "way-out"
    ensemble.reset()
    assert ensemble.case is None
    ensemble.close()


@pytest.mark.parametrize("scenario", [*SCENARIOS.values(), PULL])
def test_case_file_stores_every_scenario_completely(scenario):
    case = RunCase.of(RunSpec("husky_panda", scenario, Config(), "dbb", "planar"))
    read = RunCase.read(case.text(), "case.json")
    assert read.text() == case.text()
    assert read.scenario() == scenario
    assert read.config() == Config()


def test_case_of_another_version_lists_the_differences():
    case = RunCase.of(RunSpec("husky_panda", PULL, Config(), "dbb", "planar"))
    content = json.loads(case.text()) | {"version": "0.1"}
    del content["parameters"]["ee_hold.weight"]
    content["parameters"]["border.former"] = 7.0
    version, gone, new = RunCase.read(json.dumps(content), "case.json").differences()
    assert "0.1" in version
    assert "border.former" in gone
    assert "7.0" in gone
    assert "ee_hold.weight" in new
    assert "3000" in new


def test_case_with_former_names_of_parameters_is_read():
    config = Config().replace("task.slack_weight", 0.01)
    case = RunCase.of(RunSpec("husky_panda", PULL, config, "dbb", "planar"))
    content = json.loads(case.text()) | {"figures": {}}
    for former, path in FORMER_NAMES.items():
        content["parameters"][former] = content["parameters"].pop(path)
    read = RunCase.read(json.dumps(content), "case.json")
    assert read.config() == config
    assert read.differences() == []


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"dbb_case": 2}, "dbb_case"),
        ({"played": "guiding-fornt"}, "guiding-front"),
        ({"controller": "dbbb"}, "dbb"),
        ({"robot": "husky_pando"}, "did you mean 'husky_panda'"),
        ({"physics": "planer"}, "did you mean 'planar'"),
        ({"options": {"move": [0, 0, -11]}}, "--move"),
        ({"options": {"start": 5}}, "random-pull: start: Input should be a valid"),
        ({"options": {"q_m": ["x"]}}, "random-pull: q_m[0]: Input should be"),
        (
            {"options": {"duration": "x"}},
            "duration: Input should be a valid number, a number without quotes",
        ),
        ({"options": {"duration": True}}, "duration: Input should be a valid number (was True)"),
        ({"options": {"speed": 1}}, "speed"),
        ({"parameters": {"border.d_b": 9.0}}, "border.d_b"),
        ({"seed": -1}, "seed"),
        ({"seed": True}, "seed: Input should be a valid integer (was True)"),
        ({"parameters": {"border.d_b": True}}, "parameters.border.d_b"),
        ({"more": 1}, "more"),
        ({"parameters": {f"a.b{k}": 1.0 for k in range(1001)}}, "at most 1000"),
    ],
)
def test_invalid_case_is_refused_by_name(change, named):
    case = RunCase.of(RunSpec("husky_panda", PULL, Config(), "dbb", "planar"))
    with pytest.raises(DbbError) as refused:
        RunCase.read(json.dumps(json.loads(case.text()) | change), "mine.json")
    assert named in str(refused.value)
    assert "mine.json" in str(refused.value)


def test_case_with_a_repeated_key_is_refused():
    text = RunCase.of(RunSpec("husky_panda", PULL, Config(), "dbb", "planar")).text()
    with pytest.raises(CaseError, match="the key 'seed' appears twice"):
        RunCase.read(text.replace('"seed": 0', '"seed": 0, "seed": 5'), "mine.json")


def test_posture_of_another_robot_is_refused(robot, border_data):
    other = RunSpec("husky_panda", PULL.changed(q_m=(0.0,)), Config(), physics="kinematic")
    with pytest.raises(TargetError, match="the posture has 1 joints"):
        next(steps_of(other, robot, border_data))


def test_command_line_replays_a_case_and_reports_another_version(tmp_path, capsys, loaded_once):
    scenario = PULL.changed(duration=0.7)
    case = RunCase.of(RunSpec("husky_panda", scenario, Config(), "dbb", "kinematic"))
    file = tmp_path / "mine.json"
    file.write_text(case.text())
    main(["run", "--case", str(file), "--json"])
    figures = json.loads(capsys.readouterr().out)
    assert figures["scenario"] == PULL.name
    file.write_text(case.model_copy(update={"version": "0.1"}).text())
    main(["run", "--replay-case", str(file), "--json"])
    again = capsys.readouterr()
    assert json.loads(again.out)["base_path_m"] == figures["base_path_m"]
    assert "dbb 0.1 wrote the case" in again.err
    main(["report", str(file), "--out", str(tmp_path / "page.html"), "--json"])
    assert json.loads(capsys.readouterr().out)["scenario"] == PULL.name
    with pytest.raises(SystemExit):
        main(["screenshot", str(file), "--at", "0.1", "--seed", "1", "--out", "x.png"])
    assert "--seed" in capsys.readouterr().err


@pytest.mark.parametrize(
    "option",
    [["--robot", "husky_panda"], ["--seed", "1"], ["--start", "0.9", "0.1", "0.3"]],
    ids=lambda option: option[0],
)
def test_dashboard_refuses_options_that_its_case_sets(option, tmp_path, capsys):
    case = RunCase.of(RunSpec("husky_panda", PULL, Config(), "dbb", "kinematic"))
    file = tmp_path / "mine.json"
    file.write_text(case.text())
    with pytest.raises(SystemExit) as end:
        main(["serve", "--case", str(file), *option, "--port", "0"])
    assert end.value.code == 2
    assert f"{option[0]}: --case already sets this option" in capsys.readouterr().err
