"""The dashboard's page in a headless Chromium: opens it, drags the gizmo, operates the widgets."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from app.dashboard.export import browser as browser_of_app
from app.dashboard.panels.help import SEEN
from app.errors import BrowserError

REQUIRED = "DBB_REQUIRE_BROWSER"
"""Environment variable that turns a missing browser from a skip into a failure."""

HELPERS = (Path(__file__).parent / "browser.js").read_text(encoding="utf-8")

MIN_DIFFERENCE = 24
"""Smallest change of a colour channel (0 to 255) that counts as a difference."""

HARMLESS = "Unable to preventDefault inside passive event listener invocation."
"""A message that Chromium logs when viser's own page starts a drag; it is not an error."""

_AT_REST = 0.25  # [s] without a change
_FRAMES = 8  # [-] number of frames without a change; a busy machine takes longer for them
_NO_TOUR = f"if (location.protocol === 'http:') localStorage.setItem('{SEEN}', 'yes');"
"""Marks the visitor as a returning one, so that the tour does not open."""


@contextmanager
def chromium() -> Iterator[Any]:
    """A headless browser with WebGL.

    Without a browser the test is skipped; if the environment variable `REQUIRED` is set, it fails.
    """
    with ExitStack() as stack:
        try:
            browser = stack.enter_context(browser_of_app.chromium())
        except BrowserError as error:
            if os.environ.get(REQUIRED):
                raise
            pytest.skip(str(error))
        yield browser


def wait_for(condition: Callable[[], Any], seconds: float = 60.0, what: str = "") -> None:
    """Wait until a condition is true; fail after `seconds` with a message that contains `what`."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"not within {seconds:g} s: {what or 'the condition'}"
        time.sleep(0.02)


def around(places: np.ndarray, radius: int, picture: np.ndarray) -> np.ndarray:
    """(H, W) bool mask of a picture's pixels within squares around `places` (K, 2) [px]."""
    near = np.zeros(picture.shape[:2], bool)
    for at in np.asarray(places).round().astype(int):
        (left, top), (right, bottom) = np.maximum(at - radius, 0), np.maximum(at + radius, 0)
        near[top:bottom, left:right] = True
    return near


class DashboardTab:
    """One browser tab with the dashboard.

    Attributes:
        page: playwright's page.
        errors: Error messages of the page's console, and uncaught exceptions.
    """

    def __init__(
        self,
        browser: Any,
        address: str,
        size: tuple[int, int] = (1280, 720),
        *,
        first_visit: bool = False,
        dpr: float | None = 0.5,
        draws: bool = False,
        honest: bool = False,
        touch: bool = False,
        query: str = "",
        fresh: bool = False,
    ) -> None:
        """Open the page and wait until the robot is drawn.

        Args:
            browser: Browser that opens the tab.
            address: URL of the server.
            size: [px] width and height of the window.
            first_visit: Whether the page shows its tour.
            draws: Whether the page renders all the time, as for a user, not only for pictures.
            honest: Whether the page can detect that it renders in software.
            touch: Whether the page has touch input.
            query: Further query parameters, each with a leading "&".
            fresh: Whether the page may start its demonstration, as before the first input.
            dpr: Rendered pixels per pixel of the window; fewer pixels render faster in software.
                None leaves the choice to the page.
        """
        scripts = ["self.dbbHonest = true;"] if honest else []
        context = browser_of_app.new_context(browser, size, *scripts, has_touch=touch)
        context.add_init_script(HELPERS)
        if not fresh:
            context.add_init_script("self.dbbTouched = true;")
        if not first_visit:
            context.add_init_script(_NO_TOUR)
        self.page = context.new_page()
        self._rested: Any = None  # boxes of the panels and position of the camera
        self._draws = draws
        self._fingers: Any = None
        self.errors: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._listen)
        drawn = "" if dpr is None else f"fixedDpr={dpr:g}"
        self.page.goto(f"{address}/?{drawn}{query}")
        self.wait_for_scene()

    def wait_for_scene(self) -> None:
        """Wait until the robot and all other scene nodes are drawn."""
        self._rested = None
        self.wait("() => dbbPage.ready()")
        self.wait("() => dbbPage.has('/robot') && dbbPage.has('/gizmo')")
        self.page.evaluate("on => dbbTest.draw(on)", self._draws)
        self.render(3)

    @contextmanager
    def drawing(self) -> Iterator[None]:
        """Render in the `with`; a page without `draws` only updates its scene at other times."""
        self.page.evaluate("() => dbbTest.draw(true)")
        yield
        if not self._draws:
            self.page.evaluate("() => dbbTest.draw(false)")

    def rest(self) -> None:
        """Wait until panels and camera are where they last rested, or stop moving.

        Both move after the first picture, as soon as the server knows the size of the scene. A
        click during this motion would miss its target. A motion that has not begun is not seen.
        """
        deadline, since = time.monotonic() + 60.0, time.monotonic()
        before, frames = self._rested, 0
        while True:
            assert time.monotonic() < deadline, "the camera does not stop moving"
            self.render(2)
            now = (self.canvas_box(), self.camera().round(3).tolist())
            frames += 2
            if now == self._rested:
                return
            if now != before:
                before, since, frames = now, time.monotonic(), 0
            elif frames >= _FRAMES and time.monotonic() - since > _AT_REST:
                self._rested = now
                return

    def _listen(self, message: Any) -> None:
        if message.type == "error" and message.text != HARMLESS:
            self.errors.append(message.text)

    def wait(self, script: str, argument: Any = None, timeout: float = 60.0) -> None:
        """Wait until a JavaScript function returns a true value, at most `timeout` seconds."""
        self.page.wait_for_function(script, arg=argument, timeout=1000 * timeout)

    def render(self, frames: int = 1) -> None:
        """Wait until the page has had `frames` frames; without `drawing` they render nothing."""
        self.page.evaluate("n => dbbPage.render(n)", frames)

    def picture(self, path: Path | None = None) -> np.ndarray:
        """(H, W, 3) uint8 picture of the visible page, also written to `path`."""
        from io import BytesIO

        from PIL import Image

        self.render(1)  # new objects move into place; a frame with rendering takes ten times longer
        with self.drawing():
            self.render(1)
        data = self.page.screenshot(path=path)
        return np.array(Image.open(BytesIO(data)).convert("RGB"))

    def picture_at_rest(self) -> np.ndarray:
        """(H, W, 3) uint8 picture once two in a row are equal; needs a paused simulation."""
        before, after = self.picture(), self.picture()
        deadline = time.monotonic() + 60.0
        while self.changed(before, after).any():
            assert time.monotonic() < deadline, "the picture does not stop changing"
            before, after = after, self.picture()
        return after

    def canvas_box(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom [px] of the scene between the panels."""
        return tuple(self.page.evaluate("() => dbbTest.box()"))

    def scene_mask(self) -> np.ndarray:
        """(H, W) bool mask of the pixels that show the scene without an overlay."""
        size = self.page.viewport_size
        mask = np.zeros((size["height"], size["width"]), bool)
        left, top, right, bottom = self.canvas_box()
        mask[max(top, 0) : bottom, max(left, 0) : right] = True
        for left, top, right, bottom in self.page.evaluate("() => dbbTest.windows()"):
            mask[max(top, 0) : bottom, max(left, 0) : right] = False
        return mask

    def changed(self, before: np.ndarray, after: np.ndarray) -> np.ndarray:
        """(H, W) bool mask of the scene's pixels that differ between two pictures."""
        difference = np.abs(before.astype(int) - after.astype(int)).max(axis=-1)
        return (difference > MIN_DIFFERENCE) & self.scene_mask()

    def wait_for_change(
        self,
        before: np.ndarray,
        least: int,
        places: np.ndarray | None = None,
        radius: int = 30,
        seconds: float = 60.0,
    ) -> np.ndarray:
        """Wait until at least `least` pixels of the scene differ from a picture.

        Args:
            before: Picture to compare with.
            least: Number of pixels that must differ.
            places: (K, 2) [px] centres of the squares that count; None: the whole scene.
            radius: [px] half the side of a square.
            seconds: Longest time to wait.

        Returns:
            The new picture.
        """
        near = np.ones(before.shape[:2], bool) if places is None else around(places, radius, before)
        deadline = time.monotonic() + seconds
        while True:
            after = self.picture()
            count = int((self.changed(before, after) & near).sum())
            if count >= least:
                return after
            assert time.monotonic() < deadline, f"only {count} pixels changed, not {least}"

    def wait_for_picture(self, wanted: np.ndarray, most: int, seconds: float = 60.0) -> None:
        """Wait until at most `most` pixels of the scene differ from the picture `wanted`."""
        deadline = time.monotonic() + seconds
        while (count := int(self.changed(wanted, self.picture()).sum())) > most:
            assert time.monotonic() < deadline, f"{count} pixels still differ"

    def camera(self) -> np.ndarray:
        """(3,) [m] position of the camera in the world frame."""
        return np.array(self.page.evaluate("() => dbbTest.camera()"))

    def is_shown(self, node: str) -> bool:
        """Whether a scene node and all above it are visible."""
        return self.page.evaluate("n => dbbTest.shown(n)", node)

    def text(self, node: str) -> str | None:
        """The text of a label in the scene, or None."""
        return self.page.evaluate("n => dbbTest.text(n)", node)

    def position(self, node: str) -> np.ndarray:
        """(3,) [m] position of a scene node in the world frame."""
        return np.array(self.page.evaluate("n => dbbTest.position(n)", node))

    def pixel(self, node: str, point: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
        """Wait for `rest`; (2,) [px] position on the page of a point in a node's frame."""
        self.rest()
        return np.array(self.page.evaluate("([n, p]) => dbbTest.pixel(n, p)", [node, list(point)]))

    def plot(self, title: str) -> np.ndarray:
        """(2 + lines, N) time, lines and cursor of an open plot, by its title."""
        found = self.page.evaluate("title => dbbTest.plot(title)", title)
        assert found is not None, f"no plot {title!r} in the open tabs"
        return np.array(found, dtype=float)

    def pixels(self, node: str, points: np.ndarray) -> np.ndarray:
        """Wait for `rest`; (K, 2) [px] positions on the page of points (K, 3) in a node's frame."""
        self.rest()
        found = self.page.evaluate("([n, p]) => dbbTest.pixels(n, p)", [node, points.tolist()])
        return np.array(found)

    def drag_gizmo(
        self,
        node: str,
        axis: int,
        metres: float,
        scale: float,
        steps: int = 5,
        *,
        drop: bool = True,
    ) -> None:
        """Drag an arrow of a gizmo along its axis with the mouse.

        Args:
            node: Scene node of the gizmo.
            axis: 0, 1 or 2.
            metres: [m] Length of the drag.
            scale: The gizmo's scale.
            steps: Number of mouse moves.
            drop: Whether to release the button at the end.

        Raises:
            LookupError: The arrow is hidden in this view.
        """
        grabbed = self.arrow(node, axis, scale)
        end = grabbed.copy()
        end[axis] += metres
        a, b = self.pixels(node, np.array([grabbed, end]))
        self.drag(a, b, steps, drop=drop)

    def arrow(self, node: str, axis: int, scale: float) -> np.ndarray:
        """Wait for `rest`; (3,) [m] a visible point of a gizmo's arrow, in the gizmo's frame.

        Raises:
            LookupError: The arrow is hidden in this view.
        """
        self.rest()
        found = self.page.evaluate("([n, a, s]) => dbbTest.arrow(n, a, s)", [node, axis, scale])
        if found is None:
            raise LookupError(f"arrow {axis} of {node} is hidden in this view")
        return np.array(found)

    def drag(self, a: np.ndarray, b: np.ndarray, steps: int = 5, *, drop: bool = True) -> None:
        """Drag from pixel `a` to pixel `b` with the mouse, and release it if `drop`."""
        self.page.mouse.move(*a)
        self.render(1)  # the scene must see the pointer above it first
        self.page.mouse.down()
        for i in range(1, steps + 1):
            self.page.mouse.move(*(a + (b - a) * i / steps))
            self.page.wait_for_timeout(60)  # [ms] the page sends at most 20 events a second
        if drop:
            self.page.mouse.up()

    def look_at(self, t: float) -> None:
        """Click on the timeline at a past time t [s]."""
        self.wait("t => dbb.seen().now > t + 0.2", t)
        self.page.mouse.click(*self.page.evaluate("t => dbb.pixel(t)", t))

    def fingers(self, kind: str, points: list[dict[str, float]]) -> None:
        """Send a "touchStart", "touchMove" or "touchEnd" event with fingers at `points` [px]."""
        self._fingers = self._fingers or self.page.context.new_cdp_session(self.page)
        self._fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    def touch(self, a: np.ndarray, b: np.ndarray, steps: int = 5) -> None:
        """Drag from pixel `a` to pixel `b` with one finger, and lift it."""

        def send(kind: str, *places: np.ndarray) -> None:
            self.fingers(kind, [{"x": float(x), "y": float(y)} for x, y in places])
            self.page.wait_for_timeout(60)  # [ms] the page sends at most 20 events a second

        send("touchStart", a)
        for i in range(1, steps + 1):
            send("touchMove", a + (b - a) * i / steps)
        send("touchEnd")

    def open_tab(self, name: str) -> None:
        """Open a tab of the panel."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def row(self, label: str) -> Any:
        """The row of the widget with this label."""
        text = re.compile(rf"^\s*{re.escape(label)}(\s•)?\s*$")  # • marks a changed value
        found = self.page.locator("label").filter(has_text=text).filter(visible=True)
        return found.locator("xpath=ancestor::div[contains(@class,'mantine-Flex-root')][1]")

    def set_slider(self, label: str, value: float) -> None:
        """Type a value into a slider's number box."""
        box = self.row(label).locator("input[type=text], input[inputmode]").last
        text = f"{value:g}"  # a trailing zero would look like unfinished input
        box.fill(text)
        if box.input_value() != text:  # after a change by the server the box accepts only the sign
            box.fill(text)
        box.press("Enter")

    def choose(self, label: str, option: str) -> None:
        """Select an option of a drop-down list, again if a busy page has not taken the click."""
        box = self.row(label).locator("input").first
        for _ in range(3):
            box.click()
            self.page.get_by_role("option", name=option, exact=True).click()
            with suppress(AssertionError):
                return wait_for(lambda: box.input_value() == option, 5.0)
        raise AssertionError(f"the list {label!r} does not show {option!r}")

    def check(self, label: str, *, on: bool = True) -> None:
        """Set the check box `label`: checked if `on`."""
        self.row(label).locator("input[type=checkbox]").set_checked(on)
        self.page.mouse.move(2, 2)  # no tooltip may cover the scene

    def click(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).first.click()

    def close(self) -> None:
        """Close the tab."""
        self.page.context.close()
