"""Tab "Save": creates a picture, files of an interval, and the case of the last scenario."""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from contextlib import suppress
from functools import partial
from io import BytesIO
from typing import Any, cast

import viser
from PIL import Image

from app.dashboard.export import Look, Side
from app.dashboard.export.offscreen import CODECS, RATE, captioned, write_film_of, write_replay
from app.dashboard.job import write_log, write_report
from app.dashboard.markup import small
from app.dashboard.panels import JobStatus, Moment, Panel, Viewer
from app.dashboard.scene.camera import PRESETS
from app.dashboard.scene.colours import BACKGROUND
from app.dashboard.viser_compat import scene_picture
from app.errors import BrowserError, CaseError
from app.jobs.process import Cancelled
from app.simulation.trace.trace import Trace
from app.strict import check_range
from app.system import temporary_folder

SIZES = {"width": (64, 3840, 1280), "height": (64, 2160, 720)}  # [px] least, largest and default
NamedFile = tuple[str, bytes]


class SavePanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, self._job = self._gui, viewer.files
        self._drawn = viewer.timeline.shown(), False  # snapshot; whether it is a posture only
        with gui.add_folder("Picture"):
            self._sizes = {
                name: gui.add_number(f"{name} [px]", first, min=least, max=most, step=1)
                for name, (least, most, first) in SIZES.items()
            }
            self._file("Picture (PNG)", viser.Icon.CAMERA, self._picture)
        with gui.add_folder("Marked interval, or the last minute"):
            plain, other = "For spreadsheets and pandas", "For dbb replay and dbb report too"
            for label, icon, name, write, hint in (
                ("Log (CSV)", viser.Icon.TABLE, "log.csv", write_log, plain),
                ("Log (Parquet)", viser.Icon.TABLE, "log.parquet", write_log, other),
                ("Report (HTML)", viser.Icon.MOVIE, "report.html", write_report, None),
                ("Replay (HTML)", viser.Icon.MOVIE, "replay.html", write_replay, None),
            ):
                self._file(label, icon, partial(self._of_interval, name, write), hint=hint)
            self._film_as = gui.add_dropdown("Film format", tuple(CODECS))
            self._film_from = gui.add_dropdown("Film camera", tuple(PRESETS))
            hint = f"{RATE:g} pictures per second, in the size above. Drawing usually takes"
            hint += " longer than the run: mark a short interval."
            self._file("Film", viser.Icon.VIDEO, self._film, hint=hint)
        with gui.add_folder("Last scenario"):
            hint = "The last scenario with its parameters, for dbb serve --case FILE"
            self.button("Case (JSON)", self._case, viser.Icon.FILE_DOWNLOAD, hint=hint)
        gui.add_html(small('<i class="dbb-saved">The tab Tune saves parameters.</i>'))  # page.css
        JobStatus(viewer, viewer.files)  # below the buttons, which thus do not move

    def update(self, moment: Moment) -> None:
        self._drawn = moment.shown, self._viewer.grip.reach is not None

    def _file(self, label: str, icon: Any, make: Callable[[], NamedFile], **look: Any) -> None:
        """Add a button that sends the viewer the file of `make`, which a separate thread calls."""
        client = self._viewer.client

        def send() -> None:
            with suppress(Cancelled):  # the viewer has cancelled it
                file = make()
                self._job.check()
                client.send_file_download(*file, save_immediately=True)

        attempt = partial(self._notifier.attempt, client, send)
        self.button(label, lambda _: self._job.start(label, "in progress", attempt), icon, **look)

    def _case(self, event: Any) -> None:
        case, last = self._shared.course.case, self._shared.course.last
        if case is None or last is None:
            raise CaseError("there is no case yet; play a scenario first")
        parameters = {path: last.config.value(path) for path in case.parameters}  # all parameters
        case = case.model_copy(update={"controller": last.controller, "parameters": parameters})
        name, data = f"{case.played}.json", case.text().encode()
        event.client.send_file_download(name, data, save_immediately=True)

    def _size(self) -> tuple[int, int]:
        for name, box in self._sizes.items():
            check_range(name, box.value, *SIZES[name][:2], "px")
        return int(self._sizes["width"].value), int(self._sizes["height"].value)

    def _picture(self) -> NamedFile:
        (shown, posed), look = self._drawn, Look(light=not self._viewer.view.dark)
        picture = captioned(self._scene(*self._size()), shown, look, named=True, posed=posed)
        return "scene.png", png(picture)

    def _scene(self, width: int, height: int) -> Image.Image:
        """Return the scene as the viewer's browser draws it in a size [px]."""
        executor = ThreadPoolExecutor(1)
        future = executor.submit(scene_picture, self._viewer.client, height, width, 30.0)  # [s]
        executor.shutdown(wait=False)
        while not wait([future], 0.1).done:  # [s]
            self._job.check()
        try:
            pixels = future.result()
        except (RuntimeError, TimeoutError) as error:
            raise BrowserError(f"the browser did not deliver a picture: {error}") from None
        if pixels.shape != (height, width, 4):
            raise BrowserError("the browser delivered a picture of another size")
        whole = Image.new("RGBA", (width, height), (*BACKGROUND[self._viewer.view.dark], 255))
        whole.alpha_composite(Image.fromarray(pixels, "RGBA"))  # with a transparent background
        return whole.convert("RGB")

    def _of_interval(self, name: str, write: Callable[..., None], *more: Any) -> NamedFile:
        """Return the file that `write(report, trace, path, *more)` creates in a separate process.

        The end of the process frees the memory of the libraries. For an interval that begins in a
        scenario, a report omits the time without a scenario, which would change the final values.
        """
        snapshots = self._viewer.timeline.interval()
        if write is write_report:
            led = [s for s in snapshots if s.scenario]
            snapshots = led if led[1:] and snapshots[0].scenario else snapshots
        trace = Trace.of_snapshots(self._viewer.shared.model, snapshots)
        with temporary_folder() as folder:
            path = folder / name
            self._job.run(write, trace, path, *more)
            return name, path.read_bytes()

    def _film(self) -> NamedFile:
        view = cast("Side", self._film_from.value)
        look = Look(*self._size(), view=view, light=not self._viewer.view.dark)
        return self._of_interval(f"film{self._film_as.value}", write_film_of, look)


def png(picture: Image.Image) -> bytes:
    file = BytesIO()
    picture.save(file, "PNG")
    return file.getvalue()
