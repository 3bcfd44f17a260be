"""A guard process that kills another process if it does not end in time.

A library that hangs and holds Python's lock cannot stop the guard, because the guard is a separate
process: `python guard.py HEARD LIVES PID PATIENCE`. HEARD is the number of a file that announces
the end of the process, by its end or by a byte; the guard copies the byte to standard output.
LIVES is a pipe that is open as long as the process lives. A negative PID is
the number of a process group. PATIENCE is in seconds.
"""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress


@contextmanager
def guarded(heard: int, patience: float, *, group: bool = False) -> Iterator[int]:
    """Run a guard of this process, or of its group, during the `with`.

    Yields:
        The number of a file with the bytes that the guard copies; `heard` if no process can
        start.
    """
    passed = os.dup(heard)  # its own standard input takes the number 0
    lives, alive = os.pipe()
    pid = -os.getpgid(0) if group else os.getpid()
    words = map(str, (__file__, passed, lives, pid, patience))
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
            guard.kill()  # the guard may be suspended
            guard.wait()


def main(heard: int, lives: int, pid: int, patience: float) -> None:
    """Wait for the announcement or the end, and then for the end of the process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends with the process
    while True:
        ready, _, _ = select.select([heard, lives], [], [])
        said = os.read(heard, 1) if heard in ready else b""
        if lives in ready and not said:
            return  # it has ended
        if said:
            with suppress(OSError):
                os.write(1, said)
        if not said or said[0] in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            break
    if not select.select([lives], [], [], patience)[0]:
        if pid > 0:  # a command
            print(f"killed: it had not ended {patience:g} s after its signal", file=sys.stderr)
        with suppress(OSError):
            (os.killpg if pid < 0 else os.kill)(abs(pid), signal.SIGKILL)


if __name__ == "__main__":
    heard, lives, pid, patience = sys.argv[1:]
    main(int(heard), int(lives), int(pid), float(patience))
