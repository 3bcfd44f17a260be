"""Tab "Compare": other controllers on the same input, and a scoreboard."""

from __future__ import annotations

import viser

from app.control.controller import CONTROLLERS
from app.dashboard.drag import Sink
from app.dashboard.markup import FAINT, RIGHT, cell, mark, row, small, table
from app.dashboard.notifications import Notifier
from app.dashboard.panels.widgets import renew
from app.dashboard.scene.colours import GHOSTS, css
from app.simulation.loop.commands import Compare
from app.simulation.trace.comparison import Score
from app.simulation.trace.snapshot import Snapshot

NOBODY = "nobody"
"""Choice of no further robot."""
INPUTS = {"the hand's path": "path", "the person's force": "force"}
"""What the robots may have in common, as `Compare` names it."""
_ROWS = (
    ("least clearance", lambda score: f"{1000 * score.clearance:.0f} mm"),
    ("hand off target", lambda score: f"{1000 * score.error:.1f} mm"),
    ("… at most", lambda score: f"{1000 * score.error_max:.1f} mm"),
    ("way of the base", lambda score: f"{score.base_path:.2f} m"),
    ("largest jump of v̇", lambda score: f"{score.acceleration_jump:.3f} m/s²"),
    ("largest jump of ω̇", lambda score: f"{score.angular_jump:.3f} rad/s²"),
    ("… of a torque", lambda score: f"{score.torque_jump:.2f} N m"),
    ("steps in contact", lambda score: f"{score.contacts}"),
)


class ComparePanel:
    """Choice of the controllers beside the real one, and their scores."""

    def __init__(self, gui: viser.GuiApi, sink: Sink, notifier: Notifier) -> None:
        """Build the tab in the GUI container that is now open."""
        self._sink = sink
        self._chosen = [NOBODY, NOBODY]
        gui.add_markdown(
            "Translucent robots run the same input with other controllers and physics of their own."
        )
        self._choices = [
            gui.add_dropdown(label, (NOBODY, *CONTROLLERS))
            for label in ("Second robot", "Third robot")
        ]
        self._input = gui.add_dropdown("They share", tuple(INPUTS))
        for handle in (*self._choices, self._input):
            handle.on_update(notifier.guard(lambda _: self._choose()))  # type: ignore[arg-type]
        self._scores = gui.add_html(scores_html(()))

    def update(self, newest: Snapshot, shown: Snapshot) -> None:
        """Show what is compared now, also if another viewer has chosen it.

        Args:
            newest: What the choices stand for.
            shown: Whose scores are shown.
        """
        names = [ghost.controller for ghost in newest.ghosts]
        names += [NOBODY] * (len(self._choices) - len(names))
        if names != self._chosen:
            self._chosen = names
            for handle, name in zip(self._choices, names, strict=True):
                renew(handle, "value", name)
        renew(self._scores, "content", scores_html(shown.scores))

    def _choose(self) -> None:
        wanted = [handle.value for handle in self._choices]
        self._sink.send(
            Compare(
                tuple(name for name in wanted if name != NOBODY),
                INPUTS.get(self._input.value, "path"),
            )
        )


def scores_html(scores: tuple[Score, ...]) -> str:
    """The scoreboard: a column a robot, the real one first."""
    if not scores:
        return small("nothing compared", FAINT)
    colours = ["currentColor", *(css(colour) for colour in GHOSTS)]
    heads = (
        cell(f"{mark('●', colour)} <b>{score.controller}</b>", RIGHT)
        for score, colour in zip(scores, colours, strict=False)
    )
    rows = (
        row(cell(label, FAINT), *(cell(text(score), RIGHT) for score in scores))
        for label, text in _ROWS
    )
    return table((row(cell(), *heads), *rows), "font-size:.8em;line-height:1.7;padding:.3em .7em")
