"""Programs in place of a browser: with any message, the loop continues within its ranges."""

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
"""Messages of one client."""
WRONG = (99999.0, -1e308, float("nan"), float("inf"), "wide", None, [1, 2], {"a": 1}, True, b"\xff")


@pytest.fixture(scope="module")
def served():
    with served_dashboard() as served:
        yield served


def goes_on(served) -> bool:
    """Whether time passes in the loop, and a viewer who comes now gets a page.

    Any program may pause it or restart it, and messages may still be on their way: so it gets the
    command to continue until it does.
    """

    def passes() -> bool:
        served.loop.send(Pause(False))
        before = served.loop.latest().t
        time.sleep(0.3)
        return served.loop.latest().t > before + 0.1

    wait_for(passes, what="time goes on")
    with visitor(served):
        return served.server.error is None


@contextmanager
def visitor(served):
    """A program that has come as a viewer, and the page that was made for it."""
    known = set(served.server.pages)
    with RawClient(served.server.address) as client:
        wait_for(lambda: set(served.server.pages) - known, what="a page for who comes now")
        yield client, served.server.pages[max(served.server.pages)]


def widgets(page):
    """All widgets of a page."""
    return list(page._client.gui._gui_input_handle_from_uuid.values())


def labelled(page, label):
    """The widget with a label."""
    return next(each for each in widgets(page) if getattr(each, "label", None) == label)


def test_no_widget_takes_what_is_not_of_its_kind_or_out_of_its_range(served, caplog):
    first = served.loop.latest().config
    with visitor(served) as (client, page):
        handles = widgets(page)
        assert len(handles) > 60
        for handle in handles:
            for value in WRONG:
                client.set_widget(handle, value)
        assert goes_on(served)
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
    with visitor(served) as (client, page):
        handle = widgets(page)[0]
        for message in (
            _messages.GuiUpdateMessage("no such widget", {"value": 1}),
            _messages.GuiUpdateMessage(handle._impl.uuid, {"visible": False, "label": "forged"}),
            _messages.GuiUpdateMessage(handle._impl.uuid, {}),
            _messages.TransformControlsUpdateMessage("/no/such/node", (1, 0, 0, 0), (9, 9, 9)),
        ):
            client.send(message)
        assert goes_on(served)
        assert handle.label != "forged"
    assert served.loop.latest().config == config


def test_a_page_that_answers_with_another_picture_than_it_was_asked_for_is_told_so(
    served, monkeypatch, caplog
):
    monkeypatch.setattr(_viser, "_make_uuid", lambda: "asked")
    told, small = [], png(Image.new("RGBA", (8, 4)))
    with visitor(served) as (client, page):
        monkeypatch.setattr(page._notifier, "warn", lambda _, text: told.append(text))
        button = labelled(page, "Picture (PNG)")
        client.set_widget(button, True)

        def answer() -> bool:
            client.send(_messages.GetRenderResponseMessage(small, "asked"))
            return bool(told)

        wait_for(answer, what="a word on the picture")
    assert told == ["the browser delivered a picture of another size"]
    assert [record for record in caplog.records if record.levelname == "ERROR"] == []


def test_who_cancels_a_picture_that_does_not_come_has_not_to_wait_for_it(served):
    with visitor(served) as (client, page):
        files = page.viewer.files
        client.set_widget(labelled(page, "Picture (PNG)"), True)
        wait_for(lambda: files.progress is not None, what="the picture's begin")
        files.cancel()
        wait_for(lambda: files.progress is None, seconds=5.0, what="its end")


def test_thousands_of_messages_at_once_hold_nobody_up_and_the_last_value_counts(served):
    with visitor(served) as (client, page):
        slider = page.tuning_panel.widgets["border.d_b"].handle
        served.loop.send(Pause(False))
        begin, before = time.monotonic(), served.loop.latest().t
        for i in range(FLOOD):
            client.set_widget(slider, 0.10 + 0.1 * (i % 2) if i < FLOOD - 1 else 0.22)
        wait_for(lambda: served.loop.latest().config.border.d_b == 0.22, 60.0, "the last value")
        passed = time.monotonic() - begin
        assert served.loop.latest().t - before > 0.25 * passed, "the loop has gone on meanwhile"
        assert goes_on(served)
    served.loop.send(Configure(type(served.loop.latest().config)()))


def test_many_who_come_at_once_hold_nobody_up_and_who_has_gone_gets_no_page(served, monkeypatch):
    """Each page is built between two pictures of the others, which include panels and labels."""
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
    with visitor(served), ExitStack() as stack:
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
        wait_for(lambda: len(served.server.viser.get_clients()) == 5, what="all have gone")
        end = served.server.pictures + 5
        wait_for(lambda: served.server.pictures > end, what="the next pictures")
        assert len(built) < 8
