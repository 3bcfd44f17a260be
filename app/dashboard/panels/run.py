"""Tabs "Run" and "Compare": what is simulated, beside which controllers, and its readings."""

import math
from collections.abc import Callable, Mapping
from itertools import zip_longest
from typing import Any

import viser

from app.control import CONTROLLERS
from app.control.buffer_watch import BufferReading, needed_text
from app.dashboard.markup import (
    FAINT,
    ONE_LINE,
    RIGHT,
    banner,
    bar,
    cell,
    framed,
    mark,
    minus,
    reading,
    readings,
    row,
    small,
    table,
)
from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.panels import phrases as words
from app.dashboard.record import Course
from app.dashboard.scene.colours import GHOSTS, SERIES, css
from app.dashboard.verdict import COLOURS, State, Verdict
from app.simulation.loop.commands import SPEEDS, Choose, Compare, Play, Reset, Restart, Speed
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.scenarios.pulled import CHALLENGE
from app.simulation.trace.snapshot import PairReading, Score, Snapshot

FREE = "free: drag the hand"  # choice of no scenario
TITLES = {name: f"{name}: {scenario.about}" for name, scenario in SCENARIOS.items()}
"""What is in the list of scenarios, by their names."""
_NAMES = {title: name for name, title in TITLES.items()}
_ABOUT = {each.name: each.about for each in (*SCENARIOS.values(), CHALLENGE)}
NOBODY = "nobody"  # choice of no further robot
INPUTS = {"the hand's path": "path", "the person's force": "force"}
"""What the robots may have in common, as `Compare` names it."""
BAR_RANGE = 0.5  # [m] distance that fills a bar of the table
STEP = 0.001  # [s] of one control step
ENDED = 0.05  # [s] before its end a scenario counts as ended: snapshots are 0.02 s apart
_SIZE = "font-size:.82em"
LATE = 0.05
"""[-] share of late steps, and of real time that is missed, from which on the machine is slow."""
_SCORES = (
    ("least clearance", "clearance", lambda d: f"{1000 * d:.0f} mm", max),
    ("hand off target", "error", lambda d: f"{1000 * d:.1f} mm", min),
    ("… at most", "error_max", lambda d: f"{1000 * d:.1f} mm", min),
    ("way of the base", "base_path", lambda d: f"{d:.2f} m", None),
    ("largest jump of v̇", "acceleration_jump", lambda a: f"{a:.3f} m/s²", min),
    ("largest jump of ω̇", "angular_jump", lambda a: f"{a:.3f} rad/s²", min),
    ("… of a torque", "torque_jump", lambda u: f"{u:.2f} N m", min),
    ("steps in contact, plant", "contacts", lambda n: f"{n}", min),
)
"""Label, field of `Score`, its text, and which of them is the best; a way is neither."""


class RunPanel(Panel):
    """Scenario, controller, speed and readings; what one viewer chooses, all see."""

    of_instant = True

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, self._shared = self._gui, viewer.shared
        sink = self._sink = viewer.shared.loop
        self._scenario = gui.add_dropdown(
            "Scenario",
            (FREE, *TITLES.values()),
            hint="Played from its beginning; whoever takes the hand ends it.",
        )
        self._controller = gui.add_dropdown(
            "Controller",
            CONTROLLERS,
            hint="dbb: the base gives way, as in the paper. hqp: the hierarchy as printed, slower "
            "than real time. repulsive: a force on the arm alone. "
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
        self._pause = self.button("Pause", lambda _: viewer.toggle_pause(), viser.Icon.PLAYER_PAUSE)
        self._restart = self.button(
            "Restart", lambda _: sink.send(Restart()), viser.Icon.REFRESH, color="gray"
        )
        self._course, self._status, self._pairs = (gui.add_html("") for _ in range(3))
        self._machine = gui.add_folder("This machine", expand_by_default=False)
        with self._machine:
            self._speeds = gui.add_html("")
        if (case := viewer.shared.case) is not None:
            self.button(
                "Play the case",
                lambda _: sink.send(Play(case)),
                viser.Icon.PLAYER_TRACK_NEXT,
                hint=f"{case.about}: begins anew; whoever takes the hand ends it",
            )
        chosen = self._scenario
        self.on_update(chosen, lambda _: self.play(_NAMES.get(chosen.value, FREE)))
        self.on_update(self._controller, lambda event: sink.send(Choose(event.target.value)))
        self.on_update(self._speed, lambda event: sink.send(Speed(event.target.value)))

    def play(self, scenario: str) -> None:
        """Play a scenario from its beginning, by its name, or none: `FREE`."""
        if scenario == FREE:
            self._sink.send(Reset())
        else:
            self._sink.send(Play(scenario_of(self._shared.model.description, scenario)))

    def update(self, moment: Moment) -> None:
        """Renew the choices, which stand for the newest snapshot, and the readings."""
        newest, shown, verdict = moment
        course = self._shared.course
        self._pause.label = "Continue" if newest.paused else "Pause"
        self._pause.icon = viser.Icon.PLAYER_PLAY if newest.paused else viser.Icon.PLAYER_PAUSE
        self.follow(self._scenario, TITLES.get(newest.scenario, FREE))
        self._restart.label = f"Restart {course.name or 'from the free start'}"
        self._course.content = notice_html(newest) + course_html(course, newest.busy)
        self.follow(self._controller, newest.controller)
        self.follow(self._speed, newest.speed)
        self._status.content = status_html(shown, verdict)
        self._pairs.content = pairs_html(shown, verdict, self._shared.spoken)
        self._speeds.content, worry = machine_html(shown)
        self._machine.label = f"This machine · {worry}" if worry else "This machine"


class ComparePanel(Panel):
    """Choice of the controllers beside the real one, and their scores."""

    of_instant = True

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, self._shared = self._gui, viewer.shared
        gui.add_markdown(
            "Translucent robots run the same input with other controllers and physics of their "
            "own; hqp slows all of them down."
        )
        self._choices = [
            gui.add_dropdown(label, (NOBODY, *CONTROLLERS))
            for label in ("Second robot", "Third robot")
        ]
        self._input = gui.add_dropdown("They share", tuple(INPUTS))
        for handle in (*self._choices, self._input):
            self.on_update(handle, lambda _: self._choose())
        self._scores = gui.add_html("")
        self._names: list[str] = []

    def update(self, moment: Moment) -> None:
        """Renew the choices, which stand for the newest snapshot, and the scores.

        Who is compared stays in the list where he was chosen, also when the other one goes.
        """
        course, scores = self._shared.course, moment.shown.scores
        names = [ghost.controller for ghost in moment.newest.ghosts]
        if names != self._names:
            self._names = names
            if names != [h.value for h in self._choices if h.value != NOBODY]:
                for handle, name in zip_longest(self._choices, names, fillvalue=NOBODY):
                    handle.value = name
        self._scores.content = compared_html(scores, course) + scores_html(scores)

    def _choose(self) -> None:
        wanted = (handle.value for handle in self._choices)
        others = tuple(name for name in wanted if name != NOBODY)
        self._shared.loop.send(Compare(others, INPUTS[self._input.value]))


def scores_html(scores: tuple[Score, ...]) -> str:
    """The scoreboard: a column a robot, the real one first."""
    if not scores:
        return small("nothing compared", FAINT)
    colours = ["currentColor", *(css(colour) for colour in GHOSTS)]
    heads = (
        cell(f"{mark('●', colour)} {score.controller}", RIGHT, "font-weight:600", head=True)
        for score, colour in zip(scores, colours, strict=False)
    )
    rows = (
        row(cell(label, FAINT), *_marked([getattr(score, name) for score in scores], text, best))
        for label, name, text, best in _SCORES
    )
    return table((row(cell(), *heads), *rows), "font-size:.8em;line-height:1.7;padding:.3em .7em")


def _marked(values: list[float], text: Callable[[Any], str], best: Any) -> list[str]:
    """Cells of a row of scores, the best of them marked if they differ."""
    texts = [text(value) for value in values]
    first = text(best(values)) if best and len(set(texts)) > 1 else None
    good = "font-weight:700;color:#2f9e44"
    return [
        cell(minus(f"✓ {each}" if each == first else each), RIGHT, good if each == first else "")
        for each in texts
    ]


def compared_html(scores: tuple[Score, ...], course: Course) -> str:
    """What the comparison came to, as in "dbb kept 72 mm, none 8 mm inside: contact"."""
    if not scores:
        return ""
    when = "Until now"
    if course.name:
        when = f"{course.name}, {'until now' if course.running else 'at its end'}"
    kept = []
    for score in scores:
        d = f"{abs(1000 * score.clearance):.0f} mm{' inside' if score.clearance < 0 else ''}"
        touched = ": contact" if score.contacts or score.clearance < 0 else ""
        kept.append(f"{score.controller}{'' if kept else ' kept'} {d}{touched}")
    return small(f"{when}: <b>{', '.join(kept)}</b>.")


def notice_html(newest: Snapshot) -> str:
    """That a parameter takes on its new value step by step."""
    text = "a jump would throw an arm that is inside of the buffer"
    return banner("notice", newest.changing, text) if newest.changing else ""


def course_html(course: Course, busy: str) -> str:
    """What is prepared, how far the scenario is, or what it came to; nothing at the free start."""
    if busy:
        return banner("notice", f"{busy.capitalize()} …", "time stands still until it begins")
    if not course.name:
        return ""
    about = f"{capital(_ABOUT[course.name])}." if course.name in _ABOUT else ""
    if course.running:
        share = min(course.until / max(course.duration, STEP), 1.0)
        title = f"{course.until:.1f} of {course.duration:.0f} s"
        return small(f"{about}{bar(share)}{title}")
    early = course.until < course.duration - ENDED
    title = f"{course.name} {f'left at {course.until:.1f} s' if early else 'ended'}"
    met = course.touched or course.inside
    result = "contact" if met else "left the contact it began in" if course.left else "no contact"
    figures = course_figures(course) | {"way of the base": f"{course.path:.2f} m"}
    return framed(
        f"<b>{title}: {result}</b><br>{about}{readings(figures)}",
        css(COLOURS["contact" if met else "clear"]),
    )


def course_figures(course: Course) -> dict[str, str]:
    """What a scenario, or a challenge, has come to."""
    return {
        "least distance": minus(f"{1000 * course.least:.0f} mm"),
        "hardest pull": f"{course.pull:.0f} N",
        "fastest hand": f"{course.speed:.2f} m/s",
    }


def capital(text: str) -> str:
    """The text as a sentence begins."""
    return text[:1].upper() + text[1:]


def status_html(snapshot: Snapshot, verdict: Verdict) -> str:
    """The state of the simulation as a table of HTML, with the verdict's colours."""
    *linear, w = snapshot.base_velocity
    speed = ", ".join(words.signed(v) for v in linear)
    state = "paused" if snapshot.paused else "running"
    force = sum(f * f for f in snapshot.hand_force) ** 0.5
    pull = f"{force:.1f} N{words.borne(snapshot.force_bound)}"
    contact: State = "contact" if verdict.touching else "clear"
    rows = [
        _status_row("time", f"{snapshot.t:.1f} s"),
        _status_row("state", snapshot.busy or f"{state}, {snapshot.mode}"),
        _status_row("distances", verdict.state, verdict.state),
        _status_row("contact", verdict.touching or "none", contact),
        _status_row("buffer distance", *buffer_text(snapshot.buffer, verdict)),
        _status_row("person pulls", pull if snapshot.pulls else "no"),
        _status_row("hand off target", f"{1000 * snapshot.ee_error:.0f} mm"),
        _status_row("base", f"{speed} m/s, {words.signed(w)} rad/s"),
    ]
    return table(rows, f"{_SIZE};line-height:1.6;padding:0 .7em")


def buffer_text(reading: BufferReading, verdict: Verdict) -> tuple[str, State]:
    """Whether d_b is enough for the approaches of the last seconds, or what would be; its state.

    What is clear by now was too near lately only.
    """
    if reading.too_small:
        lately = "lately: " if verdict.state == "clear" else ""
        return lately + needed_text(reading.needed), verdict.state
    return (
        ("enough", "clear")
        if verdict.state != "contact"
        else ("did not keep them apart", "contact")
    )


def machine_html(snapshot: Snapshot) -> tuple[str, str]:
    """How the machine keeps up, as a table of HTML, and in a word what should worry, or nothing."""
    late = min(snapshot.overruns / max(round(snapshot.t / STEP), 1), 1.0)
    slow = not snapshot.paused and snapshot.realtime_factor < (1.0 - LATE) * snapshot.speed
    failed = snapshot.solver_failures > 0
    rows = [
        ("real-time factor", _number(snapshot.realtime_factor, ".2f"), slow),
        ("control step", f"{_number(snapshot.step_time_us, '.0f')} µs", False),
        ("steps late", f"{100.0 * late:.1f} %", late > LATE),
        ("solver failures", f"{snapshot.solver_failures}", failed),
    ]
    html = [_status_row(name, text, "contact" if bad else "clear") for name, text, bad in rows]
    worry = "solver failed" if failed else "too slow" if slow else "late" if late > LATE else ""
    return table(html, f"{_SIZE};line-height:1.6;padding:0 .7em"), worry


def _number(value: float, form: str) -> str:
    """A number as text; a dash where it is not known, as in what is drawn from a log."""
    return "–" if math.isnan(value) else format(value, form)


def _status_row(label: str, value: str, state: State = "clear") -> str:
    return reading(label, value, "" if state == "clear" else css(COLOURS[state]))


def pairs_html(
    snapshot: Snapshot, verdict: Verdict, spoken: Mapping[str, str] | None = None
) -> str:
    """Distances and activations of all pairs, those of L_m first, as a table of HTML.

    Pairs stand there in words if they are `spoken`; the pointer over a row says its symbols.
    """
    head = row(
        cell(), cell("pair"), cell(), cell("d [mm]", RIGHT, ONE_LINE), cell("β", RIGHT), style=FAINT
    )
    pairs = enumerate(zip(snapshot.pairs, verdict.pairs, strict=True))
    d_b, known = snapshot.config.border.d_b, spoken or {}
    rows = (
        _pair_row(i, pair, state, d_b, known.get(pair.name, pair.name))
        for i, (pair, state) in pairs
    )
    return table((head, *rows), f"{_SIZE};line-height:1.65;padding:.3em .7em")


def _pair_row(i: int, pair: PairReading, state: State, d_b: float, name: str) -> str:
    """A row whose bar is full of the colour of contact if one of the pair is inside the other."""
    colour = css(COLOURS[state])
    share = 1.0 if state == "contact" else min(pair.d, BAR_RANGE) / BAR_RANGE
    limit = min(d_b, BAR_RANGE) / BAR_RANGE
    loud = f"color:{colour};font-weight:600" if state == "contact" else ""
    return row(
        cell(mark("●", SERIES[i % len(SERIES)])),
        cell(name, ONE_LINE),
        cell(bar(share, colour, limit), "width:34%"),
        cell(minus(f"{1000 * pair.d:.0f}"), RIGHT, loud),
        cell(f"{pair.beta:.2f}", RIGHT),
        hint=f"{pair.name}: signed distance d [mm] of its bodies, below 0 inside, d_b = "
        f"{1000 * d_b:.0f} mm at the stroke; activation β from 0 at d_b to 1 at d_full, Figure 10",
    )
