"""Times of control steps along recorded paths."""

from __future__ import annotations

import gc
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from app.control import controller as controller_module
from app.control.controller import ControlLoop
from app.control.quantities import ControlStep
from app.robot.link_pairs import PairDistances
from app.simulation.loop.pacing import gc_frozen
from benchmarks.step.paths import Moment, Path

Array = np.ndarray

_WARM_UP = 1000  # [-] steps before the measurement


class Times(NamedTuple):
    """Measurements, with one entry for each control step.

    Attributes:
        step: (N,) [µs] duration.
        mobile: (N,) number of active pairs of arm and base.
        active: (N, pairs) whether each pair was active.
        tracking: (N,) whether the end-effector had a reference.
    """

    step: Array
    mobile: Array
    active: Array
    tracking: Array

    @property
    def both(self) -> Array:
        """(N,) whether two pairs of arm and base were active, or one if there were never two."""
        return self.mobile >= min(2, int(self.mobile.max()))

    @property
    def guided_by_one(self) -> Array:
        """(N,) whether the arm was guided with one active pair of arm and base."""
        return (self.mobile == 1) & ~self.tracking

    @property
    def tracking_by_both(self) -> Array:
        """(N,) whether the arm tracked a reference and `both` was true."""
        return self.both & self.tracking


def time_steps(
    loop: ControlLoop,
    paths: Sequence[Path],
    after: Callable[[Moment, ControlStep], None] = lambda _, __: None,
) -> Times:
    """Measure each call of `ControlLoop.step` on all paths.

    The first `_WARM_UP` steps of the first path run once before the measurement.

    Args:
        loop: The loop, which is reset at the start of each path.
        paths: Recorded inputs.
        after: Called after each measured step; its duration is not included.
    """
    loop.reset()
    for moment in paths[0][:_WARM_UP]:
        loop.step(*moment)
    times, active, tracking = [], [], []
    gc.collect()
    with gc_frozen():
        for path in paths:
            loop.reset()
            for moment in path:
                begin = perf_counter()
                step = loop.step(*moment).step
                times.append(perf_counter() - begin)
                active.append(step.beta > 0.0)
                tracking.append(moment.reference is not None)
                after(moment, step)
    found, mobile = np.array(active), loop.controller.last.n_mob
    counts = found[:, :mobile].sum(axis=1)
    return Times(1e6 * np.array(times), counts, found, np.array(tracking))


class Stages:
    """Adds up the durations of calls, by the names of the parts of a step."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    @contextmanager
    def timing(self, parts: Sequence[tuple[str, Any, str]]) -> Iterator[None]:
        """Measure methods in the `with`; `parts` has stage, object and attribute of each method."""
        plain = [getattr(owner, name) for _, owner, name in parts]
        for stage, owner, name in parts:
            self._wrap(owner, name, stage)
        try:
            yield
        finally:
            for function, (_, owner, name) in zip(plain, parts, strict=True):
                setattr(owner, name, function)

    def _wrap(self, owner: Any, method: str, name: str) -> None:
        function = getattr(owner, method)

        def timed(*args: Any, **options: Any) -> Any:
            begin = perf_counter()
            try:
                return function(*args, **options)
            finally:
                self.spent[name] = self.spent.get(name, 0.0) + perf_counter() - begin

        setattr(owner, method, timed)

    def take(self) -> dict[str, float]:
        """[s] duration of each stage since the last call of this function."""
        spent, self.spent = self.spent, {}
        return spent


def time_stages(loop: ControlLoop, paths: Sequence[Path]) -> dict[str, float]:
    """[µs] median of each stage over the steps of `Times.both`.

    This needs a separate run, because the clocks take time too.
    """
    stages, spent = Stages(), list[dict[str, float]]()
    with stages.timing(_PARTS):
        wholes = time_steps(loop, paths, lambda _, __: spent.append(stages.take()))
    rows = []
    for whole, parts in zip(wholes.step, spent[-len(wholes.step) :], strict=True):
        get = {name: 1e6 * parts.get(name, 0.0) for name, _, _ in _PARTS}
        rows.append(get | {"rest": whole - sum(get.values())})
    chosen = np.flatnonzero(wholes.both)
    return {name: float(np.median([rows[i][name] for i in chosen])) for name in rows[0]}


_PARTS = (
    ("update_estimate", controller_module, "_estimate"),
    ("pinocchio", controller_module, "compute_dynamics"),
    ("distances", PairDistances, "update_from"),
    ("algorithm_2", controller_module, "_law"),
)
