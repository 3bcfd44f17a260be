"""`dbb check-robot`: what a description promises, held against the robot itself, row by row."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from app.errors import DbbError
from app.onboarding.check.row import Row
from app.robot.description import RobotDescription
from app.robot.model import RobotModel

if TYPE_CHECKING:
    from app.border.cache import BorderData

Array = np.ndarray


def check_robot(
    description: RobotDescription,
    *,
    runs: bool = True,
    tell: Callable[[str], None] = lambda _: None,
    processes: int | None = None,
) -> Iterator[Row]:
    """All checks of a description that could be read, one by one.

    A check that cannot be done fails with the reason; those that need it are left out.

    Args:
        description: The robot.
        runs: Whether to guide the hand too, which takes longest.
        tell: Called with what is being done.
        processes: How many to sample the border with; all cores if not given.
    """
    from app.border.cache import load_border_data  # here: scipy makes every command start later

    tell("compiling")
    try:
        model = RobotModel(description)
    except DbbError as error:
        yield Row("pinocchio", "failed", str(error), {})
        return
    text = f"loads: {model.n_m} joints, {len(model.body_names)} bodies"
    yield Row("pinocchio", "passed", text, {})
    yield from _rows_of_model(model, tell)
    tell("sampling pairs and border")
    try:
        data = load_border_data(model, processes=processes)
    except DbbError as error:
        yield Row("border", "failed", str(error), {})
        return
    yield from _rows_of_border(model, data, tell, ("guiding-lateral", "guiding-front")[: 2 * runs])


def _rows_of_model(model: RobotModel, tell: Callable[[str], None]) -> Iterator[Row]:
    """Checks of dynamics, limits and bodies."""
    # Imported here: the engines would make every command start later.
    from app.onboarding.check import bodies, dynamics
    from app.onboarding.check.holding import holding_row

    for name, check in (
        ("pybullet", dynamics.bullet_row),
        ("mujoco", dynamics.mujoco_row),
        ("engines", dynamics.engines_row),
        ("limits", dynamics.limits_row),
        ("base's body", bodies.base_row),
        ("arm's bodies", bodies.arm_row),
        ("hand held", holding_row),
    ):
        tell(name)
        yield _done(name, check, model)


def _rows_of_border(
    model: RobotModel, data: BorderData, tell: Callable[[str], None], scenarios: Sequence[str]
) -> Iterator[Row]:
    """Checks of what avoidance needs: pairs, ready pose, border, and runs of some scenarios."""
    from app.onboarding.check.avoidance import border_row, pairs_row, run_row
    from app.onboarding.check.dynamics import ready_row

    yield pairs_row(model, data)
    yield _done("ready pose", lambda m: ready_row(m, data), model)
    yield _done("border", lambda m: border_row(m, data), model)
    rows = []
    for scenario in scenarios:
        tell(scenario)
        rows.append(_done(scenario, lambda m, s=scenario: run_row(m, data, s), model))
        yield rows[-1]
    if rows and all(row.outcome == "warned" for row in rows):
        yield Row("guiding", "failed", "no guiding run could be done", {})


def _done(name: str, check: Callable[[RobotModel], Row], model: RobotModel) -> Row:
    try:
        return check(model)
    except DbbError as error:
        return Row(name, "failed", str(error), {})
