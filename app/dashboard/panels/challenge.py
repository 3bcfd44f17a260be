"""Folder "Make it collide": thirty seconds to pull the robot into itself, and the card after it."""

import viser
from PIL import Image

from app.dashboard.export.offscreen import label
from app.dashboard.job import Challenge, Tried, write_case_replay
from app.dashboard.markup import framed, grid, mark, minus, readings, small
from app.dashboard.panels import Moment, Viewer
from app.dashboard.panels.run import course_figures
from app.dashboard.panels.save import FilePanel, png
from app.dashboard.record import Course
from app.dashboard.scene.colours import Rgb, css
from app.dashboard.verdict import COLOURS
from app.errors import CaseError
from app.simulation.loop.commands import Play
from app.simulation.scenarios.pulled import CHALLENGE
from app.system import temporary_folder

SIZE = 1280, 720  # [px] of the card's picture
_WON, _KEPT = COLOURS["contact"], (64, 160, 92)


class ChallengePanel(FilePanel):
    """The button that begins it, how it goes, and what came of it."""

    def __init__(self, viewer: Viewer) -> None:
        super().__init__(viewer)
        self._shared, name = viewer.shared, CHALLENGE.name
        # Who comes, or reloads the page, meanwhile or afterwards sees how it goes, or went.
        begun = viewer.shared.course.name == name
        with self._gui.add_folder("Make it collide", expand_by_default=begun):
            self._text = self._gui.add_html("")
            loop = viewer.shared.loop
            self._begin = self.button(
                "Begin, 30 s", lambda _: loop.send(Play(CHALLENGE)), viser.Icon.SWORDS
            )
            self._files = [
                self.file(label, icon, f"{name}{ending}", make, visible=False)
                for label, icon, ending, make in (
                    ("Card (PNG)", viser.Icon.CAMERA, ".png", self._picture),
                    ("Replay of it (HTML)", viser.Icon.MOVIE, ".html", self._replay),
                    ("Case of it (JSON)", viser.Icon.FILE_DOWNLOAD, ".json", self._case),
                )
            ]

    def update(self, moment: Moment) -> None:
        """Renew the texts; look at a challenge that has ended."""
        super().update(moment)
        challenge, course = self._shared.challenge, self._shared.course
        under_way = course.running and course.name == CHALLENGE.name
        if not under_way and course.case is not None and course.case.played == CHALLENGE.name:
            challenge.take(course.case, course)
        self._text.content = challenge_html(challenge, course)
        self._begin.label = "Begin anew" if under_way else "Begin, 30 s"
        # What is saved has its figures, and somebody to compare with: `none` comes before them.
        whole = challenge.case is not None and (challenge.case.figures or not challenge.progress)
        for handle in self._files:
            handle.visible = bool(challenge.tried and whole) and not under_way

    def _picture(self) -> bytes:
        tried = self._shared.challenge.tried  # while the scene is drawn another one may begin
        if not tried:
            raise CaseError("nobody has tried yet")
        return png(card(self.scene(*SIZE), tried, dark=self._viewer.view.dark))

    def _replay(self) -> bytes:
        text = self._case().decode()
        with temporary_folder() as folder:
            page = folder / "page.html"
            self._job.run(write_case_replay, text, page)
            return page.read_bytes()

    def _case(self) -> bytes:
        case = self._shared.challenge.case
        if case is None:
            raise CaseError("nobody has tried yet")
        return case.text().encode()


def verdict_text(tried: Tried) -> tuple[str, Rgb]:
    """Who has won, with the colour of it."""
    if tried.met:
        return f"You won: with {tried.controller} the robot met itself", _WON
    return f"The robot kept {_mm(tried.least)}: no contact", _KEPT


def challenge_html(challenge: Challenge, course: Course) -> str:
    """How the challenge goes while it is under way, else what came of the last one."""
    case = challenge.case
    if course.name == CHALLENGE.name and course.running:
        left = max(course.duration - course.until, 0.0)
        going = readings(course_figures(course))
        return small(f"<b>Pull the hand, or any link: {left:.0f} s left.</b>{going}")
    if case is None:
        return small(
            "30 s to pull the robot into itself, however you like; then the other controllers "
            "show what they would have done where you pulled to."
        )
    if not challenge.tried:
        return small("Nobody pulled, so nothing was tried.")
    text, colour = verdict_text(challenge.tried[0])
    rows = []
    for each in challenge.tried:
        texts = (_mm(each.least), f"{each.pull:.0f} N", f"{each.speed:.2f} m/s")
        loud = [mark(text, css(_WON)) if each.met else text for text in texts]
        rows.append((each.controller, *loud))
    state = ""
    if challenge.progress is not None:
        known = {each.controller for each in challenge.tried if each.figures}
        shares = {name: f"{100 * share:.0f} %" for name, share in challenge.shares.items()}
        far = (f"{name} {share}" for name, share in shares.items() if name not in known)
        state = f"Played again, step by step: {', '.join(far) or 'begins'}"
    table = grid(("", "least", "pull", "hand"), rows)
    same = "Pulled to the same places, each controller:"
    return framed(f"<b>{text}.</b><br>{same}{table}{state}{challenge.problem}", css(colour))


def card(scene: Image.Image, tried: tuple[Tried, ...], *, dark: bool) -> Image.Image:
    """The result of a challenge written over a picture of the scene."""
    lines: list[str | tuple[str, Rgb]] = ["Make it collide", verdict_text(tried[0])]
    lines.append(f"hardest pull {tried[0].pull:.0f} N, fastest hand {tried[0].speed:.2f} m/s")
    for each in tried[1:]:
        text = f"{each.controller}, pulled to the same places: "
        text += "contact" if each.met else f"{_mm(each.least)}, no contact"
        lines.append((text, _WON) if each.met else text)
    return label(scene, lines, dark=dark)


def _mm(distance: float) -> str:
    return minus(f"{1000 * distance:.0f} mm")
