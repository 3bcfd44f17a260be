"""Tab "Save": pictures, logs, reports and replays, made beside the simulation and downloaded."""

from __future__ import annotations

import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import viser
from PIL import Image

from app.dashboard.notifications import Notices
from app.dashboard.scene.theme import BACKGROUND
from app.dashboard.shared import Shared
from app.dashboard.timeline import Timeline
from app.dashboard.view import View
from app.errors import DbbError, LogError
from app.simulation.trace.trace import Trace

SIZES = {"width": (64, 3840, 1280), "height": (64, 2160, 720)}
"""[px] least, most and first size of a picture."""
_PATIENCE = 30.0  # [s] for a browser to draw a picture
_LONGEST = 600.0  # [s] for a report or a replay
_LOGS = {"Log (CSV)": "log.csv", "Log (Parquet)": "log.parquet"}
_PAGES = {"Report (HTML)": ("report", "report.html"), "Replay (HTML)": ("replay", "replay.html")}


class SavePanel:
    """Buttons, each of which ends in a download of the viewer who pressed it."""

    def __init__(
        self, gui: viser.GuiApi, shared: Shared, timeline: Timeline, view: View, notices: Notices
    ) -> None:
        """Build the tab in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            shared: Robot and simulation.
            timeline: Whose marked interval is saved.
            view: Whether the page is dark, for the ground of pictures.
            notices: For what goes wrong.
        """
        self._shared, self._timeline, self._view, self._notices = shared, timeline, view, notices
        self._busy = threading.Lock()
        with gui.add_folder("Picture"):
            self._sizes = {
                name: gui.add_number(f"{name} [px]", first, min=least, max=most, step=1)
                for name, (least, most, first) in SIZES.items()
            }
            self._button(gui, "Picture (PNG)", viser.Icon.CAMERA, self._scene)
            self._button(gui, "Whole page (PNG)", viser.Icon.BROWSER, self._whole_page)
        with gui.add_folder("The marked interval, or all that is kept"):
            for label, name in _LOGS.items():
                self._button(gui, label, viser.Icon.TABLE, self._log(name))
            for label, (command, name) in _PAGES.items():
                self._button(gui, label, viser.Icon.MOVIE, self._page(command, name))
        gui.add_markdown("Parameters are saved in the tab *Tune*.")

    def _button(
        self, gui: viser.GuiApi, label: str, icon: Any, make: Callable[[Any], tuple[str, bytes]]
    ) -> None:
        """A button that makes a file in a thread of its own and sends it."""

        def pressed(event: viser.GuiEvent) -> None:
            if not self._busy.acquire(blocking=False):
                raise LogError("one file after the other: the last one is still being made")
            threading.Thread(target=work, args=(event.client,), daemon=True).start()

        def work(client: viser.ClientHandle) -> None:
            note = client.add_notification(label, "is being made …", loading=True)
            try:
                name, content = make(client)
                client.send_file_download(name, content, save_immediately=True)
            except DbbError as error:
                self._notices.warn(client, str(error))
            except Exception as error:  # the person who pressed must learn of it
                self._notices.fail(client, error)
            finally:
                self._busy.release()
                note.remove()

        gui.add_button(label, icon=icon).on_click(self._notices.guard(pressed))  # type: ignore[arg-type]

    def _size(self) -> tuple[int, int]:
        """[px] the wanted width and height."""
        return (
            checked_size("width", self._sizes["width"].value),
            checked_size("height", self._sizes["height"].value),
        )

    def _scene(self, client: viser.ClientHandle) -> tuple[str, bytes]:
        width, height = self._size()
        try:
            pixels = client.get_render(height, width, transport_format="png", timeout=_PATIENCE)
        except (RuntimeError, TimeoutError) as error:
            raise LogError(f"the browser gave no picture: {error}") from None
        return "scene.png", png(on_ground(pixels, BACKGROUND[self._view.dark]))

    def _whole_page(self, client: viser.ClientHandle) -> tuple[str, bytes]:
        """The page as this viewer has it, but for the open tabs, drawn by a browser of our own."""
        # Imported here: they draw pages such as the one that holds this panel.
        from app.dashboard.export.browser import chromium
        from app.dashboard.export.screenshot import Look, Seat, take_pictures

        width, height = self._size()
        shown, shared = self._timeline.shown(), self._shared
        seat = Seat(self._view, client.camera.position, client.camera.look_at)
        past = [s for s in shared.loop.history(-1.0) if s.t <= shown.t] or [shown]
        with chromium() as browser:
            [picture] = take_pictures(
                browser,
                past,
                [shown.t],
                shared.model,
                shared.clouds,
                Look(width, height, dark=self._view.dark, page=True),
                seat,
            )
        return "page.png", png(picture)

    def _log(self, name: str) -> Callable[[Any], tuple[str, bytes]]:
        def make(_: Any) -> tuple[str, bytes]:
            with tempfile.TemporaryDirectory() as folder:
                return name, self._write(Path(folder) / name).read_bytes()

        return make

    def _page(self, command: str, name: str) -> Callable[[Any], tuple[str, bytes]]:
        """A page that `dbb` makes of the log in a process of its own: it takes seconds of work."""

        def make(_: Any) -> tuple[str, bytes]:
            with tempfile.TemporaryDirectory() as folder:
                log, page = self._write(Path(folder) / "log.parquet"), Path(folder) / name
                run_dbb(command, str(log), "--out", str(page))
                return name, page.read_bytes()

        return make

    def _write(self, path: Path) -> Path:
        snapshots = self._timeline.interval()
        scenario = snapshots[0].scenario
        Trace.of_snapshots(self._shared.model, snapshots, scenario=scenario).write(path)
        return path


def checked_size(name: str, value: object) -> int:
    """[px] a size of a picture.

    Args:
        name: A key of `SIZES`.
        value: What the browser has sent.

    Raises:
        LogError: It is no number, or out of range.
    """
    least, most, _ = SIZES[name]
    if not isinstance(value, (int, float)) or not least <= value <= most:
        raise LogError(f"the picture's {name} must be {least} to {most} px, was {value!r}")
    return int(value)


def on_ground(pixels: np.ndarray, ground: tuple[int, int, int]) -> Image.Image:
    """A picture (H, W, 4) uint8, partly transparent, on a ground of one colour."""
    picture = Image.fromarray(pixels, "RGBA")
    whole = Image.new("RGBA", picture.size, (*ground, 255))
    whole.alpha_composite(picture)
    return whole.convert("RGB")


def png(picture: Image.Image) -> bytes:
    """The file of a picture."""
    file = BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()


def run_dbb(*args: str) -> None:
    """Run a command of this program in a process of low priority.

    Raises:
        LogError: With the last line that it wrote, if it fails.
    """
    command = ["nice", "-n", "10", sys.executable, "-m", "app", *args]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=_LONGEST)
    except subprocess.TimeoutExpired:
        raise LogError(f"dbb {args[0]} took longer than {_LONGEST:.0f} s") from None
    if done.returncode != 0:
        lines = done.stderr.strip().splitlines() or ["no message"]
        raise LogError(f"dbb {args[0]}: {lines[-1]}")
