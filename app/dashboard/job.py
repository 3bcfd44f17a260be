"""Background jobs of the page: cancellable work in parallel to the simulation.

Work that fully occupies a core runs in a separate process (`Job.run`), which imports the module of
the work. So that the import of this module is fast, its functions import other modules themselves.
"""

from __future__ import annotations

import gc
import logging
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

from app.dashboard.markup import plain
from app.errors import ConfigError, DbbError
from app.jobs.bounded import Budget
from app.jobs.process import Cancelled, Report, run_in_process
from app.onboarding import helpers
from app.system import limited, return_freed_memory, usable_cores, write_whole

if TYPE_CHECKING:
    from app.border.cache import BorderData
    from app.onboarding.read.package import Contents
    from app.onboarding.request import Request
    from app.robot.model import RobotModel
    from app.simulation.trace.trace import Trace

logger = logging.getLogger("app.dashboard")  # for all jobs that viewers can start
_CORES = max(1, usable_cores() - 1)  # [-] cores for a job; the simulation needs one core
_PATIENCE = 10.0  # [s] timeout for the end of a thread


def give_back(*, frozen: bool = False) -> None:
    """Run the garbage collector, and return the freed memory to the system.

    Python itself rarely searches old objects for reference cycles. If `frozen`, objects that
    `gc_frozen` has excluded are searched too; if there are any, all objects are excluded again.
    """
    frozen &= gc.get_freeze_count() > 0
    if frozen:
        gc.unfreeze()
    gc.collect()
    if frozen:
        gc.freeze()
    return_freed_memory()


class Progress(NamedTuple):
    title: str
    began: float  # [s] start of the job, by `time.monotonic`
    text: str  # present step
    share: float = -1.0  # [-] completed share of this step, 0 to 1; negative if unknown


class Job:
    """Runs background jobs, at most one at a time; all methods are thread-safe."""

    replaces_robot: ClassVar[bool] = False  # whether a job leaves objects of a former robot behind

    def __init__(self) -> None:
        self.progress: Progress | None = None  # of the running job
        self.problem = ""  # error message of the last job; empty if it succeeded or still runs
        self._cancelled = threading.Event()
        self._thread: threading.Thread | None = None
        self._lock = threading.Lock()

    def start(self, title: str, text: str, work: Callable[[], None]) -> None:
        """Start the job `title`: run `work` in a new thread; `text` describes its first step.

        If `work` raises a `DbbError` or an `OSError`, `problem` has its message; after any other
        exception, `problem` refers to the log. Raises `ConfigError` if a job is running.
        """
        with self._lock:
            running = self.progress  # read once, because the work's thread may clear it
            if running is not None:
                raise ConfigError(f"{running.title}: {running.text}; cancel this job first")
            self.progress = Progress(title, time.monotonic(), text)
        self.problem = ""
        self._cancelled.clear()
        job = partial(self._work, title, work)
        self._thread = threading.Thread(target=job, name="job", daemon=True)
        self._thread.start()

    def run(self, work: Callable[..., Any], *args: Any) -> Any:
        """Return `work(report, *args)` from a separate process; raises `Cancelled` if cancelled."""
        return run_in_process(work, *args, report=self.report, cancelled=self._cancelled)

    def report(self, text: str, share: float = -1.0) -> None:
        """Set text and share of `progress`, as in `Progress`; no effect without a running job."""
        if self.progress is not None:
            self.progress = self.progress._replace(text=text, share=share)

    def check(self) -> None:
        if self.cancelled:
            raise Cancelled("cancelled")

    def cancel(self) -> None:
        self._cancelled.set()

    @property
    def cancelled(self) -> bool:
        """Whether the last job was cancelled; this job may still run."""
        return self._cancelled.is_set()

    def close(self) -> None:
        """Cancel the running job, and wait for its end for at most `_PATIENCE`."""
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
        except Exception as error:  # no caller gets it: show it to the viewers
            logger.exception("%s failed", title)
            problem = f"{title}: {plain(error)}"
        finally:
            self.problem, self.progress = problem, None
            give_back(frozen=self.replaces_robot)


def loaded(robot: str, **sampling: Any) -> tuple[RobotModel, BorderData]:
    """Return model and border data of a robot; `sampling`: arguments of `load_border_data`."""
    from app.border.cache import load_border_data
    from app.robot.description import load_robot
    from app.robot.model import RobotModel

    model = RobotModel(load_robot(robot))
    return model, load_border_data(model, **sampling)


def sample_border(report: Report, robot: str) -> BorderData:
    """Return link pairs and point clouds of a robot; sample them if they are not cached."""
    text = "sampling its border (once)"
    report(text, 0.0)
    return loaded(robot, processes=_CORES, on_progress=lambda share: report(text, share))[1]


def look_into_package(report: Report, archive: Path) -> dict[str, Contents]:
    """Return the `Contents` of each readable URDF among a zip's first 20, by the URDF's path."""
    from app.onboarding.read.package import look_into

    report("reading the zip", -1.0)
    with limited(*Budget.of(archive.stat().st_size)):
        return look_into(archive)


def build_robot(report: Report, request: Request) -> None:
    """Create a new robot's description and report in the request's folder, and its border."""
    from app.onboarding.new_robot import finish

    step = ""

    def tell(text: str, share: float = -1.0) -> None:
        nonlocal step
        step = text
        report(step, share)

    pool = partial(helpers, _CORES)
    finish(request, pool, tell=tell, processes=_CORES, on_progress=lambda x: report(step, x))


def write_log(report: Report, trace: Trace, log: Path) -> None:
    """Write a trace as a log; omit the first line of a CSV file, which is a comment."""
    from app.simulation.trace.log_file import write_trace  # pyarrow is slow to import

    report("writing the log", 0.0)
    write_trace(log, trace)
    if log.suffix == ".csv":
        log.write_bytes(log.read_bytes().partition(b"\n")[2])


def write_report(report: Report, trace: Trace, page: Path) -> None:
    from app.studies.run_report import run_report

    report("drawing the figures", 0.0)
    write_whole(page, run_report(trace, lambda share: report("drawing the figures", share)))
