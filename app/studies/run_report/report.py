"""The report of one run, on a page that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from matplotlib.figure import Figure

from app.config import Config, parameter
from app.errors import ConfigError
from app.simulation.trace.metrics import extremes, metrics, verdict
from app.simulation.trace.trace import Trace
from app.studies.page import Grid, Part, measured_grids, page_html
from app.studies.run_report.figures import (
    base_figure,
    distances_figure,
    hand_figure,
    plan_figure,
    torques_figure,
)
from app.studies.style import png_of, styled

_FIGURES: dict[str, tuple[str, Callable[[Trace], Figure]]] = {
    "distances": ("Distances and activations", distances_figure),
    "base": ("Accelerations and velocities of the base", base_figure),
    "hand": ("The hand", hand_figure),
    "torques": ("Torques of the arm", torques_figure),
    "plan": ("From above", plan_figure),
}


def run_report(run: Trace) -> str:
    """The page of a run: key numbers, figures, and which parameters were not the defaults.

    Args:
        run: As `read_trace` gives it, or made from snapshots.
    """
    title = f"{run.meta.scenario or 'A person leads the hand'}, {_controllers(run)}"
    numbers = key_numbers(run)
    parts = [Part(text=[verdict(numbers)])]
    with styled():
        parts += [
            Part(text, name, png=png_of(draw(run))) for name, (text, draw) in _FIGURES.items()
        ]
    parts += [Part("Key numbers", "numbers", tables=measured_grids(_shown(numbers))), _changes(run)]
    return page_html(title, _about(run), parts)


def _controllers(run: Trace) -> str:
    return ", then ".join(dict.fromkeys(s.controller for s in run.snapshots))


def _about(run: Trace) -> str:
    meta, first, last = run.meta, run.snapshots[0], run.snapshots[-1]
    plant = f"plant {meta.physics}, " if meta.physics else ""
    return (
        f"Robot {meta.robot}, {plant}seed {meta.seed}; {first.t:.2f} s to {last.t:.2f} s, "
        f"{len(run)} rows{_between(run)}."
    )


def _between(run: Trace) -> str:
    if run.each_step:
        return ", one a control step"
    return ". The figures are those of the rows: what happens between two of them is not seen"


def key_numbers(run: Trace) -> dict[str, Any]:
    """The figures of a run, as `dbb run --json` has them, and its extremes; keys as there."""
    return {**extremes(run), **metrics(run)}


def _shown(numbers: Mapping[str, Any]) -> dict[str, Any]:
    """Key numbers; those of each pair and each joint stand one below the other."""
    shown: dict[str, Any] = {}
    for key, value in numbers.items():
        if isinstance(value, dict):
            stem, _, unit = key.rpartition("_")
            shown |= {f"{stem} {name}_{unit}": number for name, number in value.items()}
        else:
            shown[key] = value
    return shown


def _changes(run: Trace) -> Part:
    """A table of the parameters that were not the defaults."""
    changes = config_changes([s.config for s in run.snapshots])
    rows = [(path, _unit(path), _value(default), _value(had)) for path, default, had in changes]
    if not rows:
        return Part("Parameters", "parameters", text=["All were the defaults."])
    head = ("changed", "unit", "default", "here")
    return Part("Parameters", "parameters", tables=[Grid(head, rows, numbers=True)])


def _unit(path: str) -> str:
    try:
        unit = parameter(path).unit
    except ConfigError:  # a choice has no unit
        return ""
    return "" if unit == "-" else unit


def config_changes(configs: Sequence[Config]) -> list[tuple[str, Any, Any]]:
    """Parameters that differ from the defaults in any of the configurations.

    Returns:
        Path as in `border.d_b`, default, and the values it had, in order, joined if there are more.
    """
    changes = []
    for section, defaults in Config().model_dump().items():
        for name, default in defaults.items():
            had = list(dict.fromkeys(getattr(getattr(c, section), name) for c in configs))
            if had != [default]:
                changes.append((f"{section}.{name}", default, had[0] if len(had) == 1 else had))
    return changes


def _value(value: Any) -> str:
    if isinstance(value, list):
        return ", then ".join(map(_value, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
