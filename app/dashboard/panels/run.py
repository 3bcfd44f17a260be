"""Tab "Run": scenario, controller and speed; state of the simulation and distances of the pairs."""

from __future__ import annotations

import math

import viser

from app.control.buffer_watch import BufferReading, needed_text
from app.control.controller import CONTROLLERS
from app.dashboard.drag import Sink
from app.dashboard.markup import FAINT, ONE_LINE, RIGHT, cell, mark, minus, row, table
from app.dashboard.notifications import Notifier
from app.dashboard.panels.widgets import renew
from app.dashboard.scene.colours import SERIES, css, distance_colour
from app.robot.description import RobotDescription
from app.simulation.loop.commands import SPEEDS, Choose, Pause, Play, Reset, Restart, Speed
from app.simulation.scenarios.leading import Scenario
from app.simulation.scenarios.names import SCENARIOS, own_line
from app.simulation.trace.snapshot import PairReading, Snapshot


def add_case_button(gui: viser.GuiApi, sink: Sink, notifier: Notifier, scenario: Scenario) -> None:
    """Build it in the GUI container that is now open.

    Args:
        gui: Of the viewer.
        sink: Where commands go.
        notifier: For what goes wrong.
        scenario: That begins where the loop begins after a reset.
    """
    button = gui.add_button(
        "Play the case",
        icon=viser.Icon.PLAYER_TRACK_NEXT,
        hint=f"{scenario.about}: begins anew; whoever takes the hand ends it",
    )
    button.on_click(notifier.guard(lambda _: sink.send(Play(scenario))))  # type: ignore[arg-type]


FREE = "free: drag the hand"
"""Choice of no scenario."""
BAR_RANGE = 0.5  # [m] distance that fills a bar of the table
STEP = 0.001  # [s] of one control step
_SIZE = "font-size:.82em"
GOOD, BAD = "#2f9e5b", css((222, 49, 40))


class RunPanel:
    """Buttons and readings; what one viewer chooses, all see."""

    def __init__(
        self, gui: viser.GuiApi, sink: Sink, notifier: Notifier, robot: RobotDescription
    ) -> None:
        """Build the tab in the GUI container that is now open.

        Args:
            gui: The viewer's.
            sink: Where commands go.
            notifier: For refusals.
            robot: Whose own lines the scenarios take.
        """
        self._sink, self._robot = sink, robot
        self._shown: Snapshot | None = None
        self._scenario = gui.add_dropdown(
            "Scenario",
            (FREE, *SCENARIOS),
            hint="Played from its beginning; whoever takes the hand ends it.",
        )
        self._controller = gui.add_dropdown(
            "Controller",
            CONTROLLERS,
            hint="dbb: the base gives way, as in the paper. repulsive: a force on the arm alone. "
            "barrier: each distance a hard inequality. none: no avoidance.",
        )
        self._speed = gui.add_slider(
            "Speed",
            min=SPEEDS[0],
            max=SPEEDS[1],
            step=0.1,
            initial_value=1.0,
            hint="Simulated over real time, as far as the machine keeps up.",
        )
        self._pause = gui.add_button("Pause", icon=viser.Icon.PLAYER_PAUSE)
        restart = gui.add_button("Restart", icon=viser.Icon.REFRESH, color="gray")
        self._status = gui.add_html("")
        self._pairs = gui.add_html("")
        for handle, callback in (
            (self._scenario, self._choose_scenario),
            (self._controller, self._choose_controller),
            (self._speed, self._choose_speed),
        ):
            handle.on_update(notifier.guard(callback))  # type: ignore[arg-type]
        self._pause.on_click(notifier.guard(lambda _: self.toggle_pause()))  # type: ignore[arg-type]
        restart.on_click(notifier.guard(lambda _: self.restart()))  # type: ignore[arg-type]

    def toggle_pause(self) -> None:
        """Stop, or go on."""
        self._sink.send(Pause(self._shown is None or not self._shown.paused))

    def restart(self) -> None:
        """Begin anew where the run began."""
        self._sink.send(Restart())

    def play(self, scenario: str) -> None:
        """Play a scenario from its beginning, or none.

        Args:
            scenario: Its name, or `FREE`.
        """
        if scenario == FREE:
            self._sink.send(Reset())
        else:
            self._sink.send(Play.named(scenario, own_line(self._robot, scenario)))

    def update(self, newest: Snapshot, shown: Snapshot) -> None:
        """Renew the readings; what has not changed is not sent.

        Args:
            newest: What the buttons stand for.
            shown: Whose readings are shown.
        """
        before, self._shown = self._shown, newest
        if before is None or newest.paused != before.paused:
            self._pause.label = "Continue" if newest.paused else "Pause"
            self._pause.icon = viser.Icon.PLAYER_PLAY if newest.paused else viser.Icon.PLAYER_PAUSE
        for handle, now, then in (
            (self._scenario, _choice(newest), before and _choice(before)),
            (self._controller, newest.controller, before and before.controller),
            (self._speed, newest.speed, before and before.speed),
        ):
            if now != then and handle.value != now:  # not while a choice is on its way
                handle.value = now
        renew(self._status, "content", status_html(shown))
        renew(self._pairs, "content", pairs_html(shown))

    def _choose_scenario(self, event: viser.GuiEvent) -> None:
        name = event.target.value
        if self._shown is None or name != _choice(self._shown):
            self.play(name)

    def _choose_controller(self, event: viser.GuiEvent) -> None:
        if self._shown is None or event.target.value != self._shown.controller:
            self._sink.send(Choose(event.target.value))

    def _choose_speed(self, event: viser.GuiEvent) -> None:
        if self._shown is None or event.target.value != self._shown.speed:
            self._sink.send(Speed(event.target.value))


def _choice(snapshot: Snapshot) -> str:
    return snapshot.scenario if snapshot.scenario in SCENARIOS else FREE


def status_html(snapshot: Snapshot) -> str:
    """The state of the simulation as a table of HTML; what should worry is red."""
    *linear, w = snapshot.base_velocity
    speed = ", ".join(_signed(v) for v in linear)
    contact = "arm on base" if snapshot.in_contact else ""
    contact += (" and " if contact else "") + "within arm" if snapshot.arm_in_contact else ""
    state = "paused" if snapshot.paused else "running"
    pull = f"{sum(f * f for f in snapshot.hand_force) ** 0.5:.1f} N"
    slow = not snapshot.paused and snapshot.realtime_factor < 0.95 * snapshot.speed
    rows = [
        ("time", f"{snapshot.t:.1f} s", None),
        ("state", snapshot.busy or f"{state}, {snapshot.mode}", None),
        ("real-time factor", _number(snapshot.realtime_factor, ".2f"), slow),
        ("control step", f"{_number(snapshot.step_time_us, '.0f')} µs", None),
        ("steps late", late_text(snapshot), None),
        ("contact", contact or "none", bool(contact)),
        ("buffer distance", buffer_text(snapshot.buffer), snapshot.buffer.too_small),
        ("solver failures", f"{snapshot.solver_failures}", snapshot.solver_failures > 0),
        ("person pulls", pull if snapshot.pulls else "no", None),
        ("hand off target", f"{1000 * snapshot.ee_error:.0f} mm", None),
        ("base", f"{speed} m/s, {_signed(w)} rad/s", None),
    ]
    return table((_status_row(*each) for each in rows), f"{_SIZE};line-height:1.6;padding:0 .7em")


def buffer_text(reading: BufferReading) -> str:
    """Whether d_b is enough for the approaches of the last seconds, and what would be."""
    return needed_text(reading.needed) if reading.too_small else "enough"


def late_text(snapshot: Snapshot) -> str:
    """Share of the steps since the last reset that missed their period."""
    steps = max(round(snapshot.t / STEP), 1)
    return f"{100.0 * min(snapshot.overruns / steps, 1.0):.1f} %"


def _number(value: float, form: str) -> str:
    """A number as text; a dash where it is not known, as in what is drawn from a log."""
    return "–" if math.isnan(value) else format(value, form)


def _signed(value: float) -> str:
    return minus(f"{round(value, 2) + 0.0:+.2f}")  # + 0.0 turns −0.0 into 0.0


def _status_row(label: str, value: str, bad: bool | None) -> str:
    colour = "" if bad is None else f"color:{BAD if bad else GOOD};font-weight:600"
    return row(cell(label, FAINT), cell(value, RIGHT, colour))


def pairs_html(snapshot: Snapshot) -> str:
    """Distances and activations of all pairs, those of L_m first, as a table of HTML."""
    head = row(cell(), cell("pair"), cell(), cell("d [mm]", RIGHT), cell("β", RIGHT), style=FAINT)
    rows = (_pair_row(i, pair, snapshot) for i, pair in enumerate(snapshot.pairs))
    return table((head, *rows), f"{_SIZE};line-height:1.65;padding:.3em .7em")


def _pair_row(i: int, pair: PairReading, snapshot: Snapshot) -> str:
    config = snapshot.config
    colour = css(distance_colour(pair.d, config.border.d_b, config.activation.d_full))
    share = 100.0 * min(max(pair.d, 0.0), BAR_RANGE) / BAR_RANGE
    limit = 100.0 * min(config.border.d_b, BAR_RANGE) / BAR_RANGE
    bar = (
        '<div style="position:relative;height:.55em;background:rgba(128,138,150,.22);'
        f'border-radius:2px"><div style="width:{share:.0f}%;height:100%;background:{colour};'
        f'border-radius:2px"></div><div style="position:absolute;left:{limit:.0f}%;top:-.15em;'
        'width:1px;height:.85em;background:currentColor;opacity:.7"></div></div>'
    )
    return row(
        cell(mark("●", SERIES[i % len(SERIES)])),
        cell(pair.name, ONE_LINE),
        cell(bar, "width:45%"),
        cell(minus(f"{1000 * pair.d:.0f}"), RIGHT),
        cell(f"{pair.beta:.2f}", RIGHT),
    )
