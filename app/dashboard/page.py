"""One viewer's page: its own panels, layers, camera and place in time."""

from __future__ import annotations

from collections.abc import Sequence
from time import monotonic
from typing import TypeVar

import numpy as np
import viser

from app.dashboard.drag import DragHandles, Grip
from app.dashboard.job import Job
from app.dashboard.markup import banner, plain
from app.dashboard.notifications import Notifier
from app.dashboard.panels import JobStatus, Moment, Panel, Viewer
from app.dashboard.panels.challenge import ChallengePanel
from app.dashboard.panels.explorer import ExplorerPanel
from app.dashboard.panels.help import Act, Shortcut, Tour, add_help, add_shortcuts
from app.dashboard.panels.plots import Plots
from app.dashboard.panels.robot import RobotPanel
from app.dashboard.panels.run import FREE, ComparePanel, RunPanel
from app.dashboard.panels.save import SavePanel, SweepPanel
from app.dashboard.panels.share import Link, SharePanel
from app.dashboard.panels.timeline import Timeline, TimelinePanel
from app.dashboard.panels.tuning import MAIN, TuningPanel
from app.dashboard.panels.view import ViewPanel
from app.dashboard.panels.why import strip_html, why_html
from app.dashboard.scene.camera import PRESETS, Camera
from app.dashboard.scene.colours import set_theme
from app.dashboard.scene.legend import key_html, legend_html
from app.dashboard.scene.scene import Scene
from app.dashboard.shared import SharedState
from app.dashboard.verdict import judge
from app.dashboard.view import PagePicture, View
from app.dashboard.viser_compat import Channel, has_no_gpu
from app.errors import DbbError
from app.robot.description import RobotDescription
from app.simulation.loop.commands import Compare, Play, Reset, Restart
from app.simulation.loop.loop import LoopHandle
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.trace.snapshot import Snapshot

PanelType = TypeVar("PanelType", bound=Panel)

_WENT = 0.03  # [m] of the base, which everybody sees
PANEL_WIDTH = 330  # [px] of each of the two columns
LIGHT = (
    "Your browser draws without a GPU, so it gets a light drawing: fewer triangles and points, no "
    "shadows. The tab View has the other one."
)
PATIENCE = 1.0  # [s] without a sign of life of the simulation or of the viewer's browser
SHOWN = "guiding-lateral"
"""The scenario that shows what the base does: it is pulled at along its wheels' axis."""
UNTOUCHED = 20.0  # [s] for which nobody touches a page before it shows something of itself
REST = 3.0  # [s] between two times


class Page:
    """One viewer's panels, layers, camera and place in time.

    Built and drawn by one thread only; callbacks assign to its view or send commands. Build it
    within the client's `atomic`, so that nobody sees it unfinished.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        shared: SharedState,
        notifier: Notifier,
        page_picture: PagePicture | None = None,
        before: Page | None = None,
    ) -> None:
        """Fill the page of a client; `before` is its page of another robot, now empty."""
        self._client, self._shared, self._notifier = client, shared, notifier
        plots = [plan.title for plan in shared.plans]
        view = View.first(shared.mobile, plots)
        if before:
            view = before.view.of_robot(shared.mobile, plots)
        elif has_no_gpu(client):
            view.light = True
            notifier.tell(client, "Drawing", LIGHT)
        self.view, self.timeline = view, Timeline(shared.loop, shared.strip)
        self.channel = Channel(client, notifier)
        self.channel.on("escape", self._escape)
        self.grip = Grip(shared.loop, notifier, client.client_id)
        self._camera = before.viewer.camera if before else Camera(client)
        self._camera.fit(shared.parts.extent)
        own = self.channel, self.view, self.timeline, self.grip, self._camera
        files = before.viewer.files if before else Job()
        self.viewer = Viewer(client, notifier, shared, *own, files, page_picture)
        self.channel.on("scene", self._camera.cover)
        self.closed = False
        newest = shared.loop.latest()
        self._refusal, self._newest = newest.refusal, newest  # of before this viewer came
        self._dark, self._light = self.view.dark, self.view.light
        set_theme(client.gui, dark=self.view.dark)
        client.gui.set_panel_label(shared.parts.title)
        self._panels: list[Panel] = []
        with client.atomic():
            self._build_left()
            self._build_right()
            self._add(TimelinePanel(self.viewer))
        self.tour = self._add(before.tour if before else Tour(self.viewer))
        self.tour.lead(self.channel, self._acts(), self._places)
        self.channel.begin()
        self.channel.tell("title", shared.parts.title)
        self.channel.tell("light", self._light)
        self.channel.tell("hints", self._plots.hints)
        self._scene = Scene(client.scene, shared, self.view)
        kinematics = shared.parts.kinematics.model
        arm = {kinematics.getJointId(name): name for name in shared.model.description.arm.joints}
        self.hand = DragHandles(client.scene, self._scene.robot, self.grip, notifier, arm)
        add_shortcuts(client.gui, self._shortcuts(), notifier)
        self._camera.begin(self.timeline.shown())
        self.share_panel.resume(before.share_panel.waiting if before else Link())
        self.draw(texts=True)

    def draw(self, *, texts: bool) -> None:
        """Draw the instant at which the viewer is; panels, plots and labels only if `texts`."""
        newest, shown = self._shared.loop.latest(), self.timeline.shown()
        if not newest.follows(self._newest):
            self.grip.release()  # time has begun anew, and the simulation has forgotten all pulls
        self._newest = newest
        if self.grip.holds_anything and not self.timeline.live:
            self.timeline.go_live()  # nobody pulls in the past
        shown = self.explorer_panel.shown(newest, shown)
        if self._scene.select_border(shown):
            spoken = self._shared.spoken
            self._legend.content = legend_html(
                [each._replace(pair=spoken[each.pair]) for each in self._scene.legends]
            )
        with self._client.atomic():
            if self._dark != self.view.dark:
                self._dark = self.view.dark
                set_theme(self._client.gui, dark=self._dark)
            self._scene.draw(shown, texts=texts, lens=self._camera.lens)
            self.hand.update(shown)
            self._camera.settle(shown, busy=self.grip.holds_anything)
            if texts and self.timeline.live:
                self._camera.find(shown, on=self.view.follow, busy=self.grip.holds_anything)
            self._camera.follow(shown.base_pose[:2], on=self.view.follow)
            moment = Moment(newest, shown, judge(shown, self._shared.spoken)) if texts else None
            if moment is not None:
                self._renew(moment)
        if moment is not None:
            self._renew_beside(moment)

    def _renew(self, moment: Moment) -> None:
        """Renew what is read of the instant, which comes with its picture."""
        newest, shown, verdict = moment
        for panel in self._panels:
            if panel.of_instant:
                panel.update(moment)
        self._why.content = why_html(shown, verdict)
        self._strip.content = strip_html(shown, verdict)
        self._key.content = key_html(newest.config.border.d_b)
        self._show_refusal(newest)

    def _renew_beside(self, moment: Moment) -> None:
        """Renew the rest, which may take a while."""
        _show(self._hung, hung_html(self._shared.loop.silence))
        self._change.show("")
        if self._light != self.view.light:
            self._light = self.view.light
            self.channel.tell("light", self._light)
        for panel in self._panels:
            if not panel.of_instant:
                panel.update(moment)

    @property
    def untouched(self) -> bool:
        """Whether the viewer's browser has said that nobody has touched this page yet."""
        return "untouched" in self.channel.seen and not self.closed

    def fail(self, title: str, error: BaseException) -> None:
        """Show, for good, that the simulation or the drawing has ended."""
        _show(self._banner, banner("error", title, plain(error)))

    def with_robot(self, shared: SharedState) -> Page:
        """The page of the same viewer with another robot, in place of this one."""
        if self.closed:
            return self
        self.close()
        with self._client.atomic():
            self._client.scene.reset()
            self._client.gui.reset()
            return Page(self._client, shared, self._notifier, self.viewer.page_picture, self)

    def close(self) -> None:
        """Let go of what the viewer held; nothing is drawn any more."""
        self.closed = True
        self.grip.release()

    def end(self) -> None:
        """Close it, and end what is saved for the viewer, who is gone."""
        self.close()
        self.viewer.files.cancel()

    def _add(self, panel: PanelType) -> PanelType:
        """A panel that is renewed with the others."""
        self._panels.append(panel)
        return panel

    def _build_left(self) -> None:
        gui = self._client.gui
        panel = gui.add_panel()
        why = panel.add_tab("Why", viser.Icon.BULB)
        with why:
            self._why = gui.add_html("")
            self._legend = gui.add_html(legend_html([]))
        with panel.add_tab("Plots", viser.Icon.CHART_LINE):
            self._plots = self._add(Plots(self.viewer))
        compare = panel.add_tab("Compare", viser.Icon.USERS)
        with compare:
            self._add(ComparePanel(self.viewer))
        with panel.add_tab("Key", viser.Icon.COLOR_SWATCH):
            self._key = gui.add_html("")
        self._places = {"Why": why, "Compare": compare}
        panel.dock_left()
        panel.set_width(PANEL_WIDTH)

    def _build_right(self) -> None:
        gui, viewer = self._client.gui, self.viewer
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._banner = gui.add_html("", visible=False)
        self._change = JobStatus(viewer, self._shared.robot_switch)
        self._hung = gui.add_html("", visible=False)
        self._strip = gui.add_html("")  # a narrow page shows it over the scene
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._run = self._add(RunPanel(viewer))
            self._add(ChallengePanel(viewer))
            self.main_panel = self._add(TuningPanel(viewer, MAIN))
            self.sweep_panel = self._add(SweepPanel(viewer))
            self.explorer_panel = self._add(ExplorerPanel(viewer))
        with tabs.add_tab("View"):
            ViewPanel(viewer)
        with tabs.add_tab("Tune"):
            self._add(TuningPanel(viewer))
        self.robot_panel: RobotPanel | None = None
        if self._shared.robot_switch.possible:
            with tabs.add_tab("Robot"):
                self.robot_panel = self._add(RobotPanel(viewer))
        with tabs.add_tab("Save"):
            self._add(SavePanel(viewer))
            self.share_panel = self._add(SharePanel(viewer))
        with tabs.add_tab("Help"):
            add_help(gui, self._shortcuts())

    def _acts(self) -> list[Act]:
        """What the tour's steps are about, in their order."""
        loop, start = self._shared.loop, np.array(self._shared.loop.latest().base_pose[:2])

        def play() -> None:
            self._run.play(SHOWN)

        def went() -> bool:
            return bool(np.linalg.norm(loop.latest().base_pose[:2] - start) > _WENT)

        def compare() -> None:
            loop.send(Compare(("none",)))
            self._run.play(SHOWN)

        return [
            Act("", play, lambda: bool(loop.latest().pulls)),
            Act("", play, went),
            Act("Why", play, lambda: judge(loop.latest()).state != "clear"),
            Act("", lambda: self.timeline.step(-3.0), lambda: not self.timeline.live),
            Act("Compare", compare, lambda: bool(loop.latest().ghosts)),
        ]

    def _shortcuts(self) -> list[Shortcut]:
        scenarios = [
            Shortcut(f"Play {name}", None, lambda name=name: self._run.play(name))
            for name in SCENARIOS
        ]
        looks = [
            Shortcut(f"Look: {name}", str(i), lambda name=name: self.viewer.look(name))
            for i, name in enumerate(PRESETS, 1)
        ]
        return [
            Shortcut("Pause or go on", "space", self.viewer.toggle_pause),
            Shortcut("Restart", "R", lambda: self._shared.loop.send(Restart())),
            Shortcut("Back 1 s", "B", lambda: self.viewer.step(-1.0)),
            Shortcut("Forward 1 s", "F", lambda: self.viewer.step(1.0)),
            Shortcut("Now", "N", self.timeline.go_live),
            Shortcut("Dark or light", "L", self._toggle_dark),
            *looks,
            Shortcut("Drag the hand freely", None, lambda: self._run.play(FREE)),
            *scenarios,
            Shortcut("Show the tour", "H", lambda: self.tour.begin()),
        ]

    def _escape(self) -> None:
        """Close what lies over the page."""
        self.tour.end()
        self._notifier.clear(self._client)

    def _toggle_dark(self) -> None:
        self.view.dark = not self.view.dark

    def _show_refusal(self, newest: Snapshot) -> None:
        """What was found out to be impossible only when it was tried."""
        if newest.refusal is not None and newest.refusal != self._refusal:
            self._notifier.warn(self._client, newest.refusal.message)
        self._refusal = newest.refusal


class Demonstration:
    """What a page that nobody touches shows of itself, until somebody does.

    Plays a scenario beside a ghost without avoidance; called by the thread that draws.
    """

    def __init__(self) -> None:
        self._due: float | None = None
        self._plays = False

    def update(self, pages: Sequence[Page], loop: LoopHandle, robot: RobotDescription) -> None:
        """Begin, go on or end, by who is there."""
        newest = loop.latest()
        alone = len(pages) == 1 and pages[0].untouched and newest.controller == "dbb"
        if self._plays and not alone:
            self._plays, self._due = False, None
            loop.send(Compare())
            if not any(page.grip.holds_anything for page in pages):
                loop.send(Reset())
            return
        led = newest.scenario or newest.paused or newest.busy
        others = newest.ghosts and not self._plays
        if not alone or led or others:
            self._due = None
        elif self._due is None:
            self._due = monotonic() + (REST if self._plays else UNTOUCHED)
        elif monotonic() > self._due:
            self._due, self._plays = None, True
            try:
                play = Play(scenario_of(robot, SHOWN))
                loop.send(Compare(("none",)))
                loop.send(play)
            except DbbError:  # a robot that cannot play it
                self._plays = False
                loop.send(Compare())


def hung_html(silence: float) -> str:
    """That the simulation hangs, if it has been silent [s] for long."""
    if silence < PATIENCE:
        return ""
    text = f"No sign of life for {silence:.0f} s. What is done here waits until it goes on."
    return banner("error", "The simulation hangs", text)


def _show(handle: viser.GuiHtmlHandle, html: str) -> None:
    """Show a text that is there only now and then."""
    handle.content, handle.visible = html, bool(html)


def show_failure(gui: viser.GuiApi, title: str, error: BaseException) -> None:
    """Show the same on a page that is not drawn any more."""
    gui.add_html(banner("error", title, plain(error)))
