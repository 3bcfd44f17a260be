"""A headless Chromium for the tests: find it, open the page, drag the gizmo, work the widgets."""

from __future__ import annotations

import os
import re
import shutil
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

VARIABLE = "DBB_BROWSER"
"""Environment variable that names the browser to use."""
REQUIRED = "DBB_REQUIRE_BROWSER"
"""Environment variable that turns a missing browser from a skip into a failure."""

_NAMES = (
    "chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome",
    "microsoft-edge-stable", "brave-browser",
)  # fmt: skip
_APPLICATIONS = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
# Mesa draws two to three times faster in software than Chromium's own SwiftShader.
_MESA = ("--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist",
         "--disable-gpu-compositing")  # fmt: skip
_SWIFTSHADER = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
_QUIET = ("--disable-quic", "--no-first-run", "--disable-background-networking",
          "--disable-component-update", "--disable-sync", "--disable-dev-shm-usage")  # fmt: skip
_RENDERER = """() => {
  const gl = document.createElement('canvas').getContext('webgl2');
  if (!gl) return null;
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  return gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
}"""
_HELPERS = (Path(__file__).parent / "browser.js").read_text(encoding="utf-8")

GIZMO_REACH = 0.9  # [-] where along a gizmo's arrow to grab it: its head


def browser_path(bundled: str) -> str | None:
    """Path of a browser, or None if playwright's own at `bundled` is there and none is asked for.

    Raises:
        FileNotFoundError: There is none, or the environment variable names one that is not there.
    """
    if chosen := os.environ.get(VARIABLE):
        if not Path(chosen).exists():
            raise FileNotFoundError(f"{VARIABLE}={chosen} does not exist")
        return chosen
    for name in _NAMES:
        if found := shutil.which(name):
            return found
    if sys.platform == "darwin":
        for path in _APPLICATIONS:
            if Path(path).exists():
                return path
    if Path(bundled).exists():
        return None
    raise FileNotFoundError(
        f"no Chromium: install Debian's, run `playwright install chromium`, or set {VARIABLE}"
    )


@contextmanager
def chromium() -> Iterator[Any]:
    """A headless browser with WebGL; skips the test if there is none and none is required."""
    try:
        from playwright.sync_api import sync_playwright
    except ImportError as error:
        _missing(error)
    with sync_playwright() as playwright:
        try:
            path = browser_path(playwright.chromium.executable_path)
        except FileNotFoundError as error:
            _missing(error)
        browser = _launch(playwright, path)
        try:
            yield browser
        finally:
            browser.close()


def _missing(error: Exception) -> None:
    if os.environ.get(REQUIRED):
        raise error
    pytest.skip(str(error))


def _launch(playwright: Any, path: str | None) -> Any:
    for flags in (_MESA, _SWIFTSHADER):
        browser = playwright.chromium.launch(executable_path=path, args=[*flags, *_QUIET])
        page = browser.new_page()
        renderer = page.evaluate(_RENDERER)
        page.close()
        if renderer and (flags is _SWIFTSHADER or "SwiftShader" not in renderer):
            return browser
        browser.close()
    raise RuntimeError(f"{path or 'the bundled browser'} has no WebGL 2")


class DashboardTab:
    """One tab with the dashboard open.

    Attributes:
        page: playwright's page.
        errors: What the page has written to its console as errors, and uncaught exceptions.
    """

    def __init__(self, browser: Any, address: str, size: tuple[int, int] = (1600, 900)) -> None:
        """Open the page and wait until the first picture with the robot is drawn."""
        context = browser.new_context(
            viewport={"width": size[0], "height": size[1]}, reduced_motion="reduce"
        )
        context.add_init_script(_HELPERS)
        self.page = context.new_page()
        self.errors: list[str] = []
        self.page.on("pageerror", lambda error: self.errors.append(str(error)))
        self.page.on("console", self._listen)
        self.page.goto(f"{address}/?fixedDpr=1")
        self.wait("() => dbbTest.ready()")
        self.wait("() => dbbTest.node('/robot') && dbbTest.node('/hand')")
        self.render(3)

    def _listen(self, message: Any) -> None:
        if message.type == "error":
            self.errors.append(message.text)

    def wait(self, script: str, argument: Any = None, timeout: float = 60.0) -> None:
        """Wait until a function of JavaScript gives something true, at most `timeout` seconds."""
        self.page.wait_for_function(script, arg=argument, timeout=1000 * timeout)

    def render(self, frames: int = 1) -> None:
        """Let so many pictures be drawn, to their end."""
        self.page.evaluate("n => dbbTest.render(n)", frames)

    def picture(self, path: Path | None = None) -> np.ndarray:
        """(H, W, 3) uint8 what is to be seen, also written to `path`."""
        from io import BytesIO

        from PIL import Image

        self.render(2)
        data = self.page.screenshot(path=path)
        return np.array(Image.open(BytesIO(data)).convert("RGB"))

    def canvas_box(self) -> tuple[int, int, int, int]:
        """Left, top, right and bottom [px] of the scene between the panels."""
        return tuple(self.page.evaluate("() => dbbTest.box()"))

    def position(self, node: str) -> np.ndarray:
        """(3,) [m] where a scene node is, in the world."""
        return np.array(self.page.evaluate("n => dbbTest.position(n)", node))

    def pixel(self, node: str, point: tuple[float, float, float] = (0, 0, 0)) -> np.ndarray:
        """(2,) [px] where a point in a node's frame is on the page."""
        return np.array(self.page.evaluate("([n, p]) => dbbTest.pixel(n, p)", [node, list(point)]))

    def drag_gizmo(
        self,
        node: str,
        axis: int,
        metres: float,
        scale: float,
        steps: int = 8,
        *,
        drop: bool = True,
    ) -> None:
        """Drag an arrow of a gizmo along its axis by the mouse.

        Args:
            node: Scene node of the gizmo.
            axis: 0, 1 or 2.
            metres: How far.
            scale: The gizmo's scale.
            steps: In how many moves.
            drop: Whether to let go at the end.

        Raises:
            LookupError: The arrow is hidden in this view.
        """
        start = np.zeros(3)
        start[axis] = GIZMO_REACH * scale
        grabbed = self.page.evaluate("([n, a, s]) => dbbTest.arrow(n, a, s)", [node, axis, scale])
        if grabbed is None:
            raise LookupError(f"arrow {axis} of {node} is hidden in this view")
        end = np.array(grabbed)
        end[axis] += metres
        a, b = self.pixel(node, grabbed), self.pixel(node, tuple(end.tolist()))
        self.page.mouse.move(*a)
        self.render(1)  # the gizmo has to see the pointer above it first
        self.page.mouse.down()
        for i in range(1, steps + 1):
            self.page.mouse.move(*(a + (b - a) * i / steps))
            self.page.wait_for_timeout(60)  # [ms] the page sends at most 20 events a second
        if drop:
            self.page.mouse.up()

    def open_tab(self, name: str) -> None:
        """Choose a tab of the panel."""
        self.page.get_by_role("tab", name=name, exact=True).click()

    def row(self, label: str) -> Any:
        """The row of the widget with this label."""
        text = re.compile(rf"^\s*{re.escape(label)}(\s•)?\s*$")  # with the mark of what is changed
        found = self.page.locator("label").filter(has_text=text).filter(visible=True)
        return found.locator("xpath=ancestor::div[contains(@class,'mantine-Flex-root')][1]")

    def set_slider(self, label: str, value: float) -> None:
        """Type a value into a slider's number box."""
        box = self.row(label).locator("input[type=text], input[inputmode]").last
        box.fill(str(value))
        box.press("Enter")

    def choose(self, label: str, option: str) -> None:
        """Choose from a drop-down list."""
        self.row(label).locator("input").first.click()
        self.page.get_by_role("option", name=option, exact=True).click()

    def check(self, label: str, *, on: bool = True) -> None:
        """Set a check box."""
        self.row(label).locator("input[type=checkbox]").set_checked(on)

    def click(self, name: str) -> None:
        """Press a button."""
        self.page.get_by_role("button", name=name, exact=True).click()

    def close(self) -> None:
        """Close the tab, as a person does who leaves."""
        self.page.context.close()
