"""Help: the tab with the method on a page, the keys and commands, and the tour of a first visit."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any, NamedTuple

import viser

from app.dashboard.notifications import Notifier


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


def add_shortcuts(gui: viser.GuiApi, shortcuts: list[Shortcut], notifier: Notifier) -> None:
    """Enter the commands into a viewer's palette."""
    for shortcut in shortcuts:
        command = gui.add_command(shortcut.label, hotkey=shortcut.key)
        command.on_trigger(notifier.guard(lambda _, action=shortcut.action: action()))  # type: ignore[arg-type]


def keys_text(shortcuts: list[Shortcut]) -> str:
    """The keys and what they do, as a line of markdown."""
    return ", ".join(f"`{s.key}` {s.label.lower()}" for s in shortcuts if s.key is not None)


TEXT = """
**Drag the hand** by the arrows at the gripper, or any link of the arm by itself: a person's spring
pulls it there. The stack lets the arm follow, and the base gets out of its way.

**How.** Around the base lies its *distance buffer border* (DBB): all points at the distance d_b
from it that the arm can reach. Each point has a *score* S: how well a force on the base there
moves it (the determinant of (7): zero on the wheel axis, where a differential drive cannot go
sideways) and how well the arm reaches it (R of (9)). When the arm comes nearer than d_b:

1. p_n is the border's point nearest to the hand, p_t lies from it along the border towards the
   better score, p_act between hand and p_t is where the force acts.
2. The force pushes there, the stronger the nearer the arm is. It moves the base away and turns
   it to where it can move.
3. A QP puts this before the hand's own task, faded in by β from 0 at d_b to 1 at
   d_full, so nothing jumps. Torques go to the arm at 1 kHz, velocities to the base at 10 Hz.

**Tabs.** *Why* says in words what happens now. *Plots* shows the last 20 s. *View* has layers and
cameras, *Compare* other controllers on the same input, *Tune* all parameters, *Robot* other
robots and yours, *Save* pictures, logs and replays.

**Keys** (outside of text fields): {keys}. `Ctrl K` opens the list of commands.

Several people may look at once: each has a view and a place in time of his own; the simulation
is one, and whoever pulls adds a force.
"""


def add_help(gui: viser.GuiApi, keys: str) -> None:
    """Build the tab in the GUI container that is now open.

    Args:
        gui: Of the viewer.
        keys: The shortcuts, as text.
    """
    gui.add_markdown(TEXT.format(keys=keys))


STEPS = (
    (
        "Drag the hand",
        "Pull one of the arrows at the gripper towards the base: a person's spring "
        "pulls the hand along. Any link of the arm can be pulled by itself.",
    ),
    (
        "Watch the base",
        "The coloured shell is the border around the base. Once the arm is inside, "
        "the base moves away: yellow is where it moves well, blue is where it cannot go.",
    ),
    (
        "Read why",
        "The tab **Why** on the left says in words and numbers what moves the base, and "
        "**Key** what each colour and arrow means.",
    ),
    (
        "Go back in time",
        "The slider below the scene shows the last minute again, with all readings "
        "and plots. **Now** returns.",
    ),
    (
        "Compare and tune",
        "**Scenario** plays the paper's experiments. **Compare** runs other "
        "controllers on the same pull, **Tune** has every parameter.",
    ),
)
"""Title and text of each step."""
SEEN = "dbb-tour-seen"  # key in the browser's own storage
_PATIENCE = 5.0  # [s] for the browser's answer


class Tour:
    """Opens by itself at a first visit, and whenever `begin` is called."""

    def __init__(self, client: viser.ClientHandle, notifier: Notifier) -> None:
        """Ask the browser whether it has been here before.

        Args:
            client: The viewer.
            notifier: For what goes wrong.
        """
        self._client, self._notifier = client, notifier
        self._modal: viser.GuiModalHandle | None = None
        self._step = 0
        threading.Thread(target=self._ask, name="tour", daemon=True).start()

    def begin(self) -> None:
        """Show the first step."""
        self._step = 0
        self._show()

    def _ask(self) -> None:
        storage = self._client.local_storage
        try:
            seen = storage.get_item(SEEN, timeout=_PATIENCE)
        except (RuntimeError, TimeoutError):  # gone already, or without storage
            return
        if seen is None:
            storage.set_item(SEEN, "yes")
            self.begin()

    def _show(self) -> None:
        self.end()
        title, text = STEPS[self._step]
        gui = self._client.gui
        modal = self._modal = gui.add_modal(f"{self._step + 1} of {len(STEPS)}: {title}")
        with modal:
            gui.add_markdown(text)
            last = self._step + 1 == len(STEPS)
            self._button("Done" if last else "Next", self.end if last else self._next)
            if not last:
                self._button("Skip the tour", self.end)

    def end(self) -> None:
        """Close it."""
        if self._modal is not None:
            self._modal.close()
            self._modal = None

    def _next(self) -> None:
        self._step += 1
        self._show()

    def _button(self, label: str, action: Callable[[], None]) -> None:
        button = self._client.gui.add_button(label)
        button.on_click(self._notifier.guard(lambda _: action()))  # type: ignore[arg-type]
