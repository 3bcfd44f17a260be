"""Page of one viewer: its panels, layers, camera and point in time."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from time import monotonic
from typing import TypeVar

import numpy as np
import viser

from app.dashboard.drag import DragHandles, Grip
from app.dashboard.markup import banner, plain
from app.dashboard.notifications import Notifier
from app.dashboard.panels import BACK, CONTINUE, PAUSE, RESTART, JobStatus, Moment, Panel, Viewer
from app.dashboard.panels.explorer import ExplorerPanel
from app.dashboard.panels.help import Guide, Shortcut, add_help, add_shortcuts
from app.dashboard.panels.plots import Plots
from app.dashboard.panels.robot import RobotPanel
from app.dashboard.panels.run import FREE, ComparePanel, LabPanel, RunPanel
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
from app.errors import DbbError
from app.robot.description import RobotDescription
from app.simulation.loop.commands import Compare, Play, Reset, Restart
from app.simulation.loop.loop import LoopHandle
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.scenarios.line import LineScenario
from app.simulation.session import SCENARIO_PERSON
from app.simulation.trace.snapshot import Snapshot

PanelType = TypeVar("PanelType", bound=Panel)

PRODUCT = "dbb self-collision avoidance"
PANEL_WIDTH, MAIN_WIDTH = 330, 350  # [px] of the left and of the right column
PATIENCE = 1.0  # [s] timeout of the simulation and of the viewer's browser
SHOWN = "guiding-lateral"
"""The scenario of the demonstration: the arm is pulled along the wheels' axis."""
FARTHER = 1.5  # [-] factor on this scenario's path; the arm then hits a base that stays
UNTOUCHED = 20.0  # [s] without input before a demonstration starts
REST = 3.0  # [s] pause between two demonstrations


class Page:
    """Panels, layers, camera and point in time of one viewer.

    The drawing thread creates and draws a page. Callbacks only assign to the view or send commands.
    Create a page within the client's `atomic`, so that the viewer never sees an incomplete page.
    """

    def __init__(
        self,
        client: viser.ClientHandle,
        shared: SharedState,
        notifier: Notifier,
        before: Page | None = None,
    ) -> None:
        """Create the page of a client; `before` is the client's closed page of another robot."""
        self._client, self._shared, self._notifier = client, shared, notifier
        self.viewer = viewer = Viewer(client, notifier, shared, before.viewer if before else None)
        self.view, self.timeline, self.grip = viewer.view, viewer.timeline, viewer.grip
        self.channel, self._camera = viewer.channel, viewer.camera
        self.channel.on("escape", self._escape)
        self.channel.on("nudge", self._nudge)
        self.channel.on("drop", self.grip.release_keys)
        self.closed = False
        newest = shared.loop.latest()
        self._refusal, self._newest = newest.refusal, newest  # this refusal precedes the page
        self._dark, self._light = self.view.dark, self.view.light
        set_theme(client.gui, dark=self.view.dark)
        client.gui.set_panel_label(shared.parts.title)
        self._panels: list[Panel] = []
        with client.atomic():
            self._build_left()
            self._build_right()
            self._add(TimelinePanel(self.viewer))
        end = partial(end_demonstration, shared.loop, self.grip)
        state = before.guide.state if before else ""
        self.guide = self._add(Guide(self.viewer, self._shows(), end, state))
        self.channel.begin()
        self.channel.tell("title", f"{PRODUCT} · {shared.parts.title}")
        self.channel.tell("light", self._light)
        self.channel.tell("hints", self._plots.hints)
        self._scene = Scene(client.scene, shared, self.view)
        self._border = border = self._scene.border
        self.channel.on("pointer", lambda *at: setattr(border, "pointer", at[:2] if at[1:] else ()))
        kinematics = shared.parts.kinematics.model
        arm = {kinematics.getJointId(name): name for name in shared.model.description.arm.joints}
        self.hand = DragHandles(client.scene, self._scene.robot, self.grip, notifier, arm)
        add_shortcuts(client.gui, self._shortcuts(), notifier)
        self._camera.begin(self.timeline.shown())
        self.draw(texts=True)

    def draw(self, *, texts: bool) -> None:
        """Draw the viewer's point in time; update panels, plots and labels only if `texts`."""
        newest, shown = self._shared.loop.latest(), self.timeline.shown()
        if not newest.follows(self._newest):
            self.grip.release()  # the simulation has restarted and has dropped all pulls
        self._newest = newest
        if self.grip.holds_anything and not self.timeline.live:
            self.timeline.go_live()  # the past cannot be changed
        shown = self.explorer_panel.shown(newest, shown)
        if self._border.update(self.view, shown.border):
            spoken = self._shared.spoken
            self._why.legend.content = legend_html(
                [each._replace(pair=spoken[each.pair]) for each in self._border.legends]
            )
        with self._client.atomic():
            if self._dark != self.view.dark:
                self._dark = self.view.dark
                set_theme(self._client.gui, dark=self._dark)
            verdict = self._scene.draw(shown, texts=texts, lens=self._camera.lens)
            self.hand.update(shown)
            self._camera.settle(shown, busy=self.grip.holds_anything)
            if texts and self.timeline.live:
                self._camera.find(shown, on=self.view.follow, busy=self.grip.holds_anything)
            # With ghosts the camera stands still, so that the motion of each robot is visible.
            follows = self.view.follow and not shown.ghosts
            self._camera.follow(shown.base_pose[:2], on=follows)
            if texts:
                self._renew(Moment(newest, shown, verdict))

    def _renew(self, moment: Moment) -> None:
        for panel in self._panels:
            panel.update(moment)
        self._key.content = key_html(moment.shown.border.d_b)
        self._show_refusal(moment.newest)
        _show(self._hung, hung_html(self._shared.loop.silence))
        self._change.show("")
        if self._light != self.view.light:
            self._light = self.view.light
            self.channel.tell("light", self._light)

    @property
    def untouched(self) -> bool:
        """Whether the browser has reported that the viewer has not touched this page yet."""
        return "untouched" in self.channel.seen and not self.closed

    def fail(self, title: str, error: BaseException) -> None:
        """Show permanently that the simulation or the drawing has ended."""
        _show(self._banner, banner("error", title, plain(error)))

    def with_robot(self, shared: SharedState) -> Page:
        """Replace this page by a page of another robot, for the same viewer."""
        if self.closed:
            return self
        self.close()
        with self._client.atomic():
            self._client.scene.reset()
            self._client.gui.reset()
            return Page(self._client, shared, self._notifier, self)

    def close(self) -> None:
        """Release all pulls of the viewer, end a demonstration, and stop drawing."""
        self.closed = True
        self.grip.release()
        self.guide.leave_demonstration()

    def end(self) -> None:
        """Close the page of a disconnected viewer, and cancel the creation of files."""
        self.close()
        self.viewer.files.cancel()

    def _add(self, panel: PanelType) -> PanelType:
        self._panels.append(panel)
        return panel

    def _build_left(self) -> None:
        gui = self._client.gui
        panel = gui.add_panel()
        with panel.add_tab("Why", viser.Icon.BULB):
            self._why = self._add(WhyPanel(self.viewer))
        self._plots = self._add(Plots(self.viewer, panel.add_tab("Plots", viser.Icon.CHART_LINE)))
        with panel.add_tab("Compare", viser.Icon.USERS):
            self._add(ComparePanel(self.viewer))
        with panel.add_tab("Key", viser.Icon.COLOR_SWATCH):
            self._key = gui.add_html("")
        panel.dock_left()
        panel.set_width(PANEL_WIDTH)

    def _build_right(self) -> None:
        gui, viewer = self._client.gui, self.viewer
        gui.main_panel.dock_right()
        gui.main_panel.set_width(MAIN_WIDTH)
        self._banner = gui.add_html("", visible=False)
        self._change = JobStatus(viewer, self._shared.robot_switch)
        self._hung = gui.add_html("", visible=False)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._run = self._add(RunPanel(viewer))
        with tabs.add_tab("Lab"):
            self._add(LabPanel(viewer))
            self.explorer_panel = self._add(ExplorerPanel(viewer))
        with tabs.add_tab("View"):
            self._add(ViewPanel(viewer))
        with tabs.add_tab("Tune"):
            self.tuning_panel = self._add(TuningPanel(viewer))
        self.robot_panel: RobotPanel | None = None
        if self._shared.robot_switch.possible:
            with tabs.add_tab("Robot"):
                self.robot_panel = self._add(RobotPanel(viewer))
        with tabs.add_tab("Save"):
            self._add(SavePanel(viewer))
        with tabs.add_tab("Help"):
            add_help(gui, self._shortcuts())

    def _shows(self) -> dict[str, Callable[[], None]]:
        """Return the actions of the guide's button `SHOW` by the guide's states."""
        shared = self._shared
        return {
            "watch": lambda: play_with_ghost(shared.loop, shared.model.description),
            **dict.fromkeys(("tour 1", "tour 2", "tour 3"), lambda: self._run.play(SHOWN)),
            "tour 4": lambda: self.timeline.step(-3.0),
        }

    def _shortcuts(self) -> list[Shortcut]:
        scenarios = [
            Shortcut(f"Play {name}", None, lambda name=name: self._run.play(name))
            for name in SCENARIOS
        ]
        looks = [
            Shortcut(f"Camera: {name}", str(i), lambda name=name: self.viewer.look(name))
            for i, name in enumerate(PRESETS, 1)
        ]
        return [
            Shortcut(f"{PAUSE} or {CONTINUE.lower()}", "space", self.viewer.toggle_pause),
            Shortcut(RESTART, "R", lambda: self._shared.loop.send(Restart())),
            Shortcut("Back 1 s", "B", lambda: self.viewer.step(-1.0)),
            Shortcut("Forward 1 s", "F", lambda: self.viewer.step(1.0)),
            Shortcut("Back to now", "N", self.timeline.go_live),
            Shortcut("Dark or light theme", "L", self._toggle_dark),
            *looks,
            Shortcut(BACK, None, lambda: self._run.play(FREE)),
            *scenarios,
            Shortcut("Tour", "H", lambda: self.guide.go("tour 1")),
        ]

    def _escape(self) -> None:
        """Close the guide and the messages."""
        self.guide.go("")
        self._notifier.clear(self._client)

    def _nudge(self, x: float, y: float, z: float) -> None:
        """Move the end-effector's target by `NUDGE` times x, y, z, from −1 to 1, as in `nudge`."""
        ahead = np.clip((x, y, z), -1.0, 1.0)
        self.grip.nudge(ahead, self._shared.loop.latest(), self._client)

    def _toggle_dark(self) -> None:
        self.view.dark = not self.view.dark

    def _show_refusal(self, newest: Snapshot) -> None:
        """Show the viewer each new refusal of a command by the simulation."""
        if newest.refusal is not None and newest.refusal != self._refusal:
            self._notifier.warn(self._client, newest.refusal.message)
        self._refusal = newest.refusal


def play_with_ghost(loop: LoopHandle, robot: RobotDescription) -> None:
    """Play the demonstration on a robot and on a ghost without avoidance.

    Raises:
        UnreachableError: The robot has no line for this scenario.
    """
    scenario = scenario_of(robot, SHOWN)
    if isinstance(scenario, LineScenario):
        x, y, z = (FARTHER * part for part in scenario.move)
        scenario = scenario.changed(move=(x, y, z))
    loop.send(Compare(("none",)))
    loop.send(Play(scenario))


class Demonstration:
    """Starts a repeated demonstration for a single viewer who has not touched the page.

    It shows a scenario with the controller dbb, and a ghost without avoidance. It starts after
    `UNTOUCHED` seconds without a scenario, a pause or a comparison. The first input, or a second
    viewer, closes its card, which ends it.
    """

    def __init__(self) -> None:
        self._due: float | None = None

    def update(self, pages: Sequence[Page], loop: LoopHandle, robot: RobotDescription) -> None:
        """Start or repeat the demonstration, or close its card; called by the drawing thread."""
        newest = loop.latest()
        if len(pages) != 1 or not pages[0].untouched or newest.controller != "dbb":
            self._due = None
            for page in pages:
                page.guide.leave_demonstration()
            return
        guide = pages[0].guide
        repeats = guide.state == "demo"
        if newest.scenario or newest.paused or newest.busy or (newest.ghosts and not repeats):
            self._due = None
        elif self._due is None:
            self._due = monotonic() + (REST if repeats else UNTOUCHED)
        elif monotonic() > self._due:
            self._due = None
            with suppress(DbbError):  # the robot cannot play the scenario
                play_with_ghost(loop, robot)
                guide.go("demo")


def end_demonstration(loop: LoopHandle, grip: Grip) -> None:
    """Remove the ghost, and put the robot at the free start unless a viewer holds it.

    The pull of the page's `grip` can be newer than the newest snapshot.
    """
    loop.send(Compare())
    held = any(pull.who != SCENARIO_PERSON for pull in loop.latest().pulls)
    if not (held or grip.holds_anything):
        loop.send(Reset())


def hung_html(silence: float) -> str:
    """Return an error message if the simulation's `silence` [s] exceeds `PATIENCE`, or ""."""
    if silence < PATIENCE:
        return ""
    text = f"No response for {silence:.0f} s. Commands wait until it continues."
    return banner("error", "The simulation does not respond", text)


def _show(handle: viser.GuiHtmlHandle, html: str) -> None:
    """Show a text, or hide the element if the text is empty."""
    handle.content, handle.visible = html, bool(html)


def show_failure(gui: viser.GuiApi, title: str, error: BaseException) -> None:
    """Show the failure on a page that is no longer drawn."""
    gui.add_html(banner("error", title, plain(error)))
