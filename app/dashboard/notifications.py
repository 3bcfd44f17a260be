"""Notifications to viewers, for example about an exception in a callback."""

import logging
from collections.abc import Callable, Coroutine
from time import monotonic
from typing import Any

import viser

from app.dashboard.markup import plain
from app.dashboard.phrases import sentence
from app.errors import DbbError

logger = logging.getLogger("app.dashboard")  # for all errors that viewers can cause
_LONGEST = 2000  # [characters] of a notification


class Notifier:
    """Shows notifications to one viewer or to all."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server
        self._shown: dict[tuple[int, str], tuple[str, int, Any, float]] = {}
        """By viewer and title: text, number of equal texts in a row, handle, and end [s]."""

    def warn(self, client: viser.ClientHandle | None, text: str) -> None:
        """Show for 6 s why an action was refused; to all viewers if `client` is None."""
        self._show(client, "Not possible", sentence(text), "orange")

    def tell(self, client: viser.ClientHandle | None, title: str, text: str) -> None:
        """Show a message for 6 s; to all viewers if `client` is None."""
        self._show(client, title, text, "blue")

    def clear(self, client: viser.ClientHandle) -> None:
        for key, (_, _, handle, _) in list(self._shown.items()):
            if key[0] == client.client_id:
                handle.remove()
                del self._shown[key]

    def guard(self, callback: Callable[[Any], None]) -> Callable[[Any], Coroutine[Any, Any, None]]:
        """Wrap a short callback for viser; its exceptions are shown to the event's `client`."""

        async def guarded(event: Any) -> None:  # viser runs it in its event loop
            self.attempt(event.client, lambda: callback(event))

        return guarded

    def attempt(self, client: viser.ClientHandle | None, act: Callable[[], None]) -> None:
        """Run an action of a viewer; show its exception, to all viewers if `client` is None."""
        try:
            act()
        except DbbError as error:
            self.warn(client, str(error))
        except Exception as error:  # the viewer must see it
            logger.exception("the dashboard failed")
            self._show(client, "Internal error", plain(error), "red")

    def _show(self, client: viser.ClientHandle | None, title: str, text: str, colour: Any) -> None:
        seconds = 30.0 if colour == "red" else 6.0
        text = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"  # from a file, for example
        here = self._server.get_clients()
        clients = here if client is None else {client.client_id: client}
        for key in tuple(self._shown):
            if key[0] not in (*here, *clients):  # a handle would keep a closed page in memory
                self._shown.pop(key, None)
        for each in clients.values():
            key = (each.client_id, title)
            before, count, old, until = self._shown.get(key, ("", 0, None, 0.0))
            if old is not None:
                old.remove()  # at most one message of each title
            count = count + 1 if before == text and monotonic() < until else 1
            body = text if count == 1 else f"{text} ({count} times)"
            handle = each.add_notification(title, body, color=colour, auto_close_seconds=seconds)
            self._shown[key] = text, count, handle, monotonic() + seconds
