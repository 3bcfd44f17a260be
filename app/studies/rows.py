"""What studies and sweeps share: a run as a row of rounded figures, and their JSON."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from app.system import write_whole

Row = dict[str, Any]
"""Numbers, texts, truths and None, by columns that end in their unit; no NaN."""

DIGITS = 9
"""[-] after the point, of metres, radians, newtons and seconds."""


def rounded(value: object) -> object:
    """A number rounded to `DIGITS`, anything else as it is.

    The QP solver's answers differ in their last digit with where its memory lies, and a result is
    to be the same on any number of processes.
    """
    return round(value, DIGITS) if isinstance(value, float) else value


def write_json(path: Path, content: object) -> None:
    """Write a file whole or not at all."""
    text = json.dumps(content, indent=2, allow_nan=False) + "\n"
    write_whole(path, text)
