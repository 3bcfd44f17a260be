"""Screenshots without a display: of the scene alone, or of the whole dashboard."""

from __future__ import annotations

import io
import itertools
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack, closing
from typing import TYPE_CHECKING

import viser
from PIL import Image, ImageDraw

from app.border.dbb import Cloud
from app.dashboard.export import Look, offscreen
from app.dashboard.export.offscreen import OffscreenScene, RecordedLoop
from app.dashboard.notifications import Notifier
from app.dashboard.page import Page
from app.dashboard.panels.help import SEEN
from app.dashboard.shared import SharedState
from app.errors import BrowserError
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

if TYPE_CHECKING:
    import playwright.sync_api as web

_numbers = itertools.count(1)


def take_pictures(
    browser: web.Browser,
    snapshots: Sequence[Snapshot],
    times: Sequence[float],
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    look: Look,
) -> list[Image.Image]:
    """Return a picture for each of `times` [s]: of the last snapshot at or before this time.

    `clouds` has P_i of each pair of L_m, by the pair's name. With `look.page`, each picture has its
    own viewpoint; otherwise all have the same. Raises `BrowserError` if the browser's page does
    not connect, and `AssetError` if `RobotParts` raises it.
    """
    loop = RecordedLoop(snapshots)
    with ExitStack() as stack:
        server, page = stack.enter_context(offscreen.own_page(browser, look))
        if look.page:
            shared = stack.enter_context(closing(SharedState(loop, model, clouds)))
            offscreen.open_page(page, server)
            client = _client_of(server)
            page.evaluate(f"localStorage.setItem('{SEEN}', 'yes')")  # no tour in a picture
            shown = Page(client, shared, Notifier(server))
            offscreen.apply_look(shown.view, look)

            def draw(t: float) -> None:
                loop.go_to(t)
                shared.update()
                shown.camera.wanted = look.view
                for _ in range(2):  # a panel's widgets are created, and then filled
                    shown.draw(texts=True)

            draw(times[0])
            _settled(page, server)  # then the page has reported the free part of the scene
        else:
            scene = OffscreenScene(server, loop, model, clouds, look)
            scene.look([loop.go_to(t) for t in times])
            draw = scene.draw
            draw(times[0])
            offscreen.open_page(page, server)
            page.add_style_tag(content=offscreen.ONLY_SCENE)
        pictures = []
        for t in times:
            draw(t)
            pictures.append(_settled(page, server))
        return pictures


def strip(pictures: Sequence[Image.Image], times: Sequence[float], *, dark: bool) -> Image.Image:
    """Join pictures of equal size side by side, each with its time [s] in the upper left corner."""
    width, height = pictures[0].size
    timed = zip(pictures, times, strict=True)
    labelled = [offscreen.label(each.copy(), [f"t = {t:g} s"], dark=dark) for each, t in timed]
    whole = offscreen.side_by_side(labelled)
    for x in range(width, whole.width, width):
        ImageDraw.Draw(whole).line([(x, 0), (x, height)], fill=offscreen.INK[dark])
    return whole


def _client_of(server: viser.ViserServer) -> viser.ClientHandle:
    deadline = time.monotonic() + offscreen.TIMEOUT
    while not (clients := server.get_clients()):
        if time.monotonic() > deadline:
            raise BrowserError("the browser's page did not connect")
        time.sleep(0.02)
    return next(iter(clients.values()))


def _settled(page: web.Page, server: viser.ViserServer) -> Image.Image:
    """Wait for all messages; return the first picture that equals its predecessor, or the 12th."""
    n, ready = next(_numbers), "([name, n]) => dbbPage.arrived(name) === n"
    offscreen.send_barrier(server, n)
    values, timeout = [offscreen.BARRIER, n], 1000 * offscreen.TIMEOUT
    page.wait_for_function(ready, arg=values, timeout=timeout)
    page.evaluate("() => document.fonts.ready.then(() => 0)")
    page.evaluate("() => dbbPage.hold(false)")
    before = b""
    for _ in range(12):  # texts of the scene are drawn with a delay
        page.evaluate("n => dbbPage.render(n)", 2)
        picture = page.screenshot(animations="disabled")
        if picture == before:
            break
        before = picture
    page.evaluate("() => dbbPage.hold(true)")
    return Image.open(io.BytesIO(before)).convert("RGB")
