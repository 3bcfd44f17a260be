"""A button in the tab "Run" that plays a case of a study again."""

from __future__ import annotations

import viser

from app.dashboard.drag import Sink
from app.dashboard.notifications import Notices
from app.simulation.loop.commands import Play
from app.simulation.scenarios.leading import Scenario


def add_case_button(gui: viser.GuiApi, sink: Sink, notices: Notices, scenario: Scenario) -> None:
    """Build it in the GUI container that is now open.

    Args:
        gui: Of the viewer.
        sink: Where commands go.
        notices: Tells the user what went wrong.
        scenario: That begins where the loop begins after a reset.
    """
    button = gui.add_button(
        "Play the case",
        icon=viser.Icon.PLAYER_TRACK_NEXT,
        hint=f"{scenario.about}: begins anew; whoever takes the hand ends it",
    )
    button.on_click(notices.guard(lambda _: sink.send(Play(scenario))))  # type: ignore[arg-type]
