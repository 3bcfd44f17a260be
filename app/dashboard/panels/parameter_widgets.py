"""Parameter widgets: what a viewer sets is checked, what others set is shown."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import viser

from app.config import tunable
from app.dashboard.notifications import Notifier
from app.dashboard.panels.widgets import renew
from app.dashboard.tuning import Tuning
from app.errors import ConfigError
from app.parameters import Choice, Parameter

PATIENCE = 2.0
"""[s] a refused value stands before it is set back: typing 0.2 begins with 0."""
LONGEST = 6.0
"""[s] of refused values on end, such as a flood, after which they are answered all the same."""
DECIMALS = 6
"""[-] that a number box takes."""
MARK = "\N{NO-BREAK SPACE}•"
"""Behind the label of what is not at its default."""


class ParameterWidgets:
    """Widgets of one parameter in the GUI container that is open when it is made.

    A value that is refused changes nothing, is reported to its sender, and is set back.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        tuning: Tuning,
        notifier: Notifier,
        path: str,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Add the widgets.

        Args:
            gui: Of the page or of one client.
            tuning: What they show and change.
            notifier: Reports refused values to their senders.
            path: Of the parameter.
            clock: [s] tells how long a refused value has stood.
        """
        self.about = tunable(path)
        self._tuning, self._notifier, self._clock = tuning, notifier, clock
        self._shown, self._marked = tuning.value(path), False
        self._refused: _Refused | None = None
        self._faces = _faces(gui, self.about, self._shown)
        for face in self._faces:
            face.handle.on_update(notifier.guard(self._listen(face)))
        self.update()

    @property
    def handles(self) -> list[Any]:
        """The widgets; the first one shows the value itself."""
        return [face.handle for face in self._faces]

    @property
    def is_waiting(self) -> bool:
        """Whether a refused value has yet to be answered."""
        return self._refused is not None

    @property
    def is_marked(self) -> bool:
        """Whether the parameter was not at its default at the last update."""
        return self._marked

    def show(self, *, visible: bool) -> None:
        """Show or hide the widgets."""
        for handle in self.handles:
            renew(handle, "visible", visible)

    def update(self) -> None:
        """Show what holds by now; answer a refused value that has stood long enough.

        Called by one thread only, not by the one that brings what people set. Should both write a
        widget at once, the next update mends it.
        """
        value = self._tuning.value(self.about.path)
        refused = self._refused
        if refused is not None and refused.is_due(self._clock()):
            self._refused = None
            self._put(value)
            self._notifier.warn(refused.client, str(refused.error))
        if value != self._shown:
            self._put(value)
        marked = value != self.about.default
        if marked != self._marked:
            self._marked = marked
            for face in self._faces:
                face.handle.label = face.label + (MARK if marked else "")

    def _listen(self, face: _Face) -> Callable[[Any], None]:
        def moved(event: Any) -> None:
            if event.client is None:  # this program has assigned it
                return
            try:
                value = face.read(face.handle.value)
                self._tuning.set(self.about.path, value)
            except ConfigError as error:
                now = self._clock()
                since = now if self._refused is None else self._refused.since
                self._refused = _Refused(event.client, error, since, now)
                return
            self._refused = None
            self._shown = value
            for other in self._faces:
                if other is not face:
                    other.put(value)

        return moved

    def _put(self, value: float | str) -> None:
        self._shown = value
        for face in self._faces:
            face.put(value)


class _Refused:
    """A value that a widget holds and that no parameter may have."""

    def __init__(self, client: Any, error: ConfigError, since: float, last: float) -> None:
        self.client, self.error, self.since, self.last = client, error, since, last

    def is_due(self, now: float) -> bool:
        return now - self.last > PATIENCE or now - self.since > LONGEST


class _Face:
    """A widget, and how its value is that of the parameter."""

    def __init__(self, handle: Any, label: str) -> None:
        self.handle, self.label = handle, label

    def read(self, shown: Any) -> float | str:
        return shown

    def put(self, value: float | str) -> None:
        renew(self.handle, "value", value)


class _Exponent(_Face):
    """A slider of the logarithm."""

    def read(self, shown: float) -> float:
        # Beyond a double's exponents, and not-a-number, the parameter's range refuses them.
        return rounded(10.0**shown) if abs(shown) < 300 else shown * math.inf

    def put(self, value: float | str) -> None:
        if isinstance(value, float) and self.read(self.handle.value) != value:
            self.handle.value = math.log10(value)


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
    return [_Face(number, title), _Exponent(slider, scale)]


def unbroken(title: str) -> str:
    """A title that is broken before its unit, if at all."""
    name, bracket, unit = title.partition("[")
    return name + bracket + unit.replace(" ", "\N{NO-BREAK SPACE}")


def rounded(value: float) -> float:
    """To three digits: what a logarithmic slider sets."""
    return float(f"{value:.3g}")


def power_of_ten(exponent: float) -> str:
    """As in 10⁶, for a whole exponent."""
    return "10" + f"{exponent:.0f}".translate(str.maketrans("0123456789", "⁰¹²³⁴⁵⁶⁷⁸⁹"))


def slider_step(low: float, high: float) -> float:
    """The power of ten that gives a slider 100 to 1000 steps."""
    return 10.0 ** math.floor(math.log10((high - low) / 100.0))
