"""The reproduction of the paper: runs, figures, claims, and a page that shows them."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter
from typing import Any

from app.errors import check_name
from app.studies.page import Cell, Grid, Part, measured_grids, page_html
from app.studies.paper import approach, density, departures, method
from app.studies.paper.claims import Threshold, claims_of
from app.studies.paper.drawing import Drawing
from app.studies.paper.experiments import ROBOT, Experiment, duration, load_sources, run_experiments
from app.studies.runs import write_json
from app.studies.style import Picture, pictures_in, styled
from app.system import write_whole

FIGURES = pictures_in(vars(method) | vars(approach) | vars(density) | vars(departures))
"""The figures in the order of the paper, by their names."""
_DRAWING = 5.0  # [s] simulated time whose computation takes about as long as drawing a figure


def chosen(names: Iterable[str]) -> list[str]:
    """The figures' names in the paper's order, all if `names` is empty; raises UnknownNameError."""
    selected = set(names)
    for name in sorted(selected):
        check_name("figure", name, FIGURES)
    return [name for name in FIGURES if name in selected or not selected]


def experiments_for(names: Sequence[str]) -> list[Experiment]:
    """The runs that the named figures and their claims need, without repetition."""
    needs = [e for name in names for e in FIGURES[name].needs]
    needs += [e for claim in claims_of(names) for e in claim.needs]
    return list(dict.fromkeys(needs))


def work(names: Sequence[str]) -> float:
    """[s] work of making the named figures: the simulated time that takes as long to compute."""
    return duration(experiments_for(names)) + _DRAWING * len(names)


def reproduce(
    names: list[str], out: Path, *, seed: int, processes: int, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    """Make figures with their data, judge their claims, write all files into an existing folder.

    This returns the content of `metrics.json`. `on_progress` gets the finished part of `work` [s].
    """
    begin, experiments = perf_counter(), experiments_for(names)
    sources = load_sources()  # samples a missing border before the processes start
    runs = run_experiments(experiments, seed=seed, processes=processes, on_progress=on_progress)
    sources = replace(sources, runs=runs)
    figures: dict[str, dict[str, Any]] = {}
    parts, done = [], duration(experiments)
    for name in names:
        figure = FIGURES[name]
        with styled():
            drawing = figure.draw(sources)
            files = drawing.write(out, name, figure.title)
        parts.append(figure_part(figure, drawing, files))
        figures[name] = {
            "title": figure.title,
            "files": [path.name for path in files],
            "measured": drawing.measured,
            "remarks": list(drawing.remarks),
        }
        done += _DRAWING
        on_progress(done)
    claims = [claim.judge(sources) for claim in claims_of(names)]
    about = f"Robot {ROBOT}, seed {seed}, {len(runs)} runs."
    write_whole(out / "index.html", paper_page(parts, claims, about))
    hold = sum(claim["holds"] for claim in claims)
    result = {
        "robot": ROBOT,
        "seed": seed,
        "figures": figures,
        "claims": claims,
        "claims_that_hold": hold,
        "claims_that_do_not": len(claims) - hold,
        "runs": {e.name: runs[e].figures for e in experiments},
        "page": "index.html",
        "elapsed_s": perf_counter() - begin,
    }
    write_json(out / "metrics.json", result)
    return result


def paper_page(figures: Sequence[Part], claims: Sequence[Mapping[str, Any]], about: str) -> str:
    """The HTML of `index.html`, with results of `Claim.judge` and a sentence `about` the runs."""
    lead = (
        "Reactive Self-Collision Avoidance for a Differentially Driven Mobile Manipulator, in "
        "simulation. "
    )
    parts, rows = [*figures], []
    for claim in claims:
        limits = [Threshold(**limit) for limit in claim["limits"]]
        holds = Cell("✓ holds", mark="yes") if claim["holds"] else Cell("✗ does not", mark="no")
        measured = Cell(claim["measured"], [f"{limit}: {limit.source}" for limit in limits])
        rows.append((f"§{claim['section']}", claim["paper"], measured, holds))
    if rows:
        lead += f"{sum(claim['holds'] for claim in claims)} of {len(claims)} claims hold here. "
        table = Grid(("", "The paper states", "Measured here", "Holds"), rows)
        parts.append(Part("Claims of the paper", "claims", tables=[table]))
    return page_html("The paper's experiments, reproduced", lead + about, parts)


def figure_part(figure: Picture, drawing: Drawing, files: Sequence[Path]) -> Part:
    """The part of the page with one figure; `files` are the paths from `Drawing.write`."""
    names = ", ".join(path.name for path in files)
    grids = measured_grids(drawing.measured)
    measured = Part("Measured here", tables=grids, points=drawing.remarks, note=names)
    paper = Part("The paper states", text=[figure.caption])
    return Part(figure.title, figure.name, png=files[0].read_bytes(), sides=(paper, measured))
