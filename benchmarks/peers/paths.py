"""The paths of the end-effector: from the side, from the front, on the wheel axis."""

from __future__ import annotations

from collections.abc import Sequence

from app.border.cache import BorderData
from app.config import Config
from app.errors import UnreachableError
from app.robot.model import RobotModel
from app.simulation.scenarios.line import StartedLine
from app.simulation.scenarios.start import StartSolver
from app.studies.sweep.plan import CLEAR, Approach, Start
from app.studies.sweep.sweep import StartFinder

DURATION = 15.0
"""[s] of each path; a cubic in time from rest to rest."""

AXIS_OFFSETS = (0.0, 0.001, 0.010, 0.050)
"""[m] initial x of the arm's closest point, on the paths along the wheel axis."""

_HEIGHT = 0.3  # [m] height of the end-effector on the paths along the wheel axis
_LENGTH = 0.2  # [m] length of these paths
_LINES = {
    "side": ((0.30, 0.68, 0.30), (0.0, -0.2, 0.0)),
    "front": ((0.92, 0.10, 0.30), (-0.3, 0.0, 0.0)),
}  # [m] start and displacement of the end-effector


def axis_name(offset: float) -> str:
    """The name of a path along the wheel axis, such as `axis-10mm`."""
    return f"axis-{1000 * offset:g}mm"


_OFFSETS = {axis_name(offset): offset for offset in AXIS_OFFSETS}
PATHS = (*_LINES, *_OFFSETS)
"""Names of all paths."""


def ee_paths(
    model: RobotModel, data: BorderData, names: Sequence[str] = PATHS
) -> dict[str, StartedLine]:
    """Some of `PATHS`, each with the arm's initial posture for a base at the origin.

    Raises:
        UnreachableError: The arm has no posture outside all buffers at a start.
    """
    d_b = Config().border.d_b
    solver = StartSolver(model, data.pairs, d_b)
    finder = StartFinder(model, data, d_b)  # one object for all paths, because it caches postures
    found = {}
    for name in names:
        if name in _LINES:
            start, move = _LINES[name]
            q_m = tuple(solver.solve(start).tolist())
        else:
            begin = _on_axis(finder, _OFFSETS[name], d_b + CLEAR)
            start, move, q_m = begin.p_ee, (0.0, -_LENGTH, 0.0), begin.q_m
        found[name] = StartedLine(
            name, DURATION, "the end-effector is tracked", "tracking", start, move, 1.0, q_m
        )
    return found


def _on_axis(finder: StartFinder, offset: float, distance: float) -> Start:
    """Start of a path along the wheel axis, from the left side."""
    approach = Approach("wheel_axis", _HEIGHT, 90.0, offset)
    start = finder.find(approach, distance)
    if start.reason:
        raise UnreachableError(f"{approach.name}: {start.reason}")
    return start
