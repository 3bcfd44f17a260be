"""Tab "Robot": which robot is simulated, and the report of one that was built here."""

from __future__ import annotations

import re
from html import escape

import viser

from app.dashboard.job import Progress
from app.dashboard.markup import banner, problem, small
from app.dashboard.notifications import Notifier
from app.dashboard.panels.new_robot import NewRobotPanel
from app.dashboard.panels.widgets import renew, renew_bar
from app.dashboard.robot_switch import RobotEntry
from app.dashboard.shared import SharedState
from app.errors import AssetError, ConfigError
from app.robot.assets import robot_folder

_STYLE = (
    "<style>.dbb-report table{border-collapse:collapse;width:100%;font-size:.82em}"
    ".dbb-report th,.dbb-report td{text-align:left;vertical-align:top;padding:.2em .7em .2em 0;"
    "border-bottom:1px solid rgba(128,138,150,.3)}"
    ".dbb-report img{width:100%;height:auto;background:#fff;border-radius:4px}"
    ".mantine-Modal-content:has(.dbb-report){flex:0 0 min(62rem,92vw)!important}"
    ".dbb-report h2{font-size:1.05em;margin:1.2em 0 .3em}.dbb-report .scroll{overflow-x:auto}"
    ".dbb-report ul{padding-left:1.2em}</style>"
)


def show_report(client: viser.ClientHandle, name: str, notifier: Notifier) -> None:
    """Open it over the page, with a button to keep it as a file.

    Args:
        client: The viewer.
        name: Of the robot.
        notifier: For what goes wrong.

    Raises:
        AssetError: The robot has none.
    """
    path = robot_folder(name) / "report.html"
    if not path.is_file():
        raise AssetError(f"{name}: there is no report {path}")
    page = path.read_text(encoding="utf-8")
    modal = client.gui.add_modal(f"How {name} was made")
    with modal:
        keep = client.gui.add_button("Keep as a file", icon=viser.Icon.DOWNLOAD, color="gray")
        client.gui.add_html(report_html(page))
        shut = client.gui.add_button("Close")

    def send(_: viser.GuiEvent) -> None:
        client.send_file_download(f"{name}-report.html", page.encode(), save_immediately=True)

    keep.on_click(notifier.guard(send))  # type: ignore[arg-type]
    shut.on_click(notifier.guard(lambda _: modal.close()))  # type: ignore[arg-type]


def report_html(page: str) -> str:
    """The report's content, without what belongs to a page of its own."""
    body = re.search(r"<body[^>]*>(.*)</body>", page, re.DOTALL)
    return f'{_STYLE}<div class="dbb-report">{body[1] if body else ""}</div>'


class RobotPanel:
    """A list of the robots; what one viewer chooses, all see."""

    def __init__(self, gui: viser.GuiApi, shared: SharedState, notifier: Notifier) -> None:
        """Build the tab in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            shared: Simulation, parameters and the change of the robot.
            notifier: For what goes wrong.
        """
        self._shared, self._switch = shared, shared.robot_switch
        self._entries: list[RobotEntry] = []
        self._list = gui.add_dropdown(
            "Robot",
            ("",),
            hint="Those in robot_assets and in your own folder; what one viewer chooses, all see.",
        )
        self._about = gui.add_html("")
        self._use = gui.add_button("Use this robot", icon=viser.Icon.ROBOT)
        self._cancel = gui.add_button("Cancel", icon=viser.Icon.X, color="gray", visible=False)
        self._report = gui.add_button("Report", icon=viser.Icon.REPORT, color="gray")
        self._bar = gui.add_progress_bar(0.0, animated=True, visible=False)
        self._status = gui.add_html("")
        for handle, callback in (
            (self._use, lambda _: self._begin()),
            (self._cancel, lambda _: self._switch.cancel()),
            (self._report, lambda event: show_report(event.client, self._name(), notifier)),
        ):
            handle.on_click(notifier.guard(callback))  # type: ignore[arg-type]
        self._renew_list()
        self._choose(shared.model.description.name)
        self._own = NewRobotPanel(gui, shared.robot_build, notifier)
        self.update()

    def update(self) -> None:
        """Renew list, texts and progress; what has not changed is not sent."""
        if self._switch.entries is not self._entries:
            self._renew_list()
        progress, chosen = self._switch.progress, self._chosen()
        here = chosen is not None and chosen.name == self._shared.model.description.name
        ended = self._shared.loop.error is not None  # then the same robot can be had again
        usable = chosen is not None and chosen.problem is None and (ended or not here)
        renew(self._about, "content", about_html(chosen, here=here) if chosen else "")
        renew(self._use, "disabled", progress is not None or not usable)
        renew(self._cancel, "visible", progress is not None)
        renew(self._report, "visible", chosen is not None and chosen.report)
        renew_bar(self._bar, progress)
        renew(self._status, "content", status_html(progress, self._switch.problem))
        self._own.update()

    def _begin(self) -> None:
        shared = self._shared
        self._switch.begin(
            self._name(), shared.tuning.config, shared.loop.latest().controller, shared.loop
        )

    def _name(self) -> str:
        """Of the robot that is chosen in the list.

        Raises:
            ConfigError: A program has sent a word that is not in it.
        """
        chosen = self._chosen()
        if chosen is None:
            raise ConfigError("choose a robot from the list")
        return chosen.name

    def _chosen(self) -> RobotEntry | None:
        return next((each for each in self._entries if each.label == self._list.value), None)

    def _choose(self, name: str) -> None:
        for entry in self._entries:
            if entry.name == name:
                self._list.value = entry.label

    def _renew_list(self) -> None:
        chosen = next((e.name for e in self._entries if e.label == self._list.value), "")
        self._entries = self._switch.entries
        self._list.options = tuple(entry.label for entry in self._entries) or ("",)
        self._choose(self._shared.robot_build.built or chosen)


def switch_html(progress: Progress | None) -> str:
    """What stands above all tabs while another robot is being made ready; empty if none is."""
    if progress is None:
        return ""
    share = f", {100 * progress.share:.0f} %" if progress.share >= 0.0 else ""
    return banner(
        "notice",
        f"{progress.title} is being made ready",
        f"{progress.text}{share}. The robot that is shown goes on until then.",
    )


def about_html(entry: RobotEntry, *, here: bool) -> str:
    """A robot in two lines, and why it cannot be chosen."""
    lines = [f"<b>{escape(entry.title)}</b>: {escape(entry.about) or 'no description'}"]
    if here:
        lines.append("This one is shown.")
    if entry.own:
        lines.append("One of your own.")
    if entry.problem is not None:
        lines.append(f'<span style="color:#e8590c">{escape(entry.problem)}</span>')
    return small("<br>".join(lines))


def status_html(progress: Progress | None, reason: str) -> str:
    """What is going on, or why the last change failed."""
    if progress is not None:
        return small(f"{escape(progress.title)}: {escape(progress.text)} …")
    if reason:
        return small(f"{problem(reason)}. Nothing has changed.")
    return ""
