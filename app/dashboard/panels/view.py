"""Tab "View": layers, camera and plots of one viewer."""

from dataclasses import fields
from functools import partial
from typing import Any

from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.scene.camera import PRESETS
from app.dashboard.view import BORDER, CHOICES, LAYERS, PAGE, View


class ViewPanel(Panel):
    """Check boxes and lists for the fields of the view, and camera buttons."""

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, self._view = self._gui, viewer.view
        self._widgets: dict[str, Any] = {}
        """Widgets by the field of the view."""
        with gui.add_folder(BORDER):
            for pair, quantity in self._view.borders.items():
                hint = f"Reachable points at the buffer distance from the base: P_i of {pair}, (3)"
                spoken = viewer.shared.spoken[pair]
                choice = gui.add_dropdown(spoken, CHOICES, initial_value=quantity, hint=hint)
                assign = partial(self._view.borders.__setitem__, pair)
                self.on_update(choice, lambda event, assign=assign: assign(event.target.value))
            self._add(BORDER)
        with gui.add_folder(LAYERS):
            self._add(LAYERS)
        with gui.add_folder(PAGE):
            self.buttons("Camera", {name: partial(viewer.look, name) for name in PRESETS})
            self._add(PAGE)
        with gui.add_folder("Plots", expand_by_default=False):
            titles = [plan.title for plan in viewer.shared.plans]
            self._plots = {title: gui.add_checkbox(title, False) for title in titles}
            for title, box in self._plots.items():
                self.on_update(box, partial(self._plot, title))

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
            choices: tuple[Any, ...] = (about["choices"],) if about["choices"] else ()
            add: Any = self._gui.add_dropdown if choices else self._gui.add_checkbox
            value = getattr(self._view, each.name)
            widget = add(about["label"], *choices, initial_value=value, hint=about["hint"])
            self._widgets[each.name] = widget
            assign = partial(setattr, self._view, each.name)
            self.on_update(widget, lambda event, assign=assign: assign(event.target.value))

    def _plot(self, title: str, event: Any) -> None:
        plots = self._view.plots
        self._view.plots = plots | {title} if event.target.value else plots - {title}
