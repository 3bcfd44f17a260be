"""Tab "Save": pictures, logs, reports and replays to download."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import viser
from PIL import Image

from app.dashboard.job import Job
from app.dashboard.notifications import Notifier
from app.dashboard.panels.timeline import Timeline
from app.dashboard.scene.scene import SceneData
from app.dashboard.scene.theme import BACKGROUND
from app.dashboard.shared import SharedState
from app.dashboard.view import View, Viewpoint
from app.dashboard.work import write_replay, write_report
from app.errors import DbbError, LogError
from app.jobs.process import Report
from app.simulation.trace.snapshot import Snapshot

if TYPE_CHECKING:
    from app.simulation.trace.log_meta import LogMeta

SIZES = {"width": (64, 3840, 1280), "height": (64, 2160, 720)}
"""[px] least, most and first size of a picture."""
_PATIENCE = 30.0  # [s] for a browser to draw a picture
_LOGS = {"Log (CSV)": "log.csv", "Log (Parquet)": "log.parquet"}
_PAGES = {
    "Report (HTML)": ("report.html", write_report),
    "Replay (HTML)": ("replay.html", write_replay),
}

PagePicture = Callable[[SceneData, list[Snapshot], Viewpoint, tuple[int, int]], Image.Image]
"""Draws the whole page at the last of the snapshots, so many [px] wide and high."""


class SavePanel:
    """Buttons, each of which ends in a download of the viewer who pressed it."""

    def __init__(
        self,
        gui: viser.GuiApi,
        shared: SharedState,
        timeline: Timeline,
        view: View,
        job: Job,
        notifier: Notifier,
        page_picture: PagePicture | None = None,
    ) -> None:
        """Build the tab in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            shared: Robot and simulation.
            timeline: Whose marked interval is saved.
            view: Whether the page is dark, for the ground of pictures.
            job: Makes the viewer's files, one after the other.
            notifier: For what goes wrong.
            page_picture: Draws whole pages; without, there is no button for it.
        """
        self._shared, self._timeline, self._view, self._notifier = shared, timeline, view, notifier
        self._job = job
        with gui.add_folder("Picture"):
            self._sizes = {
                name: gui.add_number(f"{name} [px]", first, min=least, max=most, step=1)
                for name, (least, most, first) in SIZES.items()
            }
            self._button(gui, "Picture (PNG)", viser.Icon.CAMERA, self._scene)
            if page_picture is not None:
                self._button(
                    gui, "Whole page (PNG)", viser.Icon.BROWSER, self._whole_page(page_picture)
                )
        with gui.add_folder("The marked interval, or all that is kept"):
            for label, name in _LOGS.items():
                self._button(gui, label, viser.Icon.TABLE, self._log(name))
            for label, (name, write) in _PAGES.items():
                self._button(gui, label, viser.Icon.MOVIE, self._page(name, write))
        gui.add_markdown("Parameters are saved in the tab *Tune*.")

    def _button(
        self, gui: viser.GuiApi, label: str, icon: Any, make: Callable[[Any], tuple[str, bytes]]
    ) -> None:
        """A button that makes a file beside the simulation and sends it."""

        def pressed(event: viser.GuiEvent) -> None:
            if (client := event.client) is not None:
                self._job.start(label, "is being made", lambda: work(client))

        def work(client: viser.ClientHandle) -> None:
            note = client.add_notification(label, "is being made …", loading=True)
            try:
                name, content = make(client)
                client.send_file_download(name, content, save_immediately=True)
            except DbbError as error:
                self._notifier.warn(client, str(error))
            except Exception as error:  # the person who pressed must learn of it
                self._notifier.fail(client, error)
            finally:
                note.remove()

        gui.add_button(label, icon=icon).on_click(self._notifier.guard(pressed))  # type: ignore[arg-type]

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

    def _whole_page(self, page_picture: PagePicture) -> Callable[[Any], tuple[str, bytes]]:
        def make(client: viser.ClientHandle) -> tuple[str, bytes]:
            shown = self._timeline.shown()
            viewpoint = Viewpoint(self._view, client.camera.position, client.camera.look_at)
            past = [s for s in self._shared.loop.history(-1.0) if s.t <= shown.t] or [shown]
            return "page.png", png(page_picture(self._shared, past, viewpoint, self._size()))

        return make

    def _log(self, name: str) -> Callable[[Any], tuple[str, bytes]]:
        def make(_: Any) -> tuple[str, bytes]:
            with tempfile.TemporaryDirectory() as folder:
                return name, self._write(Path(folder) / name).read_bytes()

        return make

    def _page(
        self, name: str, write: Callable[[Report, Path, Path], None]
    ) -> Callable[[Any], tuple[str, bytes]]:
        """A page of the log, written in a process of its own: it takes seconds of work."""

        def make(_: Any) -> tuple[str, bytes]:
            with tempfile.TemporaryDirectory() as folder:
                log, page = self._write(Path(folder) / "log.parquet"), Path(folder) / name
                self._job.run(write, log, page)
                return name, page.read_bytes()

        return make

    def _write(self, path: Path) -> Path:
        from app.simulation.trace.log import (
            write_log,  # its tables take time that the first page waits
        )

        snapshots = self._timeline.interval()
        write_log(path, snapshots, self._meta(snapshots[0]))
        return path

    def _meta(self, first: Snapshot) -> LogMeta:
        from app.simulation.trace.log_meta import LogMeta

        return LogMeta.of(self._shared.model, first, scenario=first.scenario)


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
