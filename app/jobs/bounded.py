"""Reading of untrusted data within a budget of time and memory.

Small data is read in this process. Larger data is read in a child process, which the system ends
if it exceeds its budget. Thus no file can exhaust the memory of a server or block its threads.
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

SMALL = 16 * 2**10
"""[bytes] largest data that is read in this process: more than most configurations."""
_AT_ONCE = threading.BoundedSemaphore(2)  # [-] child processes that read
_never = threading.Event()
_limited = threading.Event()  # set in a reading child, which starts no other


class BudgetError(ValueError):
    """Reading exceeded its budget."""


class Budget(NamedTuple):
    """Time and memory for reading some data, in addition to those of the reader itself."""

    seconds: float
    """[s] of processor time."""
    memory: int
    """[bytes]"""

    @classmethod
    def of(cls, size: int) -> Budget:
        """The budget for data of a size [bytes]: no valid file needs more."""
        return cls(2.0 + size / 1e6, 300 * 10**6 + 50 * size)

    def __str__(self) -> str:
        return f"{self.seconds:.2g} s and {self.memory / 1e6:.0f} MB"


def within_budget(read: Callable[..., Read], *args: object, size: int) -> Read:
    """The result of `read(*args)`, which reads data of a size [bytes].

    `read` is a function of a module; it, its arguments and its result must be picklable.

    Raises:
        BudgetError: Reading exceeds the budget.
        Exception: Any exception of `read`.
    """
    if size <= SMALL or _limited.is_set():
        return read(*args)
    budget = Budget.of(size)
    with _AT_ONCE, suppress(MemoryError, EndedError):
        packed = run_in_process(
            _limited_read, budget, read, args, report=_ignore, cancelled=_never, niceness=0
        )
        return pickle.loads(packed)
    raise BudgetError(f"it takes more than {budget} to read, which no such file needs")


def _limited_read(
    _: object, budget: Budget, read: Callable[..., object], args: tuple[object, ...]
) -> bytes:
    """The result, pickled within the budget because pickling costs time and memory too."""
    _limited.set()
    with limited(*budget):
        result = read(*args)
        try:
            return pickle.dumps(result, pickle.HIGHEST_PROTOCOL)  # keeps arrays read-only
        except RecursionError:
            raise ValueError("its brackets or tables nest too deeply") from None
        except RuntimeError as error:  # of a shape's own stream, which has no more memory
            raise MemoryError from error


def _ignore(*_: object) -> None:
    """Ignore a report of progress."""
