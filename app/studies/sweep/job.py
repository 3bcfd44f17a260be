"""A sweep in a process of its own, at low priority, beside something that must not be held up."""

from __future__ import annotations

import multiprocessing as mp
import os
import signal
from pathlib import Path
from typing import Any

from app.errors import DbbError, OutputError
from app.studies.sweep.plan import SweepPlan
from app.system import SPAWN, step_back

_NICENESS = 15  # [-] of 19
_END = 5.0  # [s] that a process may take to end


class SweepJob:
    """At most one sweep at a time; the process ends with this one."""

    def __init__(self) -> None:
        self._process: Any = None
        self._done: Any = None
        self._problem: Any = None

    @property
    def running(self) -> bool:
        """Whether a sweep is under way."""
        return self._process is not None and self._process.is_alive()

    @property
    def done(self) -> float:
        """Share of the work that is done, 0 to 1."""
        return 0.0 if self._done is None else float(self._done.value)

    def start(self, plan: SweepPlan, folder: Path) -> None:
        """Begin; its files are written into the folder when it has ended.

        Raises:
            OutputError: The folder cannot be made.
        """
        self.stop()
        try:
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write to {folder}: {error.strerror}") from None
        self._done = SPAWN.Value("d", 0.0)
        self._problem, sender = SPAWN.Pipe(duplex=False)
        self._process = SPAWN.Process(
            target=_work, args=(plan, folder, self._done, sender), daemon=True
        )
        self._process.start()
        sender.close()

    def problem(self) -> str | None:
        """Why the last sweep gave nothing, once it has ended; None if all went well."""
        if self._process is None or self.running:
            return None
        try:
            return str(self._problem.recv()) if self._problem.poll() else self._exit()
        except EOFError:
            return self._exit()

    def stop(self) -> None:
        """End it, if it is under way, and forget it."""
        if self._process is None:
            return
        self._process.terminate()
        self._process.join(_END)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()
        self._process = None

    def _exit(self) -> str | None:
        code = self._process.exitcode
        return f"the sweep's process ended with status {code}" if code else None


def _work(plan: SweepPlan, folder: Path, done: Any, problem: Any) -> None:
    """What the process does."""
    # Imported here: the process that starts this one need not know matplotlib.
    from app.studies.sweep.files import write_sweep
    from app.studies.sweep.sweep import sweep

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is answered by who started it
    step_back(_NICENESS)
    parent = mp.parent_process()

    def tell(share: float) -> None:
        if parent is not None and not parent.is_alive():  # killed, so nobody waits for this
            os._exit(1)
        done.value = share

    try:
        write_sweep(sweep(plan, processes=1, on_progress=tell), folder)
    except DbbError as error:
        problem.send(str(error))
    finally:
        problem.close()
