"""A session that records the start and the duration of each step."""

from __future__ import annotations

import struct
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from app.simulation.session import Session, Step


class TimedSession(Session):
    """A session that writes its record to a file during the run, in any process and for hours."""

    def __init__(self, record: Path, *args: Any, **options: Any) -> None:
        """Prepare a session that writes start and duration of each step to `record`."""
        self._file = record.open("wb", buffering=1 << 16)
        super().__init__(*args, **options)

    def step(self, *args: Any, **options: Any) -> Step:
        """Advance by one control step, and record its start and duration."""
        begin = perf_counter()
        step = super().step(*args, **options)
        duration, beta = perf_counter() - begin, float(step.control.beta_m)
        self._file.write(struct.pack("4d", begin, duration, step.duration, beta))
        return step

    def close(self) -> None:
        """Release the plant and end the record."""
        super().close()
        self._file.close()


def read_times(record: Path) -> np.ndarray:
    """(N, 4) start [s], duration [s], controller's part [s] and β_m [-] of each step."""
    return np.fromfile(record).reshape(-1, 4)
