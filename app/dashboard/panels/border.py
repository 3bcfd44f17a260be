"""Which border is drawn, coloured by what: the choices above the sliders of "Border & force"."""

from __future__ import annotations

import viser

from app.dashboard.notices import Notices
from app.dashboard.panels.view import bind
from app.dashboard.view import View


def add_border_choice(
    server: viser.ViserServer, view: View, notices: Notices, pairs: list[str]
) -> None:
    """Two drop-down lists in the GUI container that is now open.

    Args:
        server: The page.
        view: What they assign to.
        notices: For what goes wrong.
        pairs: Names of the pairs of L_m.
    """
    pair = server.gui.add_dropdown("Border of", tuple(pairs), initial_value=view.pair)
    quantity = server.gui.add_dropdown(
        "Coloured by", ("score", "determinant", "reachability", "hidden"),
        initial_value=view.quantity,
    )  # fmt: skip
    bind(view, "pair", pair, notices)
    bind(view, "quantity", quantity, notices)
