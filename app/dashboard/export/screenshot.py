"""Screenshots without a display: the scene alone, or the whole dashboard."""

from __future__ import annotations

import io
import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import viser
from PIL import Image, ImageDraw, ImageFont

from app.border.cloud import Cloud
from app.dashboard.export.browser import chromium, new_context
from app.dashboard.export.offscreen import (
    RecordedLoop,
    address_of,
    choose_layer,
    offscreen_scene,
    own_server,
)
from app.dashboard.notifications import Notifier
from app.dashboard.page import Page
from app.dashboard.panels.help import SEEN
from app.dashboard.panels.sweep import DEFAULT_FOLDER
from app.dashboard.scene.scene import SceneData
from app.dashboard.shared import SharedState
from app.dashboard.view import Viewpoint
from app.errors import BrowserError
from app.robot.model import RobotModel
from app.simulation.trace.snapshot import Snapshot

if TYPE_CHECKING:
    import playwright.sync_api as web

_BARRIER = "/sent"
"""Scene node whose place tells the page how much has been sent."""
_ONLY_SCENE = "body * { visibility: hidden !important; } canvas { visibility: visible !important; }"
_TIMEOUT = 60.0  # [s] for a page to open or a picture to arrive
_MOST_LOOKS = 12  # pictures until two in a row are the same
_BAR = 0.045  # [-] height of a strip's label, of the picture's height
_numbers = itertools.count(1)


class Look(NamedTuple):
    """What a picture shows.

    Attributes:
        width, height: [px].
        layer: What the border is coloured by, one of `app.dashboard.export.offscreen.LAYERS`.
        view: Where from, a key of `app.dashboard.scene.camera.PRESETS`.
        dark: A dark ground, else a light one.
        page: The whole dashboard, else the scene alone.
    """

    width: int = 1280
    height: int = 720
    layer: str = "score"
    view: str = "iso"
    dark: bool = True
    page: bool = False


def take_pictures(
    browser: web.Browser,
    snapshots: Sequence[Snapshot],
    times: Sequence[float],
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    look: Look,
    viewpoint: Viewpoint | None = None,
) -> list[Image.Image]:
    """Pictures at some times of a run, all from the same place.

    Args:
        browser: Its page is opened and closed here.
        snapshots: In order of time; trails and plots show them up to each picture's time.
        times: [s] of the pictures; each shows the last snapshot that is not later.
        model: The robot.
        clouds: P_i of every pair of L_m, by the pair's name.
        look: What they show.
        viewpoint: Of the viewer whose page is pictured, in place of `look`'s layer and view.

    Raises:
        BrowserError: Its page does not open.
        AssetError: A mesh of the robot is not there.
    """
    loop = RecordedLoop(snapshots)
    context = new_context(browser, (look.width, look.height))
    try:
        page = context.new_page()
        if look.page:
            return _of_page(page, loop, times, model, clouds, look, viewpoint)
        return _of_scene(page, loop, times, model, clouds, look)
    finally:
        context.close()


def page_picture(
    data: SceneData, snapshots: Sequence[Snapshot], viewpoint: Viewpoint, size: tuple[int, int]
) -> Image.Image:
    """The whole page as a viewer has it, but for the open tabs, drawn by a browser of its own.

    Args:
        data: Robot and borders.
        snapshots: In order of time; the last one is shown.
        viewpoint: Of the viewer.
        size: [px] width and height.

    Raises:
        BrowserError: There is no browser, or its page does not open.
    """
    look = Look(*size, dark=viewpoint.view.dark, page=True)
    times = [snapshots[-1].t]
    with chromium() as browser:
        [picture] = take_pictures(
            browser, snapshots, times, data.model, data.clouds, look, viewpoint
        )
    return picture


def strip(pictures: Sequence[Image.Image], times: Sequence[float], *, dark: bool) -> Image.Image:
    """Pictures of one size side by side, each with its time [s] in its upper left corner."""
    width, height = pictures[0].size
    whole = Image.new("RGB", (width * len(pictures), height))
    draw = ImageDraw.Draw(whole)
    size = max(round(_BAR * height), 12)
    font = ImageFont.load_default(size)
    ink, ground = ((240, 240, 245), (20, 20, 22)) if dark else ((25, 30, 38), (255, 255, 255))
    for k, (picture, t) in enumerate(zip(pictures, times, strict=True)):
        whole.paste(picture, (k * width, 0))
        at = (k * width + size, size // 2)
        draw.text(
            at,
            f"t = {t:g} s",
            fill=ink,
            font=font,
            stroke_width=max(size // 12, 1),
            stroke_fill=ground,
        )
        if k:
            draw.line([(k * width, 0), (k * width, height)], fill=ink, width=1)
    return whole


def _of_scene(
    page: web.Page,
    loop: RecordedLoop,
    times: Sequence[float],
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    look: Look,
) -> list[Image.Image]:
    with offscreen_scene(loop, model, clouds, layer=look.layer, dark=look.dark) as made:
        made.look(look.view, _middle([loop.go_to(t) for t in times]))
        made.draw(times[0])
        _open(page, made.server)
        page.add_style_tag(content=_ONLY_SCENE)
        pictures = []
        for t in times:
            made.draw(t)
            pictures.append(_settled(page, made.server))
        return pictures


def _of_page(
    page: web.Page,
    loop: RecordedLoop,
    times: Sequence[float],
    model: RobotModel,
    clouds: Mapping[str, Cloud],
    look: Look,
    viewpoint: Viewpoint | None,
) -> list[Image.Image]:
    with own_server() as server:
        shared = SharedState(loop, model, clouds, sweeps=DEFAULT_FOLDER)
        try:
            _open(page, server)
            client = _client_of(server)
            client.local_storage.set_item(SEEN, "yes")  # no tour for who only takes a picture
            shown = Page(client, shared, Notifier(server))
            shown.view.dark = look.dark
            choose_layer(shown.view, look.layer)
            if viewpoint is not None:
                shown.view.take_over(viewpoint.view)
            pictures = []
            loop.go_to(times[0])
            shared.update()
            shown.draw(texts=True)
            _settled(page, server)  # from now on it is known what the panels leave of the scene
            for t in times:
                loop.go_to(t)
                shared.update()
                if viewpoint is None:
                    shown.look(look.view)
                else:
                    shown.sit(viewpoint.eye, viewpoint.target)
                for _ in range(2):  # what the first drawing of a panel makes, the second fills
                    shown.draw(texts=True)
                pictures.append(_settled(page, server))
            return pictures
        finally:
            shared.close()


def _open(page: web.Page, server: viser.ViserServer) -> None:
    """Open the page of a server and wait until it can draw."""
    from playwright.sync_api import Error

    try:
        page.goto(f"{address_of(server)}/?fixedDpr=1")
        page.wait_for_function("() => dbbPage.ready()", timeout=1000 * _TIMEOUT)
    except Error as error:
        raise BrowserError(f"the page does not open: {str(error).splitlines()[0]}") from None


def _client_of(server: viser.ViserServer) -> viser.ClientHandle:
    """The one viewer of a server."""
    deadline = time.monotonic() + _TIMEOUT
    while not (clients := server.get_clients()):
        if time.monotonic() > deadline:
            raise BrowserError("the browser's page does not connect")
        time.sleep(0.02)
    return next(iter(clients.values()))


def _settled(page: web.Page, server: viser.ViserServer) -> Image.Image:
    """The picture when all that was sent is drawn, and nothing changes any more."""
    n = next(_numbers)
    server.scene.add_frame(_BARRIER, show_axes=False, position=(float(n), 0.0, 0.0))
    server.flush()
    page.wait_for_function(
        "([name, n]) => dbbPage.arrived(name) === n", arg=[_BARRIER, n], timeout=1000 * _TIMEOUT
    )
    page.evaluate("() => document.fonts.ready.then(() => 0)")
    before = b""
    for _ in range(_MOST_LOOKS):  # texts of the scene are made after they have arrived
        page.evaluate("n => dbbPage.render(n)", 2)
        picture = page.screenshot(animations="disabled")
        if picture == before:
            break
        before = picture
    return Image.open(io.BytesIO(before)).convert("RGB")


def _middle(snapshots: Sequence[Snapshot]) -> Snapshot:
    """A snapshot with the mean place of base and hand of some."""
    base = np.mean([s.base_pose for s in snapshots], axis=0)
    return replace(snapshots[0], base_pose=base, p_ee=np.mean([s.p_ee for s in snapshots], axis=0))
