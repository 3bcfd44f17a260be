"""Pacing: steps with a fixed period, in real time or at a multiple of real time, and statistics."""

import gc
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, sleep

_CATCH_UP = 0.2  # [s] largest delay that faster steps make up for
_WINDOW = 1.0  # [s] window of the statistics
_COARSE = 2e-4  # [s] shortest sleep that is worth a switch of threads


class Pacer:
    """Synchronises a loop with the wall clock. After a late step, steps do not sleep until the loop
    is on time; a delay above 0.2 s restarts the schedule instead, and lowers the real-time factor.
    """

    def __init__(self, period: float, speed: float = 1.0) -> None:
        """Start the schedule now; `period` [s] is the simulated duration of a step."""
        self._period = period
        self.speed = speed  # [-] desired ratio of simulated to real time; `restart` applies it
        self.overruns = 0  # number of steps that exceeded their period, or began after its end
        self._marks: deque[float] = deque()  # [s] ends of the steps in the window
        self._works: deque[float] = deque(maxlen=round(_WINDOW / period))
        self.restart()

    def restart(self) -> None:
        """Start a new schedule now, as after a pause."""
        self._real = self._period / self.speed  # [s] real time of a step
        self._begun = perf_counter()
        self._due = self._begun + self._real
        self._marks.clear()

    def worked(self, duration: float) -> None:
        """Record the real time [s] of the controller in this step."""
        self._works.append(duration)

    def wait(self) -> None:
        """End a step: sleep until its period ends; continue at once if less than 0.2 ms remain."""
        now = perf_counter()
        self._marks.append(now)
        while len(self._marks) > 2 and now - self._marks[0] > _WINDOW:
            self._marks.popleft()
        if now - self._begun > self._real or self._begun > self._due:
            self.overruns += 1
        late = now - self._due
        if late > _CATCH_UP:
            self._due = now
        elif late < -_COARSE:
            sleep(-late)
        self._due += self._real
        self._begun = perf_counter()

    @property
    def realtime_factor(self) -> float:
        """[-] ratio of simulated to real time in the last second; `speed` before two steps."""
        if len(self._marks) < 2:
            return self.speed
        passed = self._marks[-1] - self._marks[0]
        return (len(self._marks) - 1) * self._period / max(passed, 1e-9)

    @property
    def step_time_us(self) -> float:
        """[µs] mean real time of the controller in the last simulated second; 0 before a step."""
        return 1e6 * sum(self._works) / len(self._works) if self._works else 0.0


@contextmanager
def gc_frozen() -> Iterator[None]:
    """Exclude existing objects, such as a large border, from garbage collection in the `with`."""
    outermost = gc.get_freeze_count() == 0
    if outermost:
        gc.freeze()
    try:
        yield
    finally:
        if outermost:
            gc.unfreeze()
