"""Tab "View": layers, camera and plots of one viewer."""

from collections.abc import Callable
from dataclasses import fields
from functools import partial
from typing import Any

from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.scene.camera import PRESETS
from app.dashboard.view import BORDER, CHOICES, LABELS, LAYERS, PAGE, View


class ViewPanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, view = self._gui, viewer.view
        self._values: list[tuple[Any, Callable[[], Any]]] = []  # widgets, and getters of values
        with gui.add_folder(BORDER):
            for pair, quantity in view.borders.items():
                hint = f"Reachable points at the buffer distance from the base: DBB of {pair}, (3)"
                spoken, put = viewer.shared.spoken[pair], partial(view.borders.__setitem__, pair)
                box = gui.add_dropdown(spoken, CHOICES, initial_value=quantity, hint=hint)
                self._bind(box, partial(view.borders.get, pair), put)
            self._add(BORDER)
        with gui.add_folder(LAYERS):
            self._add(LAYERS)
        with gui.add_folder(PAGE):
            self.buttons("Camera", {name: partial(viewer.look, name) for name in PRESETS})
            self._add(PAGE)
        with gui.add_folder("Plots", expand_by_default=False):
            for title in (plan.title for plan in viewer.shared.plans):
                box = gui.add_checkbox(title, False)
                put = partial(self._plot, title)
                self._bind(box, lambda title=title: title in view.plots, put)

    def update(self, moment: Moment) -> None:
        for widget, value in self._values:
            self.follow(widget, value())

    def _bind(self, widget: Any, get: Callable[[], Any], put: Callable[[Any], None]) -> None:
        self.on_update(widget, lambda event: put(event.target.value))
        self._values.append((widget, get))

    def _add(self, folder: str) -> None:
        """Add a widget for each field of the view that belongs to the folder."""
        view = self._viewer.view
        for each in fields(View):
            if (about := each.metadata).get("folder") != folder:
                continue
            value = getattr(view, each.name)
            look: Any = {"initial_value": value, "hint": about["hint"]}
            if isinstance(value, bool):
                widget: Any = self._gui.add_checkbox(about["label"], **look)
            else:
                widget = self._gui.add_dropdown(about["label"], LABELS, **look)
            self._bind(widget, partial(getattr, view, each.name), partial(setattr, view, each.name))

    def _plot(self, title: str, chosen: bool) -> None:
        view = self._viewer.view
        view.plots = view.plots | {title} if chosen else view.plots - {title}
