"""Timeline: a bar, drawn by the page's own script, that selects a viewer's shown instant."""

from typing import Any

from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.record import BIN, HISTORY, Event
from app.errors import LogError
from app.simulation.trace.snapshot import Snapshot


class TimelinePanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        timeline, strip, channel = viewer.timeline, viewer.shared.strip, viewer.channel
        self._channel, self._timeline, self._strip = channel, timeline, strip
        self._sent: tuple[int, int] = (-1, 0)
        self._events: dict[int, Event] = {}
        self._state: list[Any] = []
        for word, act in {
            "go": timeline.go_to,
            "step": viewer.step,
            "pause": viewer.toggle_pause,
            "now": timeline.go_live,
            "nearest": lambda: self._jump(strip.nearest),
            "pull": lambda: self._jump(strip.hardest),
            "begin": timeline.mark_begin,
            "end": timeline.mark_end,
            "unmark": timeline.unmark,
            "play": lambda speed: timeline.play(float(speed)),
            "look": lambda: viewer.look(viewer.camera.preset or "iso"),
        }.items():
            channel.on(word, act)

    def update(self, moment: Moment) -> None:
        """Send new rows of the strip, changed and new events, and times and state if changed."""
        newest, shown, _ = moment
        strip, line = self._strip, self._timeline
        runs, closed = self._sent
        if runs != strip.runs:
            closed, self._events = 0, {}
            self._channel.tell("clear", HISTORY, BIN)
        if fresh := strip.closed - closed:
            rows = list(strip.rows)[-fresh:]
            self._channel.tell("rows", [[round(x, 3) for x in row] for row in rows])
        self._sent = strip.runs, strip.closed
        events = dict(strip.events)
        if new := [(k, *each) for k, each in events.items() if self._events.get(k) != each]:
            self._channel.tell("events", new)
        self._events = events
        marks = [None if x is None else round(x, 3) for x in (line.begin, line.end)]
        times = [round(newest.t, 3), round(shown.t, 3), *marks]
        state = [*times, line.live, newest.paused, shown.border.d_b, line.plays]
        state += [self._viewer.grip.reach is not None, line.earlier]
        if state != self._state:
            self._state = state
            self._channel.tell("state", *state)

    def _jump(self, to: Snapshot | None) -> None:
        if to is None:
            raise LogError("no such instant has been recorded yet")
        self._timeline.show(to)
