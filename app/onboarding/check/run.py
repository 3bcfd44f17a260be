"""Check by a run: a person pulls the hand towards the base, and nothing touches."""

from __future__ import annotations

from app.border.cache import BorderData
from app.config import Config
from app.errors import UnreachableError
from app.onboarding.check.checks import Row
from app.robot.model import RobotModel

CLEARANCE = 0.03
"""[m] least distance of a pair with the base that passes."""


def run_row(model: RobotModel, data: BorderData, name: str) -> Row:
    """A guiding run with the default parameters.

    Where the arm cannot start there is nothing to judge, which is warned of.
    """
    from app.simulation.run import run_scenario
    from app.simulation.scenarios.names import scenario_of

    scenario = scenario_of(model.description, name)
    try:
        figures = run_scenario(model, data, scenario, Config()).figures
    except UnreachableError as error:
        return Row(name, "warned", f"not done: {error}", {})
    clearance = figures["min_clearance_m"]
    touched = sum(int(str(figures[k])) for k in ("contacts", "arm_contacts", "floor_contacts"))
    failures = int(str(figures["solver_failures"]))
    numbers = {"contacts": float(touched), "solver_failures": float(failures)}
    text = f"{touched} steps in contact, {failures} without a solution"
    near = float(str(clearance)) if clearance is not None else None
    if near is not None:
        numbers["min_clearance_m"] = near
        text = f"least distance to the base {near:.3f} m, {text}"
    good = not touched and not failures and (near is None or near >= CLEARANCE)
    return Row(name, "passed" if good else "failed", text, numbers)
