"""Functions of the operating system: processes, files and folders, memory, standard files, locale.

Linux has all features. Each function has a fallback for a feature that another system lacks.
"""

import ctypes
import errno
import fcntl
import math
import os
import resource
import secrets
import shutil
import signal
import stat
import sys
import tempfile
import threading
import time
import weakref
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, suppress
from functools import lru_cache
from io import TextIOWrapper
from pathlib import Path
from typing import BinaryIO

import platformdirs

from app.errors import OutputError

_BEGUN = ".dbb~"  # prefix of folders with unfinished results
_PATIENCE = 1.0  # [s] time to wait until another process releases such a folder
_LOOK_EVERY = 0.02  # [s] time between two attempts to lock a folder
_NUMERIC = 1 << 4 if sys.platform == "darwin" else 1 << 1  # [-] LC_NUMERIC_MASK of newlocale(3)


def usable_cores() -> int:
    """Number of cores that this process may use; all cores if the system cannot restrict them."""
    allowed = getattr(os, "sched_getaffinity", None)
    return len(allowed(0)) if allowed else os.cpu_count() or 1


def raise_priority(niceness: int) -> None:
    """Raise the priority of this process to a niceness below 0, if the user's rights permit it.

    On three or more cores, the process also gets a real-time policy if possible. After work of
    0.5 s without a pause, the process leaves this policy; if that fails, the system ends the
    process after 30 s. Call this function in the main thread, before other threads start.
    """
    with suppress(OSError):
        os.setpriority(os.PRIO_PROCESS, 0, niceness)
    if usable_cores() >= 3:
        with suppress(AttributeError, OSError, ValueError):
            resource.setrlimit(resource.RLIMIT_RTTIME, (500_000, 30_000_000))  # [µs]
            signal.signal(signal.SIGXCPU, _leave_real_time)
            os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))  # the lowest priority


def _leave_real_time(*_: object) -> None:
    for thread in threading.enumerate():
        with suppress(OSError):  # the thread has just ended
            os.sched_setscheduler(thread.native_id or 0, os.SCHED_OTHER, os.sched_param(0))


def lower_priority(niceness: int) -> None:
    """Lower the priority of this process: add `niceness`, 0 to 19, to its niceness."""
    with suppress(OSError):
        os.nice(niceness)


@contextmanager
def limited(seconds: float, memory: int) -> Iterator[None]:
    """Limit the additional processor time [s] and memory [bytes] of this process in the `with`.
    Beyond the time, the system ends it; beyond the memory, an allocation fails (not on macOS).
    """
    used, size = sum(resource.getrusage(resource.RUSAGE_SELF)[:2]), resource.RLIM_INFINITY
    with suppress(OSError):
        pages = int(Path("/proc/self/statm").read_text().split()[0])
        size = pages * resource.getpagesize() + memory
    return_freed_memory_early()
    limits = {resource.RLIMIT_CPU: math.ceil(used + seconds), resource.RLIMIT_AS: size}
    before = {kind: resource.getrlimit(kind) for kind in limits}
    for kind, limit in limits.items():
        with suppress(ValueError, OSError):  # above the present limit of this process
            resource.setrlimit(kind, (limit, before[kind][1]))
    try:
        yield
    finally:
        for kind, usual in before.items():
            resource.setrlimit(kind, usual)


ENDING = signal.SIGINT, signal.SIGTERM, signal.SIGHUP  # by a user, a supervisor, a closed terminal


@contextmanager
def interrupt_blocked() -> Iterator[None]:
    """Block Ctrl-C in this thread during the `with`; processes started in it inherit the block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def lead_group() -> None:
    """Make this process the leader of a new group of processes, which `end_group` can end."""
    with suppress(PermissionError):  # it already leads a group
        os.setsid()


def end_when_closed(pipe: int) -> None:
    """Let the system end this process when all writers of a pipe have closed the pipe (Linux)."""
    with suppress(AttributeError, OSError):
        fcntl.fcntl(pipe, fcntl.F_SETOWN, os.getpid())
        fcntl.fcntl(pipe, fcntl.F_SETFL, fcntl.fcntl(pipe, fcntl.F_GETFL) | os.O_ASYNC)


def wake_children() -> None:
    """Resume all suspended descendants of this process (Linux), so that they react to signals."""
    found = [os.getpid()]
    for parent in found:
        for listed in Path(f"/proc/{parent}/task").glob("*/children"):
            with suppress(OSError):  # the thread has just ended
                found += map(int, listed.read_text().split())
    for child in found[1:]:
        with suppress(OSError):  # the process has just ended
            os.kill(child, signal.SIGCONT)


def end_group(leader: int, *, at_once: bool) -> None:
    """End all processes of a group (0: that of this process); with `at_once`, without a cleanup."""
    # The group has no process; macOS raises the second error if all its processes have ended.
    with suppress(ProcessLookupError, PermissionError):
        os.killpg(leader, signal.SIGKILL if at_once else signal.SIGTERM)


def claim(file: BinaryIO | int) -> bool | None:
    """Lock an open file or folder until it is closed, and return True. Return False if another
    process has the lock, None if the file system has no locks.
    """
    try:
        fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:
        return None
    return True


@contextmanager
def unfinished_folder(place: Path, name: str = "") -> Iterator[Path]:
    """Yield a locked folder in `place` for an unfinished result; the end of the `with` removes it.

    Only one process at a time can use a `name`; the default is a random name. Files of killed
    processes are removed first. An OutputError means that another process or user still uses the
    name after a second, an OSError that the folder cannot be made.
    """
    _remove_abandoned_once(place)
    folder = place / f"{_BEGUN}{name[:200] or secrets.token_hex(4)}"
    lock = _claimed(folder)
    holder = {folder}  # `finalize` also removes the folder when the process exits
    remove = weakref.finalize(holder, _remove, folder)
    try:
        for left in folder.iterdir():  # remains of a killed process
            shutil.rmtree(left) if left.is_dir() and not left.is_symlink() else left.unlink()
        yield folder
    finally:
        remove()
        os.close(lock)


def _remove(folder: Path) -> None:
    """Remove a folder; retry during one second: ending programs may still write into it."""
    end = time.monotonic() + _PATIENCE
    shutil.rmtree(folder, ignore_errors=True)
    while folder.exists() and time.monotonic() < end:
        time.sleep(_LOOK_EVERY)
        shutil.rmtree(folder, ignore_errors=True)


def _claimed(folder: Path) -> int:
    """Make and lock a folder, and return the file descriptor that holds the lock."""
    end = time.monotonic() + _PATIENCE
    while True:
        folder.mkdir(mode=0o700, exist_ok=True)
        with suppress(FileNotFoundError):  # its former owner has just removed it
            if (lock := _locked(folder)) is not None:
                return lock
        if time.monotonic() > end:
            who = "process" if folder.stat().st_uid == os.geteuid() else "user"
            raise OutputError(f"{folder.parent}: another {who} is writing the same result")
        time.sleep(_LOOK_EVERY)  # the removal of abandoned folders locks each of them briefly


def _locked(folder: Path, *, surely: bool = False) -> int | None:
    """The descriptor that locks a folder; None if another user owns the folder, or another process
    has locked or replaced it. Without locks in the file system: a descriptor, or None if `surely`.
    """
    lock = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    found = os.fstat(lock)
    with suppress(FileNotFoundError):
        free = found.st_uid == os.geteuid() and claim(lock)
        free = not surely if free is None else free
        # A new folder of the same name may have replaced this folder before the lock.
        if free and os.path.samestat(found, folder.lstat()):
            return lock
    os.close(lock)
    return None


def remove_abandoned(place: Path) -> None:
    """Remove unfinished results of killed processes of this user from a folder."""
    for folder in place.glob(f"{_BEGUN}*"):
        with suppress(OSError):
            if (lock := _locked(folder, surely=True)) is not None:
                shutil.rmtree(folder, ignore_errors=True)
                os.close(lock)


_remove_abandoned_once = lru_cache(maxsize=256)(remove_abandoned)


def temporary_folder() -> AbstractContextManager[Path]:
    """An `unfinished_folder` in the folder for temporary files."""
    return unfinished_folder(Path(tempfile.gettempdir()))


def own_path(path: Path) -> Path:
    """Resolve the links of a path; raises an OutputError for more than 40 links, for a link in a
    shared folder by neither this user nor the folder's owner, or if the working folder is gone.
    """
    try:
        found, parts, links = Path("/"), list(path.absolute().parts[1:]), 0
    except FileNotFoundError:
        raise OutputError(f"cannot write {path}: the working folder has been removed") from None
    while parts:
        part = parts.pop(0)
        here = found.parent if part == ".." else found / part
        if not here.is_symlink():
            found = here
            continue
        links += 1
        if links > 40 or _is_foreign(here):
            why = f"{here} is a link of another user, or part of a circle"
            raise OutputError(f"cannot write {path}: {why}")
        target = here.readlink()
        found = Path("/") if target.is_absolute() else found
        parts[:0] = [each for each in target.parts if each != "/"]
    return found


def _is_foreign(link: Path) -> bool:
    folder, owner = link.parent.stat(), link.lstat().st_uid
    shared = folder.st_mode & (stat.S_IWGRP | stat.S_IWOTH)
    return bool(shared) and owner not in (os.geteuid(), folder.st_uid)


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Yield the path of a new file that replaces the file at `path` if the `with` raises no error.

    No reader sees an incomplete file. If `path` is a link, the new file replaces its target
    (`own_path`). If writing fails, this raises an OutputError, and the previous file remains.
    """
    try:
        real = own_path(path)
        if is_no_file(real):
            why = "it is a folder, a device, a pipe or a mount point"
            raise OutputError(f"cannot write {path}: {why}")
        with unfinished_folder(real.parent) as folder:
            beside = folder / path.name
            yield beside
            with beside.open("rb") as file:
                os.fsync(file.fileno())
            beside.replace(real)
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from None


@contextmanager
def whole_folder(out: Path) -> Iterator[Path]:
    """Yield a temporary folder that becomes `out` if the `with` raises no error; an OutputError
    means that `out` is a file, a mount point or not empty, cannot be written, or is in use.
    """
    with ExitStack() as stack:
        try:
            out = own_path(out)
            if os.path.ismount(out):
                raise OutputError(f"--out: {out} is a mount point; choose a new folder in it")
            out.parent.mkdir(parents=True, exist_ok=True)
            folder = stack.enter_context(unfinished_folder(out.parent, out.name))
        except OSError as error:
            raise OutputError(f"--out: cannot write to {out.parent}: {error.strerror}") from None
        if out.exists() and (not out.is_dir() or any(out.iterdir())):
            raise OutputError(f"--out: {out} exists; remove it or choose another folder")
        made = folder / out.name
        made.mkdir()
        yield made
        try:
            made.replace(out)
        except OSError as error:
            raise OutputError(f"--out: cannot write to {out}: {error.strerror}") from None


def is_no_file(path: Path) -> bool:
    """Whether the path is a folder, a device, a pipe or a mount point: a file cannot replace it."""
    return path.exists() and (not path.is_file() or os.path.ismount(path))


def write_whole(path: Path, content: bytes | str) -> None:
    """Write bytes, or a text as UTF-8, completely or not at all, by `whole_file`."""
    with whole_file(path) as beside:
        beside.write_bytes(content.encode() if isinstance(content, str) else content)


def return_freed_memory_early() -> None:
    """Make glibc return freed memory to the system early; no effect with other C libraries."""
    _call_c("mallopt", -3, 2**17)  # M_MMAP_THRESHOLD [bytes]
    _call_c("mallopt", -8, 1)  # M_ARENA_MAX


def return_freed_memory() -> None:
    """Make glibc return freed small blocks of memory to the system; otherwise it keeps them."""
    _call_c("malloc_trim", 0)


def home_folder(find: Callable[..., Path]) -> Path | None:
    """This program's folder from a function of `platformdirs`; None if the user has no home."""
    with suppress(RuntimeError):  # raised by recent versions without a home
        found = find("dbb", appauthor=False)
        return found if found.is_absolute() else None  # older versions return "~/…"
    return None


def home_expanded(path: str) -> Path:
    """A path in which the user's home replaces `~`; `~NAME` of an unknown user does not change."""
    return Path(os.path.expanduser(path))  # `Path.expanduser` would raise an error


def cache_folders(*, make: bool = True) -> Iterator[Path]:
    """This user's cache folders: first the standard one, if the user has a home; second, if it is
    usable, one in the folder for temporary files. With `make`, the second one is created.
    """
    if usual := home_folder(platformdirs.user_cache_path):
        yield usual
    with suppress(OSError):  # no temporary folder either
        yield _private_folder(Path(tempfile.gettempdir()), make=make)


def is_writable(folder: Path) -> bool:
    """Whether files can be written into a folder; for a missing one, whether it can be made."""
    there = next(each for each in (folder, *folder.absolute().parents) if each.exists())
    return os.access(there, os.W_OK | os.X_OK)


def _private_folder(shared: Path, *, make: bool = True) -> Path:
    """This user's own folder in a shared one; an OSError if it is missing or others can write."""
    folder = shared / f"dbb-{os.getuid()}"
    if make:
        with suppress(FileExistsError):
            folder.mkdir(mode=0o700)
    about = folder.lstat()
    if not stat.S_ISDIR(about.st_mode) or about.st_uid != os.getuid() or about.st_mode & 0o022:
        raise PermissionError(errno.EPERM, "others can write to it", str(folder))
    return folder


def open_standard_files() -> None:
    """Open standard input, output and error as null devices if the parent process closed them;
    otherwise the next file, pipe or socket would receive printed text.

    Text for a closed standard output raises an OSError, because a result would be lost. Codes
    replace the characters that the encoding of standard output lacks.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:  # a file of a library may already use its number
            access = os.O_WRONLY if name == "stderr" else os.O_RDONLY
            setattr(sys, name, open(os.open(os.devnull, access), mode))  # noqa: SIM115 - stays open
    if isinstance(sys.stdout, TextIOWrapper):
        sys.stdout.reconfigure(errors="backslashreplace")


def set_missing_folders() -> None:
    """Remove an unwritable TMPDIR, set it if no folder is writable; set HOME if there is none."""
    if not os.access(os.environ.get("TMPDIR", ""), os.W_OK | os.X_OK):
        os.environ.pop("TMPDIR", None)
    try:
        tempfile.gettempdir()
    except FileNotFoundError:
        os.environ["TMPDIR"] = "/dev/shm"
    if not os.path.isabs(os.path.expanduser("~")):  # browsers need it
        with suppress(OSError):
            os.environ["HOME"] = str(_private_folder(Path(tempfile.gettempdir())))


@contextmanager
def decimal_points() -> Iterator[None]:
    """In the `with`, C code in this thread reads decimal points, even if the locale has commas."""
    library = _c_library()
    if library is None or not hasattr(library, "uselocale"):
        yield
        return
    create, use, free = library.newlocale, library.uselocale, library.freelocale
    create.argtypes = ctypes.c_int, ctypes.c_char_p, ctypes.c_void_p
    use.argtypes = free.argtypes = (ctypes.c_void_p,)
    create.restype = use.restype = ctypes.c_void_p
    plain = create(_NUMERIC, b"C", None)
    before = use(plain)
    try:
        yield
    finally:
        use(before)
        free(plain)


def flush_c_output() -> None:
    """Flush the output that C code has printed."""
    _call_c("fflush", None)


def _call_c(name: str, *args: int | None) -> None:
    if (function := getattr(_c_library(), name, None)) is not None:
        function(*args)


def _c_library() -> ctypes.CDLL | None:
    """The C library of this process, or None if it is not accessible."""
    try:
        return ctypes.CDLL(None)
    except (OSError, TypeError):
        return None
