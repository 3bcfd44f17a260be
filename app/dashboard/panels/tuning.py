"""All parameters in folders, made from the configuration's own records; or a few of them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import Any

import viser

from app.config import Config, sections
from app.dashboard.notifications import Notices
from app.dashboard.panels.config_file import ConfigFilePanel
from app.dashboard.panels.parameter_widgets import Knob
from app.dashboard.tuning import Tuning
from app.robot.description import RobotDescription

MAIN = (
    "border.d_b",
    "force.f_max",
    "repulsion.k_p",
    "admittance.mass",
    "admittance.damping",
    "hand.stiffness",
)
"""What a first visitor may want to move."""
_BEFORE_SCORE = "border"  # section after which the score stands, as in the paper


class TuningPanel:
    """Folders of widgets, in the GUI container that is open when it is made.

    Attributes:
        knobs: The widgets of each parameter, by its path.
    """

    def __init__(
        self,
        gui: viser.GuiApi,
        tuning: Tuning,
        notices: Notices,
        paths: Iterable[str] | None = None,
        *,
        robot: RobotDescription | None = None,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Build the panel.

        Args:
            gui: Of the page or of one client.
            tuning: The configuration, which all viewers share.
            notices: Tells who set a value that it was refused.
            paths: Parameters of a single folder without files, steps and resets of others; None
                is all of them, with those.
            robot: Whose numbers of the score are told.
            clock: [s] for what waits for the end of typing.
        """
        self._gui, self._tuning, self._notices, self._clock = gui, tuning, notices, clock
        self.knobs: dict[str, Knob] = {}
        self._folders: list[_Folder] = []
        self._seen: Config | None = None
        self._all: viser.GuiCheckboxHandle | None = None
        if paths is None:
            self._add_everything(robot)
        else:
            self._add_folder("Main parameters", tuple(paths), expand=True)
        self.update()

    def update(self) -> None:
        """Show what has changed, whoever changed it; called by the drawing thread."""
        config = self._tuning.config
        waiting = any(knob.is_waiting for knob in self.knobs.values())
        if config is self._seen and not waiting:
            return
        self._seen = config
        for knob in self.knobs.values():
            knob.update()
        for folder in self._folders:
            folder.update()
        self._show_advanced()

    def _add_everything(self, robot: RobotDescription | None) -> None:
        self._add_steps()
        self._all = self._gui.add_checkbox("Advanced", False, hint="Show all parameters")
        self._all.on_update(self._notices.guard(lambda _: self._show_advanced()))  # type: ignore[arg-type]
        for section in sections():
            paths = tuple(each.path for each in section.tunables)
            self._add_folder(section.title, paths, expand=section.name == _BEFORE_SCORE)
            if section.name == _BEFORE_SCORE:
                with self._gui.add_folder("Score", expand_by_default=False):
                    self._gui.add_html(score_html(robot))
        with self._gui.add_folder("File"):
            ConfigFilePanel(self._gui, self._tuning, self._notices)

    def _add_steps(self) -> None:
        tuning = self._tuning
        acts = {"Undo": tuning.undo, "Redo": tuning.redo, "Reset all": tuning.reset}
        steps = self._gui.add_button_group(
            "Changes", tuple(acts), hint="One step is one move of a slider, whoever moved it"
        )

        def pressed(event: Any) -> None:
            if (act := acts.get(event.target.value)) is not None:  # a program may send any word
                act()

        steps.on_click(self._notices.guard(pressed))  # type: ignore[arg-type]

    def _add_folder(self, title: str, paths: tuple[str, ...], *, expand: bool) -> None:
        handle = self._gui.add_folder(title, expand_by_default=expand)
        with handle:
            knobs = [
                Knob(self._gui, self._tuning, self._notices, path, self._clock) for path in paths
            ]
            reset = self._gui.add_button(
                "Defaults",
                icon=viser.Icon.ARROW_BACK_UP,
                color="gray",
                disabled=True,
                hint="Set what stands above to its defaults",
            )
        reset.on_click(self._notices.guard(lambda _: self._tuning.reset(paths)))  # type: ignore[arg-type]
        self.knobs |= dict(zip(paths, knobs, strict=True))
        self._folders.append(_Folder(handle, reset, title, knobs))

    def _show_advanced(self) -> None:
        wanted = self._all is None or self._all.value
        for knob in self.knobs.values():
            knob.show(visible=wanted or knob.is_marked or not knob.about.advanced)


class _Folder:
    """Its title says how many of its parameters are changed."""

    def __init__(self, handle: Any, reset: Any, title: str, knobs: list[Knob]) -> None:
        self._handle, self._reset, self._title, self._knobs = handle, reset, title, knobs

    def update(self) -> None:
        count = sum(knob.is_marked for knob in self._knobs)
        title = f"{self._title} · {count} changed" if count else self._title
        if self._handle.label != title:
            self._handle.label = title
            self._reset.disabled = not count


def score_html(robot: RobotDescription | None) -> str:
    """That the score has nothing to tune, and where its numbers come from."""
    rows = "".join(
        f"<tr><td>{body}</td><td>{r.A_per_m2:g}</td><td>{r.B_m:g}</td><td>{r.C:g}</td></tr>"
        for body, r in (robot.reachability.items() if robot else ())
    )
    table = (
        '<table style="width:100%;text-align:left;font-variant-numeric:tabular-nums">'
        '<tr style="opacity:.65"><td>body</td><td>A [1/m²]</td><td>B [m]</td><td>C</td></tr>'
        f"{rows}</table>"
        if rows
        else ""
    )
    return (
        '<div style="padding:0 .7em .5em;font-size:.82em;line-height:1.5">'
        "Nothing to tune: det J_c of (7) follows from the wheels, and A, B, C of (9) are the "
        f"robot's, from its description.{table}</div>"
    )
