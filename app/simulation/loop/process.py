"""What runs in the child process of `ProcessLoop`: the loop's thread, and a thread that posts."""

from __future__ import annotations

import gc
import pickle
import sys
import traceback
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import NamedTuple

import numpy as np

from app.errors import LoopError
from app.jobs.process import follow_parent
from app.simulation.loop.gc_freeze import settled
from app.simulation.loop.loop import SimulationLoop
from app.system import come_first

Array = np.ndarray

_POST_EVERY = 0.01  # [s] between two looks for a new snapshot; there is one every 0.02 s
_SWITCH = 2e-4  # [s] after which the loop's thread gets its turn from the one that posts
_NICENESS = -10  # [-] wished for; browsers give their drawing -8 where they may


class Started(NamedTuple):
    """The loop has begun."""

    links: tuple[str, ...]
    """Where the arm can be held."""


class Failure(NamedTuple):
    """The loop has ended with an error."""

    error: BaseException
    traceback: str
    """As it would have been printed."""


def run_loop(commands: Connection, snapshots: Connection) -> None:
    """Run a loop until the other end of `commands` is closed, or its process gone.

    Args:
        commands: Gives first how to make the session and the arm's start, then commands.
        snapshots: Takes `Started`, then snapshots, and a `Failure` if it came to one.
    """
    follow_parent()
    sys.setswitchinterval(_SWITCH)
    come_first(_NICENESS)
    try:
        make_session, q_start = commands.recv()
    except (EOFError, OSError):
        return  # the parent is gone, or nothing was to be simulated after all
    loop = SimulationLoop(make_session, q_start)
    try:
        with suppress(LoopError):  # posted below
            loop.start()
            snapshots.send(Started(loop.links))
        gc.collect()  # what is garbage already would stay with the rest
        with settled(), suppress(EOFError, OSError):
            _post(loop, commands, snapshots)
    finally:
        loop.stop()


def _post(loop: SimulationLoop, commands: Connection, snapshots: Connection) -> None:
    """Hand on commands and snapshots.

    Raises:
        EOFError: The parent has closed its end.
        OSError: The parent is gone.
    """
    posted = None
    while loop.error is None:
        latest = loop.latest()
        if latest is not posted:
            snapshots.send(latest)
            posted = latest
        if commands.poll(_POST_EVERY):
            with suppress(LoopError):  # too many at once, on top of those that the parent held
                loop.send(commands.recv())
    snapshots.send(_failure(loop.error))


def _failure(error: BaseException) -> Failure:
    """The error itself if it survives pickling, else its text."""
    text = "".join(traceback.format_exception(error))
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:  # whatever the constructor of some error raises
        error = LoopError(f"{type(error).__name__}: {error}")
    return Failure(error, text)
