"""The control panel, one builder a tab."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import viser

from app.dashboard.notifications import Notifier


class Panel:
    """Widgets of one viewer, in the GUI container that is open when it is made.

    What a widget calls takes viser's event, and what it raises is shown to who used the widget.
    An `update` may assign everything each time: viser sends only what has changed.
    """

    def __init__(self, gui: viser.GuiApi, notifier: Notifier) -> None:
        """Nothing in it yet."""
        self._gui, self._notifier = gui, notifier
        self._followed: dict[int, Any] = {}

    def on_update(self, handle: Any, act: Callable[[Any], None]) -> None:
        """Call `act` when a person sets a widget, not when this program assigns it."""

        def updated(event: viser.GuiEvent) -> None:
            if event.client is not None:
                act(event)

        handle.on_update(self._notifier.guard(updated))

    def button(
        self, label: str, act: Callable[[Any], None], icon: Any = None, **look: Any
    ) -> viser.GuiButtonHandle:
        """Add a button; what else `GuiApi.add_button` takes goes on to it."""
        handle = self._gui.add_button(label, icon=icon, **look)
        handle.on_click(self._notifier.guard(act))
        return handle

    def buttons(
        self, label: str, acts: Mapping[str, Callable[[], None]], hint: str | None = None
    ) -> None:
        """Add a row of buttons: what is written on each, and what it does."""
        handle = self._gui.add_button_group(label, tuple(acts), hint=hint)
        handle.on_click(self._notifier.guard(lambda event: acts[event.target.value]()))

    def upload(self, label: str, act: Callable[[Any], None], **look: Any) -> Any:
        """Add a button that takes a file."""
        handle = self._gui.add_upload_button(label, icon=viser.Icon.UPLOAD, **look)
        handle.on_upload(self._notifier.guard(act))
        return handle

    def follow(self, handle: Any, value: Any) -> None:
        """Show what all viewers share once it changes, not while a person's choice is under way."""
        if self._followed.get(id(handle)) != value:
            self._followed[id(handle)] = handle.value = value
