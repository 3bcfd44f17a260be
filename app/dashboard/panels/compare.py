"""Tab "Compare": other controllers on the same input, and a scoreboard."""

from __future__ import annotations

import viser

from app.control.names import CONTROLLERS
from app.dashboard.drag import Sink
from app.dashboard.notifications import Notices
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
    """Chooses the robots beside the real one, and counts along."""

    def __init__(self, gui: viser.GuiApi, sink: Sink, notices: Notices) -> None:
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
            handle.on_update(notices.guard(lambda _: self._choose()))  # type: ignore[arg-type]
        self._scores = gui.add_html(scores_html(()))

    def update(self, newest: Snapshot, shown: Snapshot) -> None:
        """Show what is compared now, also if another viewer has chosen it.

        Args:
            newest: What the choices stand for.
            shown: Whose scores are told.
        """
        names = [ghost.controller for ghost in newest.ghosts]
        names += [NOBODY] * (len(self._choices) - len(names))
        if names != self._chosen:
            self._chosen = names
            for handle, name in zip(self._choices, names, strict=True):
                if handle.value != name:
                    handle.value = name
        html = scores_html(shown.scores)
        if self._scores.content != html:
            self._scores.content = html

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
        return '<div style="padding:.4em .8em;opacity:.65;font-size:.85em">nothing compared</div>'
    colours = ["currentColor", *(css(colour) for colour in GHOSTS)]
    heads = "".join(
        f'<th style="text-align:right;font-weight:600"><span style="color:{colour}">●</span> '
        f"{score.controller}</th>"
        for score, colour in zip(scores, colours, strict=False)
    )
    rows = "".join(
        f'<tr><td style="opacity:.65">{label}</td>'
        + "".join(f'<td style="text-align:right">{text(score)}</td>' for score in scores)
        + "</tr>"
        for label, text in _ROWS
    )
    return (
        '<table style="width:100%;font-size:.8em;line-height:1.7;padding:.3em .7em;'
        f'font-variant-numeric:tabular-nums"><tr><td></td>{heads}</tr>{rows}</table>'
    )
