"""A fuzz test of untrusted input: messages of a page, and files."""

from __future__ import annotations

from typing import NamedTuple


class Length(NamedTuple):
    """Length of a fuzz test: a time or a number.

    Attributes:
        seconds: [s] duration.
        count: Number of messages, or of files of each kind, instead of the duration; or None.
    """

    seconds: float
    count: int | None = None

    def share(self, gone: float, done: int) -> float:
        """The finished share; 1 or more at the end.

        It follows from the elapsed time `gone` [s], or with a `count` from the number `done`.
        """
        return gone / self.seconds if self.count is None else done / self.count
