"""A guard: a process that kills the watched process PID if this does not end in time.

The guard works even if a library hangs and holds Python's lock. The guard's command is `python
guard.py HEARD LIVES PID PATIENCE [NUMBER ...]`. HEARD is the descriptor of a file. The end of this
file, or a byte that is one of the NUMBERs of signals, announces the end of the watched process. The
guard copies the bytes up to and including the announcement to standard output. LIVES is the
descriptor of a pipe that is open while the watched process lives. A negative PID means the process
group −PID. PATIENCE [s] is the time between the announcement and the kill.
"""

import ctypes
import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress


def wake_without_parent() -> None:
    """Let the system resume this process, if it is suspended, when its parent ends (Linux)."""
    with suppress(AttributeError):
        ctypes.CDLL(None).prctl(1, signal.SIGCONT)  # PR_SET_PDEATHSIG


@contextmanager
def guarded(
    heard: int, patience: float, numbers: Sequence[int] = (), *, group: bool = False
) -> Iterator[int]:
    """Run a guard for this process, or for its `group` of processes, during the `with`.

    `heard`, `patience` [s] and `numbers` are the guard's arguments HEARD, PATIENCE and NUMBER (see
    the module's docstring). This yields the descriptor of the guard's standard output, or `heard`
    if the guard cannot start.
    """
    passed = os.dup(heard)  # not the descriptor 0, which is the guard's standard input
    lives, alive = os.pipe()
    pid = -os.getpgid(0) if group else os.getpid()
    words = map(str, (__file__, passed, lives, pid, patience, *map(int, numbers)))
    try:
        guard = subprocess.Popen(
            [sys.executable, "-I", "-S", *words],
            pass_fds=(passed, lives),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
    except OSError:
        guard = None
    os.close(passed)
    os.close(lives)
    try:
        yield guard.stdout.fileno() if guard and guard.stdout else heard
    finally:
        os.close(alive)
        if guard is not None:
            with guard:
                guard.kill()  # the guard is possibly suspended


def main(heard: int, lives: int, pid: int, patience: float, numbers: Sequence[int]) -> None:
    """Kill `pid` if it still runs `patience` [s] after its announced end (see the top)."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the guard ends with the process
    wake_without_parent()
    while True:
        ready, _, _ = select.select([heard, lives], [], [])
        said = os.read(heard, 1) if heard in ready else b""
        if lives in ready and not said:
            return  # the process has ended
        if said:
            with suppress(OSError):
                os.write(1, said)
        if not said or said[0] in numbers:
            break
    if not select.select([lives], [], [], patience)[0]:
        if pid > 0:  # a command
            print(f"dbb: killed: still running {patience:g} s after the signal", file=sys.stderr)
        with suppress(OSError):
            (os.killpg if pid < 0 else os.kill)(abs(pid), signal.SIGKILL)


if __name__ == "__main__":
    heard, lives, pid, patience, *numbers = sys.argv[1:]
    main(int(heard), int(lives), int(pid), float(patience), [*map(int, numbers)])
