"""Headless Chromium with WebGL: search, start and end."""

from __future__ import annotations

import logging
import os
import shutil
import sys
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from app.errors import BrowserError
from app.system import temporary_folder

if TYPE_CHECKING:
    from playwright.sync_api import Browser, BrowserContext, Playwright, ViewportSize

VARIABLE = "DBB_BROWSER"  # environment variable with the path of the browser to use

_CHROMIUMS = "chromium", "chromium-browser", "google-chrome-stable", "google-chrome", "chrome"
_RELATIVES = "microsoft-edge-stable", "brave-browser"
_APPLICATIONS = (
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
)
# Mesa draws faster in software than Chromium's own SwiftShader.
_EGL = "--use-gl=angle", "--use-angle=gl-egl", "--ignore-gpu-blocklist", "--disable-gpu-compositing"
_SWIFTSHADER = "--use-angle=swiftshader", "--enable-unsafe-swiftshader"
_QUIET = "--disable-background-networking", "--disable-component-update", "--disable-sync"
_SIMPLE = "--disable-quic", "--no-first-run", "--disable-dev-shm-usage"
_RENDERER = """() => {
  const gl = document.createElement('canvas').getContext('webgl2');
  if (!gl) return null;
  const info = gl.getExtension('WEBGL_debug_renderer_info');
  return gl.getParameter(info ? info.UNMASKED_RENDERER_WEBGL : gl.RENDERER);
}"""
_HELPERS = Path(__file__).with_suffix(".js").read_text(encoding="utf-8")


def browser_path(bundled: str) -> str | None:
    """Return the path of the browser to use, or None for playwright's own, which is at `bundled`.

    The path in `DBB_BROWSER` comes first, then an installed browser, then playwright's own. Raises
    `BrowserError` if no browser is found, or if the path in `DBB_BROWSER` does not exist.
    """
    if chosen := os.environ.get(VARIABLE):
        if not Path(chosen).exists():
            raise BrowserError(f"{VARIABLE}={chosen} does not exist")
        return chosen
    applications = _APPLICATIONS if sys.platform == "darwin" else ()
    names = *_CHROMIUMS, *_RELATIVES
    for path in (*map(shutil.which, names), *filter(os.path.exists, applications)):
        if path:
            return path
    if Path(bundled).exists():
        return None
    ways = "`make browser` provides one, or `playwright install chromium`, or Debian's "
    ways += f"`apt-get install chromium`; or set {VARIABLE} to the path of a browser"
    raise BrowserError(f"no Chromium to draw with: {ways}")


@contextmanager
def chromium() -> Iterator[Browser]:
    """Run a headless browser with WebGL 2, and close it at the end.

    Raises `BrowserError` if there is no such browser, if it does not start, or if it fails in use.
    """
    # Imported here, because most users of a scene need no browser.
    from playwright.sync_api import Error, sync_playwright

    try:
        with ExitStack() as stack:
            # A signal to this command also ends browser and driver, before they delete their files.
            folder = str(stack.enter_context(temporary_folder()))
            with _temporary_folder(folder):
                playwright = stack.enter_context(sync_playwright())
            path = browser_path(playwright.chromium.executable_path)
            browser = _launch(playwright, path, folder)
            try:
                yield browser
            except Error as error:
                reason = str(error).strip().splitlines()[0]
                raise BrowserError(f"the browser has failed: {reason}") from None
            finally:
                with suppress(Error):  # it has ended already
                    browser.close()
    except KeyboardInterrupt:
        # The signal also ends playwright's driver; asyncio would log each interrupted call.
        logging.getLogger("asyncio").setLevel(logging.CRITICAL)
        raise


def new_context(
    browser: Browser, size: tuple[int, int], *scripts: str, **more: Any
) -> BrowserContext:
    """Create a browser context for pages of `size` (width, height) [px].

    Each page first runs `scripts`, then `browser.js`, which adds the object `dbbPage`. `more` has
    further arguments of playwright's `new_context`.
    """
    viewport: ViewportSize = {"width": size[0], "height": size[1]}
    context = browser.new_context(viewport=viewport, reduced_motion="reduce", **more)
    for script in (*scripts, _HELPERS):
        context.add_init_script(script)
    return context


@contextmanager
def _temporary_folder(folder: str) -> Iterator[None]:
    """Let programs that start in this context put temporary files into `folder`, by `TMPDIR`."""
    before = os.environ.get("TMPDIR")
    os.environ["TMPDIR"] = folder
    try:
        yield
    finally:
        del os.environ["TMPDIR"]
        if before is not None:
            os.environ["TMPDIR"] = before


def _launch(playwright: Playwright, path: str | None, folder: str) -> Browser:
    from playwright.sync_api import Error

    name = path or "playwright's own browser"
    for flags in (_EGL, _SWIFTSHADER):
        try:
            browser = playwright.chromium.launch(
                executable_path=path,
                args=[*flags, *_QUIET, *_SIMPLE],
                env={**os.environ, "TMPDIR": folder, "HOME": folder},  # HOME may be missing
            )
        except Error as error:
            reason = str(error).strip().splitlines()[0]
            raise BrowserError(f"{name} does not start: {reason}") from None
        page = browser.new_page()
        renderer = page.evaluate(_RENDERER)
        page.close()
        if renderer and (flags is _SWIFTSHADER or "SwiftShader" not in renderer):
            return browser
        browser.close()
    raise BrowserError(f"{name} has no WebGL 2")
