"""Which border is used: the choice above the sliders of "Border & force"."""

from __future__ import annotations

import viser

from app.dashboard.notices import Notices
from app.dashboard.panels.tuning import Tuning


def add_border_choice(gui: viser.GuiApi, tuning: Tuning, notices: Notices) -> None:
    """A drop-down list in the GUI container that is now open.

    Args:
        gui: Of the viewer.
        tuning: What is assigned to.
        notices: For what goes wrong.
    """
    kind = gui.add_dropdown(
        "Acting point on", ("surface", "points"), initial_value=tuning.config.border.kind,
        hint="surface: it moves with the hand. points: the paper's way, it jumps among the points.",
    )  # fmt: skip
    kind.on_update(
        notices.guard(lambda event: tuning.set("border.kind", event.target.value))  # type: ignore[arg-type]
    )
