"""The whole study: cases that are not yet done, then table, failures, summary and report."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from app.config import Config
from app.errors import StudyError
from app.jobs.pool import Workers
from app.studies.pulls.case import case_of, failed, play_case
from app.studies.pulls.draw import StudySources, draw_case, load_sources
from app.studies.pulls.envelope import Envelope, as_toml
from app.studies.pulls.journal import Journal, write_table
from app.studies.pulls.parameters import StudyParameters, code_digest
from app.studies.rows import Row, write_json
from app.system import write_whole

_AT_ONCE = 1000  # cases given to the workers together: each waiting one takes memory


def study(
    parameters: StudyParameters,
    cases: int,
    out: Path,
    *,
    scheduler: str | None = None,
    processes: int = 1,
    on_progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Do the cases of a study that its folder does not hold yet, and write what it says.

    Args:
        parameters: What the cases follow from.
        cases: How many, from number 0 on; a folder with fewer is gone on with.
        out: An existing folder.
        scheduler: Address of a dask scheduler, or None for processes on this machine.
        processes: How many of those.
        on_progress: Called with how many cases are done.

    Returns:
        What `study.json` holds.

    Raises:
        StudyError: The folder holds another study, the scheduler is not there, or nothing of what
            is asked for lies inside of the stated envelope.
        DbbError: The robot cannot be loaded, or no case can be drawn.
    """
    if parameters.inside:
        inside = Envelope.stated().narrowed(parameters.ranges)
        parameters = parameters.model_copy(update={"ranges": inside})
    with Journal(out, identity_of(parameters)) as journal:
        todo = [number for number in range(cases) if number not in journal.rows]
        on_progress(cases - len(todo))
        if todo:
            _do(todo, parameters, scheduler, processes, journal, on_progress)
        rows = [journal.rows[number] for number in range(cases)]
        return _write(rows, parameters, out)


def identity_of(parameters: StudyParameters) -> dict[str, Any]:
    """What a folder's study is recognised by."""
    return {**parameters.model_dump(mode="json"), "code": code_digest()}


def _do(
    todo: Sequence[int],
    parameters: StudyParameters,
    scheduler: str | None,
    processes: int,
    journal: Journal,
    on_progress: Callable[[float], None],
) -> None:
    """Play the cases of these numbers, each kept in the journal as soon as it is back."""
    load = partial(load_sources, parameters.robot)
    load()  # a border that must be sampled is sampled once
    if scheduler is None:
        workers = Workers(load, min(processes, len(todo)))
    else:
        # Imported here: nothing of dask is needed, and no port is opened, unless it is asked for.
        from app.studies.pulls.cluster import Cluster

        workers = Cluster(scheduler, load)
    kept = len(journal.rows)
    with workers:
        for begin in range(0, len(todo), _AT_ONCE):
            for row in workers.map(partial(_row, parameters), todo[begin : begin + _AT_ONCE]):
                journal.add(row)
                kept += 1
                on_progress(kept)


def _row(parameters: StudyParameters, sources: StudySources, number: int) -> Row:
    """Draw a case and play it."""
    case = draw_case(parameters, number, sources)
    return play_case(case, sources.model, sources.data)


def _write(rows: list[Row], parameters: StudyParameters, out: Path) -> dict[str, Any]:
    # Imported here: matplotlib is not needed before all cases are done.
    from app.studies.pulls.figures import draw_all
    from app.studies.pulls.report import report_html, summary_of

    summary, envelope = summary_of(rows, parameters)
    pictures = draw_all(rows, envelope, load_sources(parameters.robot), Config().border.d_b)
    write_table(out / "results.parquet", rows)
    _write_failures(rows, parameters, out / "failures")
    for name, png in pictures.items():
        write_whole(out / f"{name}.png", png)
    page = report_html(rows, parameters, summary, envelope, pictures)
    write_whole(out / "report.html", page)
    source = {
        "seed": parameters.seed,
        "controller": parameters.controller,
        "physics": parameters.physics,
        "code": code_digest(),
        "cases": len(rows),
        "failed": summary["failed"],
    }
    for name in ("inside", "inside_by_halves"):
        source |= {f"{name}_{key}": value for key, value in summary["envelope"][name].items()}
    write_whole(out / "envelope.toml", as_toml(envelope, source))
    result = {"parameters": identity_of(parameters), **summary}
    write_json(out / "study.json", result)
    return result


def _write_failures(rows: list[Row], parameters: StudyParameters, folder: Path) -> None:
    """One file a failed case, with all that it takes to play it again; older ones are removed."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise StudyError(f"--out: cannot write to {folder}: {error.strerror}") from None
    kept = set()
    for row in filter(failed, rows):
        case = case_of(row, parameters)
        kept.add(folder / f"{case.name}.json")
        write_json(
            folder / f"{case.name}.json", {"case": case.model_dump(mode="json"), "figures": row}
        )
    for path in set(folder.glob("case-*.json")) - kept:
        path.unlink()
