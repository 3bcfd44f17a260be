"""Folder "Link and case": what is played, to be sent to somebody or kept."""

from __future__ import annotations

import json
from collections.abc import Callable
from html import escape
from typing import Any

import viser

from app.dashboard.link import changed_parameters
from app.dashboard.markup import small
from app.dashboard.notifications import Notifier
from app.dashboard.panels import Panel
from app.dashboard.shared import SharedState
from app.dashboard.viser_compat import taken_upload
from app.errors import CaseError
from app.simulation.case import FORMAT, RunCase
from app.simulation.loop.commands import Choose, Pause, Play
from app.strict import parsed

LARGEST = 8 * 2**20
"""[bytes] of a case's file."""
_COPY = (
    "const box=this.previousElementSibling;box.focus();box.select();document.execCommand('copy');"
    "history.replaceState(null,'',box.value)"
)
"""In the page, once the link has arrived there: it is copied, and is the page's address."""


class SharePanel(Panel):
    """A link to what is seen, and the case of what was played last."""

    def __init__(
        self,
        gui: viser.GuiApi,
        shared: SharedState,
        notifier: Notifier,
        link: Callable[[], str],
    ) -> None:
        """Build the folder; `link` makes the address of what the viewer sees."""
        super().__init__(gui, notifier)
        self._shared, self._link = shared, link
        with gui.add_folder("Link and case"):
            self.button("Copy link", lambda _: self._copy(), viser.Icon.LINK)
            self._address = gui.add_html("", visible=False)
            self.button("Case (JSON)", self._save, viser.Icon.FILE_DOWNLOAD)
            self.upload("Play a case", self._play, mime_type="application/json")

    def _copy(self) -> None:
        box = (
            f'<input readonly value="{escape(self._link())}" aria-label="link" '
            'style="width:100%" onclick="this.select()">'
        )
        run = f'<img src="data:," alt="" style="display:none" onerror="{_COPY}">'
        self._address.content = small(f"Copied; it is this page's address now too:<br>{box}{run}")
        self._address.visible = True

    def _save(self, event: Any) -> None:
        case = self._shared.course.case
        if case is None:
            raise CaseError("nothing has been played yet: a case is of a scenario, or a challenge")
        newest = self._shared.loop.latest()
        if newest.scenario:  # what is tuned meanwhile is meant too
            case = case.model_copy(
                update={"controller": newest.controller, **parameters_of(case, newest.config)}
            )
        name = f"{case.played}.json"
        event.client.send_file_download(name, case.text().encode(), save_immediately=True)

    def _play(self, event: Any) -> None:
        file = taken_upload(event.target)
        if len(file.content) > LARGEST:
            raise CaseError(f"{file.name}: {len(file.content) / 1e6:.0f} MB is no case")
        try:
            content = parsed(json.loads, file.content.decode())
        except ValueError:
            raise CaseError(f"{file.name} is no case: not JSON") from None
        if not isinstance(content, dict) or FORMAT not in content:
            raise CaseError(f"{file.name} is no case: it has no {FORMAT!r}")
        self._notifier.tell(event.client, "Case", play_case(self._shared, content, file.name))


def parameters_of(case: RunCase, config: Any) -> dict[str, Any]:
    """The field of a case that has the parameters of now."""
    now = {**case.parameters, **{path: config.value(path) for path in case.parameters}}
    return {"parameters": now | dict(changed_parameters(config))}


def play_case(shared: SharedState, content: dict[str, Any], name: str) -> str:
    """Play a case for all viewers; what differs from when it was made, in words.

    Raises:
        DbbError: It is none, or of another robot; then nothing has changed.
    """
    case = RunCase.read(content, name)
    robot = shared.model.description
    if case.robot != robot.name:
        raise CaseError(f"{name} is of the robot {case.robot}: choose it in the tab Robot first")
    play = Play(case.scenario())
    shared.tuning.load(case.config())
    for command in (Choose(case.controller), Pause(False), play):
        shared.loop.send(command)
    return "; ".join([f"{case.played} plays again", *case.differences()])
