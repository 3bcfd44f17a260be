"""The real thing: `dbb serve`, a browser, and a mouse that drags the hand at the base.

All that is asserted is read off the page, as a person would.
"""

from __future__ import annotations

import re
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import psutil
import pytest

from app.dashboard.drag import GIZMO, SCALE
from tests.browser import DashboardTab, wait_for

pytestmark = pytest.mark.browser

PROJECT = Path(__file__).resolve().parent.parent
TOWARDS_BASE = -0.30  # [m] along x, the base's front
PATIENCE = 120.0  # [s] for work that takes a second or two on a quiet machine


class Served:
    """`dbb serve` in a process of its own.

    Attributes:
        process: The process.
        address: The printed address.
    """

    def __init__(self, *options: str) -> None:
        command = [sys.executable, "-m", "app", "serve", "--port", "0", *options]
        self.process = subprocess.Popen(
            command, cwd=PROJECT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        self.address = self._printed_address()

    def _printed_address(self) -> str:
        assert self.process.stderr is not None
        seen = ""
        for line in self.process.stderr:
            seen += line
            if found := re.search(r"http://\S+", line):
                return found.group()
        raise AssertionError(f"it ended before it served: {seen}")

    def interrupt(self) -> tuple[int, str]:
        """Press Ctrl-C; the status and the remaining output."""
        self.process.send_signal(signal.SIGINT)
        _, errors = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, errors


def simulation_of(served: Served) -> psutil.Process:
    """The process in which the simulation runs."""
    children = psutil.Process(served.process.pid).children()
    [simulation] = [child for child in children if "dbb _run_loop" in child.cmdline()]
    return simulation


@pytest.fixture
def served():
    served = Served()
    yield served
    served.process.kill()
    served.process.wait()


def reading(tab: DashboardTab, label: str) -> str:
    """The text of the table of the tab "Lab" beside a label."""
    text = re.compile(rf"^{re.escape(label)}$")
    row = tab.page.locator("tr").filter(has=tab.page.locator("td").filter(has_text=text))
    return row.locator("td").last.inner_text()


def greatest_activation(tab: DashboardTab) -> float:
    """The highest β_m on the plot of activation."""
    return float(tab.plot("activation of the avoidance β_m")[1].max())


def pull_towards_base(tab: DashboardTab) -> None:
    """Drag the hand at the base, hold it there until the base has gone, and let go."""
    before = tab.position("/robot")
    tab.drag_gizmo(GIZMO, axis=0, metres=TOWARDS_BASE, scale=SCALE, steps=12, drop=False)
    wait_for(
        lambda: re.search(r" N( \(|$)", reading(tab, "pull")), PATIENCE, "the pull in the table"
    )

    def base_has_moved() -> bool:
        return float(np.linalg.norm(tab.position("/robot") - before)) > 0.05

    wait_for(base_has_moved, PATIENCE, "the base has moved by 0.05 m")
    tab.page.mouse.up()


def test_the_base_gets_out_of_the_way_of_a_hand_that_is_dragged_at_it(browser, served):
    """And when the process of the simulation dies, the page and the command say why."""
    tab = DashboardTab(browser, served.address)
    tab.open_tab("Lab")
    tab.open_tab("Plots")
    tab.wait("() => dbbTest.plot('activation of the avoidance β_m') !== null")
    assert reading(tab, "pull") == "none"
    assert greatest_activation(tab) == 0.0
    start = tab.position(GIZMO)
    np.testing.assert_allclose(tab.position("/robot"), 0.0, atol=2e-3)
    before = tab.picture()

    pull_towards_base(tab)

    wait_for(lambda: greatest_activation(tab) > 0.2, PATIENCE, "the plot comes after the scene")
    assert tab.position("/robot")[0] < -0.05, "it backs off, away from the hand"
    wait_for(lambda: reading(tab, "pull") == "none", PATIENCE, "nobody pulls any more")
    wait_for(
        lambda: tab.position(GIZMO)[0] < start[0] - 0.1, PATIENCE, "the hand is nearer than it was"
    )
    tab.wait_for_change(before, 1000)
    assert reading(tab, "contact") == "none"
    assert reading(tab, "solver failures") == "0"
    assert tab.errors == []

    simulation_of(served).kill()
    tab.page.get_by_text("ended with status").wait_for(timeout=1000 * PATIENCE)
    status, printed = served.interrupt()
    assert status == 2
    assert "ended with status -9" in printed.splitlines()[-1]
