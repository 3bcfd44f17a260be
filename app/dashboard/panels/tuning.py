"""Tab "Tune": widgets of all parameters, which the viewers share, and files of parameters."""

from __future__ import annotations

import math
import re
from typing import Any

import viser

from app.config import sections, tunable
from app.config_file import decode_config, save_config
from app.dashboard.markup import banner
from app.dashboard.panels import Moment, Panel, Viewer
from app.errors import ConfigError
from app.simulation.trace.snapshot import Snapshot

MARK = "\N{NO-BREAK SPACE}•"  # after the label of a changed parameter
FIRST_NAME = "tuning"


class TuningPanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        tuning = self._tuning = viewer.shared.tuning
        self.widgets: dict[str, ParameterWidget] = {}  # by the parameter's path
        # Folder, reset button, title, and paths of the parameters of each section:
        self._folders: list[tuple[Any, Any, str, tuple[str, ...]]] = []
        acts = {"Undo": tuning.undo, "Redo": tuning.redo, "Reset all": self._reset}
        hint = "A changed parameter, a loaded file or a reset is a step. All viewers share them."
        self.buttons("Changes", acts, hint)
        self._all = self._gui.add_checkbox("Advanced", False, hint="Show all parameters")
        self.on_update(self._all, lambda _: self._show_advanced())
        for section in sections():
            first = section.name == "border"
            paths = tuple(each.path for each in section.tunables)
            with self._gui.add_folder(section.title, expand_by_default=first) as folder:
                for path in paths:
                    self.widgets[path] = ParameterWidget(viewer, path)
                if first:  # below the widgets, which must not move under the pointer
                    self.changing = self._gui.add_html("")
                undo, icon = (lambda _, paths=paths: tuning.reset(paths)), viser.Icon.ARROW_BACK_UP
                look: Any = {"color": "gray", "hint": "Reset the parameters of this folder"}
                reset = self.button("Defaults", undo, icon, disabled=True, **look)
            self._folders.append((folder, reset, section.title, paths))
        with self._gui.add_folder("File"):
            hint = "Name of the file, without .toml"
            self._name = self._gui.add_text("Name", FIRST_NAME, hint=hint)
            hint = "A TOML file for the option --config, for example of dbb run"
            self.button("Save", self._save, viser.Icon.DOWNLOAD, hint=hint)
            hint = "A TOML file; parameters that are not in the file get their defaults"
            self.upload("Load", self._load, color="gray", mime_type=".toml", hint=hint)
        self._show_advanced()

    def update(self, moment: Moment) -> None:
        self.changing.content = changing_html(moment.newest)
        changes = self._tuning.changes
        for path, widget in self.widgets.items():
            widget.is_marked = path in changes
        for folder, reset, title, paths in self._folders:
            count = sum(path in changes for path in paths)
            folder.label = f"{title} · {count} changed" if count else title
            reset.disabled = not count
        self._show_advanced()

    def _reset(self) -> None:
        if not self._tuning.changes:
            raise ConfigError("nothing to reset: all parameters have their defaults")
        self._tuning.reset()

    def _show_advanced(self) -> None:
        advanced = self._all.value
        for each in self.widgets.values():
            for handle in filter(None, (each.handle, each.exponent)):
                handle.visible = advanced or each.is_marked or not each.about.advanced

    def _save(self, event: Any) -> None:
        name = self._name.value.strip()
        data = save_config(self._tuning.config, name).encode()
        event.client.send_file_download(file_name(name), data, save_immediately=True)

    def _load(self, event: Any) -> None:
        file: viser.UploadedFile = event.target.value
        try:
            loaded = decode_config(file.content, self._tuning.usual)
        except ConfigError as error:
            raise ConfigError(f"{file.name[:60]}: {error}") from None
        self._tuning.load(loaded.config)
        text = f"{file.name[:60]}: {len(self._tuning.changes)} changed from the defaults."
        self._notifier.tell(event.client, "Parameters", text)
        self._name.value = loaded.name or file.name.removesuffix(".toml")[:60]


def changing_html(newest: Snapshot) -> str:
    """Return a note as HTML while d_b changes to a new value, or an empty string."""
    slowly = "d_b changes slowly: a jump would suddenly push away an arm inside the buffer."
    about = "The simulation is paused; d_b changes once it continues." if newest.paused else slowly
    return banner("notice", newest.changing, about) if newest.changing else ""


def file_name(name: str) -> str:
    """Return a file's name such as `stiff arm.toml`; "-" replaces forbidden characters."""
    return (re.sub(r"[^\w .+-]", "-", name).strip(" .") or FIRST_NAME) + ".toml"


class ParameterWidget(Panel):
    """Widget of one parameter; for a range of several powers of ten, also a logarithmic slider."""

    def __init__(self, viewer: Viewer, path: str) -> None:
        super().__init__(viewer)
        self.about = about = tunable(path)
        self.is_marked = False  # whether the value differs from its default; set before each update
        self._tuning, self._title = viewer.shared.tuning, unbroken(about.title)
        gui, value, low, high = self._gui, self._tuning.config.value(path), about.low, about.high
        title, tip = self._title, f"{about.help} {about.allowed}"
        self.exponent: Any = None  # slider of the value's decimal logarithm
        if about.choices:
            look: Any = {"initial_value": str(value), "hint": about.help}
            self.handle: Any = gui.add_dropdown(title, about.choices, **look)
        elif about.log:
            self.handle = gui.add_number(title, float(value), min=low, max=high, step=1.0, hint=tip)
            label, least, most = f"{about.label}, 10ˣ", math.log10(low), math.log10(high)
            look = {"marks": ((least, f"{low:g}"), (most, f"{high:g}")), "hint": about.help}
            self.exponent = gui.add_slider(label, least, most, 0.01, _power_of(value), **look)
        else:
            step = slider_step(low, high)
            self.handle = gui.add_slider(title, low, high, step, float(value), hint=tip)
        if not about.choices:
            self.handle.precision = 6
        for handle in filter(None, (self.handle, self.exponent)):
            self.on_update(handle, self._set)

    def update(self, moment: Moment) -> None:
        value = self._tuning.config.value(self.about.path)
        self.follow(self.handle, value)
        self.handle.label = self._title + (MARK if self.is_marked else "")
        if self.exponent is not None:
            self.follow(self.exponent, _power_of(value))

    def _set(self, event: Any) -> None:
        sent, is_power = event.target.value, event.target is self.exponent
        if is_power:  # the value is 10 to this power, or ±inf from ±300 on
            sent = float(f"{10.0**sent:.3g}") if abs(sent) < 300 else sent * math.inf
        try:
            self._tuning.set(self.about.path, sent)
        finally:
            value = self._tuning.config.value(self.about.path)
            event.target.value = _power_of(value) if is_power else value


def _power_of(value: float | str) -> float:
    """Return the decimal logarithm of a value, rounded to the slider's step."""
    return round(math.log10(float(value)), 2)


def unbroken(title: str) -> str:
    """Return a title in which no line break separates the parts of its unit."""
    name, bracket, unit = title.partition("[")
    return name + bracket + unit.replace(" ", "\N{NO-BREAK SPACE}")


def slider_step(low: float, high: float) -> float:
    """Return a slider's step: the power of ten that divides the range into 100 to 1000 steps."""
    return 10.0 ** math.floor(math.log10((high - low) / 100.0))
