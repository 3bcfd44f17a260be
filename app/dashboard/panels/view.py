"""Tab "View": which layers are drawn."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.dashboard.notices import Notices
from app.dashboard.view import View


class ViewPanel:
    """Boxes and choices, each of which assigns one field of the view."""

    def __init__(self, server: viser.ViserServer, view: View, notices: Notices) -> None:
        """Build the tab in the GUI container that is now open."""
        self._view, self._notices = view, notices
        gui = server.gui
        with gui.add_folder("Layers"):
            self._bind("meshes", gui.add_checkbox("Robot", view.meshes))
            self._bind(
                "bodies",
                gui.add_checkbox(
                    "Convex bodies", view.bodies, hint="What distances are measured to"
                ),
            )
            self._bind("distances", gui.add_checkbox("Closest points", view.distances))
            self._bind(
                "labels",
                gui.add_dropdown(
                    "Distance labels", ("active", "all", "none"), initial_value=view.labels
                ),
            )
            self._bind(
                "acting",
                gui.add_checkbox(
                    "Acting points",
                    view.acting,
                    hint="p_n, p_t, p_act and the force: 0.1 m is 40 N",
                ),
            )
            self._bind(
                "whole_border",
                gui.add_checkbox(
                    "Border above base", view.whole_border,
                    hint="The part of the border above the base's top, which hides the arm",
                ),
            )  # fmt: skip
        with gui.add_folder("Page"):
            self._bind("follow", gui.add_checkbox("Follow the base", view.follow))
            self._bind("dark", gui.add_checkbox("Dark", view.dark))
            self.reset_camera = gui.add_button(
                "Reset camera", icon=viser.Icon.CAMERA_ROTATE, color="gray"
            )

    def _bind(self, field: str, handle: Any) -> None:
        bind(self._view, field, handle, self._notices)


def bind(view: View, field: str, handle: Any, notices: Notices) -> None:
    """Let a widget assign a field of the view."""

    def assign(event: Any) -> None:
        setattr(view, field, event.target.value)

    callback: Callable[..., Any] = notices.guard(assign)
    handle.on_update(callback)
