"""The report of one run, on a page that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from matplotlib.figure import Figure

from app.config import parameter
from app.errors import ConfigError
from app.simulation.trace.log import Log
from app.studies.page import Grid, Part, measured_grids, page_html
from app.studies.run_report.figures import (
    base_figure,
    distances_figure,
    hand_figure,
    plan_figure,
    torques_figure,
)
from app.studies.run_report.numbers import Track, config_changes, key_numbers, track_of
from app.studies.style import png_of, styled

_FIGURES: dict[str, tuple[str, Callable[[Log, Track], Figure]]] = {
    "distances": ("Distances and activations", distances_figure),
    "base": ("Accelerations and velocities of the base", lambda _, track: base_figure(track)),
    "hand": ("The hand", lambda _, track: hand_figure(track)),
    "torques": ("Torques of the arm", torques_figure),
    "plan": ("From above", plan_figure),
}


def run_report(log: Log) -> str:
    """The page of a run: its verdict and figures, its numbers, and the parameters it changed.

    Args:
        log: As `read_log` gives it, or made from snapshots.
    """
    track = track_of(log)
    numbers = key_numbers(log, track)
    title = f"{log.meta.scenario or 'A person leads the hand'}, {_controllers(log)}"
    parts = [Part(text=[_verdict(numbers)])]
    with styled():
        parts += [
            Part(text, name, png=png_of(draw(log, track)))
            for name, (text, draw) in _FIGURES.items()
        ]
    parts += [Part("Key numbers", "numbers", tables=measured_grids(_shown(numbers))), _changes(log)]
    return page_html(title, _about(log), parts)


def _verdict(numbers: Mapping[str, Any]) -> str:
    """One sentence: whether anything touched, how near it came, and where the hand ended."""
    rows = numbers["rows_in_contact"]
    touched = f"In contact in {rows} rows" if rows else "No contact"
    least = numbers["least_distance_m"]
    near = ""
    if least:
        pair = min(least, key=least.get)
        near = f"; least distance {1e3 * least[pair]:.1f} mm, of {pair}"
        near += " (between their bodies, which are fatter than the links)"
    ended = f"; the hand ended {1e3 * numbers['final_error_m']:.1f} mm from where it was led"
    return f"{touched}{near}{ended}."


def _controllers(log: Log) -> str:
    return ", then ".join(dict.fromkeys(s.controller for s in log.snapshots))


def _about(log: Log) -> str:
    meta, first, last = log.meta, log.snapshots[0], log.snapshots[-1]
    plant = f"plant {meta.physics}, " if meta.physics else ""
    return (
        f"Robot {meta.robot}, {plant}seed {meta.seed}; {first.t:.2f} s to {last.t:.2f} s, "
        f"{len(log.snapshots)} rows. The figures are those of the rows: what happens between "
        "two of them is not seen."
    )


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


def _changes(log: Log) -> Part:
    """A table of the parameters that were not the defaults."""
    changes = config_changes([s.config for s in log.snapshots])
    rows = [(path, _unit(path), _value(default), _value(had)) for path, default, had in changes]
    if not rows:
        return Part("Parameters", "parameters", text=["All were the defaults."])
    head = ("changed", "unit", "default", "here")
    return Part("Parameters", "parameters", tables=[Grid(head, rows, numbers=True)])


def _unit(path: str) -> str:
    try:
        unit = parameter(path).unit
    except ConfigError:  # a choice has no range
        return ""
    return "" if unit == "-" else unit


def _value(value: Any) -> str:
    if isinstance(value, list):
        return ", then ".join(map(_value, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
