"""Tab "Robot": choice of the robot for all viewers, its changes, and a new robot from a zip."""

import re
from functools import partial
from html import escape
from typing import Any

import viser

from app.dashboard.markup import problem, small
from app.dashboard.panels import JobStatus, Moment, Panel, Viewer
from app.dashboard.panels.edit import EditPanel
from app.dashboard.robots import RobotBuild, RobotEntry, new_folder
from app.dashboard.viser_compat import taken_upload
from app.errors import AssetError, ConfigError
from app.onboarding.read.package import LARGEST_ARCHIVE, LARGEST_CONTENT, MOST_FILES
from app.onboarding.request import BOUNDS, Request, check_request, option
from app.robot.assets import robot_folder, user_robots
from app.robot.description import KINDS
from app.strict import file_text

FIND = "(detect)"  # choice for wheels that the program finds itself
_WHEEL = "Joint of a driven wheel; of a rear wheel for a car-like base"
_QUESTIONS = {  # label and hint, by the field of `Request`; "left", "right": `wheels`
    "file": ("URDF", "One of the URDF files in the zip"),
    "out": ("Name", "A letter, then letters, digits and _"),
    "base": ("Base link", "Root link of the base, z up"),
    "tip": ("Tip link", "Link that carries the end-effector"),
    "kind": ("Base", "Kind of drive"),
    "left": ("Left wheel", _WHEEL),
    "right": ("Right wheel", _WHEEL),
    "half_track": ("Half track [m]", "Effective half track; 0: measured between the wheels"),
    "wheel_radius": ("Wheel radius [m]", "For a URDF without wheels, with a half track; else 0"),
    "wheelbase": ("Wheelbase [m]", "0: measured to the steered wheels"),
    "steering_limit": ("Steering limit [rad]", "To either side; 0: from the URDF"),
    "assume_inertia": ("Assume masses", "Compute masses from volumes if the arm has none"),
}
_WHEELS = "“Left wheel” and “Right wheel”"
_NO_ROBOT = RobotEntry("", "", about="", problem="there is no robot", own=False, report=False)


class RobotPanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, shared = self._gui, viewer.shared
        self._switch = shared.robot_switch
        self._entries: list[RobotEntry] = []
        hint = "Delivered robots and your own. “Use this robot” applies to all viewers."
        self._list = gui.add_dropdown("Robot", ("",), hint=hint)
        self.about = gui.add_html("")  # the chosen robot, and why the last switch has failed
        hint = "The robot is prepared in the background; meanwhile, the present one is shown."
        use, icon = lambda _: viewer.use_robot(self._chosen.name), viser.Icon.ROBOT
        self._use = self.button("Use this robot", use, icon, hint=hint)
        self._report = self.button("Report", self._show_report, viser.Icon.REPORT, color="gray")
        self._renew_list(shared.model.description.name)
        self.edit = EditPanel(viewer)
        self.own = NewRobotPanel(viewer)

    def update(self, moment: Moment) -> None:
        if self._switch.entries is not self._entries:
            self._renew_list(self._shared.robot_build.built or self._chosen.name)
        chosen, reason = self._chosen, self._switch.problem
        here = chosen.name == self._shared.model.description.name
        ended = self._shared.loop.error is not None  # then the same robot can be restarted
        usable = chosen.problem is None and (ended or not here)
        written = escape if self._switch.cancelled else problem
        failed = small(f"{written(reason)}. The robot has not changed.") if reason else ""
        lines = (
            f"<b>{escape(chosen.title)}</b>: {escape(chosen.about) or 'no description'}",
            "In use." if here else "",
            "Your own robot." if chosen.own else "",
            problem(chosen.problem) if chosen.problem else "",
        )
        about = small("<br>".join(filter(None, lines))) if chosen.name else ""
        self.about.content = about + failed
        self._use.disabled = self._switch.progress is not None or not usable
        self._report.visible = chosen.report

    def _show_report(self, _: object) -> None:
        name, client = self._chosen.name, self._viewer.client
        path = robot_folder(name) / "report.html"
        if path.is_symlink() or not path.is_file():
            raise AssetError(f"{name}: the report {path} does not exist")
        try:
            page = file_text(path)
        except (OSError, ValueError) as error:
            raise AssetError(f"{path} cannot be read: {error}") from None
        with self._gui.add_modal(f"Report on the creation of {name}") as modal:
            send = partial(client.send_file_download, f"{name}-report.html", page.encode())
            save, icon = lambda _: send(save_immediately=True), viser.Icon.DOWNLOAD
            self.button("Save as a file", save, icon, color="gray")
            self._gui.add_html(report_html(page))
            self.button("Close", lambda _: modal.close())

    @property
    def _chosen(self) -> RobotEntry:
        """The chosen robot; `_NO_ROBOT` if the list is empty."""
        label = self._list.value
        return next((each for each in self._entries if each.label == label), _NO_ROBOT)

    def _renew_list(self, name: str) -> None:
        """Offer the robots that the last search found; choose the robot `name` if it exists."""
        self._entries = self._switch.entries
        self._list.options = tuple(entry.label for entry in self._entries) or ("",)
        for entry in self._entries:
            if entry.name == name:
                self._list.value = entry.label


class NewRobotPanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, build = self._gui, viewer.shared.robot_build
        self._build, self._package, self._shown_urdf = build, None, ""
        about = (
            f"A zip of a URDF and its meshes: at most {LARGEST_ARCHIVE / 1e6:.0f} MB, "
            f"{MOST_FILES} files, {LARGEST_CONTENT / 1e6:.0f} MB unpacked. Expand xacro first; "
            "nothing is executed. The robot's description, meshes and report are saved in<br>"
            f"<code>{escape(str(user_robots()[0]))}</code>"
        )
        with gui.add_folder("Your own robot", expand_by_default=False):
            gui.add_html(small(about))
            kind = ".zip,application/zip"
            self.uploads = self.upload("Upload a zip", self._receive, mime_type=kind)
            self.status = JobStatus(viewer, build, lambda: outcome_html(build))
            self.fields = {name: _field(gui, name) for name in _QUESTIONS}
            create, icon = lambda _: build.build(self.request()), viser.Icon.HAMMER
            self._make = self.button("Create robot", create, icon, visible=False)

    def update(self, moment: Moment) -> None:
        package, progress = self._build.package, self._build.progress
        if package is not self._package:
            self._package = package
            self._shown_urdf = ""  # another zip may have the same path with other links
            if package is not None:
                self.fields["file"].options = tuple(package.urdfs)
                self.fields["out"].value = robot_name(package.archive.stem)
        urdf = self.fields["file"].value
        if package is not None and urdf != self._shown_urdf:
            self._shown_urdf = urdf
            if (contents := package.urdfs.get(urdf)) is not None:  # not of the previous zip
                links, wheels = contents.links, (FIND, *contents.endless)
                for name, options, first in (
                    ("base", links, contents.root),
                    ("tip", links, contents.last),
                    ("left", wheels, FIND),
                    ("right", wheels, FIND),
                ):
                    self.fields[name].options = options
                    self.fields[name].value = first
        asks = package is not None and progress is None
        for name, field in self.fields.items():
            field.visible = asks and self._suits(name)
        self._make.visible = asks
        self.uploads.disabled = progress is not None

    def request(self) -> Request:
        """Return the request from all fields that apply; `ConfigError` if they are not valid."""
        if (package := self._package) is None:
            raise ConfigError("upload a zip file first")
        value = {name: field.value for name, field in self.fields.items()}
        value["out"] = new_folder(value["out"])
        wheels = value.pop("left"), value.pop("right")
        if not self._suits("left"):
            wheels = FIND, FIND
        if wheels.count(FIND) == 1:
            raise ConfigError("choose both wheels, or detect both")
        for name in BOUNDS.keys() & value.keys():
            value[name] = float(value[name]) if value[name] and self._suits(name) else None
        request = Request(str(package.archive), wheels=None if FIND in wheels else wheels, **value)
        try:
            check_request(request)
        except ConfigError as error:
            raise ConfigError(in_words(str(error))) from None
        return request

    def _receive(self, event: viser.GuiEvent) -> None:
        file = taken_upload(event.target)
        self._build.receive(file.name, file.content)

    def _suits(self, name: str) -> bool:
        """Whether a question applies to the chosen kind of base and zip."""
        kind = self.fields["kind"].value
        if name in ("left", "right"):
            return kind != "holonomic"
        if name == "file":
            return self._package is not None and len(self._package.urdfs) > 1
        return name not in BOUNDS or BOUNDS[name].kind in ("", kind)


def report_html(page: str) -> str:
    """Return a frame that shows the HTML `page` without its scripts."""
    wide = ".mantine-Modal-content:has(.dbb-report){flex:0 0 min(62rem,92vw)!important}"
    look = "width:100%;height:72vh;border:0;border-radius:4px;background:#fff"
    frame = f'<iframe class="dbb-report" sandbox srcdoc="{escape(page)}" title="report" '
    return f'<style>{wide}</style>{frame}style="{look}"></iframe>'


def outcome_html(build: RobotBuild) -> str:
    """Describe the last upload or build, and the next step; empty before the first upload."""
    failed, built, package = build.problem, build.built, build.package  # a job can change them
    if failed:
        return problem(in_words(failed))
    if built:
        return f"<b>{escape(built)}</b> is ready: choose it above, then “Use this robot”."
    if package is not None:
        count = len(package.urdfs)
        content = "a URDF" if count == 1 else f"{count} URDFs"
        name = escape(package.archive.name)
        return f"<b>{name}</b> contains {content}. Choose the base link and the tip link."
    return ""


def in_words(text: str) -> str:
    """Replace the options of the command line in a message by the labels of the questions."""
    named = {
        option(name): f"“{label.partition(' [')[0]}”" for name, (label, _) in _QUESTIONS.items()
    }
    named |= {"--wheels LEFT RIGHT": _WHEELS, "--wheels": _WHEELS}
    longest = sorted(named, key=len, reverse=True)
    pattern = "|".join(rf"{re.escape(name)}(?![\w-])" for name in longest)
    return re.sub(pattern, lambda found: named[found[0]], text)


def robot_name(stem: str) -> str:
    """Turn `stem`, the name of a file without its suffix, into a valid name for a robot."""
    name = re.sub(r"\W+", "_", stem, flags=re.ASCII).strip("_").lower()
    return name if name[:1].isalpha() else f"robot_{name}".rstrip("_")


def _field(gui: viser.GuiApi, name: str) -> Any:
    label, hint = _QUESTIONS[name]
    if name in BOUNDS:
        return gui.add_number(label, 0.0, min=0.0, max=BOUNDS[name].high, step=0.001, hint=hint)
    if name == "out":
        return gui.add_text(label, "", hint=hint)
    if name == "assume_inertia":
        return gui.add_checkbox(label, False, hint=hint)
    first = tuple(KINDS) if name == "kind" else (FIND,)  # before an upload
    return gui.add_dropdown(label, first, hint=hint)
