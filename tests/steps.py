"""Steps of a simulation that tests collect."""

from __future__ import annotations

from app.simulation.session import Step


def kept(step: Step) -> Step:
    """The step with a copy of its control quantities, which the next step would overwrite."""
    return step._replace(control=step.control.copy())
