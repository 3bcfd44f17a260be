"""Reading of untrusted data within a budget of time and memory.

A child process reads data that are larger than `SMALL`. The system ends this process when its
processor time exceeds the budget. Except on macOS, the system also refuses memory beyond the
budget. Thus no file can block a server's threads for long, or exhaust its memory (except on macOS).
"""

from __future__ import annotations

import pickle
import threading
from collections.abc import Callable
from contextlib import suppress
from typing import NamedTuple, TypeVar

from app.jobs.process import EndedError, run_in_process
from app.system import limited

Read = TypeVar("Read")

SMALL = 16_000  # [bytes] largest size of data that this process reads itself
_AT_ONCE = threading.BoundedSemaphore(2)  # largest number of reading child processes
_limited = threading.Event()  # set in a reading child, which starts no further child


class BudgetError(ValueError):
    """Reading took more time or memory than its `Budget`, or crashed its process."""


class Budget(NamedTuple):
    """Time and memory for reading data, in addition to the needs of an idle process."""

    seconds: float  # [s] processor time
    memory: int  # [bytes]

    @classmethod
    def of(cls, size: int) -> Budget:
        """Enough time and memory for reading any valid file of a size [bytes]."""
        return cls(2.0 + size / 1e6, 300 * 10**6 + 50 * size)

    def __str__(self) -> str:
        return f"{self.seconds:.2g} s and {self.memory / 1e6:.0f} MB"


def within_budget(read: Callable[..., Read], *args: object, size: int) -> Read:
    """Call `read(*args)` within the budget for data of a `size` [bytes], and return the result.

    `read`, its arguments and its result must be picklable, so `read` is no local function. Data up
    to `SMALL` have no budget; a call in the child process has no further one. If `read` exceeds the
    budget or crashes its process, this raises a BudgetError. Exceptions of `read` are raised here.
    """
    if size <= SMALL or _limited.is_set():
        return read(*args)
    budget = Budget.of(size)
    with _AT_ONCE, suppress(MemoryError, EndedError):
        cancelled = threading.Event()  # is never set
        work = _limited_read, budget, read, args
        packed = run_in_process(*work, report=lambda *_: None, cancelled=cancelled, niceness=0)
        return pickle.loads(packed)
    raise BudgetError(f"it takes more than {budget} to read, more than any valid file")


def _limited_read(
    _: object, budget: Budget, read: Callable[..., object], args: tuple[object, ...]
) -> bytes:
    _limited.set()
    with limited(*budget):
        result = read(*args)
        try:
            return pickle.dumps(result, pickle.HIGHEST_PROTOCOL)  # read-only arrays stay read-only
        except RecursionError:
            raise ValueError("its brackets or tables nest too deeply") from None
        except RuntimeError as error:  # a shape's serialisation has exhausted the memory
            raise MemoryError from error
