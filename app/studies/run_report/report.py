"""The report of one run, on a page that needs nothing else."""

from __future__ import annotations

from collections.abc import Callable
from html import escape
from typing import Any

from matplotlib.figure import Figure

from app.config import parameter
from app.simulation.trace.log import Log
from app.studies.page import document, measured_html, picture_html
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
    """The page of a run: key numbers, figures, and which parameters were not the defaults.

    Args:
        log: As `read_log` gives it, or made from snapshots.
    """
    track = track_of(log)
    title = f"{log.meta.scenario or 'A person leads the hand'}, {_controllers(log)}"
    links = "".join(f'<a href="#{name}">{text}</a>' for name, (text, _) in _FIGURES.items())
    body = [
        f'<p class="lead">{escape(_about(log))}</p>\n<nav>{links}</nav>\n',
        f'<h2>Key numbers</h2>\n<div class="scroll">{measured_html(_shown(log, track))}</div>\n',
        _changes(log),
    ]
    with styled():
        for name, (text, draw) in _FIGURES.items():
            png = png_of(draw(log, track))
            body.append(f'<h2 id="{name}">{text}</h2>\n{picture_html(text, png)}')
    return document(title, "".join(body))


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


def _shown(log: Log, track: Track) -> dict[str, Any]:
    """Key numbers; those of each pair and each joint stand one below the other."""
    shown: dict[str, Any] = {}
    for key, value in key_numbers(log, track).items():
        if isinstance(value, dict):
            stem, _, unit = key.rpartition("_")
            shown |= {f"{stem} {name}_{unit}": number for name, number in value.items()}
        else:
            shown[key] = value
    return shown


def _changes(log: Log) -> str:
    """A table of the parameters that were not the defaults."""
    changes = config_changes([s.config for s in log.snapshots])
    if not changes:
        return "<h2>Parameters</h2>\n<p>All were the defaults.</p>\n"
    rows = "".join(
        f"<tr><td>{escape(path)}</td><td>{escape(_unit(path))}</td>"
        f'<td class="number">{escape(_value(default))}</td>'
        f'<td class="number">{escape(_value(had))}</td></tr>\n'
        for path, default, had in changes
    )
    return (
        '<h2>Parameters</h2>\n<div class="scroll"><table>\n<tr><th>changed</th><th>unit</th>'
        f"<th>default</th><th>here</th></tr>\n{rows}</table></div>\n"
    )


def _unit(path: str) -> str:
    try:
        unit = parameter(path).unit
    except KeyError:  # a choice has no range
        return ""
    return "" if unit == "-" else unit


def _value(value: Any) -> str:
    if isinstance(value, list):
        return ", then ".join(map(_value, value))
    return f"{value:g}" if isinstance(value, float) else str(value)
