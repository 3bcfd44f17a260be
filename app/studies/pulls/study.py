"""The whole study: cases that are not yet done, then table, failures, summary and report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from app.config import Config
from app.errors import StudyError
from app.studies.pulls.cluster import cluster
from app.studies.pulls.envelope import Envelope, as_toml
from app.studies.pulls.journal import Journal, write_json, write_whole
from app.studies.pulls.parameters import StudyParameters, code_digest
from app.studies.pulls.play import Row, case_of, failed
from app.studies.pulls.rollouts import rollouts
from app.studies.pulls.sources import load_sources
from app.studies.pulls.summary import summary_of


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
        StudyError: The folder holds another study, or the scheduler is not there.
        DbbError: The robot cannot be loaded, or no case can be drawn.
    """
    with Journal(out, identity_of(parameters)) as journal:
        todo = [number for number in range(cases) if number not in journal.rows]
        on_progress(cases - len(todo))
        if todo:
            load_sources(parameters.robot)  # a border that must be sampled is sampled once
            with cluster(scheduler, min(processes, len(todo))) as client:
                for done, row in enumerate(rollouts(client, parameters, todo), start=1):
                    journal.add(row)
                    on_progress(cases - len(todo) + done)
        rows = [journal.rows[number] for number in range(cases)]
        return _write(rows, parameters, out)


def identity_of(parameters: StudyParameters) -> dict[str, Any]:
    """What a folder's study is recognised by."""
    identity = {**parameters.model_dump(mode="json"), "code": code_digest()}
    if parameters.inside:
        identity["envelope"] = Envelope.stated().model_dump(mode="json")
    return identity


def _write(rows: list[Row], parameters: StudyParameters, out: Path) -> dict[str, Any]:
    # Imported here: matplotlib is not needed before all cases are done.
    from app.studies.pulls.figures import draw_all
    from app.studies.pulls.report import report_html
    from app.studies.pulls.table import write_table

    summary = summary_of(rows, parameters)
    fitted = {k: v for k, v in summary["envelope"].items() if not k.startswith("inside")}
    outline = load_sources(parameters.robot).outline
    envelope = Envelope.model_validate(fitted)
    pictures = draw_all(rows, envelope, outline, Config().border.d_b)
    write_table(out / "results.parquet", rows)
    _write_failures(rows, parameters, out / "failures")
    for name, png in pictures.items():
        write_whole(out / f"{name}.png", png)
    page = report_html(rows, parameters, summary, pictures)
    write_whole(out / "report.html", page.encode())
    result = {"parameters": identity_of(parameters), **summary}
    source = {
        "seed": parameters.seed,
        "controller": parameters.controller,
        "physics": parameters.physics,
        "code": code_digest(),
        "cases": len(rows),
        "failed": summary["failed"],
        **_told("inside", summary["envelope"]["inside"]),
        **_told("inside_by_halves", summary["envelope"]["inside_by_halves"]),
    }
    write_whole(out / "envelope.toml", as_toml(envelope, source).encode())
    write_json(out / "study.json", result)
    return result


def _told(name: str, counted: dict[str, Any]) -> dict[str, Any]:
    return {f"{name}_{key}": value for key, value in counted.items()}


def _write_failures(rows: list[Row], parameters: StudyParameters, folder: Path) -> None:
    """One file a failed case, with all that it takes to play it again; older ones are removed."""
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise StudyError(f"--out: cannot write to {folder}: {error.strerror}") from None
    names = set()
    for row in filter(failed, rows):
        case = case_of(row, parameters)
        names.add(f"{case.name}.json")
        write_json(
            folder / f"{case.name}.json", {"case": case.model_dump(mode="json"), "figures": row}
        )
    for path in folder.glob("case-*.json"):
        if path.name not in names:
            path.unlink()
