"""Steps of a simulation that tests collect."""

from __future__ import annotations

from app.simulation.session import Step


def kept(step: Step) -> Step:
    """The same with quantities that the next step does not overwrite."""
    return step._replace(control=step.control.copy())
