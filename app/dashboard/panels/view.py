"""Tab "View": layers, camera and plots of one viewer."""

from dataclasses import fields
from functools import partial
from typing import Any

from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.scene.camera import PRESETS
from app.dashboard.view import BORDER, CHOICES, LABELS, LAYERS, PAGE, View


class ViewPanel(Panel):
    """Check boxes and lists for the fields of the view, and camera buttons."""

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, self._view = self._gui, viewer.view
        self._widgets: dict[str, Any] = {}  # widgets by the field of the view
        with gui.add_folder(BORDER):
            for pair, quantity in self._view.borders.items():
                hint = f"Reachable points at the buffer distance from the base: DBB of {pair}, (3)"
                spoken = viewer.shared.spoken[pair]
                choice = gui.add_dropdown(spoken, CHOICES, initial_value=quantity, hint=hint)
                self.on_update(choice, partial(self._colour, pair))
            self._add(BORDER)
        with gui.add_folder(LAYERS):
            self._add(LAYERS)
        with gui.add_folder(PAGE):
            self.buttons("Camera", {name: partial(viewer.look, name) for name in PRESETS})
            self._add(PAGE)
        with gui.add_folder("Plots", expand_by_default=False):
            titles = [plan.title for plan in viewer.shared.plans]
            self._plots = {
                title: self.on_update(gui.add_checkbox(title, False), partial(self._plot, title))
                for title in titles
            }

    def update(self, moment: Moment) -> None:
        for field, widget in self._widgets.items():
            self.follow(widget, getattr(self._view, field))
        for title, box in self._plots.items():
            self.follow(box, title in self._view.plots)

    def _add(self, folder: str) -> None:
        for each in fields(View):
            about = each.metadata
            if about.get("folder") != folder:
                continue
            value = getattr(self._view, each.name)
            look: Any = {"initial_value": value, "hint": about["hint"]}
            if isinstance(value, bool):
                widget: Any = self._gui.add_checkbox(about["label"], **look)
            else:
                widget = self._gui.add_dropdown(about["label"], LABELS, **look)
            self._widgets[each.name] = self.on_update(widget, partial(self._assign, each.name))

    def _assign(self, field: str, event: Any) -> None:
        setattr(self._view, field, event.target.value)

    def _colour(self, pair: str, event: Any) -> None:
        self._view.borders[pair] = event.target.value

    def _plot(self, title: str, event: Any) -> None:
        plots = self._view.plots
        self._view.plots = plots | {title} if event.target.value else plots - {title}
