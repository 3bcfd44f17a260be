"""Without viewers, dashboard and simulation use little CPU; they continue for the next viewer."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from functools import partial

import numpy as np
import psutil
import pytest

from app.config import Config
from app.dashboard.page import PATIENCE
from app.dashboard.server import DashboardServer, serve_dashboard
from app.simulation.loop.commands import Pause
from app.simulation.loop.process_loop import ProcessLoop
from app.simulation.session import Session
from tests.browser import wait_for
from tests.dashboards import clouds, parts
from tests.raw_client import RawClient

pytestmark = pytest.mark.slow

MEASURED = 1.0  # [s]


@pytest.fixture(scope="module")
def dashboard(robot, border_data) -> Iterator[DashboardServer]:
    make_session = partial(Session, robot, border_data, Config(), physics="kinematic")
    loop = ProcessLoop(make_session, np.array(robot.description.arm.ready_position))
    loop.start()
    try:
        server = serve_dashboard(loop, robot, clouds(), port=0, parts=parts())
        yield server
        server.stop()
        assert server.error is None
    finally:
        loop.stop()


def stand_still(dashboard: DashboardServer) -> bool:
    """Whether simulated time stands still for 0.3 s."""
    t = dashboard.shared.loop.latest().t
    time.sleep(0.3)
    return dashboard.shared.loop.latest().t == t


def working_time() -> float:
    """[s] CPU time of this process and its children."""
    own = psutil.Process()
    return sum(sum(each.cpu_times()[:2]) for each in (own, *own.children()))


def test_simulation_rests_without_viewers_and_continues_for_the_next_one(dashboard):
    loop = dashboard.shared.loop
    wait_for(lambda: stand_still(dashboard), what="rest")
    left, before, begin = loop.latest(), working_time(), time.monotonic()
    time.sleep(MEASURED)
    share = (working_time() - before) / (time.monotonic() - begin)
    assert share < 0.1
    assert loop.latest() is left
    assert loop.silence < 1.0, "a resting loop still responds"
    with RawClient(dashboard.address):
        wait_for(lambda: loop.latest().t > left.t + 0.1, what="simulated time")
        (next_one, *_) = loop.history(left.t)
        assert next_one.t == pytest.approx(left.t + 0.02, abs=0.021)
    wait_for(lambda: stand_still(dashboard), what="rest after the viewer has left")


def test_page_shows_a_banner_while_the_simulation_process_is_stopped(dashboard):
    """Both while the simulation runs and while it is paused."""
    loop = dashboard.shared.loop
    child = loop._child._process.pid
    wait_for(lambda: not dashboard.pages, what="the end of earlier viewers")
    with RawClient(dashboard.address):
        wait_for(lambda: dashboard.pages, what="a page")
        [page] = dashboard.pages.values()
        for paused in (False, True):
            loop.send(Pause(paused))
            wait_for(lambda paused=paused: loop.latest().paused is paused, what="the pause")
            time.sleep(1.5 * PATIENCE)
            assert not page._hung.visible, "a paused loop still responds"
            os.kill(child, signal.SIGSTOP)
            try:
                begin = time.monotonic()
                wait_for(lambda: page._hung.visible, what="the banner")
                assert time.monotonic() - begin < 2.0
            finally:
                os.kill(child, signal.SIGCONT)
            wait_for(lambda: not page._hung.visible, what="the end of the banner")
        assert dashboard.error is None
        assert loop.error is None
