"""Tab "Tune": all parameters in folders, made from the configuration's records, and as a file."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable
from typing import Any

import viser

from app.config import Config, sections
from app.config_file import decode_config, save_config
from app.dashboard.markup import FAINT, cell, row, small, table
from app.dashboard.notifications import Notifier
from app.dashboard.panels.parameter_widgets import ParameterWidgets
from app.dashboard.tuning import Tuning
from app.errors import ConfigError
from app.robot.description import RobotDescription

FIRST_NAME = "tuning"


class ConfigFilePanel:
    """A name, a button that saves, and one that loads, in the GUI container that is open."""

    def __init__(self, gui: viser.GuiApi, tuning: Tuning, notifier: Notifier) -> None:
        """Add the widgets.

        Args:
            gui: Of the page or of one client.
            tuning: What is saved, and takes over what is loaded.
            notifier: For what is wrong with a file.
        """
        self._tuning = tuning
        self._name = gui.add_text("Name", FIRST_NAME, hint="Of the file, without .toml")
        save = gui.add_button(
            "Save", icon=viser.Icon.DOWNLOAD, hint="For --config of dbb run, serve and sweep"
        )
        load = gui.add_upload_button(
            "Load",
            icon=viser.Icon.UPLOAD,
            color="gray",
            mime_type=".toml",
            hint="A TOML file; what is not in it goes to its default",
        )
        save.on_click(notifier.guard(self._save))  # type: ignore[arg-type]
        load.on_upload(notifier.guard(self._load))  # type: ignore[arg-type]

    def _save(self, event: Any) -> None:
        name = self._name.value.strip()
        text = save_config(self._tuning.config, name)
        event.client.send_file_download(
            file_name(name), text.encode("utf-8"), save_immediately=True
        )

    def _load(self, event: Any) -> None:
        file: viser.UploadedFile = event.target.value
        try:
            loaded = decode_config(file.content)
        except ConfigError as error:
            raise ConfigError(f"{file.name[:60]}: {error}") from None
        self._tuning.load(loaded.config)
        self._name.value = loaded.name or file.name.removesuffix(".toml")[:60]


def file_name(name: str) -> str:
    """A name for a file on any system, as in `stiff arm.toml`."""
    safe = re.sub(r"[^\w .+-]", "-", name).strip(" .")
    return f"{safe or FIRST_NAME}.toml"


MAIN = (
    "border.d_b",
    "force.f_max",
    "repulsion.k_p",
    "admittance.mass",
    "admittance.damping",
    "hand.stiffness",
)
"""What a first visitor may want to move."""
_BEFORE_SCORE = "border"  # section after which the score stands, as in the paper


class TuningPanel:
    """Folders of widgets, in the GUI container that is open when it is made.

    Attributes:
        widgets: The widgets of each parameter, by its path.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        tuning: Tuning,
        notifier: Notifier,
        paths: Iterable[str] | None = None,
        *,
        robot: RobotDescription | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Build the panel.

        Args:
            gui: Of the page or of one client.
            tuning: The configuration, which all viewers share.
            notifier: Reports refused values to their senders.
            paths: Parameters of a single folder without files, steps and resets of others; None
                is all of them, with those.
            robot: Whose numbers of the score are shown.
            clock: [s] for what waits for the end of typing.
        """
        self._gui, self._tuning, self._notifier, self._clock = gui, tuning, notifier, clock
        self.widgets: dict[str, ParameterWidgets] = {}
        self._folders: list[_Folder] = []
        self._seen: Config | None = None
        self._all: viser.GuiCheckboxHandle | None = None
        if paths is None:
            self._add_everything(robot)
        else:
            self._add_folder("Main parameters", tuple(paths), expand=True)
        self.update()

    def update(self) -> None:
        """Show what has changed, whoever changed it; called by the drawing thread."""
        config = self._tuning.config
        waiting = any(each.is_waiting for each in self.widgets.values())
        if config is self._seen and not waiting:
            return
        self._seen = config
        for each in self.widgets.values():
            each.update()
        for folder in self._folders:
            folder.update()
        self._show_advanced()

    def _add_everything(self, robot: RobotDescription | None) -> None:
        self._add_steps()
        self._all = self._gui.add_checkbox("Advanced", False, hint="Show all parameters")
        self._all.on_update(self._notifier.guard(lambda _: self._show_advanced()))  # type: ignore[arg-type]
        for section in sections():
            paths = tuple(each.path for each in section.tunables)
            self._add_folder(section.title, paths, expand=section.name == _BEFORE_SCORE)
            if section.name == _BEFORE_SCORE:
                with self._gui.add_folder("Score", expand_by_default=False):
                    self._gui.add_html(score_html(robot))
        with self._gui.add_folder("File"):
            ConfigFilePanel(self._gui, self._tuning, self._notifier)

    def _add_steps(self) -> None:
        tuning = self._tuning
        acts = {"Undo": tuning.undo, "Redo": tuning.redo, "Reset all": tuning.reset}
        steps = self._gui.add_button_group(
            "Changes", tuple(acts), hint="One step is one move of a slider, whoever moved it"
        )

        def pressed(event: Any) -> None:
            if (act := acts.get(event.target.value)) is not None:  # a program may send any word
                act()

        steps.on_click(self._notifier.guard(pressed))  # type: ignore[arg-type]

    def _add_folder(self, title: str, paths: tuple[str, ...], *, expand: bool) -> None:
        handle = self._gui.add_folder(title, expand_by_default=expand)
        with handle:
            widgets = [
                ParameterWidgets(self._gui, self._tuning, self._notifier, path, self._clock)
                for path in paths
            ]
            reset = self._gui.add_button(
                "Defaults",
                icon=viser.Icon.ARROW_BACK_UP,
                color="gray",
                disabled=True,
                hint="Set what stands above to its defaults",
            )
        reset.on_click(self._notifier.guard(lambda _: self._tuning.reset(paths)))  # type: ignore[arg-type]
        self.widgets |= dict(zip(paths, widgets, strict=True))
        self._folders.append(_Folder(handle, reset, title, widgets))

    def _show_advanced(self) -> None:
        wanted = self._all is None or self._all.value
        for each in self.widgets.values():
            each.show(visible=wanted or each.is_marked or not each.about.advanced)


class _Folder:
    """Its title says how many of its parameters are changed."""

    def __init__(
        self, handle: Any, reset: Any, title: str, widgets: list[ParameterWidgets]
    ) -> None:
        self._handle, self._reset, self._title, self._widgets = handle, reset, title, widgets

    def update(self) -> None:
        count = sum(each.is_marked for each in self._widgets)
        title = f"{self._title} · {count} changed" if count else self._title
        if self._handle.label != title:
            self._handle.label = title
            self._reset.disabled = not count


def score_html(robot: RobotDescription | None) -> str:
    """That the score has nothing to tune, and where its numbers come from."""
    head = row(*map(cell, ("body", "A [1/m²]", "B [m]", "C")), style=FAINT)
    rows = [
        row(*map(cell, (body, f"{r.A_per_m2:g}", f"{r.B_m:g}", f"{r.C:g}")))
        for body, r in (robot.reachability.items() if robot else ())
    ]
    return small(
        "Nothing to tune: det J_c of (7) follows from the wheels, and A, B, C of (9) are the "
        f"robot's, from its description.{table((head, *rows)) if rows else ''}"
    )
