"""Which border is drawn and which is used: the choices above the sliders of "Border & force"."""

from __future__ import annotations

import viser

from app.dashboard.notices import Notices
from app.dashboard.panels.tuning import Tuning
from app.dashboard.panels.view import bind
from app.dashboard.view import View


def add_border_choice(
    server: viser.ViserServer, view: View, tuning: Tuning, notices: Notices, pairs: list[str]
) -> None:
    """Three drop-down lists in the GUI container that is now open.

    Args:
        server: The page.
        view: What the first two assign to.
        tuning: What the third assigns to.
        notices: For what goes wrong.
        pairs: Names of the pairs of L_m.
    """
    kind = server.gui.add_dropdown(
        "Acting point on", ("surface", "points"), initial_value=tuning.config.border.kind,
        hint="surface: it moves with the hand. points: the paper's way, it jumps among the points.",
    )  # fmt: skip
    kind.on_update(
        notices.guard(lambda event: tuning.set("border.kind", event.target.value))  # type: ignore[arg-type]
    )
    pair = server.gui.add_dropdown("Border of", tuple(pairs), initial_value=view.pair)
    quantity = server.gui.add_dropdown(
        "Coloured by", ("score", "determinant", "reachability", "hidden"),
        initial_value=view.quantity,
    )  # fmt: skip
    bind(view, "pair", pair, notices)
    bind(view, "quantity", quantity, notices)
