"""A sleeping viewer's pull ends, a silent connection is closed, a hanging loop is reported."""

from __future__ import annotations

import time
from contextlib import contextmanager

import numpy as np
import pytest

from app.dashboard import viser_compat
from app.dashboard.page import Page, hung_html
from app.simulation.loop.commands import Release
from tests.browser import wait_for
from tests.dashboards import served_dashboard
from tests.raw_client import RawClient

pytestmark = pytest.mark.slow

MOTIONLESS = 2.0  # [s] of a pull without motion, longer than the timeout of a sleeping viewer


@pytest.fixture
def served():
    with served_dashboard() as served:
        yield served


@contextmanager
def visitor(served):
    with RawClient(served.server.address) as raw:
        page = served.page()
        page.grip.take()
        page.grip.pull(np.array([0.6, 0.0, 0.7]))
        yield raw, page


def pull_without_motion(page: Page) -> None:
    time.sleep(MOTIONLESS)
    assert page.grip.holds_anything


def test_pull_ends_if_its_browser_sleeps_but_not_without_motion(served):
    with visitor(served) as (raw, page):
        pull_without_motion(page)
        with raw.asleep():
            begin = time.monotonic()
            wait_for(lambda: not page.grip.holds_anything, what="the end of the pull")
            assert time.monotonic() - begin < 3.0
        # The page ends the pull first; another thread then sends the release to the loop.
        wait_for(lambda: isinstance(served.loop.commands[-1], Release), what="the release")
        assert served.server.watchdog.closed == 0
        assert not page.closed


def test_pull_continues_while_a_busy_browser_moves_it_without_answers(served):
    with visitor(served) as (raw, page), raw.asleep():
        for x in np.linspace(0.6, 0.5, 20):
            page.grip.pull(np.array([x, 0.0, 0.7]))
            time.sleep(0.1)
            assert page.grip.holds_anything


@pytest.mark.parametrize("why", ["reads nothing", "is sent nothing"])
def test_connection_that_delivers_nothing_is_closed_and_counted(served, why, monkeypatch, caplog):
    monkeypatch.setattr(viser_compat, "STUCK", 6)
    monkeypatch.setattr(viser_compat, "LOOK", 0.25)
    monkeypatch.setattr(viser_compat, "_said", {})
    with RawClient(served.server.address) as raw, RawClient(served.server.address) as other:
        wait_for(lambda: len(served.server.pages) == 2, what="two pages")
        number = min(served.server.pages)
        if why == "reads nothing":
            with raw.asleep():
                wait_for(lambda: number not in served.server.pages, what="the end of the page")
        else:  # as after a lost wake-up of its queue
            inner = served.server.viser._websock_server
            queue = inner._client_state_from_id[number].message_buffer
            queue.message_event.set = lambda: None
            queue.message_event.clear()
            wait_for(lambda: number not in served.server.pages, what="the end of the page")
        raw._thread.join(timeout=5.0)
        assert not raw._thread.is_alive(), "still connected"
        assert served.server.watchdog.closed == 1
        assert f"nothing reached viewer {number}" in caplog.text
        assert other._thread.is_alive()


def test_page_reports_a_silent_simulation_until_it_responds_again(served):
    with RawClient(served.server.address):
        warning = served.page()._hung
        assert not warning.visible
        served.loop.silence = 1.2
        wait_for(lambda: warning.visible, what="the banner")
        assert "The simulation does not respond" in warning.content
        served.loop.silence = 0.0
        wait_for(lambda: not warning.visible, what="the end of the banner")
    assert hung_html(0.9) == ""
