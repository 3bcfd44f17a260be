"""Parts that all panels of the page share: viewer, base class, and status of a job."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from html import escape
from typing import Any, NamedTuple

import viser

from app.dashboard.drag import Grip
from app.dashboard.job import Job
from app.dashboard.markup import small
from app.dashboard.notifications import Notifier
from app.dashboard.record import Timeline
from app.dashboard.scene.camera import Camera
from app.dashboard.shared import SharedState
from app.dashboard.verdict import Verdict
from app.dashboard.view import View
from app.dashboard.viser_compat import Channel, has_no_gpu
from app.errors import ConfigError
from app.simulation.loop.commands import STEPS, Pause, Play, Reset, StepOnce
from app.simulation.scenarios import scenario_of
from app.simulation.trace.snapshot import Snapshot

# Labels of actions, the same on all buttons and in the list of commands:
PAUSE, CONTINUE, RESTART, BACK = "Pause", "Continue", "Restart", "Back to the free start"
LIGHT = (
    "Your browser draws without a GPU, so the page uses low detail: fewer triangles and points, no "
    "shadows. To change this, use “Low detail” in the tab View."
)


class Viewer:
    """The parts of one viewer's page that its panels use."""

    def __init__(
        self,
        client: viser.ClientHandle,
        notifier: Notifier,
        shared: SharedState,
        before: Viewer | None = None,
    ) -> None:
        """Create the parts of a page; choices, camera and `files` are those of `before`, if any."""
        self.client, self.notifier, self.shared = client, notifier, shared
        self.panels: list[Panel] = []  # in the order of their creation
        plots = [plan.title for plan in shared.plans]
        self.view = (before.view.of_robot if before else View.first)(shared.mobile, plots)
        """The viewer's choices; callbacks assign to its fields."""
        if before is None and has_no_gpu(client):
            self.view.light = True
            notifier.tell(client, "Drawing", LIGHT)
        self.timeline = Timeline(shared.loop, shared.strip)
        self.channel = Channel(client, notifier)
        self.grip = Grip(shared.loop, notifier, client, self.timeline)
        self.camera = before.camera if before else Camera(client)
        self.camera.extent = shared.parts.extent
        self.channel.on("scene", self.camera.cover)
        self.files = before.files if before else Job()  # creates the viewer's files

    def look(self, preset: str) -> None:
        """Let the camera use a preset of `PRESETS`; "door" without a door raises `ConfigError`."""
        if preset == "door" and self.timeline.shown().door is None:
            raise ConfigError("this scenario has no door")
        self.camera.wanted = preset

    def play(self, scenario: str) -> None:
        """End a pause; play the scenario of this name; for "", restart without a scenario."""
        loop = self.shared.loop
        if scenario:
            loop.send(Play(scenario_of(self.shared.model.description, scenario)))
        else:
            loop.send(Reset())
            loop.send(Pause(False))

    def use_robot(self, name: str) -> None:
        """Start to replace the robot for all viewers, with the changed parameters if possible."""
        shared = self.shared
        shared.robot_switch.begin(name, shared.tuning.changes, shared.loop)

    def toggle_pause(self) -> None:
        self.shared.loop.send(Pause(not self.shared.loop.latest().paused))

    def step(self, seconds: float) -> None:
        """Move the shown instant by `seconds`, or advance a paused run from its newest instant."""
        newest = self.shared.loop.latest()
        if seconds > 0.0 and newest.paused and self.timeline.shown().t >= newest.t:
            self.timeline.go_live()
            self.shared.loop.send(StepOnce(min(seconds, STEPS[1])))
        else:
            self.timeline.step(seconds)


class Moment(NamedTuple):
    newest: Snapshot
    shown: Snapshot
    verdict: Verdict  # on the shown snapshot

    @property
    def live(self) -> bool:
        """Whether the present is shown; `shown` can be newer, because it is read after `newest`."""
        return self.shown.t >= self.newest.t


class Panel:
    """Widgets of one viewer; the constructor adds them to the GUI container that is open.

    The exceptions of a widget's callback are shown to the viewer who used the widget. `update`
    may assign all values each time, because viser sends only changes.
    """

    def __init__(self, viewer: Viewer) -> None:
        self._viewer, self._shared = viewer, viewer.shared
        self._gui, self._notifier = viewer.client.gui, viewer.notifier
        self.followed: dict[int, Any] = {}  # values that `follow` has assigned, by the widget's id
        viewer.panels.append(self)

    def update(self, moment: Moment) -> None:
        """Show the moment; the drawing thread calls this method."""

    def on_update(self, handle: Any, act: Callable[[Any], None]) -> Any:
        """Call `act` if a person changes a widget, not if the program does; return the widget."""

        def updated(event: viser.GuiEvent) -> None:
            if event.client is not None:
                act(event)

        handle.on_update(self._notifier.guard(updated))
        return handle

    def button(
        self, label: str, act: Callable[[Any], None], icon: Any = None, **look: Any
    ) -> viser.GuiButtonHandle:
        """Add a button; `look` has further arguments of `GuiApi.add_button`."""
        handle = self._gui.add_button(label, icon=icon, **look)
        handle.on_click(self._notifier.guard(act))
        return handle

    def choice(
        self, label: str, titles: Mapping[str, str], act: Callable[[str], None], hint: str
    ) -> Any:
        """Add a list of the values of `titles`; `act` gets the key of the chosen title."""
        names = {title: name for name, title in titles.items()}
        handle = self._gui.add_dropdown(label, tuple(names), hint=hint)
        return self.on_update(handle, lambda event: act(names[event.target.value]))

    def buttons(
        self, label: str, acts: Mapping[str, Callable[[], None]], hint: str | None = None
    ) -> None:
        """Add a row of buttons; `acts` has the action of each button by the button's text."""
        handle = self._gui.add_button_group(label, tuple(acts), hint=hint)
        handle.on_click(self._notifier.guard(lambda event: acts[event.target.value]()))

    def upload(self, label: str, act: Callable[[Any], None], **look: Any) -> Any:
        """Add a button for uploads; after each upload, `act` runs in a separate thread."""
        handle = self._gui.add_upload_button(label, icon=viser.Icon.UPLOAD, **look)
        handle.on_upload(lambda event: self._notifier.attempt(event.client, lambda: act(event)))
        return handle

    def follow(self, handle: Any, value: Any) -> None:
        """Assign a shared value to a widget if this value has changed since the last call.

        A repeated assignment would replace a viewer's choice on its way to the simulation.
        """
        if self.followed.get(id(handle)) != value:
            self.followed[id(handle)] = handle.value = value


class JobStatus(Panel):
    """Progress of `job`, with a button that cancels it; while no job runs, the HTML of `idle`."""

    def __init__(self, viewer: Viewer, job: Job, idle: Callable[[], str] = lambda: "") -> None:
        super().__init__(viewer)
        self._job, self._idle = job, idle
        self.text = self._gui.add_html("", visible=False)
        self._bar = self._gui.add_progress_bar(0.0, animated=True, visible=False)
        look: Any = {"color": "gray", "visible": False}
        self._cancel = self.button("Cancel", lambda _: job.cancel(), viser.Icon.X, **look)

    def update(self, moment: Moment) -> None:
        progress, text = self._job.progress, self._idle()
        if progress is not None:
            seconds = time.monotonic() - progress.began
            share = f", {100 * progress.share:.0f} %" if progress.share >= 0.0 else ""
            far = "cancelling" if self._job.cancelled else f"{progress.text}{share}"
            text = f"<b>{escape(progress.title)}</b>: {escape(far)}, {seconds:.0f} s"
            self._bar.value = round(100.0 * max(progress.share, 0.0), 1)
        self.text.content = small(text) if text else ""
        self.text.visible = bool(text)
        self._bar.visible = progress is not None and progress.share >= 0.0
        self._cancel.visible = progress is not None
        self._cancel.disabled = self._job.cancelled
