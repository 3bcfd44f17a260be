"""Time line: which instant a viewer sees, of the last 60 s, and the panel to choose it."""

from __future__ import annotations

import math

import viser

from app.dashboard.drag import Sink
from app.dashboard.notifications import Notifier
from app.dashboard.panels.widgets import renew
from app.simulation.loop.commands import Pause, StepOnce
from app.simulation.loop.loop import LoopHandle
from app.simulation.trace.snapshot import Snapshot

REACH = 60.0
"""[s] how far back a viewer can look."""
FRAME = 0.02
"""[s] between two snapshots."""


class Timeline:
    """The place of one viewer in time; the simulation does not notice.

    Attributes:
        begin, end: [s] the marked interval; None if it is not marked.
    """

    def __init__(self, loop: LoopHandle) -> None:
        """Begin with now.

        Args:
            loop: Gives the newest snapshot and those of the last 60 s.
        """
        self._loop = loop
        self._shown: Snapshot | None = None
        self._reference = 0.0
        self.begin: float | None = None
        self.end: float | None = None

    @property
    def live(self) -> bool:
        """Whether the newest snapshot is shown."""
        return self._shown is None

    def shown(self) -> Snapshot:
        """The snapshot to be drawn; after a restart of the simulation always the newest."""
        newest = self._loop.latest()
        if self._shown is not None and newest.t < self._shown.t:
            self.go_live()
        if self.begin is not None and newest.t < self.begin:
            self.begin = self.end = None
        return newest if self._shown is None else self._shown

    def look_back(self, seconds: float) -> None:
        """Show what was so many seconds before the instant at which the viewer stopped.

        Args:
            seconds: [s] 0 goes to that instant, not to now.
        """
        if self._shown is None:
            self._reference = self._loop.latest().t
        self._go_to(self._reference - min(max(seconds, 0.0), REACH))

    def step(self, seconds: float) -> None:
        """Go on (or back, if negative) by so many seconds, within what is kept."""
        self._go_to(self.shown().t + seconds)

    def go_live(self) -> None:
        """Show the newest snapshot again, from now on."""
        self._shown = None

    @property
    def back(self) -> float:
        """[s] how far back the viewer is, as `look_back` takes it."""
        return 0.0 if self._shown is None else max(self._reference - self._shown.t, 0.0)

    def mark_begin(self) -> None:
        """The marked interval begins at the instant that is shown."""
        self.begin = self.shown().t
        if self.end is not None and self.end <= self.begin:
            self.end = None

    def mark_end(self) -> None:
        """The marked interval ends at the instant that is shown."""
        self.end = self.shown().t
        if self.begin is not None and self.begin >= self.end:
            self.begin = None

    def interval(self) -> list[Snapshot]:
        """The snapshots of the marked interval, or all that are kept, oldest first."""
        kept = self._loop.history(-1.0)
        low = -1.0 if self.begin is None else self.begin
        high = kept[-1].t if self.end is None else self.end
        return [snapshot for snapshot in kept if low - 1e-9 <= snapshot.t <= high + 1e-9]

    def _go_to(self, t: float) -> None:
        kept = self._loop.history(-1.0)
        if self._shown is None:
            self._reference = kept[-1].t
        self._shown = min(kept, key=lambda snapshot: abs(snapshot.t - t))
        self._reference = max(self._reference, self._shown.t)


WIDTH = 520  # [px]
_STEPS = {"−1 s": -1.0, "−20 ms": -FRAME, "+20 ms": FRAME, "+1 s": 1.0}
_PAUSE, _NOW = "Stop / go", "Now"
_MARKS = ("Mark begin", "Mark end", "No marks")


class TimelinePanel:
    """Slider and buttons over one viewer's place in time."""

    def __init__(
        self, gui: viser.GuiApi, timeline: Timeline, sink: Sink, notifier: Notifier
    ) -> None:
        """Open the panel, floating under the scene.

        Args:
            gui: Of the viewer.
            timeline: What is moved.
            sink: Where commands go.
            notifier: For what goes wrong.
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
        self._slider.on_update(notifier.guard(self._slide))  # type: ignore[arg-type]
        go.on_click(notifier.guard(self._press))  # type: ignore[arg-type]
        marks.on_click(notifier.guard(self._mark))  # type: ignore[arg-type]

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
        renew(self._text, "content", time_html(newest, shown, self._timeline))
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
