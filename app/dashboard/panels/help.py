"""Tab "Help": the method in a page, and the keys."""

from __future__ import annotations

import viser

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
