"""Accessibility of the page: axe-core checks names, landmarks and contrast."""

from __future__ import annotations

import os
import shutil
import subprocess
import tarfile
import time
from pathlib import Path

import numpy as np
import pytest

from app.simulation.loop.commands import Pull, Release
from tests.browser import REQUIRED, DashboardTab, wait_for
from tests.dashboards import served_dashboard

pytestmark = pytest.mark.browser

AXE = "axe-core@4.11.1"
"""npm package; only tests use it."""
TABS = (
    ("Run", "Why"),
    ("Lab", "Plots"),
    ("View", "Compare"),
    ("Tune", "Key"),
    ("Save",),
    ("Help",),
)
"""Tabs of the right and the left column that are open at the same time."""


@pytest.fixture(scope="module")
def axe(tmp_path_factory: pytest.TempPathFactory) -> str:
    """Source text of axe-core."""
    folder, npm = tmp_path_factory.mktemp("axe"), shutil.which("npm")
    pack = [npm or "npm", "pack", AXE, "--silent", "--prefer-offline"]
    if npm is None or subprocess.run(pack, cwd=folder, timeout=120, check=False).returncode:
        if os.environ.get(REQUIRED) and npm is not None:
            pytest.fail(f"npm does not deliver {AXE}")
        pytest.skip("without npm there is no axe-core")
    [archive] = Path(folder).glob("*.tgz")
    with tarfile.open(archive) as packed:
        source = packed.extractfile("package/axe.min.js")
        assert source is not None
        return source.read().decode()


@pytest.fixture(scope="module")
def served():
    with served_dashboard() as served:
        yield served


def violations(tab: DashboardTab, rules: dict[str, object]) -> list[tuple[str, str, str]]:
    """The violated rules, each with its first element and the reason."""
    how = {"resultTypes": ["violations"], **rules}
    found = tab.page.evaluate("how => axe.run(document, how)", how)
    nodes = [(each["id"], each["nodes"][0]) for each in found["violations"]]
    return [(kind, n["html"][:200], n["failureSummary"]) for kind, n in nodes]


def test_no_tab_violates_accessibility_rules(browser, served, axe):
    """Names and landmarks do not depend on the theme; contrast does, so both themes are checked.

    New elements get their names within 0.3 s, so violations count only if they last.
    """
    tab = DashboardTab(browser, served.server.address, first_visit=True)
    tab.page.locator("#dbb-card").wait_for()
    tab.page.evaluate(axe + ";0")
    for theme, rules in (("dark", {}), ("light", {"runOnly": ["color-contrast"]})):
        served.page().view.dark = theme == "dark"
        tab.page.wait_for_selector(f"html[data-mantine-color-scheme={theme}]")
        for names in TABS:
            for name in names:
                tab.page.evaluate("name => dbbPanels.open(name)", name)
                tab.page.get_by_role("tab", name=name, selected=True).wait_for()
            tab.page.wait_for_timeout(100)
            deadline = time.monotonic() + 5.0
            while found := violations(tab, rules):
                assert time.monotonic() < deadline, (theme, names, found)
    tab.close()


def test_arrow_keys_pull_the_end_effector_until_shift_is_released(browser, served):
    served.begin_anew()
    tab = DashboardTab(browser, served.server.address)
    p_ee = np.array(served.loop.latest().p_ee)
    keys = tab.page.keyboard
    keys.down("Shift")
    for _ in range(3):
        keys.press("ArrowDown")
    wait_for(lambda: len(served.loop.pulls()) >= 3, what="pulls")
    keys.up("Shift")
    wait_for(lambda: isinstance(served.loop.commands[-1], Release), what="release")
    pulls = [command for command in served.loop.commands if isinstance(command, Pull)]
    np.testing.assert_allclose(pulls[-1].target - p_ee, [-0.06, 0.0, 0.0], atol=1e-6)
    tab.close()
