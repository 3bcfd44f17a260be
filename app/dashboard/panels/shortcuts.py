"""Commands of the palette (Ctrl K), some with a key of their own."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import viser

from app.dashboard.notifications import Notices


class Shortcut(NamedTuple):
    """One command.

    Attributes:
        label: In the palette.
        key: That triggers it, or None.
        action: What it does.
    """

    label: str
    key: Any
    action: Callable[[], None]


def add_shortcuts(gui: viser.GuiApi, shortcuts: list[Shortcut], notices: Notices) -> None:
    """Enter the commands into a viewer's palette."""
    for shortcut in shortcuts:
        command = gui.add_command(shortcut.label, hotkey=shortcut.key)
        command.on_trigger(notices.guard(lambda _, action=shortcut.action: action()))  # type: ignore[arg-type]


def keys_text(shortcuts: list[Shortcut]) -> str:
    """The keys and what they do, as a line of markdown."""
    return ", ".join(f"`{s.key}` {s.label.lower()}" for s in shortcuts if s.key is not None)
