"""The command line and the dashboard repeat the run of a case."""

from __future__ import annotations

import json
import pickle
import time
from types import SimpleNamespace

import numpy as np
import pytest
import viser

from app.cli.main import main
from app.dashboard.notifications import Notifier
from app.dashboard.panels.run import LabPanel
from app.dashboard.server import serve_dashboard
from app.simulation.case import RunCase
from app.simulation.loop.commands import Play, Pull, Reset
from app.simulation.loop.loop import SimulationLoop
from app.simulation.run import run_from_spec
from app.simulation.session import Session
from app.studies.pulls.case import draw_case, load_sources, play_case, spec_of
from app.studies.pulls.parameters import StudyParameters, StudyRange
from app.studies.runs import Row
from tests.browser import wait_for
from tests.fakes import ScriptedLoop
from tests.raw_client import RawClient
from tests.robots import husky_panda

FAST = StudyParameters(
    seed=1,
    controller="none",
    physics="kinematic",
    ranges=StudyRange(
        duration=0.4,
        speed=(0.9, 1.0),
        height=(0.2, 0.4),
        encoder_noise=(0.001, 0.002),
        released=0.0,
    ),
)


@pytest.fixture(scope="module")
def sources():
    return load_sources("husky_panda")


@pytest.fixture(scope="module")
def drawn(sources) -> Row:
    return draw_case(FAST, 0, sources)


@pytest.fixture(scope="module")
def case(drawn) -> RunCase:
    return RunCase.of(spec_of(drawn, FAST))


@pytest.fixture
def file(case, tmp_path):
    path = tmp_path / "case.json"
    path.write_text(case.text())
    return path


@pytest.mark.slow
def test_the_command_gives_the_figures_of_the_study(sources, drawn, case, file, capfd):
    row = play_case(drawn, FAST, sources.model, sources.data)
    main(["run", "--case", str(file), "--json"])
    played = json.loads(capfd.readouterr().out)
    assert (played["scenario"], played["controller"]) == ("random-pull", "none")
    assert (played["physics"], played["seed"]) == ("kinematic", case.seed)
    for name in ("min_clearance_m", "contacts", "ee_error_final_m", "torque_jump_max_nm"):
        assert played[name] == pytest.approx(row[name], abs=2e-9), name
    for pair, distance in played["min_distance_m"].items():
        assert distance == pytest.approx(row[f"min_distance_{pair}_m"], abs=2e-9)


def test_a_case_can_be_played_with_another_controller(case, file, capfd):
    main(["run", "--case", str(file), "--controller", "dbb", "--json"])
    assert json.loads(capfd.readouterr().out)["controller"] == "dbb"


@pytest.mark.parametrize(
    ("args", "words"),
    [
        (["guiding-front"], ["SCENARIO", "--case"]),
        (["--move", "0", "0", "0.1"], ["--move", "--case"]),
        (["--base-delay", "0.1"], ["--base-delay", "--case"]),
        (["--controller", "dbx"], ["did you mean 'dbb'"]),
    ],
)
def test_options_that_a_case_defines_are_refused(file, capfd, args, words):
    with pytest.raises(SystemExit) as end:
        main(["run", *args, "--case", str(file)])
    assert end.value.code == 2
    (line,) = capfd.readouterr().err.splitlines()
    assert all(word in line for word in words), line


def test_the_dashboard_refuses_a_file_that_is_no_case(tmp_path, capfd):
    path = tmp_path / "case.json"
    path.write_text("{}")
    with pytest.raises(SystemExit):
        main(["serve", "--case", str(path), "--port", "0"])
    assert str(path) in capfd.readouterr().err


def test_the_dashboard_checks_the_names_in_a_case_before_loading(file, capfd):
    content = json.loads(file.read_text())
    content["controller"] = "dbx"
    file.write_text(json.dumps(content))
    with pytest.raises(SystemExit) as end:
        main(["serve", "--case", str(file), "--port", "0"])
    assert end.value.code == 2
    assert "did you mean 'dbb'" in capfd.readouterr().err


@pytest.fixture
def loop(sources, case):
    def make_session() -> Session:
        return Session(
            sources.model,
            sources.data,
            case.config(),
            controller=case.controller,
            physics=case.physics,
            seed=case.seed,
        )

    loop = SimulationLoop(make_session, np.array(case.options["q_m"]))
    loop.start()
    yield loop
    loop.stop()


def wait_for_pull(loop: SimulationLoop) -> None:
    """Wait until the pull has started."""
    end = time.monotonic() + 60
    while loop.latest().hand_target is None:
        assert time.monotonic() < end
        time.sleep(0.002)


def test_the_loop_repeats_the_run_and_releases_the_robot_at_its_end(sources, drawn, case, loop):
    """Each snapshot equals a row of the run's log exactly, including noise."""
    trace = run_from_spec(spec_of(drawn, FAST), sources.model, sources.data).trace
    log = {round(t, 3): k for k, t in enumerate(trace.t)}
    loop.send(Play(case.scenario()))
    wait_for_pull(loop)
    end, seen = time.monotonic() + 60, {}
    while time.monotonic() < end and loop.latest().t < case.options["duration"] + 0.1:
        seen |= {s.t: s for s in loop.history(-1.0) if s.hand_target is not None}
        time.sleep(0.01)
    assert loop.error is None
    same = [s for t, s in seen.items() if round(t, 3) in log]
    assert len(same) > 10
    for s in same:
        k = log[round(s.t, 3)]
        assert trace.of("q_m")[k].tolist() == s.q_m.tolist()
        assert trace.of("ee_error")[k] == s.ee_error
    assert max(s.t for s in seen.values()) < case.options["duration"]
    assert loop.latest().hand_target is None


@pytest.mark.parametrize("command", [Pull((0.9, 0.0, 0.5)), Reset()])
def test_a_pull_or_a_reset_ends_the_replay(case, loop, command):
    loop.send(Play(case.scenario()))
    wait_for_pull(loop)
    loop.send(command)
    time.sleep(0.3)
    target = loop.latest().hand_target
    wanted = getattr(command, "target", None)
    assert (target is None) if wanted is None else tuple(target) == wanted


def test_the_button_plays_the_case_of_the_page(case):
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    sent = []
    sink = SimpleNamespace(send=sent.append)
    shared = SimpleNamespace(loop=sink, case=case.scenario())
    LabPanel(SimpleNamespace(client=server, notifier=Notifier(server), shared=shared, panels=[]))
    handles = server.gui._gui_input_handle_from_uuid.values()
    (button,) = (handle for handle in handles if handle.label == "Play the case")
    button.value = True
    wait_for(lambda: sent)
    server.stop()
    assert sent == [Play(case.scenario())]
    assert pickle.loads(pickle.dumps(sent)) == sent  # it is sent to the process of the loop


def labels_of_the_page(server) -> list[str]:
    """The names of the widgets of a new viewer."""
    with RawClient(server.address):
        end = time.monotonic() + 60
        while not server.pages:
            assert time.monotonic() < end
            time.sleep(0.01)
        [client] = server.viser.get_clients().values()
        return [getattr(w, "label", "") for w in client.gui._gui_input_handle_from_uuid.values()]


@pytest.mark.slow
def test_only_the_page_of_a_case_has_its_button(case, border_data):
    scenarios = (None, case.scenario())
    for scenario in scenarios:
        loop = ScriptedLoop(husky_panda())
        loop.start()
        server = serve_dashboard(loop, husky_panda(), border_data.clouds, port=0, case=scenario)
        try:
            labels = labels_of_the_page(server)
        finally:
            server.stop()
            loop.stop()
        assert ("Play the case" in labels) == (scenario is not None)
        assert any(label.startswith("Restart") for label in labels)
