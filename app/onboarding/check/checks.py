"""`dbb check-robot`: what a description promises, held against the robot itself, row by row."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Literal, NamedTuple

import numpy as np

from app.errors import DbbError
from app.robot.description import RobotDescription
from app.robot.model import RobotModel

Array = np.ndarray

Outcome = Literal["passed", "warned", "failed"]


class Row(NamedTuple):
    """One check.

    Attributes:
        name: What was checked.
        outcome: passed, warned or failed.
        text: One sentence.
        numbers: What was measured; keys end in their unit.
    """

    name: str
    outcome: Outcome
    text: str
    numbers: dict[str, float]


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
    # Imported here: the engines and scipy would make every command start later.
    from app.border.cache import load_border_data
    from app.onboarding.check.bodies import arm_row, base_row, pairs_row
    from app.onboarding.check.border import border_row
    from app.onboarding.check.dynamics import (
        bullet_row,
        engines_row,
        limits_row,
        mujoco_row,
        ready_row,
    )
    from app.onboarding.check.holding import holding_row
    from app.onboarding.check.run import run_row

    tell("compiling")
    try:
        model = RobotModel(description)
    except DbbError as error:
        yield Row("pinocchio", "failed", str(error), {})
        return
    yield Row(
        "pinocchio", "passed", f"loads: {model.n_m} joints, {len(model.body_names)} bodies", {}
    )
    for name, check in (
        ("pybullet", bullet_row),
        ("mujoco", mujoco_row),
        ("engines", engines_row),
        ("limits", limits_row),
        ("base's body", base_row),
        ("arm's bodies", arm_row),
        ("hand held", holding_row),
    ):
        tell(name)
        yield _done(name, check, model)
    tell("sampling pairs and border")
    try:
        data = load_border_data(model, processes=processes)
    except DbbError as error:
        yield Row("border", "failed", str(error), {})
        return
    yield pairs_row(model, data)
    yield _done("ready pose", lambda m: ready_row(m, data), model)
    yield _done("border", lambda m: border_row(m, data), model)
    if runs:
        rows = []
        for scenario in ("guiding-lateral", "guiding-front"):
            tell(scenario)
            rows.append(_done(scenario, lambda m, s=scenario: run_row(m, data, s), model))
            yield rows[-1]
        if all(row.outcome == "warned" for row in rows):
            yield Row("guiding", "failed", "no guiding run could be done", {})


def _done(name: str, check: Callable[[RobotModel], Row], model: RobotModel) -> Row:
    try:
        return check(model)
    except DbbError as error:
        return Row(name, "failed", str(error), {})
