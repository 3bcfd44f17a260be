"""The complete system: `dbb serve`, a browser, and a mouse drag of the end-effector to the base.

The assertions read only the page and the output of the command.
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
PATIENCE = 120.0  # [s] for work that takes a second or two on an idle machine


class Served:
    """`dbb serve` in a separate process.

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
        raise AssertionError(f"the process ended before it served: {seen}")

    def interrupt(self) -> tuple[int, str]:
        """Press Ctrl-C; returns the status and the remaining output."""
        self.process.send_signal(signal.SIGINT)
        _, errors = self.process.communicate(timeout=PATIENCE)
        return self.process.returncode, errors


def simulation_of(served: Served) -> psutil.Process:
    """The process that runs the simulation."""
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
    """The cell beside a label in the table of the tab "Lab"."""
    text = re.compile(rf"^{re.escape(label)}$")
    row = tab.page.locator("tr").filter(has=tab.page.locator("td").filter(has_text=text))
    return row.locator("td").last.inner_text()


def greatest_activation(tab: DashboardTab) -> float:
    """The largest β_m in the plot of the activation."""
    return float(tab.plot("activation of the avoidance β_m")[1].max())


def pull_towards_base(tab: DashboardTab) -> None:
    """Drag the end-effector to the base, hold it until the base has moved, and release it."""
    before = tab.position("/robot")
    tab.drag_gizmo(GIZMO, axis=0, metres=TOWARDS_BASE, scale=SCALE, steps=12, drop=False)
    wait_for(
        lambda: re.search(r" N( \(|$)", reading(tab, "pull")), PATIENCE, "the pull in the table"
    )

    def base_has_moved() -> bool:
        return float(np.linalg.norm(tab.position("/robot") - before)) > 0.05

    wait_for(base_has_moved, PATIENCE, "base motion of 0.05 m")
    tab.page.mouse.up()


def test_base_moves_away_from_the_dragged_end_effector(browser, served):
    """After the simulation's process is killed, page and command report the cause."""
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

    wait_for(lambda: greatest_activation(tab) > 0.2, PATIENCE, "activation in the plot")
    assert tab.position("/robot")[0] < -0.05, "the base must back off"
    wait_for(lambda: reading(tab, "pull") == "none", PATIENCE, "no pull in the table")
    wait_for(
        lambda: tab.position(GIZMO)[0] < start[0] - 0.1, PATIENCE, "end-effector nearer to the base"
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
