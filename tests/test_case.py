"""A case repeats its run bit by bit, and reports differences."""

import json

import numpy as np
import pytest

from app.cli.main import main
from app.config import Config
from app.errors import CaseError, DbbError
from app.simulation.case import RunCase, RunSpec
from app.simulation.loop.commands import Pull
from app.simulation.loop.ensemble import Ensemble
from app.simulation.run import run_from_spec, steps_of
from app.simulation.scenarios import SCENARIOS
from app.simulation.scenarios.line import RANDOM_PULL
from app.simulation.scenarios.pulled import CHALLENGE
from app.simulation.session import Session

Q_START = (0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8)


@pytest.fixture(scope="module")
def pulled(robot, border_data):
    """A challenge of 0.9 s in which two people pulled, its last state, and its case."""
    config = Config().replace("border.d_b", 0.2).replace("disturbance.encoder_noise", 1e-4)
    session = Session(robot, border_data, config, physics="planar", seed=3)
    ensemble = Ensemble(session, np.array(Q_START))
    ensemble.pull(Pull((0.5, 0.2, 0.4)))
    for _ in range(150):  # earlier steps must have no effect
        ensemble.step()
    ensemble.play(CHALLENGE.changed(duration=0.9, q_m=Q_START))
    for k in range(900):
        if k in (13, 200, 377):
            ensemble.pull(Pull((0.6 - 1e-3 * k, 0.1 / 3, 0.5 - 1e-3 * k), who=1))
        if k == 301:
            ensemble.pull(Pull((0.1, 0.5, 0.9), "panda_joint4", (0.0, 0.05, 0.0), who=2))
        if k == 650:
            ensemble.release(1)
            assert ensemble.leading == CHALLENGE.name, "who lets go goes on"
        ensemble.step()
    state = state_of(session)
    ensemble.step()  # in which it ends
    case = ensemble.case
    ensemble.close()
    assert case is not None
    return state, case


def state_of(session: Session) -> bytes:
    """All that moves, to the bit."""
    truth = session.physics.measure()
    return b"".join(np.ascontiguousarray(a).tobytes() for a in (*truth[:2], truth.q_m, truth.qd_m))


def test_what_people_pulled_plays_again_to_the_bit_from_its_file(pulled, robot, border_data):
    state, case = pulled
    read = RunCase.read(case.text(), "case.json")
    assert read.differences() == []
    *_, last = (state_of(s) for s, _ in steps_of(read.spec(), robot, border_data))
    assert last == state


def test_the_pull_moved_the_robot(pulled, robot, border_data):
    """Else the test above would say nothing."""
    state, case = pulled
    still = RunSpec(case.robot, case.scenario().changed(pulls=()), case.config(), seed=3)
    *_, last = (state_of(s) for s, _ in steps_of(still, robot, border_data))
    assert last != state


def test_the_figures_of_a_case_come_out_again(pulled, robot, border_data):
    _, case = pulled
    result = run_from_spec(case.spec()._replace(controller="none"), robot, border_data)
    figures = {"base_path_m": result.figures["base_path_m"]}
    kept = case.model_copy(update={"figures": figures})
    assert kept.changes(result.figures) == []
    [line] = kept.changes({"base_path_m": -1.0})
    assert "base_path_m" in line
    assert "-1.0" in line


def test_what_begins_anew_is_no_case_of_what_was_before(robot, border_data):
    ensemble = Ensemble(Session(robot, border_data, Config(), physics="kinematic"), Q_START)
    ensemble.play(SCENARIOS["way-out"])
    assert ensemble.case is not None
    assert ensemble.case.played == "way-out"
    ensemble.play(CHALLENGE.changed(q_m=Q_START))
    assert ensemble.case is None, "nothing has been pulled yet"
    ensemble.close()


def test_a_parameter_that_changes_ends_a_challenge(robot, border_data):
    ensemble = Ensemble(Session(robot, border_data, Config(), physics="kinematic"), Q_START)
    ensemble.play(CHALLENGE.changed(q_m=Q_START))
    for _ in range(40):
        ensemble.step()
    ensemble.configure(Config())
    assert ensemble.leading, "the same parameters change nothing"
    ensemble.configure(Config().replace("border.d_b", 0.1))
    assert not ensemble.leading
    assert ensemble.case is not None
    assert ensemble.case.parameters["border.d_b"] == 0.15
    assert ensemble.case.options["duration"] == pytest.approx(0.04)
    ensemble.close()


@pytest.mark.parametrize("scenario", [*SCENARIOS.values(), CHALLENGE, RANDOM_PULL])
def test_every_scenario_comes_back_from_its_file(scenario):
    case = RunCase.of(RunSpec("husky_panda", scenario, Config(), "dbb", "planar"))
    read = RunCase.read(case.text(), "case.json")
    assert read.text() == case.text()
    assert read.scenario() == scenario
    assert read.config() == Config()


def test_a_case_of_another_version_says_what_differs():
    case = RunCase.of(RunSpec("husky_panda", CHALLENGE, Config(), "dbb", "planar"))
    content = json.loads(case.text()) | {"version": "0.1"}
    del content["parameters"]["ee_hold.weight"]
    content["parameters"]["border.former"] = 7.0
    version, gone, new = RunCase.read(json.dumps(content), "case.json").differences()
    assert "0.1" in version
    assert "border.former" in gone
    assert "7.0" in gone
    assert "ee_hold.weight" in new
    assert "3000" in new


@pytest.mark.parametrize(
    ("change", "named"),
    [
        ({"dbb_case": 2}, "dbb_case"),
        ({"played": "guiding-fornt"}, "guiding-front"),
        ({"controller": "dbbb"}, "dbb"),
        ({"robot": "husky_pando"}, "did you mean 'husky_panda'"),
        ({"physics": "planer"}, "did you mean 'planar'"),
        ({"options": {"pulls": [[1, 0, [0, 0, -1]]]}}, "below the floor"),
        ({"options": {"pulls": [[-1, 0, [0, 0, 1]]]}}, "control step"),
        (
            {"options": {"pulls": [["a", 0, [0, 0, 1]]]}},
            "make-it-collide: pulls[0][0]: Input should be",
        ),
        ({"options": {"pulls": 5}}, "make-it-collide: pulls: Input should be a valid"),
        ({"options": {"q_m": ["x"]}}, "make-it-collide: q_m[0]: Input should be"),
        (
            {"options": {"duration": "x"}},
            "duration: Input should be a valid number, a number without quotes",
        ),
        ({"options": {"duration": True}}, "duration: Input should be a valid number (was True)"),
        ({"options": {"speed": 1}}, "speed"),
        ({"parameters": {"border.d_b": 9.0}}, "border.d_b"),
        ({"seed": -1}, "seed"),
        ({"more": 1}, "more"),
        ({"parameters": {f"a.b{k}": 1.0 for k in range(1001)}}, "at most 1000"),
    ],
)
def test_a_wrong_case_is_refused_in_one_line(change, named):
    case = RunCase.of(RunSpec("husky_panda", CHALLENGE, Config(), "dbb", "planar"))
    with pytest.raises(DbbError) as refused:
        RunCase.read(json.dumps(json.loads(case.text()) | change), "mine.json")
    assert named in str(refused.value)
    assert "mine.json" in str(refused.value)


def test_a_course_of_another_robot_is_refused(robot, border_data):
    other = CHALLENGE.changed(q_m=(0.0,))
    with pytest.raises(CaseError, match="not of the robot"):
        other.setting(robot, border_data, Config(), 0)


def test_the_command_line_plays_a_case_again_and_says_what_is_not_as_it_was(
    tmp_path, capsys, loaded_once
):
    scenario = CHALLENGE.changed(duration=0.3, q_m=Q_START, pulls=((20, 0, (0.5, 0.0, 0.3)),))
    case = RunCase.of(RunSpec("husky_panda", scenario, Config(), "dbb", "kinematic"))
    file = tmp_path / "mine.json"
    file.write_text(case.text())
    main(["run", "--case", str(file), "--json"])
    figures = json.loads(capsys.readouterr().out)
    assert figures["scenario"] == CHALLENGE.name
    held = {"base_path_m": figures["base_path_m"]}
    file.write_text(case.model_copy(update={"figures": held}).text())
    main(["run", "--case", str(file)])
    assert "changed since" not in capsys.readouterr().err
    other = {"figures": {"base_path_m": 7.5}, "version": "0.1"}
    file.write_text(case.model_copy(update=other).text())
    main(["run", "--case", str(file)])
    told = capsys.readouterr().err
    assert "base_path_m was 7.5" in told
    assert "dbb 0.1 wrote the case" in told
    main(["report", str(file), "--out", str(tmp_path / "page.html"), "--json"])
    assert json.loads(capsys.readouterr().out)["scenario"] == CHALLENGE.name
    with pytest.raises(SystemExit):
        main(["screenshot", str(file), "--at", "0.1", "--seed", "1", "--out", "x.png"])
    assert "--seed" in capsys.readouterr().err
