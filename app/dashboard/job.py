"""Background job: one piece of work beside the simulation, with progress, result and cancellation.

All viewers see the same job. Work that takes a core runs in a process of its own (`Job.run`).
"""

from __future__ import annotations

import gc
import logging
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from app.errors import ConfigError, DbbError
from app.jobs.process import Cancelled, run_in_process
from app.system import give_freed_memory_back


def give_back() -> None:
    """Collect what only cycles hold, and give the freed memory back.

    Python looks for old cycles only once they are a quarter of all objects, and few objects may
    hold much: a model, a border, an open pipe.
    """
    gc.collect()
    give_freed_memory_back()


logger = logging.getLogger(__name__)

_PATIENCE = 10.0  # [s] for a thread to end


@dataclass(frozen=True)
class Progress:
    """How far a job is.

    Attributes:
        title: What is worked on.
        text: What is being done.
        share: 0 to 1; below 0 if it is unknown.
    """

    title: str
    text: str
    share: float = -1.0


class Job:
    """At most one piece of work at a time.

    Any thread may call any of the methods.

    Attributes:
        progress: Of the work under way, or None.
        problem: Why the last work failed, or an empty string.
    """

    def __init__(self) -> None:
        """Nothing under way."""
        self.progress: Progress | None = None
        self.problem = ""
        self._cancelled = threading.Event()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def start(self, title: str, text: str, work: Callable[[], None]) -> None:
        """Do a piece of work in a thread.

        Args:
            title: What is worked on.
            text: What is done first.
            work: Ends early by `Cancelled`; any other exception becomes `problem`.

        Raises:
            ConfigError: Another one is under way.
        """
        with self._lock:
            running = self.progress  # read once: its thread may end
            if running is not None:
                raise ConfigError(f"{running.title}: {running.text}; cancel that first")
            self.progress = Progress(title, text)
        self.problem = ""
        self._cancelled.clear()
        self._thread = threading.Thread(
            target=self._work, args=(title, work), name="job", daemon=True
        )
        self._thread.start()

    def run(self, work: Callable[..., Any], *args: Any) -> Any:
        """Run `work(report, *args)` in a process; see `run_in_process`. Part of a started work."""
        return run_in_process(work, *args, report=self.report, cancelled=self._cancelled)

    def report(self, text: str, share: float = -1.0) -> None:
        """Renew `progress`; part of a started work."""
        if self.progress is not None:
            self.progress = Progress(self.progress.title, text, share)

    def check(self) -> None:
        """Go on if nobody has cancelled the work.

        Raises:
            Cancelled: Somebody has.
        """
        if self._cancelled.is_set():
            raise Cancelled("cancelled")

    def cancel(self) -> None:
        """End the work under way; nothing of it is left."""
        self._cancelled.set()

    def close(self) -> None:
        """Cancel, and wait until the work has ended."""
        self.cancel()
        if self._thread is not None:
            self._thread.join(_PATIENCE)

    def _work(self, title: str, work: Callable[[], None]) -> None:
        problem = ""
        try:
            work()
        except Cancelled:
            problem = f"{title}: cancelled"
        except (DbbError, OSError) as error:
            problem = f"{title}: {str(error).removeprefix(f'{title}: ')}"
        except Exception as error:  # nobody joins this thread: the viewers have to learn of it
            logger.exception("%s failed", title)
            problem = f"{title}: {type(error).__name__}: {error}"
        finally:
            self.problem = problem
            give_back()
            self.progress = None
