"""The whole command: runs, figures, claims and the page, written into a folder."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from time import perf_counter
from typing import Any

from app.studies.drawing import Drawing
from app.studies.page import Section, page_html
from app.studies.paper.claims import claims_of, judge
from app.studies.paper.experiments import (
    ROBOT,
    Experiment,
    Sources,
    duration,
    load_sources,
    run_experiments,
)
from app.studies.paper.names import FIGURES
from app.studies.style import styled

_DRAWING = 5.0  # [s] of simulated time that drawing a figure costs about as much as


def experiments_for(names: Sequence[str]) -> list[Experiment]:
    """What has to be run for these figures and their claims, each once."""
    needs = [e for name in names for e in FIGURES[name].needs]
    needs += [e for claim in claims_of(names) for e in claim.needs]
    return list(dict.fromkeys(needs))


def work(names: Sequence[str]) -> float:
    """[s] of simulated time that making these figures costs about as much as."""
    return duration(experiments_for(names)) + _DRAWING * len(names)


def reproduce(
    names: Sequence[str],
    out: Path,
    *,
    seed: int = 0,
    processes: int = 1,
    on_progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Make figures with their data, judge the claims, and write all of it.

    Args:
        names: Names of figures, in the order of the page.
        out: An existing folder.
        seed: Of everything random in the runs.
        processes: How many runs to do side by side.
        on_progress: Called now and then with how much of `work` is done [s].

    Returns:
        What `metrics.json` holds.

    Raises:
        DbbError: A run cannot be done.
    """
    begin = perf_counter()
    experiments = experiments_for(names)
    loaded = load_sources()
    runs = run_experiments(experiments, seed=seed, processes=processes, on_progress=on_progress)
    sources = Sources(loaded.model, loaded.data, loaded.config, runs)
    sections, done = [], duration(experiments)
    for name in names:
        with styled():
            sections.append(_make(FIGURES[name].draw(sources), name, out))
        done += _DRAWING
        on_progress(done)
    claims = [judge(claim, sources) for claim in claims_of(names)]
    about = f"Robot {ROBOT}, seed {seed}, {len(runs)} runs."
    (out / "index.html").write_text(page_html(sections, claims, about), encoding="utf-8")
    result = {
        "robot": ROBOT,
        "seed": seed,
        "figures": {s.name: _figure(s) for s in sections},
        "claims": claims,
        "claims_that_hold": sum(bool(claim["holds"]) for claim in claims),
        "claims_that_do_not": sum(not claim["holds"] for claim in claims),
        "runs": {e.name: runs[e].figures for e in experiments},
        "page": "index.html",
        "elapsed_s": perf_counter() - begin,
    }
    text = json.dumps(result, indent=2, allow_nan=False) + "\n"
    (out / "metrics.json").write_text(text, encoding="utf-8")
    return result


def _make(drawing: Drawing, name: str, out: Path) -> Section:
    files = drawing.write(out, name)
    return Section(
        name,
        drawing.title,
        files[0].read_bytes(),
        drawing.paper,
        drawing.measured,
        drawing.remarks,
        [path.name for path in files],
    )


def _figure(section: Section) -> dict[str, Any]:
    return {
        "title": section.title,
        "files": list(section.files),
        "measured": dict(section.measured),
        "remarks": list(section.remarks),
    }
