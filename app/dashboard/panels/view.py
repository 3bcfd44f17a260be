"""Tab "View": layers, camera and plots of one viewer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from typing import Any

import viser

from app.dashboard.notifications import Notifier
from app.dashboard.panels import Panel
from app.dashboard.scene.camera import PRESETS
from app.dashboard.view import CHOICES, View


class ViewPanel(Panel):
    """Boxes and choices, each of which assigns one field of the view."""

    def __init__(
        self,
        gui: viser.GuiApi,
        view: View,
        notifier: Notifier,
        plots: list[str],
        look: Callable[[str], None],
        spoken: Mapping[str, str],
    ) -> None:
        """Build the tab.

        Args:
            gui: Of the viewer.
            view: What is assigned to.
            notifier: For what goes wrong.
            plots: Titles of all plots.
            look: Takes the name of a camera's preset.
            spoken: Link pairs in words, by their names.
        """
        super().__init__(gui, notifier)
        self._view = view
        with gui.add_folder("Border coloured by"):
            self._add_borders(spoken)
        with gui.add_folder("Layers"):
            self._add_layers()
        with gui.add_folder("Camera and page"):
            self.buttons("Look from", {name: partial(look, name) for name in PRESETS})
            self._box("follow", "Follow the base")
            self._box("dark", "Dark")
            self._box(
                "light",
                "Light drawing",
                "Fewer triangles and points, no shadows, fewer pictures: for a browser without a "
                "GPU, which gets it by itself",
            )
        with gui.add_folder("Plots", expand_by_default=False):
            for title in plots:
                box = gui.add_checkbox(title, title in view.plots)
                self.on_update(box, partial(self._plot, title))

    def _add_borders(self, spoken: Mapping[str, str]) -> None:
        for pair, quantity in self._view.borders.items():
            hint = f"P_i of {pair}: points at the distance d_b of the base, (3)"
            choice = self._gui.add_dropdown(
                spoken[pair], CHOICES, initial_value=quantity, hint=hint
            )
            self.on_update(choice, partial(self._colour, pair))
        self._box(
            "whole_border",
            "Above the base too",
            "The part of the border above the base's top, which hides the arm",
        )
        self._box(
            "shell",
            "As a body",
            "In the place of points; a click on it tells det, R and S there, and which way the "
            "base would go for an arm that is halfway in",
        )
        self._box("slice", "Slice at the hand", "The border's contour at the hand's height")

    def _add_layers(self) -> None:
        self._box("meshes", "Robot")
        self._box("bodies", "Convex bodies", "What distances are measured to")
        self._box("distances", "Closest points")
        labels = self._gui.add_dropdown(
            "Distances of", ("active", "all", "none"), initial_value=self._view.labels
        )
        self.on_update(labels, lambda event: setattr(self._view, "labels", event.target.value))
        self._box("acting", "Acting points", "p_n, p_t, p_act and the force of avoidance")
        self._box("names", "Names of points", "p_a and p_b of the nearest pair, p_n, p_t and p_act")
        self._box("motion", "Person and base", "The person's force, and what the base is asked")
        self._box("trails", "Trails", "Where base and hand have been")

    def _box(self, field: str, label: str, hint: str | None = None) -> None:
        box = self._gui.add_checkbox(label, getattr(self._view, field), hint=hint)
        self.on_update(box, lambda event: setattr(self._view, field, event.target.value))

    def _colour(self, pair: str, event: Any) -> None:
        self._view.borders[pair] = event.target.value

    def _plot(self, title: str, event: Any) -> None:
        plots = self._view.plots
        self._view.plots = plots | {title} if event.target.value else plots - {title}
