"""One viewer's page: its own panels, layers, camera and place in time."""

from __future__ import annotations

import numpy as np
import viser

from app.dashboard.channel import Channel
from app.dashboard.demonstration import SHOWN
from app.dashboard.drag import DragHandles, Grip
from app.dashboard.job import Job
from app.dashboard.link import Link, camera_text, changed_parameters
from app.dashboard.markup import banner, plain
from app.dashboard.notifications import Notifier
from app.dashboard.panels.challenge import ChallengePanel
from app.dashboard.panels.explorer import ExplorerPanel
from app.dashboard.panels.help import Act, Shortcut, Tour, add_help, add_shortcuts
from app.dashboard.panels.plots import Plots
from app.dashboard.panels.robot import RobotPanel, switch_html
from app.dashboard.panels.run import FREE, ComparePanel, RunPanel
from app.dashboard.panels.save import PagePicture, SavePanel, SweepPanel
from app.dashboard.panels.share import SharePanel
from app.dashboard.panels.timeline import Timeline, TimelinePanel
from app.dashboard.panels.tuning import MAIN, TuningPanel
from app.dashboard.panels.view import ViewPanel
from app.dashboard.panels.why import sentence, why_html
from app.dashboard.scene.camera import PRESETS, Camera
from app.dashboard.scene.colours import css, set_theme
from app.dashboard.scene.legend import key_html, legend_html
from app.dashboard.scene.scene import Scene
from app.dashboard.shared import SharedState
from app.dashboard.verdict import Verdict, judge
from app.dashboard.view import View
from app.dashboard.viser_compat import add_light_mark, add_untouched, address_of, has_no_gpu
from app.errors import TargetError
from app.simulation.loop.commands import Choose, Command, Compare, Pause, Play
from app.simulation.scenarios.names import SCENARIOS, own_line
from app.simulation.trace.snapshot import Snapshot

Array = np.ndarray

_WENT = 0.03  # [m] of the base, which everybody sees
PANEL_WIDTH = 330  # [px] of each of the two columns
LIGHT = (
    "Your browser draws without a GPU, so it gets a light drawing: fewer triangles and points, no "
    "shadows. The tab View has the other one."
)
PATIENCE = 1.0  # [s] without a sign of life of the simulation or of the viewer's browser


class Page:
    """One viewer's panels, layers, camera and place in time.

    Built and drawn by one thread only; callbacks assign to its view or send commands.
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
        self._page_picture = page_picture
        plots = [plan.title for plan in shared.plans]
        self.view = (
            before.view.of_robot(shared.mobile, plots)
            if before
            else View.first(shared.mobile, plots)
        )
        self.timeline = Timeline(shared.loop, shared.strip)
        self.channel = Channel(client, notifier)
        self.channel.on("escape", self._escape)
        if not before and has_no_gpu(client):
            self.view.light = True
            notifier.tell(client, "Drawing", LIGHT)
        self.grip = Grip(shared.loop, notifier, client.client_id)
        self.save_job = before.save_job if before else Job()
        self.closed = False
        refusal = shared.loop.latest().refusal
        self._refusals = 0 if refusal is None else refusal.number  # of before this viewer came
        self._camera = before._camera if before else Camera(client)
        self._camera.fit(shared.parts.extent)
        self._dark = self.view.dark
        set_theme(client.gui, dark=self.view.dark)
        client.gui.set_panel_label(shared.parts.title)
        with client.atomic():
            self._build_left()
            self._build_right()
            self.timeline_panel = TimelinePanel(
                self.channel, self.timeline, shared.loop, shared.strip
            )
        self.channel.begin()
        self._scene = Scene(client.scene, shared, self.view)
        kinematics = shared.parts.kinematics.model
        arm = {kinematics.getJointId(name): name for name in shared.model.description.arm.joints}
        self.hand = DragHandles(client.scene, self._scene.robot, self.grip, notifier, arm)
        add_shortcuts(client.gui, self._shortcuts(), notifier)
        self.tour = before.tour if before else Tour(client, notifier)
        self.tour.lead(self._acts(), self._places)
        self.look("iso")
        self._link = before._link if before else Link()
        if self._link.robot == shared.model.description.name:
            self._obey(self._link)  # which waited for this robot

    def draw(self, *, texts: bool) -> None:
        """Draw the instant at which the viewer is; panels, plots and labels only if `texts`."""
        newest, shown = self._shared.loop.latest(), self.timeline.shown()
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
            self._scene.draw(shown, texts=texts)
            self.hand.update(shown, texts=texts)
            self._camera.settle(shown, busy=self.grip.holds_anything)
            if texts and self.timeline.live:
                self._camera.find(shown, on=self.view.follow, busy=self.grip.holds_anything)
            self._camera.follow(shown.base_pose[:2], on=self.view.follow)
            if texts:
                verdict = judge(shown, self._shared.spoken)
                self._run.update(newest, shown, verdict, self._shared.course)
                self.explorer_panel.update(shown)
                self._why.content = why_html(shown, verdict)
                self._strip.content = strip_html(shown, verdict)
                self._compare.update(newest, shown, self._shared.course)
                self.timeline_panel.update(newest, shown)
                self._plots.update(self._shared.record, self.timeline, shown)
                self._key.content = key_html(newest.config.border.d_b)
                self._show_refusal(newest)
        if texts:
            self._light.visible = self.view.light
            self._change.content = switch_html(self._shared.robot_switch.progress)
            self._change.visible = bool(self._change.content)
            self._hung.content = hung_html(self._shared.loop.silence)
            self._hung.visible = bool(self._hung.content)
            if self.robot_panel is not None:
                self.robot_panel.update()
            self.tour.update()
            self.sweep_panel.update()
            self.save_panel.update()
            self.challenge_panel.update()
            self.main_panel.update()
            self.tuning_panel.update()
        link = self._link
        here = link.robot in ("", self._shared.model.description.name)
        if link.look and here and newest.scenario == link.scenario and not newest.busy:
            self._link = Link()
            self._notifier.attempt(self._client, lambda: self._look_as(link))

    def open_link(self, query: str) -> None:
        """Do what the page's address asks for; if that cannot be, say why and change nothing."""
        if query:
            self._notifier.attempt(self._client, lambda: self._open(Link.read(query)))

    def link(self) -> str:
        """The address of what is seen."""
        newest, shown = self._shared.loop.latest(), self.timeline.shown()
        course, camera = self._shared.course, self._client.camera
        scenario = course.name if course.name in SCENARIOS else ""
        link = Link(
            scenario,
            newest.controller,
            self._shared.model.description.name,
            changed_parameters(self._shared.tuning.config),
            self._camera.preset or camera_text(camera.position, camera.look_at),
            round(min(shown.t, course.until), 3) if scenario else None,
        )
        return f"{address_of(self._client)}?{link.query()}"

    def _open(self, link: Link) -> None:
        shared = self._shared
        if link.robot in ("", shared.model.description.name):
            self._obey(link)
            return
        config = link.configured(shared.tuning.config)
        controller = link.controller or shared.loop.latest().controller
        shared.robot_switch.begin(link.robot, config, controller, shared.loop)
        self._link = link

    def _obey(self, link: Link) -> None:
        shared, commands = self._shared, list[Command]()
        if link.controller:
            commands.append(Choose(link.controller))
        if link.scenario:
            description = shared.model.description
            scenario = Play.named(link.scenario, own_line(description, link.scenario)).scenario
            commands += [Pause(False), Play(scenario, link.at or 0.0)]
        shared.tuning.load(link.configured(shared.tuning.config))
        for command in commands:
            shared.loop.send(command)
        self._link = link if link.scenario else Link()
        if link.look and not link.scenario:
            self._look_as(link)

    def _look_as(self, link: Link) -> None:
        place = link.camera()
        if place is None:
            self.look(link.look)
        else:
            self.sit(*place)

    @property
    def untouched(self) -> bool:
        """Whether the viewer's browser has said that nobody has touched this page yet."""
        return bool(self._untouched.value) and not self.closed

    def look(self, preset: str) -> None:
        """Look from a key of `app.dashboard.scene.camera.PRESETS`, at the instant that is shown.

        Raises:
            TargetError: There is no door to look at.
        """
        shown = self.timeline.shown()
        if preset == "door" and shown.door is None:
            raise TargetError("there is no door here; the scenario refrigerator has one")
        self._camera.use(preset, shown)

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
        with self._client.atomic():
            self._client.scene.reset()
            self._client.gui.reset()
        return Page(self._client, shared, self._notifier, self._page_picture, self)

    def browser_is_silent(self) -> None:
        """The viewer's browser may sleep: it lets go, unless it has pulled just now."""
        self.grip.release_if_still(PATIENCE, self._client)

    def close(self) -> None:
        """Let go of what the viewer held; nothing is drawn any more."""
        self.closed = True
        self.grip.release()

    def end(self) -> None:
        """Close it, and end what is saved for the viewer, who is gone."""
        self.close()
        self.save_job.cancel()

    def _build_left(self) -> None:
        gui = self._client.gui
        panel = gui.add_panel()
        why = panel.add_tab("Why", viser.Icon.BULB)
        with why:
            self._why = gui.add_html("")
            self._legend = gui.add_html(legend_html([]))
        with panel.add_tab("Plots", viser.Icon.CHART_LINE):
            self._plots = Plots(gui, self._shared.plans, self.view)
        compare = panel.add_tab("Compare", viser.Icon.USERS)
        with compare:
            self._compare = ComparePanel(gui, self._shared.loop, self._notifier)
        with panel.add_tab("Key", viser.Icon.COLOR_SWATCH):
            self._key = gui.add_html("")
        self._places = {"Why": why, "Compare": compare}
        panel.dock_left()
        panel.set_width(PANEL_WIDTH)

    def _build_right(self) -> None:
        gui, notifier, shared = self._client.gui, self._notifier, self._shared
        gui.main_panel.dock_right()
        gui.main_panel.set_width(PANEL_WIDTH)
        self._banner = gui.add_html("", visible=False)
        self._change = gui.add_html("", visible=False)  # that another robot is being prepared
        self._hung = gui.add_html("", visible=False)
        self._strip = gui.add_html("")  # a narrow page shows it over the scene
        self._untouched = add_untouched(gui)
        self._light = add_light_mark(gui, visible=self.view.light)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Run"):
            self._run = RunPanel(
                gui, shared.loop, notifier, shared.model.description, shared.spoken, shared.case
            )
            self.challenge_panel = ChallengePanel(gui, shared, self.view, self.save_job, notifier)
            self.main_panel = TuningPanel(gui, shared.tuning, notifier, MAIN)
            self.sweep_panel = SweepPanel(gui, shared, notifier)
            self.explorer_panel = ExplorerPanel(gui, shared, self.grip, notifier)
        with tabs.add_tab("View"):
            plots = [plan.title for plan in shared.plans]
            ViewPanel(gui, self.view, notifier, plots, self.look, shared.spoken)
        with tabs.add_tab("Tune"):
            self.tuning_panel = TuningPanel(
                gui, shared.tuning, notifier, robot=shared.model.description
            )
        self.robot_panel: RobotPanel | None = None
        if shared.robot_switch.possible:
            with tabs.add_tab("Robot"):
                self.robot_panel = RobotPanel(gui, shared, notifier)
        with tabs.add_tab("Save"):
            self.save_panel = SavePanel(
                gui, shared, self.timeline, self.view, self.save_job, notifier, self._page_picture
            )
            SharePanel(gui, shared, notifier, self.link)
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

    def _escape(self) -> None:
        """Close what lies over the page."""
        self.tour.end()
        self._notifier.clear(self._client)

    def _toggle_dark(self) -> None:
        self.view.dark = not self.view.dark

    def _show_refusal(self, newest: Snapshot) -> None:
        """What was found out to be impossible only when it was tried."""
        number = 0 if newest.refusal is None else newest.refusal.number
        if newest.refusal is not None and number > self._refusals:
            self._notifier.warn(self._client, newest.refusal.message)
        self._refusals = number


def strip_html(shown: Snapshot, verdict: Verdict) -> str:
    """What the tab Why says, for a page that is too narrow for panels beside the scene."""
    colour = css(verdict.colour)
    return (
        f'<div data-strip style="border-left:6px solid {colour}"><b style="color:{colour}">'
        f"{verdict.state.capitalize()}</b> {sentence(shown)}</div>"
    )


def hung_html(silence: float) -> str:
    """That the simulation hangs, if it has been silent [s] for long."""
    if silence < PATIENCE:
        return ""
    text = f"No sign of life for {silence:.0f} s. What is done here waits until it goes on."
    return banner("error", "The simulation hangs", text)


def show_failure(gui: viser.GuiApi, title: str, error: BaseException) -> None:
    """Show the same on a page that is not drawn any more."""
    gui.add_html(_failure_html(title, error))


def _failure_html(title: str, error: BaseException) -> str:
    return banner("error", title, plain(error))
