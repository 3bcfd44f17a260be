"""Tab "Tune": widgets of all parameters, from the configuration's records, and parameter files.

The viewer's changes are checked, and changes by other viewers are shown.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import viser

from app.config import sections, tunable
from app.config_file import decode_config, save_config
from app.dashboard.markup import FAINT, cell, row, small, table
from app.dashboard.panels import Moment, Panel, Viewer
from app.errors import ConfigError
from app.parameters import Choice, Parameter
from app.robot.description import RobotDescription

DECIMALS = 6  # [-] decimals of a number box
MARK = "\N{NO-BREAK SPACE}•"  # after the label of a changed parameter
FIRST_NAME = "tuning"
_BEFORE_SCORE = "border"  # the score follows this section, as in the paper


class TuningPanel(Panel):
    """Folders of widgets."""

    def __init__(self, viewer: Viewer) -> None:
        """Create the panel; all viewers share the configuration."""
        super().__init__(viewer)
        self._viewer, self._tuning = viewer, viewer.shared.tuning
        self.widgets: dict[str, ParameterWidgets] = {}
        """Widgets of each parameter, by the parameter's path."""
        self._folders: list[_Folder] = []
        self._add_everything()
        self._show_advanced()

    def update(self, moment: Moment) -> None:
        for each in self.widgets.values():
            each.update(moment)
        for folder in self._folders:
            count = sum(self.widgets[path].is_marked for path in folder.paths)
            folder.handle.label = f"{folder.title} · {count} changed" if count else folder.title
            folder.reset.disabled = not count
        self._show_advanced()

    def _add_everything(self) -> None:
        tuning = self._tuning
        self.buttons(
            "Changes",
            {"Undo": tuning.undo, "Redo": tuning.redo, "Reset all": tuning.reset},
            hint="One step is one change of a parameter, by any viewer.",
        )
        self._all = self._gui.add_checkbox("Advanced", False, hint="Show all parameters")
        self.on_update(self._all, lambda _: self._show_advanced())
        for section in sections():
            paths = tuple(each.path for each in section.tunables)
            self._add_folder(section.title, paths, expand=section.name == _BEFORE_SCORE)
            if section.name == _BEFORE_SCORE:
                with self._gui.add_folder("Score", expand_by_default=False):
                    self._gui.add_html(score_html(self._viewer.shared.model.description))
        with self._gui.add_folder("File"):
            self._name = self._gui.add_text(
                "Name", FIRST_NAME, hint="Name of the file, without .toml"
            )
            self.button(
                "Save",
                self._save,
                viser.Icon.DOWNLOAD,
                hint="A TOML file for --config of dbb run, serve and sweep",
            )
            self.upload(
                "Load",
                self._load,
                color="gray",
                mime_type=".toml",
                hint="A TOML file; parameters that are not in it get their defaults",
            )

    def _add_folder(self, title: str, paths: tuple[str, ...], *, expand: bool) -> None:
        handle = self._gui.add_folder(title, expand_by_default=expand)
        with handle:
            for path in paths:
                self.widgets[path] = ParameterWidgets(self._viewer, path)
            reset = self.button(
                "Defaults",
                lambda _: self._tuning.reset(paths),
                viser.Icon.ARROW_BACK_UP,
                color="gray",
                disabled=True,
                hint="Reset the parameters of this folder",
            )
        self._folders.append(_Folder(handle, reset, title, paths))

    def _show_advanced(self) -> None:
        advanced = self._all.value
        for each in self.widgets.values():
            for handle in each.handles:
                handle.visible = advanced or each.is_marked or not each.about.advanced

    def _save(self, event: Any) -> None:
        name = self._name.value.strip()
        text = save_config(self._tuning.config, name)
        event.client.send_file_download(
            file_name(name), text.encode("utf-8"), save_immediately=True
        )

    def _load(self, event: Any) -> None:
        file: viser.UploadedFile = event.target.value
        try:
            loaded = decode_config(file.content, self._tuning.usual)
        except ConfigError as error:
            raise ConfigError(f"{file.name[:60]}: {error}") from None
        self._tuning.load(loaded.config)
        count = len(self._tuning.changes)
        self._notifier.tell(
            event.client, "Parameters", f"{file.name[:60]}: {count} changed from the defaults."
        )
        self._name.value = loaded.name or file.name.removesuffix(".toml")[:60]


class _Folder(NamedTuple):
    """Folder of parameters, whose title shows the number of changed ones."""

    handle: Any
    reset: Any
    title: str
    paths: tuple[str, ...]


def file_name(name: str) -> str:
    """Return a file name that is valid on all systems, as in `stiff arm.toml`."""
    safe = re.sub(r"[^\w .+-]", "-", name).strip(" .")
    return f"{safe or FIRST_NAME}.toml"


def score_html(robot: RobotDescription) -> str:
    """Explain that the score has no parameters, and show its constants."""
    head = row(*map(cell, ("body", "A [1/m²]", "B [m]", "C")), style=FAINT)
    rows = [
        row(*map(cell, (body, f"{r.A_per_m2:g}", f"{r.B_m:g}", f"{r.C:g}")))
        for body, r in robot.reachability.items()
    ]
    return small(
        "The score has no parameters: det J_c of (7) follows from the wheels; A, B, C of (9) are "
        f"in the robot's description.{table((head, *rows)) if rows else ''}"
    )


class ParameterWidgets(Panel):
    """Widgets of one parameter.

    A refused value changes nothing: its sender gets a message, and the widget is reset. A typed
    value arrives when it is complete.
    """

    def __init__(self, viewer: Viewer, path: str) -> None:
        """Add the widgets of the parameter at `path`; see `TuningPanel`."""
        super().__init__(viewer)
        self.about, self.is_marked = tunable(path), False
        """The parameter, and whether it differed from its default at the last update."""
        self._tuning = viewer.shared.tuning
        self._shown = self._tuning.config.value(path)
        self._faces = _faces(self._gui, self.about, self._shown)
        for face in self._faces:
            self.on_update(face.handle, partial(self._set, face))

    @property
    def handles(self) -> list[Any]:
        """The widgets; the first one shows the value itself."""
        return [face.handle for face in self._faces]

    def update(self, moment: Moment) -> None:
        """Show the present value.

        The drawing thread calls this method, and another thread handles the viewers' changes. If
        both assign a widget at the same time, the next update corrects the widget.
        """
        value = self._tuning.config.value(self.about.path)
        if value != self._shown:
            self._put(value)
        self.is_marked = value != self._tuning.usual.value(self.about.path)
        for face in self._faces:
            face.handle.label = face.label + (MARK if self.is_marked else "")

    def _set(self, face: _Face, event: Any) -> None:
        try:
            value = face.read(event.target.value)
            self._tuning.set(self.about.path, value)
        except ConfigError:
            self._put(self._tuning.config.value(self.about.path))
            raise
        self._put(value, but=face)

    def _put(self, value: float | str, but: _Face | None = None) -> None:
        self._shown = value
        for face in self._faces:
            if face is not but and face.read(face.handle.value) != value:
                face.handle.value = face.write(value)


class _Face(NamedTuple):
    """A widget, with the conversions of its value to that of the parameter and back."""

    handle: Any
    label: str
    read: Callable[[Any], Any] = lambda shown: shown
    write: Callable[[Any], Any] = lambda value: value


def _faces(gui: viser.GuiApi, about: Parameter | Choice, value: float | str) -> list[_Face]:
    title, hint = unbroken(about.title), about.help
    if isinstance(about, Choice):
        choice = gui.add_dropdown(title, about.choices, initial_value=str(value), hint=hint)
        return [_Face(choice, title)]
    value, hint = float(value), f"{hint} {about.allowed}"
    if not about.log:
        step = slider_step(about.low, about.high)
        slider = gui.add_slider(title, about.low, about.high, step, value, hint=hint)
        slider.precision = DECIMALS
        return [_Face(slider, title)]
    number = gui.add_number(title, value, min=about.low, max=about.high, step=1.0, hint=hint)
    number.precision = DECIMALS
    low, high = math.log10(about.low), math.log10(about.high)
    scale = f"{about.label}, 10ˣ"
    marks = ((low, f"{about.low:g}"), (high, power_of_ten(high)))
    slider = gui.add_slider(scale, low, high, 0.01, math.log10(value), marks=marks, hint=hint)
    return [_Face(number, title), _Face(slider, scale, read_exponent, math.log10)]


def read_exponent(exponent: float) -> float:
    """Return the value of a logarithmic slider, to three digits."""
    # The parameter's range refuses exponents beyond those of a double, and NaN.
    return float(f"{10.0**exponent:.3g}") if abs(exponent) < 300 else exponent * math.inf


def unbroken(title: str) -> str:
    """Return a title that can break only before its unit."""
    name, bracket, unit = title.partition("[")
    return name + bracket + unit.replace(" ", "\N{NO-BREAK SPACE}")


def power_of_ten(exponent: float) -> str:
    """Format a power with a whole exponent, as in 10⁶."""
    return "10" + f"{exponent:.0f}".translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))


def slider_step(low: float, high: float) -> float:
    """Return the power of ten that gives a slider 100 to 1000 steps."""
    return 10.0 ** math.floor(math.log10((high - low) / 100.0))
