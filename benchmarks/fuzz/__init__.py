"""A fuzz test of untrusted input: messages of a page, and files."""

from __future__ import annotations

from typing import NamedTuple


class Length(NamedTuple):
    """How long there is fuzzing: for a time, or until a count.

    Attributes:
        seconds: [s]
        count: Of messages, or of files of each kind; the time does not count then.
    """

    seconds: float
    count: int | None = None

    def share(self, gone: float, done: int) -> float:
        """The share that is done after a time [s], 1 or more at the end."""
        return gone / self.seconds if self.count is None else done / self.count
