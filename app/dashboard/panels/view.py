"""Tab "View": layers, camera and plots of one viewer."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import viser

from app.dashboard.notifications import Notifier
from app.dashboard.scene.camera import PRESETS
from app.dashboard.view import CHOICES, View


class ViewPanel:
    """Boxes and choices, each of which assigns one field of the view."""

    def __init__(
        self,
        gui: viser.GuiApi,
        view: View,
        notifier: Notifier,
        plots: list[str],
        look: Callable[[str], None],
    ) -> None:
        """Build the tab in the GUI container that is now open.

        Args:
            gui: Of the viewer.
            view: What is assigned to.
            notifier: For what goes wrong.
            plots: Titles of all plots.
            look: Takes the name of a camera's preset.
        """
        self._gui, self._view, self._notifier = gui, view, notifier
        with gui.add_folder("Border coloured by"):
            for pair, quantity in view.borders.items():
                choice = gui.add_dropdown(pair, CHOICES, initial_value=quantity)
                self._on_update(choice, self._border(pair))
            self._box(
                "whole_border",
                "Above the base too",
                "The part of the border above the base's top, which hides the arm",
            )
            self._box("slice", "Slice at the hand", "The border's contour at the hand's height")
        with gui.add_folder("Layers"):
            self._box("meshes", "Robot")
            self._box("bodies", "Convex bodies", "What distances are measured to")
            self._box("distances", "Closest points")
            labels = gui.add_dropdown(
                "Distances of", ("active", "all", "none"), initial_value=view.labels
            )
            self._on_update(labels, lambda event: setattr(view, "labels", event.target.value))
            self._box("acting", "Acting points", "p_n, p_t, p_act and the force of avoidance")
            self._box("names", "Names of points", "p_a, p_b, p_n, p_t and p_act")
            self._box("motion", "Person and base", "The person's force, and what the base is asked")
            self._box("trails", "Trails", "Where base and hand have been")
        with gui.add_folder("Camera and page"):
            cameras = gui.add_button_group("Look from", tuple(PRESETS))
            cameras.on_click(notifier.guard(lambda event: _look(look, event.target.value)))  # type: ignore[arg-type]
            self._box("follow", "Follow the base")
            self._box("dark", "Dark")
        with gui.add_folder("Plots", expand_by_default=False):
            for title in plots:
                box = gui.add_checkbox(title, title in view.plots)
                self._on_update(box, self._plot(title))

    def _box(self, field: str, label: str, hint: str | None = None) -> None:
        box = self._gui.add_checkbox(label, getattr(self._view, field), hint=hint)
        self._on_update(box, lambda event: setattr(self._view, field, bool(event.target.value)))

    def _border(self, pair: str) -> Callable[[Any], None]:
        def assign(event: Any) -> None:
            if event.target.value in CHOICES:  # the server does not check what a client sends
                self._view.borders[pair] = event.target.value

        return assign

    def _plot(self, title: str) -> Callable[[Any], None]:
        def assign(event: Any) -> None:
            plots = self._view.plots
            self._view.plots = plots | {title} if event.target.value else plots - {title}

        return assign

    def _on_update(self, handle: Any, callback: Callable[[Any], None]) -> None:
        handle.on_update(self._notifier.guard(callback))


def _look(look: Callable[[str], None], name: str) -> None:
    if name in PRESETS:  # the server does not check what a client sends
        look(name)
