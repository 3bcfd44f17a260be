"""Figures as they are kept: rounded so that the machine's memory has no part in them."""

from __future__ import annotations

DIGITS = 9
"""[-] after the point, of metres, radians, newtons and seconds."""


def rounded(value: object) -> object:
    """A number rounded to `DIGITS`, anything else as it is.

    The QP solver's answers differ in their last digit with where its memory lies, and a result is
    to be the same on any number of processes.
    """
    return round(value, DIGITS) if isinstance(value, float) else value
