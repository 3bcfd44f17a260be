"""Tab "Save" and folder "Sweep": files that are made beside the simulation."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from functools import partial
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import viser
from PIL import Image

from app.dashboard.export.film import CODECS
from app.dashboard.export.offscreen import Look
from app.dashboard.job import (
    FILM_RATE,
    Job,
    Progress,
    sweep_to_files,
    write_film_of,
    write_replay,
    write_report,
)
from app.dashboard.markup import small
from app.dashboard.notifications import Notifier
from app.dashboard.panels import Panel
from app.dashboard.panels.timeline import Timeline
from app.dashboard.scene.camera import PRESETS
from app.dashboard.scene.colours import BACKGROUND
from app.dashboard.scene.scene import SceneData
from app.dashboard.shared import SharedState
from app.dashboard.view import View, Viewpoint
from app.errors import DbbError, LogError, OutputError
from app.jobs.process import Cancelled, Report
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.trace import Trace
from app.studies.sweep.plan import SweepPlan
from app.studies.sweep.sweep import newest_map, read_map

SIZES = {"width": (64, 3840, 1280), "height": (64, 2160, 720)}
"""[px] least, most and first size of a picture."""
STEP = 15.0
"""[deg] between two directions of a map that is made here."""
SWEEPS = Path("out/sweep")
"""Where `dbb sweep` writes by default."""
_LOOK_EVERY = 20  # updates between two looks into the folder of maps
_PATIENCE = 30.0  # [s] for a browser to draw a picture

PagePicture = Callable[[SceneData, list[Snapshot], Viewpoint, tuple[int, int]], Image.Image]
"""Draws the whole page at the last of the snapshots, so many [px] wide and high."""


class SavePanel(Panel):
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
        """Build the tab.

        Args:
            gui: Of the viewer.
            shared: Robot and simulation.
            timeline: Whose marked interval is saved.
            view: Whether the page is dark, for the ground of pictures.
            job: Makes the viewer's files, one after the other.
            notifier: For what goes wrong.
            page_picture: Draws whole pages; without, there is no button for it.
        """
        super().__init__(gui, notifier)
        self._shared, self._timeline, self._view, self._job = shared, timeline, view, job
        self._progress = gui.add_html("", visible=False)
        self._cancel = self.button("Cancel", lambda _: job.cancel(), viser.Icon.X, visible=False)
        self._began = 0.0
        with gui.add_folder("Picture"):
            self._sizes = {
                name: gui.add_number(f"{name} [px]", first, min=least, max=most, step=1)
                for name, (least, most, first) in SIZES.items()
            }
            self._file("Picture (PNG)", viser.Icon.CAMERA, "scene.png", self._scene)
            if page_picture is not None:
                make = partial(self._whole_page, page_picture)
                self._file("Whole page (PNG)", viser.Icon.BROWSER, "page.png", make)
        with gui.add_folder("The marked interval, or all that is kept"):
            for label, name in (("Log (CSV)", "log.csv"), ("Log (Parquet)", "log.parquet")):
                self._file(label, viser.Icon.TABLE, name, partial(self._log, name))
            for label, name, write in (
                ("Report (HTML)", "report.html", write_report),
                ("Replay (HTML)", "replay.html", write_replay),
            ):
                self._file(label, viser.Icon.MOVIE, name, partial(self._page, write))
            self._film_as = gui.add_dropdown("Film as", tuple(CODECS))
            self._film_from = gui.add_dropdown("Film from", tuple(PRESETS))
            self._file(
                "Film",
                viser.Icon.VIDEO,
                lambda: f"film{self._film_as.value}",
                self._film,
                hint=f"{FILM_RATE:g} pictures a second of the interval, as large as a picture; "
                "each takes about a quarter of a second to draw: mark a short interval",
            )
        gui.add_markdown("Parameters are saved in the tab *Tune*.")

    def update(self) -> None:
        """Show how far the work is; called by the drawing thread."""
        progress = self._job.progress
        self._progress.visible = self._cancel.visible = progress is not None
        if progress is None:
            self._began = 0.0
            return
        self._began = self._began or time.monotonic()
        self._progress.content = progress_html(progress, time.monotonic() - self._began)

    def _file(
        self,
        label: str,
        icon: Any,
        name: str | Callable[[], str],
        make: Callable[[Any], bytes],
        **look: Any,
    ) -> None:
        """Add a button that makes a file beside the simulation and sends it."""

        def pressed(event: viser.GuiEvent) -> None:
            if (client := event.client) is not None:
                self._job.start(label, "is being made", lambda: work(client))

        def work(client: viser.ClientHandle) -> None:
            note = client.add_notification(label, "is being made …", loading=True)
            try:
                told = name if isinstance(name, str) else name()
                data = make(client)
                self._job.check()
                client.send_file_download(told, data, save_immediately=True)
            except Cancelled:
                pass  # who pressed knows
            except DbbError as error:
                self._notifier.warn(client, str(error))
            except Exception as error:  # the person who pressed must learn of it
                self._notifier.fail(client, error)
            finally:
                note.remove()

        self.button(label, pressed, icon, **look)

    def _size(self) -> tuple[int, int]:
        """[px] the wanted width and height."""
        return (
            checked_size("width", self._sizes["width"].value),
            checked_size("height", self._sizes["height"].value),
        )

    def _scene(self, client: viser.ClientHandle) -> bytes:
        width, height = self._size()
        try:
            pixels = client.get_render(height, width, transport_format="png", timeout=_PATIENCE)
        except (RuntimeError, TimeoutError) as error:
            raise LogError(f"the browser gave no picture: {error}") from None
        return png(on_ground(pixels, BACKGROUND[self._view.dark]))

    def _whole_page(self, page_picture: PagePicture, client: viser.ClientHandle) -> bytes:
        shown = self._timeline.shown()
        viewpoint = Viewpoint(self._view, client.camera.position, client.camera.look_at)
        past = [s for s in self._shared.loop.history(-1.0) if s.t <= shown.t] or [shown]
        return png(page_picture(self._shared, past, viewpoint, self._size()))

    def _log(self, name: str, _: viser.ClientHandle) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            return self._write(Path(folder) / name).read_bytes()

    def _page(self, write: Callable[[Report, Path, Path], None], _: viser.ClientHandle) -> bytes:
        """A page of the log, written in a process of its own: it takes seconds of work."""
        with tempfile.TemporaryDirectory() as folder:
            log, page = self._write(Path(folder) / "log.parquet"), Path(folder) / "page.html"
            self._job.run(write, log, page)
            return page.read_bytes()

    def _film(self, _: viser.ClientHandle) -> bytes:
        """A film of the log, in a process of its own, which has a browser."""
        look = Look(*self._size(), view=self._film_from.value, dark=self._view.dark)
        with tempfile.TemporaryDirectory() as folder:
            log = self._write(Path(folder) / "log.parquet")
            film = Path(folder) / f"film{self._film_as.value}"
            self._job.run(write_film_of, log, film, look)
            return film.read_bytes()

    def _write(self, path: Path) -> Path:
        snapshots = self._timeline.interval()
        scenario = snapshots[0].scenario
        Trace.of_snapshots(self._shared.model, snapshots, scenario=scenario).write(path)
        return path


class SweepPanel(Panel):
    """The newest polar map of a folder, and the button that starts and stops a sweep."""

    def __init__(self, gui: viser.GuiApi, shared: SharedState, notifier: Notifier) -> None:
        """Build the folder, closed; the job of `shared` is common to all viewers."""
        super().__init__(gui, notifier)
        self._shared, self._job = shared, shared.sweep_job
        self._waiting = False
        self._map: tuple[Path, int] | None = None
        self._updates = 0
        self._box = gui.add_folder("Sweep", expand_by_default=False)
        with self._box:
            self._text = gui.add_markdown("")
            self._button = self.button(
                "Make a map",
                lambda _: self._start_or_stop(),
                viser.Icon.RADAR,
                hint=f"Hand paths towards the base every {STEP:g}°, with the controller and the "
                "parameters of now, in a process of low priority; takes some minutes.",
            )
        self._image: viser.GuiImageHandle | None = None
        self.update()

    def update(self) -> None:
        """Renew text and map; called by the drawing thread."""
        progress = self._job.progress
        if self._waiting and progress is None:  # any viewer may have begun or stopped it
            self._updates = 0
            if self._job.problem:
                self._notifier.warn(None, f"No map was made: {self._job.problem}")
        self._waiting = progress is not None
        self._button.label = "Stop" if self._waiting else "Make a map"
        if self._updates % _LOOK_EVERY == 0:
            self._look()
        self._updates += 1
        if self._text.content != (text := self._status(progress)):
            self._text.content = text  # viser sends markdown even if it is the same

    def _start_or_stop(self) -> None:
        if self._job.progress is not None:
            self._job.cancel()
            return
        shared = self._shared
        plan = SweepPlan(
            shared.model.description.name,
            (shared.loop.latest().controller,),
            step=STEP,
            config=shared.tuning.config,
        )
        start_sweep(self._job, plan, shared.sweeps)

    def _status(self, progress: Progress | None) -> str:
        if progress is not None:
            return f"Sweep under way: {100 * max(progress.share, 0.0):.0f} %"
        if self._map is None:
            return f"No map in `{self._shared.sweeps}` yet."
        return f"`{self._map[0].name}`"

    def _look(self) -> None:
        """Show the folder's newest map, if it is another one than is shown."""
        path = newest_map(self._shared.sweeps)
        if path is None or (found := (path, path.stat().st_mtime_ns)) == self._map:
            return
        picture = read_map(path)  # whole: a press on it enlarges it
        if self._image is None:
            with self._box:
                self._image = self._gui.add_image(picture, format="png")
        else:
            self._image.image = picture
        self._map = found


def progress_html(progress: Progress, seconds: float) -> str:
    """How far a piece of work is, and since when [s]."""
    share = f", {100 * progress.share:.0f} %" if progress.share >= 0.0 else ""
    width = 100 * progress.share if progress.share >= 0.0 else 100
    return small(
        f"<b>{progress.title}</b>: {progress.text}{share}, {seconds:.0f} s"
        '<div style="background:rgba(128,138,150,.22);border-radius:2px"><div style="'
        f'width:{width:.0f}%;height:.5em;background:#2684d6;border-radius:2px"></div></div>'
    )


def start_sweep(job: Job, plan: SweepPlan, folder: Path) -> None:
    """Begin a sweep; its files are written into the folder when all of it is done.

    Raises:
        OutputError: The folder cannot be made.
        ConfigError: A sweep is under way.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror}") from None
    job.start("sweep", "begins", lambda: job.run(sweep_to_files, plan, folder))


def checked_size(name: str, value: float) -> int:
    """[px] a size of a picture, by its key of `SIZES`.

    Raises:
        LogError: It is out of range.
    """
    least, most, _ = SIZES[name]
    if not least <= value <= most:
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
