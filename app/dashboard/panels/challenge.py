"""Folder "Make it collide": thirty seconds to pull the robot into itself, and the card after it."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import viser
from PIL import Image

from app.dashboard.challenge import Challenge, Tried, write_case_replay
from app.dashboard.export.labels import label
from app.dashboard.job import Job
from app.dashboard.markup import RIGHT, cell, minus, row, small, table
from app.dashboard.notifications import Notifier
from app.dashboard.panels import Panel
from app.dashboard.panels.save import on_ground, png
from app.dashboard.record import Course
from app.dashboard.scene.colours import BACKGROUND, Rgb, css
from app.dashboard.shared import SharedState
from app.dashboard.verdict import COLOURS
from app.dashboard.view import View
from app.errors import BrowserError, CaseError
from app.simulation.case import RunCase
from app.simulation.loop.commands import Pause, Play
from app.simulation.scenarios.pulled import CHALLENGE

SIZE = 1280, 720  # [px] of the card's picture
_PATIENCE = 30.0  # [s] for a browser to draw it
_WON, _KEPT = COLOURS["contact"], (64, 160, 92)


class ChallengePanel(Panel):
    """The button that begins it, how it goes, and what came of it."""

    def __init__(
        self, gui: viser.GuiApi, shared: SharedState, view: View, job: Job, notifier: Notifier
    ) -> None:
        """Build the folder; `job` makes the viewer's files, one after the other."""
        super().__init__(gui, notifier)
        self._shared, self._view, self._job = shared, view, job
        with gui.add_folder("Make it collide", expand_by_default=False) as self._folder:
            self._text = gui.add_html("")
            self._begin = self.button("Begin, 30 s", lambda _: self._play(), viser.Icon.SWORDS)
            self._files = [
                self._file("Card (PNG)", viser.Icon.CAMERA, ".png", self._picture),
                self._file("Replay of it (HTML)", viser.Icon.MOVIE, ".html", self._replay),
                self._file("Case of it (JSON)", viser.Icon.FILE_DOWNLOAD, ".json", self._case),
            ]

    def update(self) -> None:
        """Renew the texts; called by the drawing thread."""
        shared = self._shared
        challenge, course = shared.challenge, shared.course
        under_way = course.running and course.name == CHALLENGE.name
        if not under_way and course.case is not None and course.case.played == CHALLENGE.name:
            challenge.take(course.case)
        self._text.content = challenge_html(challenge, course)
        self._begin.label = "Begin anew" if under_way else "Begin, 30 s"
        for handle in self._files:
            handle.visible = bool(challenge.tried) and not under_way

    def _play(self) -> None:
        for command in (Pause(False), Play(CHALLENGE)):
            self._shared.loop.send(command)

    def _file(
        self, text: str, icon: Any, ending: str, make: Callable[[RunCase, Any], bytes]
    ) -> viser.GuiButtonHandle:
        """Add a button that makes a file of the challenge beside the simulation and sends it."""

        def pressed(event: viser.GuiEvent) -> None:
            client, case = event.client, self._shared.challenge.case
            if client is None or case is None:
                raise CaseError("nobody has tried yet")

            def send() -> None:
                name = f"{CHALLENGE.name}{ending}"
                client.send_file_download(name, make(case, client), save_immediately=True)

            self._job.start(text, "is being made", lambda: self._notifier.attempt(client, send))

        return self.button(text, pressed, icon, visible=False)

    def _picture(self, _: RunCase, client: viser.ClientHandle) -> bytes:
        width, height = SIZE
        try:
            pixels = client.get_render(height, width, transport_format="png", timeout=_PATIENCE)
        except (RuntimeError, TimeoutError) as error:
            raise BrowserError(f"the browser gave no picture: {error}") from None
        scene = on_ground(pixels, BACKGROUND[self._view.dark])
        return png(card(scene, self._shared.challenge.tried, dark=self._view.dark))

    def _replay(self, case: RunCase, _: Any) -> bytes:
        with tempfile.TemporaryDirectory() as folder:
            page = Path(folder) / "page.html"
            self._job.run(write_case_replay, case.text(), page)
            return page.read_bytes()

    def _case(self, case: RunCase, _: Any) -> bytes:
        return case.text().encode()


def verdict_text(tried: Tried) -> tuple[str, Rgb]:
    """Who has won, with the colour of it."""
    if tried.met:
        return f"You won: with {tried.controller} the robot met itself", _WON
    return f"The robot kept {_mm(tried.least)}: no contact", _KEPT


def challenge_html(challenge: Challenge, course: Course) -> str:
    """How the challenge goes while it is under way, else what came of the last one."""
    progress, case = challenge.progress, challenge.case
    going = ""
    if course.name == CHALLENGE.name:
        rows = [
            ("least distance", _mm(course.least)),
            ("hardest pull", f"{course.pull:.0f} N"),
            ("fastest hand", f"{course.speed:.2f} m/s"),
        ]
        going = table(row(cell(name), cell(text, RIGHT)) for name, text in rows)
        if course.running:
            left = max(course.duration - course.until, 0.0)
            return small(f"<b>Pull the hand, or any link: {left:.0f} s left.</b>{going}")
    state = f"{progress.text}, {100 * max(progress.share, 0):.0f} %" if progress else ""
    if case is None:
        return small(
            "30 s to pull the robot into itself, however you like; then the other controllers "
            "show what they would have done under the same pull."
        )
    if not challenge.tried:
        told = state and f"{going}Who has won is looked at step by step: {state}"
        return small(told or challenge.problem or "Nobody pulled, so nothing was tried.")
    text, colour = verdict_text(challenge.tried[0])
    heads = ("", "least", "pull", "hand")
    rows = [row(*(cell(name, RIGHT, head=True) for name in heads))]
    for each in challenge.tried:
        bad = f"color:{css(_WON)}" if each.met else ""
        cells = (_mm(each.least), f"{each.pull:.0f} N", f"{each.speed:.2f} m/s")
        rows.append(row(cell(each.controller), *(cell(c, RIGHT, bad) for c in cells)))
    return small(
        f"<b>{text}.</b><br>The same pull, each controller:{table(rows)}{state}{challenge.problem}",
        f"border:1px solid {css(colour)};border-left:6px solid {css(colour)};margin:.4em .7em",
    )


def card(scene: Image.Image, tried: tuple[Tried, ...], *, dark: bool) -> Image.Image:
    """The result of a challenge written over a picture of the scene."""
    lines: list[str | tuple[str, Rgb]] = ["Make it collide", verdict_text(tried[0])]
    lines.append(f"hardest pull {tried[0].pull:.0f} N, fastest hand {tried[0].speed:.2f} m/s")
    for each in tried[1:]:
        text = f"the same pull with {each.controller}: "
        text += "contact" if each.met else f"{_mm(each.least)}, no contact"
        lines.append((text, _WON) if each.met else text)
    return label(scene, lines, dark=dark)


def _mm(distance: float) -> str:
    return minus(f"{1000 * distance:.0f} mm")
