"""Shared configuration of all viewers: each change is a step that can be undone."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Iterable

from app.config import Config, tunable
from app.dashboard.drag import Sink
from app.errors import ConfigError
from app.simulation.loop.commands import Configure

BURST = 0.7
"""[s] moves of one slider that follow each other faster are one step."""
MOST_STEPS = 200
"""[-] that can be undone; each is a small record."""


class Tuning:
    """The configuration and its history; every change is sent to the simulation at once.

    May be called by any thread.
    """

    def __init__(
        self, sink: Sink, config: Config, *, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin without a history.

        Args:
            sink: Where the configuration goes.
            config: The one that holds already.
            clock: [s] tells which moves follow each other fast.
        """
        self._sink, self._clock = sink, clock
        self._config = config
        self._past: list[Config] = []
        self._future: list[Config] = []
        self._burst: tuple[str, float] | None = None
        """Parameter that was moved last, and when."""
        self._lock = threading.RLock()

    @property
    def config(self) -> Config:
        """What holds now; the same object as long as nothing changes."""
        return self._config

    def value(self, path: str) -> float | str:
        """The value of a parameter now."""
        return self._config.value(path)

    def set(self, path: str, value: float | str) -> None:
        """Change one parameter; moves of the same one in a burst are one step.

        Raises:
            ConfigError: No such parameter, or a value that it cannot have.
        """
        with self._lock:
            if self._config.value(path) == value:
                return
            config, now = self._config.replace(path, value), self._clock()
            last, at = self._burst or ("", -math.inf)
            if last != path or now - at > BURST:
                self._remember()
            self._burst = path, now
            self._hold(config)
            if self._past[-1] == config:  # there and back in one burst is no step
                self._past.pop()
                self._burst = None

    def load(self, config: Config) -> None:
        """Take over a whole configuration, in one step."""
        with self._lock:
            if config != self._config:
                self._burst = None
                self._remember()
                self._hold(config)

    def reset(self, paths: Iterable[str] | None = None) -> None:
        """Set parameters, by default all, to their defaults, in one step."""
        with self._lock:
            config = Config() if paths is None else self._config
            for path in paths or ():
                config = config.replace(path, tunable(path).default)
            self.load(config)

    def undo(self) -> None:
        """Take the last step back.

        Raises:
            ConfigError: There is none.
        """
        with self._lock:
            self._step(self._past, self._future, "nothing to undo")

    def redo(self) -> None:
        """Do the step again that was undone last.

        Raises:
            ConfigError: There is none, or something was changed since.
        """
        with self._lock:
            self._step(self._future, self._past, "nothing to do again")

    def move_to(self, sink: Sink, config: Config) -> None:
        """Go on with another simulation, which has a configuration already.

        Args:
            sink: Where configurations go from now on.
            config: The one that holds there; if it is another than here, that is one step.
        """
        with self._lock:
            self._sink = sink
            if self._config != config:
                self._burst = None
                self._remember()
                self._config = config

    def _step(self, source: list[Config], target: list[Config], nothing: str) -> None:
        if not source:
            raise ConfigError(nothing)
        target.append(self._config)
        self._burst = None
        self._hold(source.pop())

    def _remember(self) -> None:
        self._past.append(self._config)
        del self._past[:-MOST_STEPS]
        self._future.clear()

    def _hold(self, config: Config) -> None:
        self._config = config
        self._sink.send(Configure(config))
