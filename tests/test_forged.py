"""Messages of a client that is no browser neither stop the loop nor set a value out of range."""

from __future__ import annotations

import time
from contextlib import ExitStack, contextmanager

import pytest
from PIL import Image
from viser import _messages, _viser

from app.dashboard.page import Page
from app.dashboard.panels.save import png
from app.simulation.loop.commands import Configure, Pause, Speed, StepOnce
from tests.browser import wait_for
from tests.dashboards import served_dashboard
from tests.raw_client import RawClient

pytestmark = pytest.mark.slow

FLOOD = 4_000
"""Number of messages that one client sends."""
WRONG = (99999.0, -1e308, float("nan"), float("inf"), "wide", None, [1, 2], {"a": 1}, True, b"\xff")


@pytest.fixture(scope="module")
def served():
    with served_dashboard() as served:
        yield served


def is_responsive(served) -> bool:
    """Whether the loop runs and a new viewer gets a page.

    A late message may pause or restart the loop, so the command to continue is repeated.
    """

    def passes() -> bool:
        served.loop.send(Pause(False))
        before = served.loop.latest().t
        time.sleep(0.3)
        return served.loop.latest().t > before + 0.1

    wait_for(passes, what="a running loop")
    with new_viewer(served):
        return served.server.error is None


@contextmanager
def new_viewer(served):
    """A raw client and the page that the server has built for it."""
    known = set(served.server.pages)
    with RawClient(served.server.address) as client:
        wait_for(lambda: set(served.server.pages) - known, what="a page of the new viewer")
        yield client, served.server.pages[max(served.server.pages)]


def widgets(page):
    """All widgets of a page."""
    return list(page.client.gui._gui_input_handle_from_uuid.values())


def labelled(page, label):
    """The widget with a label."""
    return next(each for each in widgets(page) if getattr(each, "label", None) == label)


def test_no_widget_accepts_values_of_a_wrong_type_or_out_of_range(served, caplog):
    first = served.loop.latest().config
    with new_viewer(served) as (client, page):
        handles = widgets(page)
        assert len(handles) > 60
        for handle in handles:
            for value in WRONG:
                client.set_widget(handle, value)
        assert is_responsive(served)
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []
    for command in served.loop.commands:  # these commands have passed their own checks
        if isinstance(command, Configure):
            assert type(first).model_validate(command.config.model_dump()) == command.config
        if isinstance(command, Speed):
            assert 0.1 <= command.factor <= 4.0
        if isinstance(command, StepOnce):
            assert 0.0 < command.seconds <= 1.0


def test_unknown_widgets_nodes_and_attributes_are_ignored(served):
    config = served.loop.latest().config
    with new_viewer(served) as (client, page):
        handle = widgets(page)[0]
        for message in (
            _messages.GuiUpdateMessage("no such widget", {"value": 1}),
            _messages.GuiUpdateMessage(handle._impl.uuid, {"visible": False, "label": "forged"}),
            _messages.GuiUpdateMessage(handle._impl.uuid, {}),
            _messages.TransformControlsUpdateMessage("/no/such/node", (1, 0, 0, 0), (9, 9, 9)),
        ):
            client.send(message)
        assert is_responsive(served)
        assert handle.label != "forged"
    assert served.loop.latest().config == config


def test_a_picture_of_another_size_gives_the_viewer_a_warning(served, monkeypatch, caplog):
    monkeypatch.setattr(_viser, "_make_uuid", lambda: "asked")
    warnings, small = [], png(Image.new("RGBA", (8, 4)))
    with new_viewer(served) as (client, page):
        monkeypatch.setattr(page.notifier, "warn", lambda _, text: warnings.append(text))
        button = labelled(page, "Picture (PNG)")
        client.set_widget(button, True)

        def answer() -> bool:
            client.send(_messages.GetRenderResponseMessage(small, "asked"))
            return bool(warnings)

        wait_for(answer, what="the warning about the picture")
    assert warnings == ["the browser delivered a picture of another size"]
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []


def test_a_picture_that_does_not_arrive_can_be_cancelled(served):
    with new_viewer(served) as (client, page):
        files = page.files
        client.set_widget(labelled(page, "Picture (PNG)"), True)
        wait_for(lambda: files.progress is not None, what="the start of the picture")
        files.cancel()
        wait_for(lambda: files.progress is None, seconds=5.0, what="its end")


def test_thousands_of_messages_do_not_stop_the_loop_and_the_last_counts(served):
    with new_viewer(served) as (client, page):
        slider = page.tuning_panel.widgets["border.d_b"].handle
        served.loop.send(Pause(False))
        begin, before = time.monotonic(), served.loop.latest().t
        for i in range(FLOOD):
            client.set_widget(slider, 0.10 + 0.1 * (i % 2) if i < FLOOD - 1 else 0.22)
        wait_for(lambda: served.loop.latest().config.border.d_b == 0.22, 60.0, "the last value")
        passed = time.monotonic() - begin
        assert served.loop.latest().t - before > 0.25 * passed, "the loop has stalled meanwhile"
        assert is_responsive(served)
    served.loop.send(Configure(type(served.loop.latest().config)()))


def test_pages_of_many_viewers_are_built_one_by_one_for_open_clients(served, monkeypatch):
    """Each page is built between two pictures of the other pages, with panels and labels."""
    built, texts = [], []

    class Slow(Page):
        def __init__(self, *args):
            built.append(served.server.pictures)
            time.sleep(0.3)
            super().__init__(*args)

        def draw(self, **how):
            texts.append(how["texts"])
            super().draw(**how)

    monkeypatch.setattr("app.dashboard.server.Page", Slow)
    with new_viewer(served), ExitStack() as stack:
        built.clear()
        texts.clear()
        for _ in range(4):
            stack.enter_context(RawClient(served.server.address))
        wait_for(lambda: len(built) == 4, what="their pages")
        assert len(set(built)) == 4
        assert sum(texts) >= 4
        built.clear()
        for _ in range(8):
            RawClient(served.server.address).close()
        wait_for(
            lambda: len(served.server.viser.get_clients()) == 5,
            what="closed clients",
        )
        end = served.server.pictures + 5
        wait_for(lambda: served.server.pictures > end, what="the next pictures")
        assert len(built) < 8
