"""One viewer's page: its own panels, layers, camera and place in time."""

from __future__ import annotations

import numpy as np
import viser

from app.config import Config
from app.dashboard.drag import DragHandles, Grip
from app.dashboard.job import Job
from app.dashboard.markup import banner
from app.dashboard.notifications import Notifier
from app.dashboard.panels.compare import ComparePanel
from app.dashboard.panels.help import Shortcut, Tour, add_help, add_shortcuts, keys_text
from app.dashboard.panels.plots import Plots
from app.dashboard.panels.robot import RobotPanel, switch_html
from app.dashboard.panels.run import FREE, RunPanel, add_case_button
from app.dashboard.panels.save import PagePicture, SavePanel
from app.dashboard.panels.sweep import SweepPanel
from app.dashboard.panels.timeline import Timeline, TimelinePanel
from app.dashboard.panels.tuning import MAIN, TuningPanel
from app.dashboard.panels.view import ViewPanel
from app.dashboard.panels.why import WhyPanel
from app.dashboard.scene.camera import PRESETS, Camera
from app.dashboard.scene.legend import key_html, legend_html
from app.dashboard.scene.scene import Scene
from app.dashboard.scene.theme import set_theme
from app.dashboard.shared import SharedState
from app.dashboard.view import View
from app.simulation.scenarios.names import SCENARIOS
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

PANEL_WIDTH = 330  # [px] of each of the two columns


class Page:
    """Built and drawn by one thread only; callbacks assign to its view or send commands.

    Attributes:
        view: What the viewer has chosen to see.
        timeline: The viewer's place in time.
        grip: What the viewer holds.
        save_job: Makes the viewer's files.
        closed: Whether the viewer is gone.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        shared: SharedState,
        notifier: Notifier,
        page_picture: PagePicture | None = None,
        before: Page | None = None,
    ) -> None:
        """Fill the page of a client.

        Args:
            client: The viewer.
            shared: What all viewers share.
            notifier: For what goes wrong.
            page_picture: Draws whole pages for the tab "Save".
            before: The same viewer's page of another robot, now empty.
        """
        self._client, self._shared, self._notifier = client, shared, notifier
        self._page_picture = page_picture
        plots = [plan.title for plan in shared.plans]
        self.view = (
            before.view.of_robot(shared.mobile, plots)
            if before
            else View.first(shared.mobile, plots)
        )
        self.timeline = Timeline(shared.loop)
        self.grip = Grip(shared.loop, notifier, client.client_id)
        self.save_job = before.save_job if before else Job()
        self.closed = False
        refusal = shared.loop.latest().refusal
        self._refusals = 0 if refusal is None else refusal.number  # of before this viewer came
        self._camera = before._camera if before else Camera(client)
        self._camera.fit(shared.parts.extent)
        self._dark: bool | None = None
        self._key: tuple[float, float] | None = None
        set_theme(client.gui, dark=self.view.dark)
        client.gui.set_panel_label(shared.parts.title)
        with client.atomic():
            self._build_left()
            self._build_right()
            self.timeline_panel = TimelinePanel(client.gui, self.timeline, shared.loop, notifier)
        self._scene = Scene(client.scene, shared, self.view)
        kinematics = shared.parts.kinematics.model
        arm = {kinematics.getJointId(name): name for name in shared.model.description.arm.joints}
        self.hand = DragHandles(client.scene, self._scene.robot, self.grip, notifier, arm)
        add_shortcuts(client.gui, self._shortcuts(), notifier)
        self.tour = before.tour if before else Tour(client, notifier)
        self.look("iso")

    def draw(self, *, texts: bool) -> None:
        """Draw the instant at which the viewer is.

        Args:
            texts: Whether panels, plots and labels are due too.
        """
        newest, shown = self._shared.loop.latest(), self.timeline.shown()
        if self.grip.holds_anything and not self.timeline.live:
            self.timeline.go_live()  # nobody pulls in the past
        if self._scene.select_border(shown):
            self._legend.content = legend_html(self._scene.legends)
        with self._client.atomic():
            self._apply_theme()
            self._scene.draw(shown, texts=texts)
            self.hand.update(shown, texts=texts)
            self._camera.settle(shown, busy=self.grip.holds_anything)
            self._camera.follow(shown.base_pose[:2], on=self.view.follow)
            if texts:
                self._run.update(newest, shown)
                self._why.update(shown)
                self._compare.update(newest, shown)
                self.timeline_panel.update(newest, shown)
                self._plots.update(self._shared.record, self.timeline, shown)
                self._renew_key(newest.config)
                self._show_refusal(newest)
        if texts:
            self._show_switch()
            if self.robot_panel is not None:
                self.robot_panel.update()
            self.sweep_panel.update()
            self.main_panel.update()
            self.tuning_panel.update()

    def look(self, preset: str) -> None:
        """Look from a preset, at the instant that is shown.

        Args:
            preset: A key of `app.dashboard.scene.camera.PRESETS`.
        """
        self._camera.use(preset, self.timeline.shown())

    def sit(self, eye: Array, target: Array) -> None:
        """Look from a place (3,) [m] in the world at another one, as another viewer does."""
        self._camera.put(eye, target)

    def fail(self, title: str, error: BaseException) -> None:
        """Show, for good, that the simulation or the drawing has ended."""
        self._banner.content = _failure_html(title, error)
        self._banner.visible = True

    def with_robot(self, shared: SharedState) -> Page:
        """The page of the same viewer with another robot, in place of this one."""
        if self.closed:
            return self
        self.close()
        self.tour.end()
        with self._client.atomic():
            self._client.scene.reset()
            self._client.gui.reset()
        return Page(self._client, shared, self._notifier, self._page_picture, self)

    def close(self) -> None:
        """Let go of what the viewer held who is gone; nothing is drawn any more."""
        self.closed = True
        self.grip.release()

    def _build_left(self) -> None:
        gui = self._client.gui
        panel = gui.add_panel()
        with panel.add_tab("Why", viser.Icon.BULB):
            self._why = WhyPanel(gui)
            self._legend = gui.add_html(legend_html([]))
        with panel.add_tab("Plots", viser.Icon.CHART_LINE):
            self._plots = Plots(gui, self._shared.plans, self.view)
        with panel.add_tab("Compare", viser.Icon.USERS):
            self._compare = ComparePanel(gui, self._shared.loop, self._notifier)
        with panel.add_tab("Key", viser.Icon.COLOR_SWATCH):
            self._key_text = gui.add_html("")
        panel.dock_left()
        panel.set_width(PANEL_WIDTH)

    def _build_right(self) -> None:
        gui, notifier, shared = self._client.gui, self._notifier, self._shared
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._banner = gui.add_html("", visible=False)
        self._change = gui.add_html("", visible=False)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._run = RunPanel(gui, shared.loop, notifier, shared.model.description)
            if shared.case is not None:
                add_case_button(gui, shared.loop, notifier, shared.case)
            self.main_panel = TuningPanel(gui, shared.tuning, notifier, MAIN)
            self.sweep_panel = SweepPanel(gui, shared, notifier)
        with tabs.add_tab("View"):
            plots = [plan.title for plan in shared.plans]
            ViewPanel(gui, self.view, notifier, plots, self.look)
        with tabs.add_tab("Tune"):
            self.tuning_panel = TuningPanel(
                gui, shared.tuning, notifier, robot=shared.model.description
            )
        self.robot_panel: RobotPanel | None = None
        if shared.robot_switch.possible:
            with tabs.add_tab("Robot"):
                self.robot_panel = RobotPanel(gui, shared, notifier)
        with tabs.add_tab("Save"):
            SavePanel(
                gui, shared, self.timeline, self.view, self.save_job, notifier, self._page_picture
            )
        with tabs.add_tab("Help"):
            add_help(gui, keys_text(self._shortcuts()))

    def _shortcuts(self) -> list[Shortcut]:
        scenarios = [
            Shortcut(f"Play {name}", None, lambda name=name: self._run.play(name))
            for name in SCENARIOS
        ]
        looks = [
            Shortcut(f"Look: {name}", str(i), lambda name=name: self.look(name))
            for i, name in enumerate(PRESETS, 1)
        ]
        return [
            Shortcut("Pause or go on", "space", lambda: self._run.toggle_pause()),
            Shortcut("Restart", "R", lambda: self._run.restart()),
            Shortcut("Back 1 s", "B", lambda: self.timeline_panel.step(-1.0)),
            Shortcut("Forward 1 s", "F", lambda: self.timeline_panel.step(1.0)),
            Shortcut("Now", "N", self.timeline.go_live),
            Shortcut("Dark or light", "L", self._toggle_dark),
            *looks,
            Shortcut("Drag the hand freely", None, lambda: self._run.play(FREE)),
            *scenarios,
            Shortcut("Show the tour", "H", lambda: self.tour.begin()),
        ]

    def _toggle_dark(self) -> None:
        self.view.dark = not self.view.dark

    def _show_refusal(self, newest: Snapshot) -> None:
        """What was found out to be impossible only when it was tried."""
        number = 0 if newest.refusal is None else newest.refusal.number
        if newest.refusal is not None and number > self._refusals:
            self._notifier.warn(self._client, newest.refusal.message)
        self._refusals = number

    def _show_switch(self) -> None:
        """Above all tabs: that another robot is being prepared."""
        html = switch_html(self._shared.robot_switch.progress)
        if self._change.content != html:
            self._change.content = html
            self._change.visible = bool(html)

    def _renew_key(self, config: Config) -> None:
        wanted = (config.border.d_b, config.activation.d_full)
        if wanted != self._key:
            self._key = wanted
            self._key_text.content = key_html(*wanted)

    def _apply_theme(self) -> None:
        if self._dark != self.view.dark:
            self._dark = self.view.dark
            set_theme(self._client.gui, dark=self.view.dark)


def show_failure(gui: viser.GuiApi, title: str, error: BaseException) -> None:
    """Show the same on a page that is not drawn any more."""
    gui.add_html(_failure_html(title, error))


def _failure_html(title: str, error: BaseException) -> str:
    return banner("error", title, f"{type(error).__name__}: {error}")
