"""Several viewers of one simulation, and viewers whose connection ends."""

from __future__ import annotations

import numpy as np
import pytest

from app.dashboard.drag import GIZMO, SCALE
from app.dashboard.scene.canvas import ROOT
from app.simulation.loop.commands import Pause
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda

pytestmark = pytest.mark.browser


def drag_without_release(tab: DashboardTab, axis: int, metres: float) -> None:
    """Drag the end-effector and keep the mouse button down."""
    tab.drag_gizmo(GIZMO, axis=axis, metres=metres, scale=SCALE, steps=5, drop=False)


def test_two_viewers_have_separate_layers_and_times_and_both_pull(browser):
    with served_dashboard() as served:
        loop = served.loop
        first = DashboardTab(browser, served.server.address)
        page_of_first = served.page()
        second = DashboardTab(browser, served.server.address)
        page_of_second = served.page()
        assert page_of_second is not page_of_first

        first.open_tab("View")
        first.choose("end-effector – base", "hidden")
        wait_for(lambda: not first.is_shown(f"{ROOT}/border_lm-lEE"))
        assert second.is_shown(f"{ROOT}/border_lm-lEE"), (
            "the layers of one viewer changed those of the other"
        )

        served.pull_at_base(3.0)
        first.look_at(1.5)
        wait_for(lambda: not page_of_first.timeline.live)
        then, now = page_of_first.timeline.shown(), loop.latest()
        wait_for(lambda: np.linalg.norm(first.position(GIZMO) - then.p_ee) < 1e-3)
        wait_for(lambda: np.linalg.norm(second.position(GIZMO) - now.p_ee) < 1e-3)
        assert np.linalg.norm(now.p_ee - then.p_ee) > 0.1, "both viewers show the same time"
        first.click("Back to now")
        served.begin_anew()
        first.open_tab("Run")
        second.click("Pause")
        first.page.get_by_role("button", name="Continue", exact=True).first.wait_for(timeout=40_000)
        loop.send(Pause(False))

        drag_without_release(first, 1, 0.15)
        drag_without_release(second, 1, -0.15)
        wait_for(lambda: len(loop.latest().pulls) == 2, what="two pulls")
        for tab in (first, second):
            wait_for(lambda tab=tab: tab.is_shown("/pull/0") and tab.is_shown("/pull/1"))
        second.close()  # during its drag
        wait_for(lambda: len(loop.latest().pulls) == 1, what="a closed page ends its pull")
        wait_for(lambda: not first.is_shown("/pull/1"))
        assert first.is_shown("/pull/0"), "the pull of the other viewer has ended"
        first.close()
        wait_for(lambda: loop.latest().pulls == ())
        assert (first.errors, second.errors) == ([], [])


def test_the_page_reconnects_to_a_new_server_and_reports_a_failed_loop(browser):
    with served_dashboard() as served:
        port = int(served.server.address.rpartition(":")[2])
        tab = DashboardTab(browser, served.server.address)
        assert tab.errors == []
    loop = ScriptedLoop(husky_panda())
    with served_dashboard(loop, port) as served:
        wait_for(lambda: served.server.pages, 60.0, "the tab reconnects")
        tab.wait_for_scene()
        tab.click("Pause")
        wait_for(lambda: loop.commands == [Pause(True)], what="the new simulation pauses")
        loop.send(Pause(False))
        tab.drag_gizmo(GIZMO, axis=1, metres=0.1, scale=SCALE)
        wait_for(lambda: loop.pulls() and loop.pulls()[-1] is None, what="a pull, and its end")

        loop.error = RuntimeError("the plant is gone")
        tab.page.get_by_text("The simulation has stopped").wait_for(timeout=40_000)
        tab.page.reload()
        tab.page.get_by_text("The simulation has stopped").wait_for(timeout=60_000)
    unexpected = [text for text in tab.errors if "ERR_CONNECTION_REFUSED" not in text]
    assert unexpected == [], "errors other than refused connections"
