"""Channel: what the page's own script and this program say to each other.

viser has no widget that spans the page or reads a number as a person typed it; `controls.js` has.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser

from app.dashboard.notifications import Notifier
from app.dashboard.viser_compat import number_ranges, run_script, widget_name

_SCRIPT = Path(__file__).with_name("controls.js").read_text(encoding="utf-8")


class Channel:
    """Of one viewer's page: calls functions of its script, and is told words by it."""

    def __init__(self, client: viser.ClientHandle, notifier: Notifier) -> None:
        """Send the script; a script that is there already ends."""
        self._client, self._acts = client, dict[str, Callable[..., None]]()
        self._box = client.gui.add_text("", "", visible=False)
        self._box.on_update(notifier.guard(self._hear))
        self.on("refused", lambda text: notifier.warn(client, str(text)[:300]))
        run_script(client, _SCRIPT)

    def begin(self) -> None:
        """Say where the page's answers go, and which numbers its boxes take."""
        self.tell("begin", widget_name(self._box), number_ranges(self._client.gui))

    def tell(self, function: str, *values: Any) -> None:
        """Call a function of the script with values that JSON can have."""
        told = json.dumps(values, separators=(",", ":"), allow_nan=False)
        run_script(self._client, f"dbb.{function}(...{told})")

    def on(self, word: str, act: Callable[..., None]) -> None:
        """Call `act` with the values that the page says after a word."""
        self._acts[word] = act

    def _hear(self, event: viser.GuiEvent) -> None:
        if event.client is None:
            return
        try:
            _, word, *values = json.loads(event.target.value)
            act = self._acts[word]
        except (ValueError, TypeError, KeyError):  # no page of this program says so
            return
        if all(isinstance(value, str | int | float) for value in values):
            act(*values)
