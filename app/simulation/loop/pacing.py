"""Pacing: steps of a fixed period in real time, or a multiple of it, and how well it is kept."""

import gc
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from time import perf_counter, sleep

_CATCH_UP = 0.2  # [s] of delay that is made good; more is given up
_WINDOW = 1.0  # [s] over which figures are taken
_COARSE = 2e-4  # [s] a shorter sleep is not worth a switch of threads


class Pacer:
    """Lets a loop of fixed period keep to the wall clock.

    A late step is followed at once by the next ones until the delay is made good; a delay of more
    than 0.2 s is given up and shows in the real-time factor.
    """

    def __init__(self, period: float, speed: float = 1.0) -> None:
        """Begin now; a step is a `period` [s], at `speed` [-] simulated over real time."""
        self._period, self._speed = period, speed
        self.overruns = 0
        """Steps that missed their period: their own work took longer, or they began after it was
        over."""
        self._marks: deque[tuple[float, int]] = deque()
        self._works: deque[float] = deque(maxlen=round(_WINDOW / period))
        self._steps = 0
        self.restart()

    def restart(self) -> None:
        """Begin a new schedule now, as after a pause."""
        self._begun = perf_counter()
        self._due = self._begun + self._real
        self._marks.clear()

    @property
    def speed(self) -> float:
        """[-] wanted simulated time over real time; another one begins a new schedule."""
        return self._speed

    @speed.setter
    def speed(self, speed: float) -> None:
        self._speed = speed
        self.restart()

    @property
    def _real(self) -> float:
        """[s] of real time in a step."""
        return self._period / self._speed

    def worked(self, duration: float) -> None:
        """Note the real time [s] that the controller took in this step."""
        self._works.append(duration)

    def wait(self) -> None:
        """Sleep until the step's period is over."""
        now = perf_counter()
        self._steps += 1
        self._marks.append((now, self._steps))
        while len(self._marks) > 2 and now - self._marks[0][0] > _WINDOW:
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
        """[-] simulated over real time in the last second; as wanted before it is known."""
        if len(self._marks) < 2:
            return self._speed
        (begin, first), (end, last) = self._marks[0], self._marks[-1]
        return (last - first) * self._period / max(end - begin, 1e-9)

    @property
    def step_time_us(self) -> float:
        """[µs] mean duration of a control step in the last second."""
        return 1e6 * sum(self._works) / len(self._works) if self._works else 0.0


@contextmanager
def settled() -> Iterator[None]:
    """Let the garbage collector leave alone what is there already.

    A run's own objects are few, a robot's border is not: looking through it again takes
    milliseconds. Within another one it changes nothing. At the end all is looked at again: else
    solvers held in cycles would be reported as leaks.
    """
    outermost = gc.get_freeze_count() == 0
    if outermost:
        gc.freeze()
    try:
        yield
    finally:
        if outermost:
            gc.unfreeze()
