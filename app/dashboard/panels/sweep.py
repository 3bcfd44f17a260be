"""Folder "Sweep": the newest polar map of a folder, and a button that computes one."""

from __future__ import annotations

from pathlib import Path

import viser

from app.dashboard.job import Job, Progress
from app.dashboard.notifications import Notifier
from app.dashboard.panels.widgets import renew
from app.dashboard.shared import SharedState
from app.dashboard.work import sweep_to_files
from app.errors import OutputError
from app.studies.sweep.maps import newest_map, read_map
from app.studies.sweep.plan import SweepPlan

STEP = 15.0
"""[deg] between two directions of a map that is made here."""
DEFAULT_FOLDER = Path("out/sweep")
"""Where `dbb sweep` writes by default."""
_LOOK_EVERY = 20  # updates between two looks into the folder


class SweepPanel:
    """A map, a line of text, and the button that starts and stops a sweep."""

    def __init__(self, gui: viser.GuiApi, shared: SharedState, notifier: Notifier) -> None:
        """Build the folder, closed, in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            shared: Tells robot, controller, parameters and folder; its job is common to all.
            notifier: For what goes wrong.
        """
        self._gui, self._shared, self._notifier = gui, shared, notifier
        self._job, self._folder = shared.sweep_job, shared.sweeps
        self._waiting = False
        self._map: tuple[Path, int] | None = None
        self._updates = 0
        self._box = gui.add_folder("Sweep", expand_by_default=False)
        with self._box:
            self._text = gui.add_markdown("")
            self._button = gui.add_button(
                "Make a map",
                icon=viser.Icon.RADAR,
                hint=f"Hand paths towards the base every {STEP:g}°, with the controller and the "
                "parameters of now, in a process of low priority; takes some minutes.",
            )
        self._image: viser.GuiImageHandle | None = None
        self._button.on_click(notifier.guard(lambda _: self._start_or_stop()))  # type: ignore[arg-type]
        self.update()

    def update(self) -> None:
        """Renew text and map; called by the drawing thread."""
        progress = self._job.progress
        if (progress is not None) != self._waiting:  # any viewer may have begun or stopped it
            self._waiting = progress is not None
            self._button.label = "Stop" if self._waiting else "Make a map"
            if not self._waiting:
                self._updates = 0
                if self._job.problem:
                    self._notifier.warn(None, f"No map was made: {self._job.problem}")
        if self._updates % _LOOK_EVERY == 0:
            self._look()
        self._updates += 1
        renew(self._text, "content", self._status(progress))

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
        start_sweep(self._job, plan, self._folder)

    def _status(self, progress: Progress | None) -> str:
        if progress is not None:
            return f"Sweep under way: {100 * max(progress.share, 0.0):.0f} %"
        if self._map is None:
            return f"No map in `{self._folder}` yet."
        return f"`{self._map[0].name}`"

    def _look(self) -> None:
        """Show the folder's newest map, if it is another one than is shown."""
        path = newest_map(self._folder)
        if path is None:
            return
        found = path, path.stat().st_mtime_ns
        if found == self._map:
            return
        picture = read_map(path)  # whole: a press on it enlarges it
        if self._image is None:
            with self._box:
                self._image = self._gui.add_image(picture, format="png")
        else:
            self._image.image = picture
        self._map = found


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
