"""Sliders of parameters: range, unit and help come from the configuration, and so do the checks."""

from __future__ import annotations

import math
from collections.abc import Iterable

import viser

from app.config import Config, parameter
from app.dashboard.hand import Sink
from app.dashboard.notices import Notices
from app.errors import ConfigError
from app.simulation.snapshot import Configure

MAIN = {
    "Main parameters": (
        "border.d_b", "force.f_max", "repulsion.k_p", "admittance.mass", "admittance.damping",
        "hand.stiffness",
    ),
}  # fmt: skip
"""Folder of the tab "Run": what a first visitor may want to move, in sight at once."""
BORDER_AND_FORCE = {
    "Border": ("border.eps",),
    "Activation": ("activation.d_full",),
    "Force": ("force.alpha_min", "force.alpha_max", "force.alpha_gain"),
}
"""Folders of the tab "Border & force"."""
GAINS = {
    "Repulsion of the arm": ("repulsion.k_v",),
    "Admittance of the base": (
        "admittance.inertia", "admittance.angular_damping", "admittance.v_max",
        "admittance.omega_max", "admittance.period",
    ),
    "Person's hand": ("hand.damping", "hand.f_max"),
    "End-effector task": ("task.ee_stiffness", "task.ee_damping"),
    "Arm and base at rest": (
        "task.posture_stiffness", "task.posture_damping", "task.base_damping",
    ),
    "Disturbances": (
        "disturbance.encoder_noise", "disturbance.base_delay", "disturbance.mass_error",
        "disturbance.slip",
    ),
}  # fmt: skip
"""Folders of the tab "Gains"."""


class Tuning:
    """The configuration as the sliders have it: one for all viewers."""

    def __init__(self, sink: Sink, config: Config) -> None:
        self._sink = sink
        self.config = config

    def set(self, path: str, value: float | str) -> None:
        """Change one parameter and tell the simulation.

        Raises:
            ConfigError: The value is out of the parameter's range or not one of its choices, which
                viser does not check.
        """
        if self.value(path) == value:
            return
        self.config = self.config.replace(path, value)
        self._sink.send(Configure(self.config))

    def value(self, path: str) -> float:
        """The value of a parameter now."""
        section, _, name = path.partition(".")
        return getattr(getattr(self.config, section), name)


class TuningPanel:
    """Folders of sliders, and a button that sets them back."""

    def __init__(
        self, gui: viser.GuiApi, tuning: Tuning, notices: Notices,
        folders: dict[str, tuple[str, ...]],
    ) -> None:  # fmt: skip
        """Build the tab in the GUI container that is now open."""
        self._tuning = tuning
        self.sliders: dict[str, viser.GuiSliderHandle[float]] = {}
        for title, paths in folders.items():
            with gui.add_folder(title):
                for path in paths:
                    self._add_slider(gui, notices, path)
        default = gui.add_button("Defaults", icon=viser.Icon.ARROW_BACK_UP, color="gray")
        default.on_click(notices.guard(lambda _: self.reset()))  # type: ignore[arg-type]

    def reset(self, paths: Iterable[str] | None = None) -> None:
        """Set parameters of this tab, by default all, to their defaults."""
        for path in self.sliders if paths is None else paths:
            self._tuning.set(path, parameter(path).default)
            self.sliders[path].value = self._tuning.value(path)

    def _add_slider(self, gui: viser.GuiApi, notices: Notices, path: str) -> None:
        about = parameter(path)
        slider = gui.add_slider(
            label(path), min=float(about.low), max=float(about.high),
            step=slider_step(about.low, about.high),
            initial_value=float(self._tuning.value(path)), hint=about.help or None,
        )  # fmt: skip
        self.sliders[path] = slider

        def moved(event: viser.GuiEvent) -> None:
            apply(self._tuning, path, event.target)

        slider.on_update(notices.guard(moved))  # type: ignore[arg-type]


def apply(tuning: Tuning, path: str, slider: viser.GuiSliderHandle[float]) -> None:
    """Take the slider's value over, or set the slider back.

    Raises:
        ConfigError: The value is out of range.
    """
    try:
        tuning.set(path, slider.value)
    except ConfigError:
        slider.value = tuning.value(path)
        raise


def label(path: str) -> str:
    """Name and unit of a parameter, with Greek letters, as in `α_min [m]`."""
    section, _, name = path.partition(".")
    if section in {"admittance", "hand"}:  # else a mass or a stiffness could be anybody's
        name = f"{section}_{name}"
    name = name.replace("alpha", "α").replace("eps", "ε").replace("omega", "ω")
    symbol = (
        name
        if name in {"d_b", "ε", "f_max", "k_p", "k_v", "d_full"} or "α" in name
        else (name.removeprefix("ee_").removeprefix("posture_").replace("_", " "))
    )
    unit = parameter(path).unit
    return symbol if unit == "-" else f"{symbol} [{unit}]"


def slider_step(low: float, high: float) -> float:
    """The power of ten that gives a slider 100 to 1000 steps."""
    return 10.0 ** math.floor(math.log10((high - low) / 100.0))
