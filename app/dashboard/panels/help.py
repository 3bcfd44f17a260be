"""Help: the tab with method and keys, and the card with introduction, demonstration and tour."""

from threading import RLock
from typing import NamedTuple

from app.dashboard.panels import Moment, Panel, Viewer
from app.simulation.loop.commands import Compare, Play, Reset
from app.simulation.scenarios import scenario_of
from app.simulation.scenarios.line import LineScenario
from app.simulation.session import SCENARIO_PERSON
from app.simulation.trace.words import METHOD_WORDS

TEXT = """
**Purpose.** The controller moves the base of a mobile robot out of the way of its arm. It
implements *Reactive Self-Collision Avoidance for a Differentially Driven Mobile Manipulator*;
numbers such as (7) are equations of that paper.

**Pull the robot** with the arrows at its end-effector, or by any link of the arm: a virtual spring
pulls the held point to the mouse. The arm follows, and the base gives way before they touch.

**How it works.** The *distance buffer border* (DBB) surrounds the base: it consists of the points
at the buffer distance d_b from the base that the arm can reach. Each point has a *score* S, the
product of two values: how well the base moves the point, by the determinant of (7), and how easily
the arm reaches it, by R of (9). A differential base cannot move sideways, so S is zero on its wheel
axis; behind this axis S is negative. When the arm is closer to the base than d_b:

1. p_n is the point of the border nearest to the arm. p_t is p_n moved along the border's tangent
   towards a higher score. The acting point p_act is the point of the border nearest to p_t.
2. A virtual force acts on the base at p_act. The force is larger for smaller distances. It pushes
   the base away from the arm, and turns the base so that the base can move away better.
3. A quadratic program gives avoidance priority over the end-effector's task. The activation β
   rises from 0 at d_b to 1 at d_full, so that avoidance begins smoothly. The arm gets torques at
   1 kHz, the base gets velocities, by default at 10 Hz.

**Tabs.** *Why* explains the current motion. *Plots* shows the last 20 s. *Compare* runs other
controllers on the same pull. *Key* explains colours and arrows. *Run* has the scenarios. *Lab* has
the speed, readings and joint sliders. *View* has layers and cameras. *Tune* has all parameters.
*Robot* has other robots and your own. *Save* has pictures, logs, reports, replays and films.

**Keys** (outside text fields): {keys}. `?` opens this tab, `Ctrl K` lists all commands. `Esc`
closes messages and the card; if no card or dialogue is open, it also returns to the present.
`Shift` with the arrow keys, `Page Up` or `Page Down` pulls the end-effector until `Shift` is
released. Double click the scene to reset the camera.

Several people can use the page at once. Each has their own view and point in time; the simulation
is shared, and the forces of all who pull add up.
"""
WATCH, PULL, NEXT, SHOW, CLOSE = "Watch it (8 s)", "Pull it yourself", "Next", "Show me", "Close"
TOUR = "Take the tour"
SHOWN = "guiding-lateral"  # the demonstration: a pull from the side towards the base
FARTHER = 1.5  # [-] factor on this scenario's path; the arm then almost reaches a resting base


class Card(NamedTuple):  # text and buttons of the card over the scene
    title: str
    text: str
    buttons: tuple[str, ...]
    place: str = ""  # tab that the card explains and opens


_NO_CARD = Card("", "", ())
_STEP = (SHOW, NEXT, CLOSE)
_BOTH = (  # the demonstration in words, until its results replace them
    "Solid: with avoidance, the base gives way. Violet: without avoidance, the base stays, and the "
    "arm comes much too near or runs into it."
)
CARDS = {  # by the guide's state
    "welcome": Card(
        "This robot moves its base out of the way of its own arm",
        "A person guides the arm towards the base, and the base gives way. Without avoidance the "
        "base stays, and the arm comes much too near or runs into it.",
        (WATCH, PULL),
    ),
    "watch": Card(
        "The same pull on two robots",
        f"{_BOTH} The scenario is {SHOWN}, on a path {FARTHER:g} times as long.",
        (WATCH, PULL, CLOSE),
    ),
    "demo": Card(
        "Demonstration", f"{_BOTH} This repeats until you click or type.", (WATCH, PULL, CLOSE)
    ),
    "pull": Card(
        "Pull the robot",
        "Drag an arrow at the end-effector towards the base, or drag any link of the arm.",
        (TOUR, CLOSE),
    ),
    "tour 1": Card(
        "1 of 5: Pull the end-effector",
        "Drag one of the arrows at the end-effector towards the base: a virtual spring pulls it. "
        "Every link of the arm can be dragged as well.",
        _STEP,
    ),
    "tour 2": Card(
        "2 of 5: Watch the base",
        "The coloured border surrounds the base. Once the arm is inside the border, the base moves "
        "away, and turns parts with a higher score towards the arm (yellow: high, purple: low).",
        _STEP,
    ),
    "tour 3": Card(
        "3 of 5: Read why",
        "The panel Why explains the base's motion. Key explains colours and arrows.",
        _STEP,
        "Why",
    ),
    "tour 4": Card(
        "4 of 5: Go back in time",
        "The timeline below replays the last ten minutes, with all readings and plots. “Back to "
        "now” returns.",
        _STEP,
    ),
    "tour 5": Card(
        "5 of 5: Compare",
        "This panel runs other controllers on the same pull, as ghosts. Run has the paper's "
        "experiments, Tune has every parameter.",
        (SHOW, CLOSE),
        "Compare",
    ),
}
"""The first three cards begin with the same buttons, so a late click still hits the same one."""
SEEN = "dbb-tour-seen"  # key in the browser's storage after the first visit


class Guide(Panel):
    """The card over the scene; the state is a key of `CARDS`, or empty without a card."""

    def __init__(self, viewer: Viewer, state: str) -> None:
        super().__init__(viewer)
        self.state, self._shown = state, _NO_CARD
        self._compares = False  # whether the guide has started a comparison
        self._lock = RLock()  # the drawing thread, too, begins and ends the demonstration
        self._channel = viewer.channel
        viewer.channel.on("tour", lambda: self.go("welcome"))
        viewer.channel.on("card", self._press, str)

    def go(self, state: str) -> None:
        """Show the card of a state, or none for ""; end a comparison that the guide has started.

        If the guide ends a comparison after a demonstration or for the card "pull", it also resets
        the simulation, unless a person holds the robot. If a viewer has chosen other ghosts
        meanwhile, their comparison continues.
        """
        with self._lock:
            anew = self.state == "demo" or state == "pull"
            self.state = state
            loop, compares, self._compares = self._shared.loop, self._compares, False
            if not compares or {ghost.controller for ghost in loop.latest().ghosts} - {"none"}:
                return  # no comparison, or another one that a viewer has chosen
            loop.send(Compare())
            held = any(pull.who != SCENARIO_PERSON for pull in loop.latest().pulls)
            held |= self._viewer.grip.holds_anything  # the grip can be newer than the pulls
            if anew and not held:
                loop.send(Reset())

    def watch(self, state: str) -> None:
        """Show the card of a state; play `SHOWN` on the robot and on a ghost without avoidance.

        Raises `UnreachableError` if the robot's description has no path for the scenario `SHOWN`.
        """
        with self._lock:
            scenario = scenario_of(self._shared.model.description, SHOWN)
            if isinstance(scenario, LineScenario):
                x, y, z = (FARTHER * part for part in scenario.move)
                scenario = scenario.changed(move=(x, y, z))
            self.state = state
            self._shared.loop.send(Compare(("none",)))
            self._shared.loop.send(Play(scenario))
            self._compares = True

    def leave_demonstration(self) -> None:
        with self._lock:
            if self.state == "demo":
                self.go("")

    def update(self, moment: Moment) -> None:
        card, newest = CARDS.get(self.state, _NO_CARD), moment.newest
        if self.state in ("watch", "demo") and newest.ghosts and not newest.scenario:
            robots = zip(("Solid", "Violet", "Teal"), newest.scores, strict=False)
            ends = (f"{look}, {METHOD_WORDS[s.controller]}: {s.text}." for look, s in robots)
            card = card._replace(text=card.text.replace(_BOTH, " ".join(("Result.", *ends))))
        if card == self._shown:
            return
        self._shown = card
        self._channel.tell("card", card.title, card.text, *card.buttons)
        if card.place:
            self._channel.tell("open", card.place)

    def _press(self, label: str) -> None:
        """Handle a click on a button of the card; ignore a label that the card does not have.

        Without a card, `WATCH` and `PULL` are valid: the same click may have closed their card.
        """
        with self._lock:
            card = CARDS.get(self.state)
            if label not in (card.buttons if card else (WATCH, PULL)):
                return
            if label == SHOW and self.state == "tour 4":
                self._viewer.timeline.step(-3.0)
            elif label == SHOW and self.state != "tour 5":
                self._viewer.play(SHOWN)
            elif label == SHOW:
                self.watch(self.state)
            elif label == WATCH:
                self.watch("watch")
            elif label == NEXT:
                self.go(f"tour {int(self.state[-1]) + 1}")
            else:
                self.go({PULL: "pull", TOUR: "tour 1"}.get(label, ""))
