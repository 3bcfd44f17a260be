"""The challenge: what a visitor pulls is kept, played again by others, and told as it was."""

import threading
from functools import partial
from pathlib import Path

import numpy as np
import pytest

import app.dashboard.job as job_module
import app.dashboard.panels.challenge as panel_module
from app.config import Config
from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.job import Challenge, Tried, try_again
from app.dashboard.panels.challenge import card, challenge_html
from app.dashboard.record import Course
from app.simulation.case import Planned, RunCase
from app.simulation.loop.commands import Pause
from app.simulation.loop.loop import SimulationLoop
from app.simulation.run import run_planned, run_scenario
from app.simulation.scenarios.pulled import CHALLENGE
from app.simulation.session import Session
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard

Q_START = (0.0, -0.3, 0.0, -2.2, 0.0, 2.0, 0.8)


def tried(controller, least, *, met):
    return Tried(controller, least, met, 38.0, 0.7, {"base_path_m": 0.5})


def html(*found):
    challenge = Challenge()
    challenge.case = RunCase.of(Planned("husky_panda", CHALLENGE, Config(), "dbb", "planar"))
    challenge.tried = found
    return challenge_html(challenge, Course())


def test_it_says_honestly_who_has_won():
    assert "You won" in html(tried("dbb", 0.02, met=True), tried("none", 0.1, met=False))
    kept = html(tried("dbb", 0.031, met=False), tried("none", -0.01, met=True))
    assert "You won" not in kept
    assert "31 mm" in kept
    assert "−10 mm" in kept
    assert "Nobody pulled" in html()


def test_what_was_seen_is_told_at_once_and_each_controller_when_it_is_known(monkeypatch):
    """`none` is played again before the others, and the seen figures are replaced by exact ones."""
    course, gate, asked = Course(), threading.Event(), []
    course.least, course.pull = 0.04, 38.0

    def again(_, work, text, name):
        asked.append(name)
        gate.wait(10.0)
        return tried(name, 0.039 if name == "dbb" else -0.01, met=name == "none")

    monkeypatch.setattr(Challenge, "run", again)
    challenge = Challenge()
    scenario = CHALLENGE.changed(pulls=((20, 0, (0.5, 0.0, 0.3)),))
    case = RunCase.of(Planned("husky_panda", scenario, Config(), physics="planar"))
    challenge.take(case, course)
    assert [each.controller for each in challenge.tried] == ["dbb"]
    assert "kept 40 mm" in challenge_html(challenge, Course())
    gate.set()
    wait_for(lambda: challenge.progress is None, 10.0)
    assert asked[0] == "none"
    assert [each.controller for each in challenge.tried] == [
        "dbb",
        "none",
        "hqp",
        "repulsive",
        "barrier",
    ]
    assert "kept 39 mm" in challenge_html(challenge, Course())
    assert challenge.case is not None
    assert challenge.case.figures


def test_the_card_shows_what_came_of_it():
    from PIL import Image

    plain = Image.new("RGB", (640, 360), (20, 20, 20))
    won = np.array(card(plain.copy(), (tried("dbb", 0.0, met=True),), dark=True))
    kept = np.array(card(plain.copy(), (tried("dbb", 0.03, met=False),), dark=True))
    assert (won != np.array(plain)).any()
    assert (won != kept).any()


def test_what_is_tried_again_is_what_a_run_of_the_case_gives(robot, border_data):
    pulls = ((20, 0, (0.5, 0.0, 0.3)), (80, 1, (0.4, 0.4, 0.6), "panda_joint4", (0.0, 0.0, 0.0)))
    scenario = CHALLENGE.changed(duration=0.3, q_m=Q_START, pulls=pulls)
    case = RunCase.of(Planned("husky_panda", scenario, Config(), "dbb", "kinematic"))
    found = try_again(lambda *_: None, case.text(), "none")
    run = run_scenario(
        robot, border_data, scenario, Config(), controller="none", physics="kinematic"
    )
    assert case.model_copy(update={"figures": found.figures}).changes(run.figures) == []
    assert found.pull >= found.figures["hand_force_max_n"] > 0.0
    assert found.speed == run.figures["hand_speed_max_mps"]


@pytest.mark.browser
@pytest.mark.slow
def test_a_visitor_tries_and_gets_the_proof(
    browser, robot, border_data, monkeypatch, tmp_path: Path
):
    monkeypatch.setattr(job_module, "CONTROLLERS", ("dbb", "none"))
    monkeypatch.setattr(panel_module, "CHALLENGE", CHALLENGE.changed(duration=4.0))
    # Not in a process of low priority, which on a busy machine gets its turn late.
    monkeypatch.setattr(Challenge, "run", lambda self, work, *args: work(self.report, *args))
    loop = SimulationLoop(partial(Session, robot, border_data, Config()), np.array(Q_START))
    with served_dashboard(loop) as served:  # type: ignore[arg-type]
        tab = DashboardTab(browser, served.server.address)
        tab.page.get_by_text("Make it collide", exact=True).click()
        tab.arrow(GIZMO, 2, SCALE)  # once nothing moves any more
        tab.click("Begin, 30 s")
        tab.page.get_by_text("Pull the hand, or any link").wait_for()
        tab.drag_gizmo(GIZMO, 2, -0.25, SCALE)
        shared = served.server.shared
        wait_for(lambda: len(shared.challenge.tried) == 2, seconds=120, what="the card")
        tab.page.get_by_text("Pulled to the same places, each controller").wait_for()
        loop.send(Pause(True))
        first = shared.challenge.tried[0]
        assert first.controller == "dbb"
        assert first.pull > 1.0, "the mouse pulled"
        with tab.page.expect_download() as download:
            tab.click("Case of it (JSON)")
        download.value.save_as(tmp_path / "case.json")
        case = RunCase.read((tmp_path / "case.json").read_text(), "case.json")
        with tab.page.expect_download() as download:
            tab.click("Card (PNG)")
        download.value.save_as(tmp_path / "card.png")
        tab.picture(tmp_path / "page.png")
        tab.page.reload()  # who comes back finds it open
        tab.wait_for_scene()
        tab.page.get_by_text("Pulled to the same places, each controller").wait_for()
        assert tab.errors == []
    again = run_planned(case.planned(), robot, border_data)
    assert case.figures
    assert case.changes(again.figures) == []
