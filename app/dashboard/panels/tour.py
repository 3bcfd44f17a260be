"""Five short steps for who opens the page for the first time."""

from __future__ import annotations

import threading
from collections.abc import Callable

import viser

from app.dashboard.notifications import Notices

STEPS = (
    (
        "Drag the hand",
        "Pull one of the arrows at the gripper towards the base: a person's spring "
        "pulls the hand along. Any link of the arm can be pulled by itself.",
    ),
    (
        "Watch the base",
        "The coloured shell is the border around the base. Once the arm is inside, "
        "the base moves away: yellow is where it moves well, blue is where it cannot go.",
    ),
    (
        "Read why",
        "The tab **Why** on the left says in words and numbers what moves the base, and "
        "**Key** what each colour and arrow means.",
    ),
    (
        "Go back in time",
        "The slider below the scene shows the last minute again, with all readings "
        "and plots. **Now** returns.",
    ),
    (
        "Compare and tune",
        "**Scenario** plays the paper's experiments. **Compare** runs other "
        "controllers on the same pull, **Tune** has every parameter.",
    ),
)
"""Title and text of each step."""
SEEN = "dbb-tour-seen"  # key in the browser's own storage
_PATIENCE = 5.0  # [s] for the browser's answer


class Tour:
    """Opens by itself at a first visit, and whenever `begin` is called."""

    def __init__(self, client: viser.ClientHandle, notices: Notices) -> None:
        """Ask the browser whether it has been here before.

        Args:
            client: The viewer.
            notices: For what goes wrong.
        """
        self._client, self._notices = client, notices
        self._modal: viser.GuiModalHandle | None = None
        self._step = 0
        threading.Thread(target=self._ask, name="tour", daemon=True).start()

    def begin(self) -> None:
        """Show the first step."""
        self._step = 0
        self._show()

    def _ask(self) -> None:
        storage = self._client.local_storage
        try:
            seen = storage.get_item(SEEN, timeout=_PATIENCE)
        except (RuntimeError, TimeoutError):  # gone already, or without storage
            return
        if seen is None:
            storage.set_item(SEEN, "yes")
            self.begin()

    def _show(self) -> None:
        self.end()
        title, text = STEPS[self._step]
        gui = self._client.gui
        modal = self._modal = gui.add_modal(f"{self._step + 1} of {len(STEPS)}: {title}")
        with modal:
            gui.add_markdown(text)
            last = self._step + 1 == len(STEPS)
            self._button("Done" if last else "Next", self.end if last else self._next)
            if not last:
                self._button("Skip the tour", self.end)

    def end(self) -> None:
        """Close it."""
        if self._modal is not None:
            self._modal.close()
            self._modal = None

    def _next(self) -> None:
        self._step += 1
        self._show()

    def _button(self, label: str, action: Callable[[], None]) -> None:
        button = self._client.gui.add_button(label)
        button.on_click(self._notices.guard(lambda _: action()))  # type: ignore[arg-type]
