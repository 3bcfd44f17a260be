"""The tuning panel in a real browser: typing, files, undo, two viewers."""

from __future__ import annotations

import pytest

from app.config import Config
from app.config_file import read_config
from app.dashboard.notifications import Notifier
from app.simulation.loop.commands import Configure
from tests.browser import DashboardTab, wait_for
from tests.dashboards import served_dashboard

pytestmark = pytest.mark.browser


@pytest.fixture
def served():
    with served_dashboard() as served:
        yield served


def configured(loop):
    return [command.config for command in loop.commands if isinstance(command, Configure)]


def box(tab, label):
    """The number box of a parameter."""
    return tab.row(label).locator("input[type=text], input[inputmode]").last


def test_both_viewers_see_typed_loaded_and_undone_values(browser, served, tmp_path, monkeypatch):
    server, loop = served
    tabs = [DashboardTab(browser, server.address) for _ in range(2)]
    for tab in tabs:
        tab.open_tab("Tune")
    first, second = tabs

    first.set_slider("Buffer distance d_b [m]", 0.225)
    wait_for(lambda: configured(loop) == [Config().replace("border.d_b", 0.225)])
    wait_for(lambda: box(second, "Buffer distance d_b [m]").input_value() == "0.225")
    second.page.get_by_text("Border · 1 changed").wait_for()

    path = tmp_path / "wide.toml"
    with first.page.expect_download() as download:
        first.click("Save")
    download.value.save_as(path)
    assert read_config(path).config == Config().replace("border.d_b", 0.225)
    path.write_text(path.read_text(encoding="utf-8").replace("d_b = 0.225", "d_b = 0.25"))

    with second.page.expect_file_chooser() as chooser:
        second.click("Load")
    chooser.value.set_files(path)
    wait_for(lambda: box(first, "Buffer distance d_b [m]").input_value() == "0.25")
    first.click("Undo")
    wait_for(lambda: box(second, "Buffer distance d_b [m]").input_value() == "0.225")

    warnings = []
    monkeypatch.setattr(Notifier, "warn", lambda self, client, text: warnings.append(text))
    for wrong in ("7", "abc", ""):
        box(second, "Buffer distance d_b [m]").click()
        second.page.keyboard.press("Control+a")
        second.page.keyboard.press("Delete")
        second.page.keyboard.type(wrong)
        second.page.keyboard.press("Tab")
        named = f"“{wrong}”" if wrong else "nothing"
        range_ = "needs a number from 0.05 to 0.3"
        line = f"Buffer distance d_b [m] {range_}, not {named}; the value stays 0.225."
        wait_for(lambda line=line: warnings[-1:] == [line], what=line)
        assert box(second, "Buffer distance d_b [m]").input_value() == "0.225"
    assert configured(loop)[-1] == Config().replace("border.d_b", 0.225)
    assert all(config.border.d_b <= 0.25 for config in configured(loop))
    for tab in tabs:
        tab.close()
        assert tab.errors == []
