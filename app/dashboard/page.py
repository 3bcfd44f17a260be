"""Page of one viewer: its panels, layers, camera and point in time."""

from collections.abc import Callable
from functools import partial
from typing import Any

import viser

from app.dashboard.drag import DragHandles
from app.dashboard.markup import banner, plain
from app.dashboard.notifications import Notifier
from app.dashboard.panels import BACK, CONTINUE, PAUSE, RESTART, JobStatus, Moment, Viewer
from app.dashboard.panels.explorer import ExplorerPanel
from app.dashboard.panels.help import TEXT, Guide
from app.dashboard.panels.plots import Plots
from app.dashboard.panels.robot import RobotPanel
from app.dashboard.panels.run import ComparePanel, LabPanel, RunPanel
from app.dashboard.panels.save import SavePanel
from app.dashboard.panels.timeline import TimelinePanel
from app.dashboard.panels.tuning import TuningPanel
from app.dashboard.panels.view import ViewPanel
from app.dashboard.panels.why import WhyPanel
from app.dashboard.scene.camera import PRESETS
from app.dashboard.scene.colours import set_theme
from app.dashboard.scene.legend import key_html, legend_html
from app.dashboard.scene.scene import Scene
from app.dashboard.shared import SharedState
from app.simulation.loop.commands import Restart
from app.simulation.scenarios import SCENARIOS
from app.simulation.trace.snapshot import Snapshot

PRODUCT = "dbb self-collision avoidance"
PATIENCE = 1.0  # [s] timeout of the simulation and of the viewer's browser
_MAIN_WIDTH = 350  # [px] of the right column


class Page(Viewer):
    """Panels and scene of one viewer; create it within `atomic`, so that it appears as a whole."""

    def __init__(
        self,
        client: viser.ClientHandle,
        shared: SharedState,
        notifier: Notifier,
        before: "Page | None" = None,
    ) -> None:
        """Create the page of a client; `before` is the client's closed page of another robot."""
        super().__init__(client, notifier, shared, before)
        self.channel.on("escape", self._escape)
        self.channel.on("nudge", lambda *ahead: self.grip.nudge(ahead, self._present()))
        self.channel.on("drop", self.grip.release_keys)
        self.closed = False
        newest = shared.loop.latest()
        self._refusal, self._newest = newest.refusal, newest  # this refusal precedes the page
        self._look: tuple[bool, ...] = ()  # theme and detail of the page
        client.gui.set_panel_label(shared.parts.title)
        with client.atomic():
            self._build_left()
            self._build_right()
            TimelinePanel(self)
        self.guide = Guide(self, before.guide.state if before else "")
        self.channel.begin()
        self.channel.tell("title", f"{PRODUCT} · {shared.parts.title}")
        self.channel.tell("hints", self._plots.hints)
        self._scene = Scene(client.scene, shared, self.view)
        border = self._border = self._scene.border
        self.channel.on("pointer", lambda *at: setattr(border, "pointer", at[:2] if at[1:] else ()))
        kinematics = shared.parts.kinematics.model
        arm = {kinematics.getJointId(name): name for name in shared.model.description.arm.joints}
        self.handles = DragHandles(client.scene, self._scene.robot, self.grip, arm)
        for label, key, act in self._shortcuts():
            command = client.gui.add_command(label, hotkey=key)
            command.on_trigger(notifier.guard(lambda _, act=act: act()))
        self.camera.begin(self.timeline.shown())
        self.draw(texts=True)

    def _present(self) -> Snapshot:
        """Return the newest snapshot; while joint sliders are in use, the response to them."""
        return self.explorer_panel.shown(newest := self.shared.loop.latest(), newest)

    def draw(self, *, texts: bool) -> None:
        """Draw the snapshot that the viewer sees; update panels, plots, labels only if `texts`."""
        newest, shown = self.shared.loop.latest(), self.timeline.shown()
        if not newest.follows(self._newest) and self.grip.holds_anything:
            self.grip.release()  # the simulation has restarted and has dropped all pulls
            if self.grip.reach is None:
                self.notifier.tell(self.client, "Pull ended", "A new run has started.")
        self._newest = newest
        if self.grip.holds_anything:
            self.timeline.go_live()  # the past cannot be changed
        shown = self.explorer_panel.shown(newest, shown)
        if self._border.update(self.view, shown.border):
            self._why.legend.content = legend_html(self._border.legends)
        with self.client.atomic():
            if self._look != (self.view.dark, self.view.light):
                self._look = self.view.dark, self.view.light
                set_theme(self.client.gui, dark=self.view.dark)
                self.channel.tell("light", self.view.light)
            verdict = self._scene.draw(shown, texts=texts, lens=self.camera.lens)
            self.handles.update(shown)
            self.camera.settle(shown, busy=self.grip.holds_anything)
            moment = Moment(newest, shown, verdict)
            if texts and moment.live:
                self.camera.find(shown, on=self.view.follow, busy=self.grip.holds_anything)
            # With ghosts the camera does not follow: the motion of each robot is visible.
            self.camera.follow(shown.base_pose[:2], on=self.view.follow and not shown.ghosts)
            if texts:
                self._renew(moment)

    def _renew(self, moment: Moment) -> None:
        before, self._refusal = self._refusal, moment.newest.refusal
        refused = self._refusal != before
        for panel in self.panels:
            if refused:  # the panels show the state again, not the refused choice
                panel.followed.clear()
            panel.update(moment)
        self._key.content = key_html(moment.shown.border.d_b)
        if refused and self._refusal is not None:
            self.notifier.warn(self.client, self._refusal.message)
        _show(self._hung, hung_html(self.shared.loop.silence))

    @property
    def untouched(self) -> bool:
        """Whether the page is open, and its browser reports that the viewer has not touched it."""
        return "untouched" in self.channel.seen and not self.closed

    def fail(self, title: str, error: BaseException) -> None:
        """Show an error at the top of the right column until the page is replaced."""
        _show(self._banner, banner("error", title, plain(error)))

    def with_robot(self, shared: SharedState) -> "Page":
        """Return a page of another robot in place of this page, or this page if it is closed."""
        if self.closed:
            return self
        self.close()
        with self.client.atomic():
            self.client.scene.reset()
            self.client.gui.reset()
            return Page(self.client, shared, self.notifier, self)

    def close(self) -> None:
        """Release the viewer's pull, end the demonstration if it runs, and stop drawing."""
        self.closed = True
        self.grip.release()
        self.guide.leave_demonstration()

    def end(self) -> None:
        """Close the page and its guide, and cancel the job that creates the viewer's files."""
        self.close()
        self.guide.go("")
        self.files.cancel()

    def _build_left(self) -> None:
        gui = self.client.gui
        panel = gui.add_panel()
        with panel.add_tab("Why", viser.Icon.BULB):
            self._why = WhyPanel(self)
        self._plots = Plots(self, panel.add_tab("Plots", viser.Icon.CHART_LINE))
        with panel.add_tab("Compare", viser.Icon.USERS):
            ComparePanel(self)
        with panel.add_tab("Key", viser.Icon.COLOR_SWATCH):
            self._key = gui.add_html("")
        panel.dock_left()
        panel.set_width(330)

    def _build_right(self) -> None:
        gui = self.client.gui
        gui.main_panel.dock_right()
        gui.main_panel.set_width(_MAIN_WIDTH)
        self.channel.on("wide", lambda _: gui.main_panel.set_width(_MAIN_WIDTH))
        self._banner = gui.add_html("", visible=False)
        self.change = JobStatus(self, self.shared.robot_switch)
        self._hung = gui.add_html("", visible=False)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            RunPanel(self)
        with tabs.add_tab("Lab"):
            LabPanel(self)
            self.explorer_panel = ExplorerPanel(self)
        with tabs.add_tab("View"):
            ViewPanel(self)
        with tabs.add_tab("Tune"):
            self.tuning_panel = TuningPanel(self)
        self.robot_panel: RobotPanel | None = None
        if self.shared.robot_switch.possible:
            with tabs.add_tab("Robot"):
                self.robot_panel = RobotPanel(self)
        with tabs.add_tab("Save"):
            SavePanel(self)
        with tabs.add_tab("Help"):
            keyed = ((label, key) for label, key, _ in self._shortcuts() if key is not None)
            keys = ", ".join(f"`{key}` {label.lower()}" for label, key in keyed)
            gui.add_markdown(TEXT.format(keys=keys))

    def _shortcuts(self) -> list[tuple[str, Any, Callable[[], None]]]:
        views = ((f"Camera: {name}", str(i), name) for i, name in enumerate(PRESETS, 1))
        return [
            (f"{PAUSE} or {CONTINUE.lower()}", "space", self.toggle_pause),
            (RESTART, "R", lambda: self.shared.loop.send(Restart())),
            ("Back 1 s", "B", lambda: self.step(-1.0)),
            ("Forward 1 s", "F", lambda: self.step(1.0)),
            ("Back to now", "N", self.timeline.go_live),
            ("Dark or light theme", "L", self.view.toggle_dark),
            *((label, key, partial(self.look, name)) for label, key, name in views),
            (BACK, None, partial(self.play, "")),
            *((f"Play {name}", None, partial(self.play, name)) for name in SCENARIOS),
            ("Tour", "H", lambda: self.guide.go("tour 1")),
        ]

    def _escape(self) -> None:
        self.guide.go("")
        self.notifier.clear(self.client)


def hung_html(silence: float) -> str:
    """Return an error message as HTML if `silence` [s] is at least `PATIENCE`, otherwise ""."""
    text = f"No response for {silence:.0f} s. Commands wait until it continues."
    return banner("error", "The simulation does not respond", text) if silence >= PATIENCE else ""


def _show(handle: viser.GuiHtmlHandle, html: str) -> None:
    handle.content, handle.visible = html, bool(html)
