"""Folder "Link and case": links and files that reproduce the present run.

A link is the page's address with scenario, controller, robot, parameters, camera and time.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from html import escape
from typing import TYPE_CHECKING, Any, NamedTuple
from urllib.parse import parse_qsl, urlencode

import numpy as np
import viser

from app.config import Config, tunable
from app.control import CONTROLLERS
from app.dashboard.gate import DENSITY
from app.dashboard.markup import small
from app.dashboard.panels import Moment, Panel, Viewer
from app.dashboard.scene.camera import PRESETS
from app.dashboard.viser_compat import address_of, taken_upload
from app.errors import CaseError, ConfigError, DbbError, UnknownNameError
from app.parameters import Parameter
from app.robot.assets import robot_names
from app.simulation.case import RunCase
from app.simulation.loop.commands import Choose, Play
from app.simulation.scenarios import SCENARIOS, scenario_of
from app.strict import Array, check_range, text_of

if TYPE_CHECKING:
    from app.dashboard.shared import SharedState

_NAMES = ("scenario", "controller", "robot", "look", "at", DENSITY)
"""Names in a link's query, in addition to the paths of parameters."""
_FARTHEST = 100.0  # [m] largest coordinate of a camera
_COPY = (
    "const box=this.previousElementSibling;box.focus();box.select();document.execCommand('copy');"
    "history.replaceState(null,'',box.value)"
)
"""Script of the page that receives the link: copies it, and makes it the page's address."""


class Link(NamedTuple):
    """Requests of a link. An empty field changes nothing."""

    scenario: str = ""
    """Name of the scenario to play. If it is set, parameters that the link does not name get their
    defaults."""
    controller: str = ""
    robot: str = ""
    parameters: tuple[tuple[str, float | str], ...] = ()
    """Paths and values of parameters."""
    look: str = ""
    """A key of `PRESETS`, or eye and target as six numbers [m]."""
    at: float | None = None
    """[s] time of the scenario at which the simulation pauses."""

    @classmethod
    def read(cls, query: str) -> Link:
        """Read and check the query of an address.

        Raises:
            UnknownNameError: A scenario, controller, robot, parameter or view does not exist.
            ConfigError: A value is out of its range, or not a number.
        """
        words = dict(parse_qsl(query, keep_blank_values=True))
        given = {name: words.pop(name) for name in _NAMES if name in words}
        unknown = next((name for name in words if "." not in name), None)
        if unknown is not None:
            raise UnknownNameError("parameter", unknown, (*_NAMES, "a path such as border.d_b"))
        check_range(DENSITY, _number(DENSITY, given.get(DENSITY, "1")), 0.1, 4.0, "")
        for name, choices in (
            ("scenario", SCENARIOS),
            ("controller", CONTROLLERS),
            ("robot", robot_names()),
        ):
            if name in given and given[name] not in choices:
                raise UnknownNameError(name, given[name], choices)
        parameters = ((path, _value(path, text)) for path, text in words.items())
        scenario, controller, robot, look = (
            given.get(name, "") for name in ("scenario", "controller", "robot", "look")
        )
        found = cls(scenario, controller, robot, tuple(parameters), look)
        Config().changed(found.changes({}))
        found.camera()
        if "at" in given:
            at = _number("at", given["at"])
            if not found.scenario:
                raise ConfigError("at: this time needs a scenario; name one")
            check_range("at", at, 0.0, SCENARIOS[found.scenario].duration, "s")
            found = found._replace(at=at)
        return found

    def changes(self, now: Mapping[str, float | str]) -> dict[str, float | str]:
        """Return the changed parameters once the link is open; `now` has the present changes."""
        return {**({} if self.scenario else now), **dict(self.parameters)}

    def camera(self) -> tuple[Array, Array] | None:
        """Return eye and target, (3,) [m] each, or None for a preset or no view.

        Raises:
            UnknownNameError: The view is neither a preset nor six numbers.
            ConfigError: A coordinate is beyond 100 m, or the camera would look vertically.
        """
        if not self.look or self.look in PRESETS:
            return None
        numbers = self.look.split(",")
        if len(numbers) != 6:
            raise UnknownNameError("look", self.look, PRESETS)
        place = np.array([_number("look", text) for text in numbers])
        for number in place:
            check_range("look", float(number), -_FARTHEST, _FARTHEST, "m")
        if np.linalg.norm(place[:2] - place[3:5]) < 1e-3:
            raise ConfigError("look: the target is exactly above or below the camera")
        return place[:3], place[3:]

    def query(self) -> str:
        """Return the query of the link's address."""
        words: list[tuple[str, str | float]] = [
            (name, getattr(self, name))
            for name in ("scenario", "controller", "robot")
            if getattr(self, name)
        ]
        words += [(p, f"{v:.12g}" if isinstance(v, float) else v) for p, v in self.parameters]
        words += [("look", self.look)] if self.look else []
        words += [("at", f"{self.at:g}")] if self.at is not None else []
        return urlencode(words, safe=",")


def read_link(query: str) -> tuple[str, str]:
    """Return all errors of a link (or an empty text), and the query without the wrong parts."""
    why, kept = [], []
    words = dict(parse_qsl(query, keep_blank_values=True))
    # "at" is checked last, because it needs the name of the scenario.
    for word in sorted(words.items(), key=lambda word: word[0] == "at"):
        try:
            Link.read(urlencode([*kept, word]))
        except DbbError as error:
            why.append(str(error))
        else:
            kept.append(word)
    return "; ".join(why), urlencode(kept, safe=",") if why else query


def camera_text(eye: Array, target: Array) -> str:
    """Return a camera as in a link, rounded to centimetres."""
    return ",".join(f"{number:.2f}" for number in (*eye, *target))


class SharePanel(Panel):
    """A link to the shown scene, and the case of the last run."""

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        self.waiting = Link()
        """Link that waits for its robot, or for its scenario before it sets the camera."""
        viewer.channel.on("link", self.open, str)
        with self._gui.add_folder("Link and case"):
            self.button("Copy link", lambda _: self._copy(), viser.Icon.LINK)
            self._address = self._gui.add_html("", visible=False)
            self.button("Case (JSON)", self._save, viser.Icon.FILE_DOWNLOAD)
            self.upload("Play a case", self._play, mime_type="application/json")

    def update(self, moment: Moment) -> None:
        """Set the camera of the waiting link when its scenario plays."""
        link, newest = self.waiting, moment.newest
        if (
            link.look
            and link.robot in ("", self._shared.model.description.name)
            and newest.scenario == link.scenario
            and not newest.busy
        ):
            self.waiting = Link()
            self._notifier.attempt(self._viewer.client, lambda: self._look_as(link))

    def open(self, query: str) -> None:
        """Apply the page's address; after an error, show the error and change nothing."""
        if query:
            self._notifier.attempt(self._viewer.client, lambda: self._open(Link.read(query)))

    def resume(self, link: Link) -> None:
        """Continue with a link from the previous page; apply it if the page shows its robot."""
        self.waiting = link
        if link.robot == self._shared.model.description.name:
            self._obey(link)

    def _link(self) -> str:
        """Return the address of the shown scene."""
        shared, client = self._shared, self._viewer.client
        newest, shown = shared.loop.latest(), self._viewer.timeline.shown()
        course, camera = shared.course, client.camera
        scenario = course.name if course.name in SCENARIOS else ""
        link = Link(
            scenario,
            newest.controller,
            shared.model.description.name,
            tuple(shared.tuning.changes.items()),
            self._viewer.camera.preset or camera_text(camera.position, camera.look_at),
            round(min(shown.t, course.until), 3) if scenario else None,
        )
        return f"{address_of(client)}?{link.query()}"

    def _open(self, link: Link) -> None:
        shared = self._shared
        if link.robot in ("", shared.model.description.name):
            self._obey(link)
            return
        changes = link.changes(shared.tuning.changes)
        controller = link.controller or shared.loop.latest().controller
        shared.robot_switch.begin(link.robot, changes, controller, shared.loop)
        self.waiting = link

    def _obey(self, link: Link) -> None:
        shared, commands = self._shared, []
        if link.controller:
            commands.append(Choose(link.controller))
        if link.scenario:
            scenario = scenario_of(shared.model.description, link.scenario)
            commands.append(Play(scenario, link.at or 0.0))
        tuning = shared.tuning
        tuning.load(tuning.usual.changed(link.changes(tuning.changes)))
        for command in commands:
            shared.loop.send(command)
        self.waiting = link if link.scenario else Link()
        if link.look and not link.scenario:
            self._look_as(link)

    def _look_as(self, link: Link) -> None:
        place = link.camera()
        if place is None:
            self._viewer.look(link.look)
        else:
            self._viewer.camera.put(*place)

    def _copy(self) -> None:
        box = (
            f'<input readonly value="{escape(self._link())}" aria-label="link" '
            'style="width:100%" onclick="this.select()">'
        )
        run = f'<img src="data:," alt="" style="display:none" onerror="{_COPY}">'
        self._address.content = small(f"Copied. This page now has the same address:<br>{box}{run}")
        self._address.visible = True

    def _save(self, event: Any) -> None:
        case = self._shared.course.case
        if case is None:
            raise CaseError("there is no case yet; play a scenario first")
        newest = self._shared.loop.latest()
        if newest.scenario:  # includes parameters changed during the run
            case = case.model_copy(
                update={"controller": newest.controller, **parameters_of(case, newest.config)}
            )
        name = f"{case.played}.json"
        event.client.send_file_download(name, case.text().encode(), save_immediately=True)

    def _play(self, event: Any) -> None:
        file = taken_upload(event.target)
        try:
            text = text_of(file.content)
        except ValueError as error:
            raise CaseError(f"{file.name}: {error}") from None
        self._notifier.tell(event.client, "Case", play_case(self._shared, text, file.name))


def parameters_of(case: RunCase, config: Config) -> dict[str, Any]:
    """Return the fields of a case with the present parameters."""
    now = {path: config.value(path) for path in case.parameters}
    return {"parameters": now | config.changes(Config())}


def play_case(shared: SharedState, text: str, name: str) -> str:
    """Play a case for all viewers, and return its differences from the recording in words.

    Raises:
        DbbError: The text is not a case, or the case is of another robot. Then nothing changes.
    """
    case = RunCase.read(text, name)
    robot = shared.model.description
    if case.robot != robot.name:
        raise CaseError(
            f"{name} needs the robot {case.robot}: choose this robot in the tab Robot first"
        )
    play = Play(case.scenario())
    shared.tuning.load(case.config())
    for command in (Choose(case.controller), play):
        shared.loop.send(command)
    return "; ".join([f"{case.played} is playing", *case.differences()])


def _value(path: str, text: str) -> float | str:
    return _number(path, text) if isinstance(tunable(path), Parameter) else text


def _number(name: str, text: str) -> float:
    try:
        number = float(text)
    except ValueError:
        number = math.nan
    if not math.isfinite(number):
        raise ConfigError(f"{name}: {text[:40]!r} is not a number")
    return number
