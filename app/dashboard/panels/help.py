"""Help: the tab with the method on a page, the keys and commands, and the tour of a first visit."""

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from time import monotonic
from typing import Any, NamedTuple

import viser

from app.dashboard.notifications import Notifier
from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.viser_compat import Channel

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
_PAUSE = 2.5  # [s] between what was done and the next step


class Act(NamedTuple):
    """What a step of the tour is about, on one viewer's page."""

    place: str
    """The tab that the step stands in; empty for what is above all tabs."""
    show: Callable[[], None]
    """Does it for the visitor."""
    done: Callable[[], bool]
    """Whether it is done, by whomever."""


STEPS = (
    (
        "Drag the hand",
        "Pull one of the arrows at the gripper towards the base, by mouse or finger: a person's "
        "spring pulls the hand along. Any link of the arm can be pulled by itself.",
    ),
    (
        "Watch the base",
        "The coloured shell is the border around the base. Once the arm is inside, "
        "the base moves away: yellow is where it moves well, blue is where it cannot go.",
    ),
    (
        "Read why",
        "Here stands in words and numbers what moves the base. **Key** says what each colour and "
        "arrow means.",
    ),
    (
        "Go back in time",
        "The time line below the scene shows what was, with all readings and plots. Go back a few "
        "seconds; **Now** returns.",
    ),
    (
        "Compare",
        "Here other controllers run beside the real one, on the same pull. **Scenario** plays the "
        "paper's experiments, **Tune** has every parameter.",
    ),
)
"""Title and text of each step."""
SEEN = "dbb-tour-seen"
"""Key in the browser's own storage, where the page notes that it has asked for the tour."""


class Shortcut(NamedTuple):
    """One command: its label in the palette, its key or None, and what it does."""

    label: str
    key: Any
    action: Callable[[], None]


def add_shortcuts(gui: viser.GuiApi, shortcuts: list[Shortcut], notifier: Notifier) -> None:
    """Enter the commands into a viewer's palette."""
    for shortcut in shortcuts:
        command = gui.add_command(shortcut.label, hotkey=shortcut.key)
        command.on_trigger(notifier.guard(lambda _, action=shortcut.action: action()))


def add_help(gui: viser.GuiApi, shortcuts: list[Shortcut]) -> None:
    """Build the tab in the GUI container that is now open."""
    keys = ", ".join(f"`{s.key}` {s.label.lower()}" for s in shortcuts if s.key is not None)
    gui.add_markdown(TEXT.format(keys=keys))


class Tour(Panel):
    """Opens by itself at a first visit, and whenever `begin` is called.

    Each step stands in the panel that it speaks of, and waits until it is done: by the visitor, or
    for him. What happens before he has touched the page, as in a demonstration, is no step of his.
    """

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        self._card: viser.GuiFolderHandle | None = None
        self._step = self._wanted = -1  # that is shown, and that is to be
        self._next_at = math.inf

    def lead(self, channel: Channel, acts: Sequence[Act], places: Mapping[str, Any]) -> None:
        """Go on, on a new page, whose acts are those of `STEPS` and whose tabs have these names."""
        self._channel, self._acts, self._places = channel, tuple(acts), places
        self._card, self._step = None, -1
        channel.on("tour", self.begin)

    def begin(self) -> None:
        """Show the first step."""
        self._wanted = 0

    def end(self) -> None:
        """Close it."""
        self._wanted = -1

    def update(self, moment: Moment) -> None:
        if self._step != self._wanted:
            self._show(self._wanted)
        elif self._step >= 0 and self._next_at == math.inf:
            if "untouched" not in self._channel.seen and self._acts[self._step].done():
                self._next_at = monotonic() + _PAUSE
                self._said.content = "**Done.**"
        elif monotonic() > self._next_at:
            self._go_on()

    def _go_on(self) -> None:
        self._wanted = self._step + 1 if self._step + 1 < len(STEPS) else -1

    def _show(self, step: int) -> None:
        self._step, self._next_at = step, math.inf
        if self._card is not None:
            self._card.remove()
            self._card = None
        if step < 0:
            return
        (title, text), act = STEPS[step], self._acts[step]
        # On a narrow page all steps stand above the tabs.
        name = "" if "narrow" in self._channel.seen else act.place
        self._channel.tell("open", name)
        with self._places.get(name, nullcontext()):
            card = self._gui.add_folder(f"{step + 1} of {len(STEPS)}: {title}", order=-1.0)
        with card:
            self._gui.add_markdown(text)
            self._said = self._gui.add_markdown("")
            self.button("Show me", lambda _: act.show(), color="blue")
            last = step + 1 == len(STEPS)
            self.button("Done" if last else "Next", lambda _: self._go_on(), color="gray")
            if not last:
                self.button("Skip the tour", lambda _: self.end(), color="gray")
        self._card = card
