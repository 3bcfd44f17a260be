"""Tabs "Run" (scenario, controller, results), "Lab" (speed, readings) and "Compare" (ghosts)."""

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from itertools import compress, zip_longest

import viser

from app.control import CONTROLLERS
from app.control.buffer_watch import needed_text
from app.dashboard import markup
from app.dashboard import phrases as words
from app.dashboard.markup import FAINT, ONE_LINE, RIGHT, cell, reading, row, small, table
from app.dashboard.panels import BACK, CONTINUE, PAUSE, RESTART, Moment, Panel, Viewer
from app.dashboard.panels.tuning import changing_html
from app.dashboard.panels.why import distance_bar, state_chip
from app.dashboard.record import Course, pulled
from app.dashboard.scene.colours import GHOSTS, SERIES, css
from app.dashboard.verdict import COLOURS, LATE, Verdict, is_slow
from app.errors import DbbError
from app.robot.description import RobotDescription
from app.simulation.loop.commands import SPEEDS, Choose, Compare, Play, Restart, Speed
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.simulation.session import DT
from app.simulation.trace.metrics import OPENED
from app.simulation.trace.snapshot import Score, Snapshot
from app.simulation.trace.words import METHOD_WORDS, millimetres, outcome

FREE = "Free: pull the robot yourself"  # choice without a scenario
OFF = "off"  # choice without another robot
# Choices in the lists of scenarios and of controllers, by name:
TITLES = {name: f"{name}: {scenario.about}" for name, scenario in SCENARIOS.items()}
METHOD_TITLES = {name: f"{name}: {METHOD_WORDS[name]}" for name in CONTROLLERS}
INPUTS = {"path": "the end-effector's path", "force": "the person's force"}  # of `Compare.same`
_SIZE = "font-size:.82em"
_STARTS = "A scenario starts at once. A pull of the end-effector ends it."
_SCORES = (  # label with unit, field of `Score`, text of a value, function for the best or None
    ("smallest distance to base [mm]", "clearance", lambda d: _distance(d), max),
    ("end-effector error, now or final [mm]", "error", lambda d: f"{1000 * d:.1f}", min),
    ("end-effector error, largest [mm]", "error_max", lambda d: f"{1000 * d:.1f}", min),
    ("base travel [m]", "base_path", lambda d: f"{d:.2f}", None),
    ("acceleration jump v̇ [m/s²]", "acceleration_jump", lambda a: f"{a:.3f}", min),
    ("turning jump ω̇ [rad/s²]", "angular_jump", lambda a: f"{a:.3f}", min),
    ("torque jump [N m, N]", "torque_jump", lambda u: f"{u:.2f}", min),
)


class RunPanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, sink = self._gui, viewer.shared.loop
        self._scenario = self.choice("Scenario", {"": FREE, **TITLES}, viewer.play, _STARTS)
        self._controller = self.choice(
            "Controller",
            METHOD_TITLES,
            lambda name: sink.send(Choose(name)),
            hint="dbb: the base gives way, as in the paper. hqp: the same, slower. repulsive: only "
            "the arm gives way. barrier: a constraint on the distance. none: no avoidance.",
        )
        self._pause = self.button(PAUSE, lambda _: viewer.toggle_pause(), viser.Icon.PLAYER_PAUSE)
        restart, icon = lambda _: sink.send(Restart()), viser.Icon.REFRESH
        self._restart = self.button(RESTART, restart, icon, color="gray")
        self.button(BACK, lambda _: viewer.play(""), viser.Icon.HOME, color="gray")
        self._course, self._pairs = (gui.add_html("") for _ in range(2))

    def update(self, moment: Moment) -> None:
        """Update the table of pairs from the shown snapshot, and the rest from the newest one."""
        newest, shown, verdict = moment
        course = self._shared.course
        self._pause.label = CONTINUE if newest.paused else PAUSE
        self._pause.icon = viser.Icon.PLAYER_PLAY if newest.paused else viser.Icon.PLAYER_PAUSE
        # Also after the end of a scenario, because a choice of `FREE` must change the list.
        self.follow(self._scenario, TITLES.get(newest.scenario or course.name, FREE))
        self._restart.label = f"{RESTART} {course.name}".strip()
        ended = course.name and not (course.running or newest.busy)
        beside = newest.scores[1:] if ended else ()
        self._course.content = (
            changing_html(newest)
            + course_html(course, newest.busy, self._shared.model.description)
            + (small(outcomes_html(beside)) if beside else "")
        )
        self.follow(self._controller, METHOD_TITLES[newest.controller])
        self._pairs.content = pairs_html(shown, verdict, self._shared.spoken)


class LabPanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui, sink = self._gui, viewer.shared.loop
        hint = "Factor of real time; a slow machine does not reach it."
        self._speed = gui.add_slider("Speed", *SPEEDS, 0.1, 1.0, hint=hint)
        self.on_update(self._speed, lambda event: sink.send(Speed(event.target.value)))
        if (case := viewer.shared.case) is not None:
            act, hint = lambda _: sink.send(Play(case)), f"{case.about}. {_STARTS}"
            self.button("Play the case", act, viser.Icon.PLAYER_TRACK_NEXT, hint=hint)
        self._status = gui.add_html("")

    def update(self, moment: Moment) -> None:
        newest, shown, verdict = moment
        self.follow(self._speed, newest.speed)
        rows = [*status_rows(shown, verdict), *machine_rows(shown)]
        self._status.content = table(rows, f"{_SIZE};line-height:1.6;padding:0 .7em")


class ComparePanel(Panel):
    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        gui = self._gui
        gui.add_markdown("Other controllers run as ghosts beside the robot. hqp is slow.")
        titles, labels = (OFF, *METHOD_TITLES.values()), ("Second robot", "Third robot")
        self._choices = [gui.add_dropdown(label, titles) for label in labels]
        hint = "All end-effectors have the same path, or the same force acts on all robots."
        self._input = gui.add_dropdown("Same input", tuple(INPUTS.values()), hint=hint)
        for handle in (*self._choices, self._input):
            self.on_update(handle, lambda _: self._choose())
        self._scores = gui.add_html("")
        self._names: list[str] = []

    def update(self, moment: Moment) -> None:
        """Update the choices from the newest snapshot, and the scores from the shown one."""
        self.follow(self._input, INPUTS.get(moment.newest.same, self._input.value))
        names = [METHOD_TITLES[ghost.controller] for ghost in moment.newest.ghosts]
        if names != self._names:
            self._names = names
            if names != self._chosen():  # otherwise the lists stay as the viewer has set them
                for handle, name in zip_longest(self._choices, names, fillvalue=OFF):
                    handle.value = name
        shown, last, outcomes = moment.shown, self._shared.course.name, ""
        if shown.scores:
            ended = f"{last}, at its end" if last else "So far"
            when = f"{shown.scenario}, until {shown.t:.1f} s" if shown.scenario else ended
            outcomes = small(f"{when}<br>{outcomes_html(shown.scores)}")
        self._scores.content = outcomes + scores_html(shown.scores)

    def _choose(self) -> None:
        names = {title: name for name, title in METHOD_TITLES.items()}
        others = tuple(names[title] for title in self._chosen())
        inputs = {title: same for same, title in INPUTS.items()}
        self._shared.loop.send(Compare(others, inputs[self._input.value]))
        if others:
            self._notifier.tell(self._viewer.client, "New run", "The timeline starts again.")

    def _chosen(self) -> list[str]:
        values = [handle.value for handle in self._choices]  # once: a person can change them
        return [value for value in values if value != OFF]


def scores_html(scores: tuple[Score, ...]) -> str:
    """Return a table (✓ marks the best of differing results) or, without scores, a sentence."""
    if not scores:
        return small("No comparison is running.", FAINT)
    heads = (
        cell(f"{markup.mark('●', colour)} {score.controller}", RIGHT, "font-weight:600", head=True)
        for score, colour in zip(scores, ("currentColor", *map(css, GHOSTS)), strict=False)
    )
    ends = [outcome(score.clearance, touched=bool(score.contacts)) for score in scores]
    valid = [end == "no contact" for end in ends]
    texts = [end if end == "no contact" else state_chip("contact", end) for end in ends]
    rows = [row(cell("outcome", FAINT), *(cell(text, RIGHT) for text in texts))]
    for label, name, text, best in _SCORES:
        values = [getattr(score, name) for score in scores]
        compared = list(compress(values, valid))
        differ = len(set(map(text, compared))) > 1
        first = text(best(compared)) if best and differ else None
        cells = (
            cell(f"✓ {text(v)}" if good and text(v) == first else text(v), RIGHT, ONE_LINE)
            for v, good in zip(values, valid, strict=True)
        )
        rows.append(row(cell(label, FAINT), *cells))
    look = "font-size:.8em;line-height:1.7;padding:.3em .7em;border-collapse:separate"
    return table((row(cell(), *heads), *rows), f"{look};border-spacing:.6em 0")


def _distance(d: float) -> str:
    """Return a distance [m] as a number of millimetres, on the colour of contact if negative."""
    text = millimetres(d)[:-3]
    return text if d >= 0.0 else state_chip("contact", text)


def outcomes_html(scores: Sequence[Score]) -> str:
    """Return lines such as "With avoidance (dbb): no contact, smallest distance 72 mm", as HTML."""
    lines = (
        f"<b>{METHOD_WORDS[each.controller].capitalize()}</b> ({each.controller}): {each.text}"
        for each in scores
    )
    return "<br>".join(lines)


def course_html(course: Course, busy: str, robot: RobotDescription) -> str:
    """Return as HTML the preparation `busy`, or else progress or result of the last scenario."""
    if busy:
        text = "The simulation continues after this."
        return markup.banner("notice", f"{words.sentence(busy)} …", text)
    if not course.name or (last := course.last) is None:
        return ""
    about = f"{words.sentence(SCENARIOS[course.name].about)}." if course.name in SCENARIOS else ""
    if course.running:
        filled = markup.bar(min(course.until / max(course.duration, DT), 1.0))
        return small(f"{about}{filled}{course.until:.1f} of {course.duration:.0f} s")
    ended = f"stopped at {course.until:.1f} s" if course.until < course.duration else "ended"
    changed = course.case is not None and course.name in SCENARIOS
    with suppress(DbbError):  # the robot has no line of its own for this scenario
        changed &= course.case is None or course.case.scenario() != scenario_of(robot, course.name)
    options = " (options changed)" if changed else ""
    title = f"{course.name}{options} with {last.controller} {ended}"
    met = course.touched or course.inside
    result = "recovered from the initial contact" if course.left and not met else course.outcome
    values = [
        reading("smallest distance", millimetres(course.least)),
        reading("largest pull", f"{course.pull:.0f} N"),
        reading("peak end-effector speed", f"{course.speed:.2f} m/s"),
        reading("base travel", f"{course.path:.2f} m"),
    ]
    if last.door is not None:
        turned = f"{math.degrees(last.door.angle):.0f}° of {math.degrees(OPENED):.0f}°"
        values.insert(0, reading("door opened", turned))
    colour = css(COLOURS["contact" if met else "clear"])
    frame = f"border:1px solid {colour};border-left:6px solid {colour};margin:.4em .7em"
    return small(f"<b>{title}: {result}</b><br>{about}{table(values)}", frame)


def status_rows(snapshot: Snapshot, verdict: Verdict) -> list[str]:
    state = "paused" if snapshot.paused else "running"
    pull, bound = f"{pulled(snapshot):.1f} N", snapshot.force_bound
    pull += "" if math.isnan(bound) else f" (the arm can resist {bound:.0f} N)"
    *linear, w = snapshot.base_velocity
    speed = ", ".join(map(words.signed, linear))
    rows = [
        reading("time", f"{snapshot.t:.1f} s"),
        reading("state", snapshot.busy or f"{state}, {snapshot.mode}"),
        _warned("contact", verdict.touching or "none", bad=bool(verdict.touching)),
        reading("pull", pull if snapshot.pulls else "none"),
        reading("end-effector error", millimetres(snapshot.ee_error)),
        reading("base velocity", f"{speed} m/s, {words.signed(w)} rad/s"),
    ]
    if snapshot.buffer.too_small:
        needed, state = needed_text(snapshot.buffer.needed), verdict.state
        text = f"lately: {needed}" if state == "clear" else state_chip(state, needed)
        rows.insert(3, reading("buffer", text))
    return rows


def machine_rows(snapshot: Snapshot) -> list[str]:
    late = min(snapshot.overruns / max(round(snapshot.t / DT), 1), 1.0)
    factor = f"{snapshot.realtime_factor:.2f}".replace("nan", "–")
    step = f"{snapshot.step_time_us:.0f} µs".replace("nan", "–")
    failures = snapshot.solver_failures
    return [
        _warned("real-time factor", factor, bad=is_slow(snapshot)),
        reading("control step", step),
        _warned("late steps", f"{100.0 * late:.1f} %", bad=late > LATE),
        _warned("solver failures", f"{failures}", bad=failures > 0),
    ]


def _warned(name: str, value: str, *, bad: bool) -> str:
    return reading(name, state_chip("contact", value) if bad else value)


def pairs_html(snapshot: Snapshot, verdict: Verdict, spoken: Mapping[str, str]) -> str:
    """Return a table of all pairs; `spoken` has their displayed names in the order of the plots."""
    distance = cell("distance [mm]", RIGHT, ONE_LINE, span=2)
    beta = cell("activation β", RIGHT, ONE_LINE, "padding-left:1em")
    head = row(cell(), cell("link pair"), distance, beta, style=FAINT)
    order = list(spoken)  # also that of the colours in the plots
    about = "signed distance d of its convex bodies, negative where they overlap; the mark is d_b ="
    rows = (
        row(
            cell(markup.mark("●", SERIES[order.index(pair.name) % len(SERIES)])),
            cell(spoken[pair.name], ONE_LINE),
            cell(distance_bar(pair.d, snapshot.d_b, state), "width:26%;padding-left:.4em"),
            cell(_distance(pair.d), RIGHT),
            cell(f"{pair.beta:.2f}", RIGHT),
            hint=f"{pair.name}: {about} {millimetres(snapshot.d_b)}; activation β is 0 at d_b",
        )
        for pair, state in zip(snapshot.pairs, verdict.pairs, strict=True)
    )
    return table((head, *rows), f"{_SIZE};line-height:1.65;padding:.3em .7em")
