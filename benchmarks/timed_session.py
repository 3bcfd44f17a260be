"""A session that notes when each of its steps began and how long it took."""

from __future__ import annotations

from array import array
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

from app.simulation.session import Session, Step


class TimedSession(Session):
    """Writes its record when it is closed, so that it may live in any thread or process."""

    def __init__(self, record: Path, *args: Any, **options: Any) -> None:
        """A session, see there, that writes its times to `record`, a file of numpy."""
        self._record = record
        self._times = array("d")  # grows in place: appending costs 0.1 µs
        super().__init__(*args, **options)

    def step(self, *args: Any, **options: Any) -> Step:
        """Advance by one control step."""
        begin = perf_counter()
        step = super().step(*args, **options)
        self._times.extend(
            (begin, perf_counter() - begin, step.duration, step.output.avoidance.beta_m)
        )
        return step

    def close(self) -> None:
        """Release the plant and write the record."""
        super().close()
        np.save(self._record, np.array(self._times).reshape(-1, 4))
