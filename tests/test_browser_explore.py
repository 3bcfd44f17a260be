"""Values of the border under the pointer, and exploration of postures with sliders."""

import numpy as np
import pytest
import viser

from app.config import Config
from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.explorer import Explorer, Posture
from app.dashboard.scene.borders import Borders, DrawnBorders
from app.dashboard.scene.camera import Window, lens_of
from app.dashboard.view import View
from app.simulation.loop.commands import Pause, Reset
from app.simulation.loop.ensemble import Ensemble
from app.simulation.session import Session
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard
from tests.fakes import ScriptedLoop


def test_probe_shows_the_foremost_border_point_and_the_base_response(robot, border_data):
    borders = Borders(robot, border_data.clouds)
    snapshot = ScriptedLoop(robot).latest()
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        drawn = DrawnBorders(server.scene, borders, robot)
        drawn.update(View.first(["lm-lEE"], []), snapshot.config.border)
        eye, target = np.array([3.0, 0.0, 0.25]), np.array([0.0, 0.0, 0.25])
        lens = lens_of(eye, target, 800.0, Window())
        probe = drawn._find(snapshot, lens, (0.0, 0.0))
        assert probe is not None
        assert probe.p[0] > 0.5, "the point must be on the front, not on the rear"
        assert abs(probe.p[1:] - (0.0, 0.25)).max() < 0.05
        assert probe.acceleration[0] < -0.1
        field = borders.fields["lm-lEE"]
        assert f"score S {field.score(probe.p):.3g} " in probe.text
        assert f"reachability {field.reachability(probe.p):.0f}" in probe.text
        assert drawn._find(snapshot, lens, (390.0, 390.0)) is None
    finally:
        server.stop()


def test_run_from_explored_posture_starts_with_the_explored_response(robot, border_data):
    q_m = np.array((0.3, 0.9, 0.0, -1.9, 0.1, 2.3, 0.8))
    ensemble = Ensemble(Session(robot, border_data, Config(), physics="kinematic"), 0.9 * q_m)
    snapshot = ScriptedLoop(robot).latest()
    found = Explorer(robot, border_data.clouds, snapshot).respond(
        Posture(np.array((0.5, -0.2, 0.7)), q_m), snapshot
    )
    ensemble.reset(tuple(q_m), (0.5, -0.2, 0.7))
    step = ensemble.step()
    np.testing.assert_array_equal(found.base_acceleration, step.control.a_base_cmd)
    np.testing.assert_allclose([pair.d for pair in found.pairs], step.distances, atol=1e-12)
    ensemble.restart()
    np.testing.assert_array_equal(ensemble.step().truth.q_m, step.truth.q_m)
    ensemble.reset()
    np.testing.assert_array_equal(ensemble.step().truth.q_m, 0.9 * q_m)
    ensemble.close()


def test_reach_solves_for_a_position_or_reports_the_remaining_distance(robot, border_data):
    loop = ScriptedLoop(robot)
    snapshot = loop.latest()
    explorer = Explorer(robot, border_data.clouds, snapshot)
    begin = Posture(np.zeros(3), np.array(snapshot.q_m))
    place = np.add(snapshot.p_ee, (0.05, 0.05, -0.1))
    posture, off = explorer.reach(begin, place)
    assert off < 1e-3
    np.testing.assert_allclose(explorer.respond(posture, snapshot).p_ee, place, atol=1e-3)
    _, off = explorer.reach(begin, np.array((5.0, 0.0, 0.5)))
    assert off > 1.0


@pytest.mark.browser
def test_visitor_explores_postures_and_probes_the_border(browser):
    with served_dashboard() as served:
        tab = DashboardTab(browser, served.server.address)
        tab.open_tab("Lab")
        tab.page.get_by_text("Joint sliders", exact=True).click()
        tab.click("Pause and pose the arm")
        tab.row("panda_joint4 [°]").wait_for()
        page = served.page()
        before = served.loop.latest().q_m.copy()
        tab.set_slider("panda_joint4 [°]", -150.0)
        wait_for(lambda: page.explorer_panel.posture.q_m[3] == pytest.approx(np.radians(-150.0)))
        np.testing.assert_array_equal(served.loop.latest().q_m, before)
        before_drag = page.explorer_panel.posture
        tab.drag_gizmo(GIZMO, 0, -0.1, SCALE)  # the arm covers the upright arrow
        wait_for(lambda: not np.array_equal(page.explorer_panel.posture.q_m, before_drag.q_m))
        assert served.loop.pulls() in ([], [None]), "no pull"

        place = np.array([[0.645, 0.0, 0.25]])
        [at] = tab.pixels("/robot", place)
        tab.page.mouse.move(*at)
        wait_for(lambda: tab.is_shown("/probe/text"), what="the values of the point")
        assert "mobility" in tab.text("/probe/text")
        tab.page.mouse.move(2, 2)
        wait_for(lambda: not tab.is_shown("/probe/text"), what="hidden values")

        tab.open_tab("Lab")
        tab.click("Start from this posture")
        wait_for(lambda: Pause(False) in served.loop.commands, what="the start")
        [reset] = [c for c in served.loop.commands if isinstance(c, Reset) and c.q_m]
        assert reset.q_m[3] != pytest.approx(before[3])
        tab.click("Pause and pose the arm")
        wait_for(lambda: page.explorer_panel.posture is not None, what="a posture")
        wait_for(lambda: served.loop.latest().paused, what="a pause")
        served.loop.send(Reset())
        assert served.loop.latest().paused
        wait_for(lambda: page.explorer_panel.posture is None, what="the end of the exploration")
        assert tab.errors == []
