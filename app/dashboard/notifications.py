"""Notifications to viewers, and callbacks whose exceptions become notifications."""

from __future__ import annotations

import logging
from collections.abc import Awaitable, Callable
from typing import Any

import viser

from app.errors import DbbError

logger = logging.getLogger(__name__)


class Notifier:
    """Notifications, to one client or to all."""

    def __init__(self, server: viser.ViserServer) -> None:
        self._server = server

    def warn(self, client: viser.ClientHandle | None, text: str) -> None:
        """Something was refused; goes away by itself."""
        self._show(client, "Not possible", text, "orange", 6.0)

    def inform(self, text: str) -> None:
        """Something that all viewers should know; goes away by itself."""
        self._show(None, "Robot", text, "blue", 6.0)

    def fail(self, client: viser.ClientHandle | None, error: BaseException) -> None:
        """A defect of the program: stays until it is closed, and goes to the log."""
        logger.error("the dashboard failed", exc_info=error)
        self._show(client, "Internal error", f"{type(error).__name__}: {error}", "red", None)

    def guard(self, callback: Callable[[Any], None]) -> Callable[[Any], Awaitable[None]]:
        """The callback for viser, none of whose exceptions is lost.

        It is `async`, so that viser runs it on its event loop: in order, and one at a time. So it
        must be short.

        Args:
            callback: Takes an event that has a `client`.
        """

        async def guarded(event: Any) -> None:
            try:
                callback(event)
            except DbbError as error:
                self.warn(event.client, str(error))
            except Exception as error:  # the person who pressed must learn of it
                self.fail(event.client, error)

        return guarded

    def _show(
        self,
        client: viser.ClientHandle | None,
        title: str,
        text: str,
        colour: Any,
        seconds: float | None,
    ) -> None:
        clients = [client] if client is not None else list(self._server.get_clients().values())
        for each in clients:
            each.add_notification(title, text, color=colour, auto_close_seconds=seconds)
