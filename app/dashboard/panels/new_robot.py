"""Folder "Your own robot": a zip is uploaded, asked about, and becomes a robot."""

from __future__ import annotations

import re
from html import escape
from typing import Any

import viser

from app.dashboard.markup import problem, small
from app.dashboard.notifications import Notifier
from app.dashboard.panels.widgets import renew, renew_bar
from app.dashboard.robot_build import Package, RobotBuild
from app.dashboard.viser_compat import taken_upload
from app.errors import ConfigError
from app.onboarding.read.unpack import LARGEST_ARCHIVE, LARGEST_CONTENT, MOST_FILES
from app.onboarding.request import BOUNDS, NAME, OF_KIND, Request, check_request, option
from app.robot.assets import user_robots
from app.robot.description import KINDS

FIND = "(find them)"
"""Choice of no wheels: they are looked for."""
_NUMBERS = ("half_track", "wheel_radius", "wheelbase", "steering_limit")
"""Fields of `Request` that are asked for as a number; 0 leaves them to the URDF."""
_LABELS = {
    "file": "URDF",
    "name": "Name",
    "base": "Base link",
    "tip": "Tip link",
    "kind": "Base",
    "left": "Left wheel",
    "right": "Right wheel",
    "half_track": "Half track [m]",
    "wheel_radius": "Wheel radius [m]",
    "wheelbase": "Wheelbase [m]",
    "steering_limit": "Steering limit [rad]",
    "assume": "Assume masses",
}


class NewRobotPanel:
    """Upload, the questions that a URDF leaves open, and how far the work is."""

    def __init__(self, gui: viser.GuiApi, build: RobotBuild, notifier: Notifier) -> None:
        """Build the folder in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            build: What was uploaded and is built, common to all viewers.
            notifier: For what goes wrong.
        """
        self._build, self._package = build, None
        self._shown_urdf = ""
        with gui.add_folder("Your own robot", expand_by_default=False):
            gui.add_html(about_html())
            self._upload = gui.add_upload_button(
                "Upload a zip", icon=viser.Icon.UPLOAD, mime_type=".zip,application/zip"
            )
            self._status = gui.add_html("")
            self._bar = gui.add_progress_bar(0.0, animated=True, visible=False)
            self._fields = self._questions(gui)
            self._make = gui.add_button("Make it", icon=viser.Icon.HAMMER, visible=False)
            self._cancel = gui.add_button("Cancel", icon=viser.Icon.X, color="gray", visible=False)
        self._upload.on_upload(notifier.guard(self._receive))  # type: ignore[arg-type]
        self._make.on_click(notifier.guard(lambda _: build.build(self._request())))  # type: ignore[arg-type]
        self._cancel.on_click(notifier.guard(lambda _: build.cancel()))  # type: ignore[arg-type]
        self.update()

    @staticmethod
    def _questions(gui: viser.GuiApi) -> dict[str, Any]:
        hints = {
            "half_track": "Effective; 0 measures it between the wheels",
            "wheel_radius": "Only for a base whose URDF has no wheels, with its half track; else 0",
            "wheelbase": "0 measures it to the steered wheels",
            "steering_limit": "To either side; 0 takes the URDF's",
        }
        wheel = "Joint of a driven wheel; of a car-like base, of a rear one"
        return {
            "file": gui.add_dropdown(_LABELS["file"], ("",), hint="Which of the zip's URDFs"),
            "name": gui.add_text(_LABELS["name"], "", hint="Letters, digits and _"),
            "base": gui.add_dropdown(_LABELS["base"], ("",), hint="Moves with the base, z up"),
            "tip": gui.add_dropdown(_LABELS["tip"], ("",), hint="Carries the end-effector"),
            "kind": gui.add_dropdown(_LABELS["kind"], tuple(KINDS), hint="How the base drives"),
            "left": gui.add_dropdown(_LABELS["left"], (FIND,), hint=wheel),
            "right": gui.add_dropdown(_LABELS["right"], (FIND,), hint=wheel),
            **{
                name: gui.add_number(
                    _LABELS[name], 0.0, min=0.0, max=BOUNDS[name].high, step=0.001, hint=hint
                )
                for name, hint in hints.items()
            },
            "assume": gui.add_checkbox(
                _LABELS["assume"],
                False,
                hint="From volumes, where the arm's URDF states none at all",
            ),
        }

    def update(self) -> None:
        """Renew questions, texts and progress; what has not changed is not sent."""
        package, progress = self._build.package, self._build.progress
        if package is not self._package:
            self._package = package
            if package is not None:
                self._ask(package)
        if package is not None and self._fields["file"].value != self._shown_urdf:
            self._ask_of_urdf(package)
        asks = package is not None and progress is None
        for name, field in self._fields.items():
            renew(field, "visible", asks and self._suits(name))
        renew(self._make, "visible", asks)
        renew(self._upload, "disabled", progress is not None)
        renew(self._cancel, "visible", progress is not None)
        renew_bar(self._bar, progress)
        renew(self._status, "content", build_html(self._build))

    def _receive(self, event: viser.GuiEvent) -> None:
        file = taken_upload(event.target)
        self._build.receive(file.name, file.content)

    def _suits(self, name: str) -> bool:
        """Whether a question is one for the kind of base, and the zip, that is chosen."""
        kind = self._fields["kind"].value
        if name in ("left", "right"):
            return kind != "holonomic"
        if name == "file":
            return self._package is not None and len(self._package.urdfs) > 1
        return OF_KIND.get(name, kind) == kind

    def _ask(self, package: Package) -> None:
        self._shown_urdf = ""  # one of the same path may have other links
        self._fields["file"].options = tuple(package.urdfs)
        self._fields["name"].value = robot_name(package.archive.stem)

    def _ask_of_urdf(self, package: Package) -> None:
        """The links of the URDF that is chosen; the first guess is to be confirmed."""
        fields = self._fields
        self._shown_urdf = fields["file"].value
        contents = package.urdfs.get(self._shown_urdf)
        if contents is None:  # a program may send any word
            return
        for name, guess in (("base", contents.root), ("tip", contents.last)):
            fields[name].options = contents.links
            fields[name].value = guess
        for name in ("left", "right"):
            fields[name].options = (FIND, *contents.endless)
            fields[name].value = FIND

    def _request(self) -> Request:
        """What the fields say.

        Raises:
            ConfigError: They do not go together.
        """
        package = self._package
        if package is None:
            raise ConfigError("upload a zip first")
        value = {name: field.value for name, field in self._fields.items()}
        if not NAME.fullmatch(value["name"]):  # before it becomes a part of a path
            raise ConfigError("a name is a letter, then letters, digits and _ only")
        left, right = (
            value[name] if self._suits(name) and value[name] != FIND else ""
            for name in ("left", "right")
        )
        if bool(left) != bool(right):
            raise ConfigError("choose both wheels, or let both be found")
        numbers: dict[str, Any] = {
            name: float(value[name]) for name in _NUMBERS if self._suits(name) and value[name]
        }
        request = Request(
            str(package.archive),
            value["base"],
            value["tip"],
            user_robots() / value["name"],
            wheels=(left, right) if left else None,
            kind=value["kind"],
            assume_inertia=value["assume"],
            file=value["file"],
            **numbers,
        )
        try:
            check_request(request)
        except ConfigError as error:
            raise ConfigError(in_words(str(error))) from None
        return request


def in_words(text: str) -> str:
    """What is said of options, said of the questions that stand for them here."""
    named = {option(name): f"“{_LABELS[name].partition(' [')[0]}”" for name in _NUMBERS}
    named |= {
        "--wheels LEFT RIGHT": "“Left wheel” and “Right wheel”",
        "--wheels": "“Left wheel” and “Right wheel”",
        "--kind": "“Base”",
        "--assume-inertia": "“Assume masses”",
        "--base": "“Base link”",
        "--tip": "“Tip link”",
        "--file": "“URDF”",
        "--out": "“Name”",
    }
    longest = sorted(named, key=len, reverse=True)
    pattern = "|".join(rf"{re.escape(name)}(?![\w-])" for name in longest)
    return re.sub(pattern, lambda found: named[found[0]], text)


def robot_name(stem: str) -> str:
    """A name that a robot may have, from that of a file."""
    name = re.sub(r"\W+", "_", stem, flags=re.ASCII).strip("_").lower()
    return name if name[:1].isalpha() else f"robot_{name}".rstrip("_")


def about_html() -> str:
    """What may be uploaded, and where the robot will be."""
    return small(
        f"A zip with a URDF and its meshes: at most {LARGEST_ARCHIVE / 1e6:.0f} MB, "
        f"{MOST_FILES} files, {LARGEST_CONTENT / 1e6:.0f} MB expanded. Nothing in it is executed; "
        "a xacro has to be expanded first. What is made of it, a description, its border and a "
        f"report, is kept in<br><code>{escape(str(user_robots()))}</code>"
    )


def build_html(build: RobotBuild) -> str:
    """What is going on, how it ended, or what to do next."""
    progress = build.progress
    if progress is not None:
        share = f", {100 * progress.share:.0f} %" if progress.share >= 0.0 else ""
        return small(f"<b>{escape(progress.title)}</b>: {escape(progress.text)}{share} …")
    if build.problem:
        return small(problem(in_words(build.problem)))
    if build.built:
        return small(
            f"<b>{escape(build.built)}</b> is made: it is in the list above, with its report. "
            "“Use this robot” shows it."
        )
    if build.package is not None:
        count = len(build.package.urdfs)
        what = "a URDF" if count == 1 else f"{count} URDFs"
        return small(f"<b>{escape(build.package.archive.name)}</b> holds {what}. Which links?")
    return ""
