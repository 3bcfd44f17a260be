"""Times of control steps along recorded paths."""

from __future__ import annotations

import gc
from collections.abc import Callable, Sequence
from time import perf_counter
from typing import Any, NamedTuple

import numpy as np

from app.control.controller import Controller, ControlOutput
from app.simulation.loop.pacing import settled
from benchmarks.step.paths import Moment, Path

Array = np.ndarray

_WARM_UP = 1000  # steps that are not counted


class Times(NamedTuple):
    """One entry a control step.

    Attributes:
        step: (N,) [µs] that it took.
        mobile: (N,) how many pairs of L_m were active.
        active: (N, pairs) which pairs were active.
    """

    step: Array
    mobile: Array
    active: Array

    @property
    def both(self) -> Array:
        """(N,) whether two pairs of L_m, or all that there are, were active."""
        return self.mobile >= min(2, int(self.mobile.max()))


def time_steps(
    controller: Controller,
    paths: Sequence[Path],
    after: Callable[[Moment, ControlOutput], None] = lambda _, __: None,
) -> Times:
    """Time every step of all paths; the first path is begun once more, unmeasured, to warm up.

    Args:
        controller: Starts anew at each path.
        paths: What it is given.
        after: Called after each measured step, outside of its time.
    """
    controller.reset()
    for moment in paths[0][:_WARM_UP]:
        _step(controller, moment)
    times, mobile, active = [], [], []
    gc.collect()
    with settled():
        for path in paths:
            controller.reset()
            for moment in path:
                begin = perf_counter()
                output = _step(controller, moment)
                times.append(perf_counter() - begin)
                mobile.append(sum(pair.beta > 0.0 for pair in output.avoidance.mobile))
                active.append([pair.beta > 0.0 for pair in output.avoidance.pairs])
                after(moment, output)
    return Times(1e6 * np.array(times), np.array(mobile), np.array(active))


def _step(controller: Controller, moment: Moment) -> ControlOutput:
    return controller.step(
        moment.measurement, moment.reference, base_acceleration=moment.base_acceleration
    )


class Stages:
    """Adds up how long parts of a step take, by name, while they are wrapped."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    def wrap(self, owner: Any, method: str, name: str) -> None:
        """Time a method of an object from now on, as a stage or a part of one."""
        function = getattr(owner, method)

        def timed(*args: Any, **options: Any) -> Any:
            begin = perf_counter()
            try:
                return function(*args, **options)
            finally:
                self.spent[name] = self.spent.get(name, 0.0) + perf_counter() - begin

        setattr(owner, method, timed)

    def take(self) -> dict[str, float]:
        """[s] by name since the last call."""
        spent, self.spent = self.spent, {}
        return spent


def time_stages(controller: Controller, paths: Sequence[Path]) -> dict[str, float]:
    """[µs] median of each stage over the steps with both pairs of L_m active.

    In a run of its own, since the clocks take time too. The controller's methods stay wrapped.
    """
    stages = Stages()
    avoidance, solver = controller._avoidance, controller._solver
    stages.wrap(controller.state, "update", "kinematics_dynamics")
    stages.wrap(avoidance._monitor, "find_nearest", "distances")
    for finder in avoidance._finders.values():
        stages.wrap(finder, "find_acting_point", "acting_point")
    stages.wrap(avoidance, "update", "avoidance")
    stages.wrap(solver, "solve", "qp")
    spent: list[dict[str, float]] = []
    wholes = time_steps(controller, paths, lambda _, __: spent.append(stages.take()))
    rows = []
    for whole, parts in zip(wholes.step, spent, strict=True):
        get = {name: 1e6 * parts.get(name, 0.0) for name in _PARTS}
        within = get.pop("avoidance")
        get["task"] = within - get["distances"] - get["acting_point"]
        get["rest"] = whole - sum(get.values())
        rows.append(get)
    chosen = np.flatnonzero(wholes.both)
    return {name: float(np.median([rows[i][name] for i in chosen])) for name in rows[0]}


_PARTS = ("kinematics_dynamics", "distances", "acting_point", "avoidance", "qp")
