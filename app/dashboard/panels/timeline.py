"""The time line under the scene: stop, look back, step, go on; mark an interval."""

from __future__ import annotations

import math

import viser

from app.dashboard.drag import Sink
from app.dashboard.notifications import Notices
from app.dashboard.timeline import FRAME, REACH, Timeline
from app.simulation.loop.commands import Pause, StepOnce
from app.simulation.trace.snapshot import Snapshot

WIDTH = 520  # [px]
_STEPS = {"−1 s": -1.0, "−20 ms": -FRAME, "+20 ms": FRAME, "+1 s": 1.0}
_PAUSE, _NOW = "Stop / go", "Now"
_MARKS = ("Mark begin", "Mark end", "No marks")


class TimelinePanel:
    """Slider and buttons over one viewer's place in time."""

    def __init__(self, gui: viser.GuiApi, timeline: Timeline, sink: Sink, notices: Notices) -> None:
        """Open the panel, floating under the scene.

        Args:
            gui: Of the viewer.
            timeline: What is moved.
            sink: Where commands go.
            notices: For what goes wrong.
        """
        self._timeline, self._sink = timeline, sink
        self._set = 0.0
        self._newest: Snapshot | None = None
        panel = gui.add_panel()
        with panel.add_tab("Time line", viser.Icon.HISTORY):
            self._text = gui.add_html("")
            self._slider = gui.add_slider(
                "Back [s]",
                min=-REACH,
                max=0.0,
                step=FRAME,
                initial_value=0.0,
                hint="Shows the scene, readings and plots as they were; the simulation goes on.",
            )
            back, on = tuple(_STEPS)[:2], tuple(_STEPS)[2:]
            go = gui.add_button_group("Go", (*back, _PAUSE, *on, _NOW))
            marks = gui.add_button_group("Interval", _MARKS)
        panel.float(x=12, y=-12, width=WIDTH)
        self._slider.on_update(notices.guard(self._slide))  # type: ignore[arg-type]
        go.on_click(notices.guard(self._press))  # type: ignore[arg-type]
        marks.on_click(notices.guard(self._mark))  # type: ignore[arg-type]

    def step(self, seconds: float) -> None:
        """Go on or back; where time stands still at now, one step on is simulated."""
        newest = self._newest
        at_now = self._timeline.live and newest is not None and newest.paused
        if at_now and seconds > 0.0:
            self._sink.send(StepOnce(seconds))
        else:
            self._timeline.step(seconds)

    def update(self, newest: Snapshot, shown: Snapshot) -> None:
        """Renew text and slider."""
        self._newest = newest
        text = time_html(newest, shown, self._timeline)
        if self._text.content != text:
            self._text.content = text
        back = -round(self._timeline.back / FRAME) * FRAME
        if abs(back - self._slider.value) > 0.5 * FRAME:
            self._set = back
            self._slider.value = back

    def _slide(self, event: viser.GuiEvent) -> None:
        value = event.target.value
        if not isinstance(value, (int, float)) or not math.isfinite(value):
            return  # the server does not check what a client sends
        if abs(value - self._set) < 0.5 * FRAME:  # set by `update`
            return
        self._set = value
        self._timeline.look_back(-value)

    def _press(self, event: viser.GuiEvent) -> None:
        choice = event.target.value
        if choice == _NOW:
            self._timeline.go_live()
        elif choice == _PAUSE:
            self._sink.send(Pause(self._newest is None or not self._newest.paused))
        elif choice in _STEPS:
            self.step(_STEPS[choice])

    def _mark(self, event: viser.GuiEvent) -> None:
        begin, end, neither = _MARKS
        if event.target.value == begin:
            self._timeline.mark_begin()
        elif event.target.value == end:
            self._timeline.mark_end()
        elif event.target.value == neither:  # a program may send any word
            self._timeline.begin = self._timeline.end = None


def time_html(newest: Snapshot, shown: Snapshot, timeline: Timeline) -> str:
    """Which instant is shown, and which interval is marked."""
    state = "paused" if newest.paused else "running"
    where = "now" if timeline.live else f"{newest.t - shown.t:.2f} s ago"
    begin = "…" if timeline.begin is None else f"{timeline.begin:.2f}"
    end = "…" if timeline.end is None else f"{timeline.end:.2f}"
    marked = timeline.begin is not None or timeline.end is not None
    mark = f"marked {begin} to {end} s" if marked else "no interval marked"
    return (
        '<div style="display:flex;justify-content:space-between;padding:.2em .8em;font-size:.85em;'
        f'font-variant-numeric:tabular-nums"><b>t = {shown.t:.2f} s, {where}</b>'
        f'<span style="opacity:.65">{mark}, {state}</span></div>'
    )
