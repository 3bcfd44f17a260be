"""Folder "Your own robot": a zip is uploaded, asked about, and becomes a robot."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import viser

from app.dashboard.making import Making, Package
from app.dashboard.notices import Notices
from app.dashboard.panels.widgets import renew, renew_bar, small
from app.dashboard.upload_guard import guard_uploads
from app.errors import ConfigError
from app.onboarding.request import NAME, Request
from app.onboarding.unpack import LARGEST_ARCHIVE, LARGEST_CONTENT, MOST_FILES
from app.robot.assets import user_robots

FIND = "(find them)"
"""Choice of no wheels: they are looked for."""
KINDS = ("differential", "holonomic", "car-like")
"""Of bases."""
_LARGEST = {"half_track": 3.0, "radius": 1.0, "wheelbase": 10.0}  # [m]


class NewRobotPanel:
    """Upload, the questions that a URDF leaves open, and how far the work is."""

    def __init__(self, gui: viser.GuiApi, making: Making, notices: Notices) -> None:
        """Build the folder in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            making: What was uploaded and is made, common to all viewers.
            notices: For what goes wrong.
        """
        self._making, self._package = making, None
        self._shown_urdf = ""
        guard_uploads(gui, notices, LARGEST_ARCHIVE)
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
        self._upload.on_upload(notices.guard(self._receive))  # type: ignore[arg-type]
        self._make.on_click(notices.guard(lambda _: making.make(self._request())))  # type: ignore[arg-type]
        self._cancel.on_click(notices.guard(lambda _: making.cancel()))  # type: ignore[arg-type]
        self.update()

    @staticmethod
    def _questions(gui: viser.GuiApi) -> dict[str, Any]:
        return {
            "file": gui.add_dropdown("URDF", ("",), hint="Which of the zip's URDFs"),
            "name": gui.add_text("Name", "", hint="Letters, digits and _"),
            "base": gui.add_dropdown("Base link", ("",), hint="Moves with the base, z up"),
            "tip": gui.add_dropdown("Tip link", ("",), hint="Carries the end-effector"),
            "kind": gui.add_dropdown("Base", KINDS, hint="How the base drives"),
            "left": gui.add_dropdown("Left wheel", (FIND,), hint="Joint of a driven wheel"),
            "right": gui.add_dropdown("Right wheel", (FIND,), hint="Joint of a driven wheel"),
            "half_track": gui.add_number(
                "Half track [m]", 0.0, min=0.0, max=_LARGEST["half_track"], step=0.001,
                hint="Effective; 0 measures it between the wheels",
            ),
            "radius": gui.add_number(
                "Wheel radius [m]", 0.0, min=0.0, max=_LARGEST["radius"], step=0.001,
                hint="Only for a base whose URDF has no wheels, with its half track; else 0",
            ),
            "wheelbase": gui.add_number(
                "Wheelbase [m]", 0.0, min=0.0, max=_LARGEST["wheelbase"], step=0.001,
                hint="Of a car-like base; 0 measures it to its steered wheels",
            ),
            "assume": gui.add_checkbox(
                "Assume masses", False,
                hint="From volumes, where the arm's URDF states none at all",
            ),
        }  # fmt: skip

    def update(self) -> None:
        """Renew questions, texts and progress; what has not changed is not sent."""
        making = self._making
        package, progress = making.package, making.progress
        if package is not self._package:
            self._package = package
            if package is not None:
                self._ask(package)
        if package is not None and self._fields["file"].value != self._shown_urdf:
            self._ask_of_urdf(package)
        asks = package is not None and progress is None
        for field in self._fields.values():
            renew(field, "visible", asks)
        renew(self._make, "visible", asks)
        renew(self._upload, "disabled", progress is not None)
        renew(self._cancel, "visible", progress is not None)
        renew_bar(self._bar, progress)
        renew(self._status, "content", making_html(making))

    def _receive(self, event: viser.GuiEvent) -> None:
        file = event.target.value
        self._making.receive(file.name, file.content)

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
        wheels = (value["left"], value["right"])
        given = [wheel for wheel in wheels if wheel != FIND]
        if len(given) == 1:
            raise ConfigError("choose both wheels, or let both be found")
        numbers = {name: float(value[name]) for name in _LARGEST}
        if not all(0.0 <= number <= _LARGEST[name] for name, number in numbers.items()):
            raise ConfigError("half track, wheel radius and wheelbase: [m], within their range")
        _check_kind(value["kind"], numbers, given)
        half_track, radius, wheelbase = (number or None for number in numbers.values())
        return Request(
            str(package.archive), value["base"], value["tip"], user_robots() / value["name"],
            wheels=wheels if given else None, half_track=half_track, wheel_radius=radius,
            kind=value["kind"], wheelbase=wheelbase, assume_inertia=value["assume"],
            file=value["file"],
        )  # fmt: skip


def _check_kind(kind: str, numbers: Mapping[str, float], wheels: Sequence[str]) -> None:
    """Whether the numbers and wheels that were given are those of such a base.

    Raises:
        ConfigError: They are not; says which.
    """
    if kind not in KINDS:
        raise ConfigError(f"a base is one of: {', '.join(KINDS)}")
    if kind != "differential" and (numbers["half_track"] or numbers["radius"]):
        raise ConfigError(f"a {kind} base has neither half track nor wheel radius; leave them at 0")
    if kind != "car-like" and numbers["wheelbase"]:
        raise ConfigError(f"a {kind} base has no wheelbase; leave it at 0")
    if kind == "holonomic" and wheels:
        raise ConfigError("a holonomic base needs no wheels; let them be found")
    if numbers["radius"] and (not numbers["half_track"] or wheels):
        raise ConfigError("a wheel radius needs a half track, and no wheels")


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


def making_html(making: Making) -> str:
    """What is going on, how it ended, or what to do next."""
    progress = making.progress
    if progress is not None:
        share = f", {100 * progress.share:.0f} %" if progress.share >= 0.0 else ""
        return small(f"<b>{escape(progress.title)}</b>: {escape(progress.text)}{share} …")
    if making.problem:
        return small(f'<span style="color:#e03131">{escape(making.problem)}</span>')
    if making.made:
        return small(
            f"<b>{escape(making.made)}</b> is made: choose it in the list above, where its report "
            "is too."
        )
    if making.package is not None:
        count = len(making.package.urdfs)
        what = "a URDF" if count == 1 else f"{count} URDFs"
        return small(f"<b>{escape(making.package.archive.name)}</b> holds {what}. Which links?")
    return ""
