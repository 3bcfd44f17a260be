"""Folder "Sweep": the newest map of a folder, and a button that makes one."""

from __future__ import annotations

from pathlib import Path

import viser

from app.dashboard.notifications import Notices
from app.dashboard.shared import Shared
from app.studies.sweep.maps import newest_map, read_map
from app.studies.sweep.plan import SweepPlan

STEP = 15.0
"""[deg] between two directions of a map that is made here."""
DEFAULT_FOLDER = Path("out/sweep")
"""Where `dbb sweep` writes if it is told nothing else."""
_LOOK_EVERY = 20  # updates between two looks into the folder


class SweepPanel:
    """A map, a line of text, and the button that starts and stops a sweep."""

    def __init__(self, gui: viser.GuiApi, shared: Shared, notices: Notices) -> None:
        """Build the folder, closed, in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            shared: Tells robot, controller, parameters and folder; its job is common to all.
            notices: For what goes wrong.
        """
        self._gui, self._shared, self._notices = gui, shared, notices
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
        self._button.on_click(notices.guard(lambda _: self._start_or_stop()))  # type: ignore[arg-type]
        self.update()

    def update(self) -> None:
        """Renew text and map; called by the drawing thread."""
        if not self._waiting and self._job.running:  # perhaps begun by another viewer
            self._waiting = True
            self._button.label = "Stop"
        if self._waiting and not self._job.running:
            self._waiting = False
            self._updates = 0
            self._button.label = "Make a map"
            problem = self._job.problem()
            if problem is not None:
                self._notices.warn(None, f"The sweep gave nothing: {problem}")
        if self._updates % _LOOK_EVERY == 0:
            self._look()
        self._updates += 1
        text = self._status()
        if self._text.content != text:
            self._text.content = text

    def _start_or_stop(self) -> None:
        if self._job.running:
            self._job.stop()
            self._waiting = False
            self._button.label = "Make a map"
            return
        shared = self._shared
        plan = SweepPlan(
            shared.model.description.name,
            (shared.loop.latest().controller,),
            step=STEP,
            config=shared.tuning.config,
        )
        self._job.start(plan, self._folder)
        self._waiting = True
        self._button.label = "Stop"

    def _status(self) -> str:
        if self._waiting:
            return f"Sweep under way: {100 * self._job.done:.0f} %"
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
