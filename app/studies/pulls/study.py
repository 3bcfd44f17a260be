"""A study: it runs the missing cases, and writes table, failures, summary, envelope and report."""

import json
import logging
import os
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

from app.errors import StudyError
from app.jobs.bounded import SMALL
from app.jobs.pool import Workers
from app.robot.description import load_robot
from app.simulation.case import RunCase
from app.strict import file_text, from_json
from app.studies.pulls import case
from app.studies.pulls.envelope import Envelope, as_toml
from app.studies.pulls.parameters import StudyParameters, code_digest
from app.studies.runs import Row, write_json, write_rows
from app.system import claim, write_whole

Task = Callable[..., Any]
_AT_ONCE = 1000  # number of cases that are sent to the workers together, to limit the memory
_PATIENCE = 10.0  # [s] timeout of the connection to a scheduler
_LINES, _HEAD = "cases.jsonl", "parameters.json"


def study(
    parameters: StudyParameters,
    cases: int,
    out: Path,
    *,
    scheduler: str | None = None,
    processes: int = 1,
    on_progress: Callable[[float], None] = lambda _: None,
) -> dict[str, Any]:
    """Run the missing cases of a study, write its results, and return the content of `study.json`.

    The cases have the numbers from 0 to `cases` - 1; further stored cases are ignored. They run on
    the workers of the dask scheduler with the address `scheduler`; without one, in processes of
    this machine. `on_progress` gets the number of stored cases.

    Raises:
        StudyError: The existing folder `out` has another study or damaged data, or is in use; the
            scheduler does not answer or has no suitable workers; a range has no part inside the
            stated envelope; or the arm reaches no start.
        DbbError: The robot cannot be loaded, or no monitored part of its arm can meet the base.
    """
    if parameters.inside:
        inside = Envelope.stated().narrowed(parameters.ranges)
        parameters = parameters.model_copy(update={"ranges": inside})
    with Journal(out, identity_of(parameters)) as journal:
        todo = [number for number in range(cases) if number not in journal.rows]
        stored = cases - len(todo)
        on_progress(stored)
        with closing(_rows(todo, parameters, scheduler, processes)) as rows:
            for done, row in enumerate(rows, stored + 1):
                journal.add(row)
                on_progress(done)
        return _write([journal.rows[number] for number in range(cases)], parameters, out)


def identity_of(parameters: StudyParameters) -> dict[str, Any]:
    """The data that identify the study in a folder: parameters and `code_digest`."""
    return {**parameters.model_dump(mode="json"), "code": code_digest()}


def _rows(
    todo: Sequence[int], parameters: StudyParameters, scheduler: str | None, processes: int
) -> Generator[Row, None, None]:
    """Run the cases with the numbers `todo`, and yield their rows."""
    if not todo:
        return
    load = partial(case.load_sources, parameters.robot)
    load()  # samples a missing border once
    run, lost = (partial(function, parameters) for function in (_row, _lost_row))
    pool: Any = _client(scheduler) if scheduler else Workers(load, min(processes, len(todo)))
    run_all = partial(_map, pool, load) if scheduler else pool.map
    with pool:
        for begin in range(0, len(todo), _AT_ONCE):
            yield from run_all(run, todo[begin : begin + _AT_ONCE], lost=lost)


def _row(parameters: StudyParameters, sources: case.StudySources, number: int) -> Row:
    drawn = case.draw_case(parameters, number, sources)
    return case.play_case(drawn, parameters, sources.model, sources.data)


def _lost_row(parameters: StudyParameters, number: int) -> Row:
    """The row of a case whose process has ended in each attempt."""
    drawn = case.draw_case(parameters, number, case.load_sources(parameters.robot))
    return {**drawn, "nan": False, "error": "the process was killed in each attempt"}


def _write(rows: list[Row], parameters: StudyParameters, out: Path) -> dict[str, Any]:
    """Write the results of a study, and return the content of `study.json`."""
    from app.studies.pulls.report import PICTURES, report_html, summary_of
    from app.studies.style import png_of, styled

    d_b = load_robot(parameters.robot).config.border.d_b
    summary, envelope = summary_of(rows, parameters, d_b)
    with styled():
        pictures = {n: png_of(each.draw(rows, envelope, d_b)) for n, each in PICTURES.items()}
    write_rows(out / "results.parquet", rows)
    folder = out / "failures"
    try:
        folder.mkdir(exist_ok=True)
    except OSError as error:
        raise StudyError(f"--out: cannot write to {folder}: {error.strerror}") from None
    former = set(folder.glob("case-*.json"))
    for row in filter(case.failed, rows):
        path = folder / f"case-{row['case']:05d}.json"
        write_whole(path, RunCase.of(case.spec_of(row, parameters)).text())
        former.discard(path)
    for path in former:
        path.unlink()
    for name, png in pictures.items():
        write_whole(out / f"{name}.png", png)
    write_whole(out / "report.html", report_html(rows, parameters, summary, envelope, pictures))
    result = {"parameters": identity_of(parameters), **summary}
    whole, inside = result["parameters"] | summary, summary["envelope"]
    source = {n: whole[n] for n in ("seed", "controller", "physics", "code", "cases", "failed")}
    for name in ("inside", "inside_by_halves"):
        source |= {f"{name}_{key}": value for key, value in inside[name].items()}
    write_whole(out / "envelope.toml", as_toml(envelope, source))
    write_json(out / "study.json", result)
    return result


class Journal(AbstractContextManager["Journal"]):
    """The stored rows of a study, one line of JSON each, on the disk before `add` returns.

    An incomplete last line, left by a killed process, is removed, and its case runs again.
    """

    def __init__(self, folder: Path, identity: dict[str, Any]) -> None:
        """Open or start the journal of the study with this identity in an existing folder; raises a
        StudyError if the folder has another study or damaged data, or is in use.
        """
        self.rows: dict[int, Row] = {}  # by the number of the case
        self._file = (folder / _LINES).open("a+b")
        with ExitStack() as stack:
            stack.enter_context(self._file)  # closes it after an error
            if claim(self._file) is False:
                raise StudyError(f"--out: another dbb study uses {folder}; wait, or choose another")
            _check_identity(folder, identity)
            self._read(folder / _LINES)
            stack.pop_all()  # no error: the file stays open

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, row: Row) -> None:
        """Store the row of a case; a second row of the same case is ignored."""
        if row["case"] in self.rows:
            return
        self._file.write(json.dumps(row, allow_nan=False).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())
        self.rows[row["case"]] = row

    def _read(self, path: Path) -> None:
        self._file.seek(0)
        whole = 0
        for number, line in enumerate(iter(partial(self._file.readline, SMALL), b""), start=1):
            if not line.endswith(b"\n") and len(line) < SMALL:
                break  # cut off
            whole += len(line)
            try:
                row = from_json(line.decode())
                self.rows.setdefault(row["case"], row)
            except (ValueError, KeyError, TypeError):
                why = f"line {number} of {path} is damaged"
                raise StudyError(f"{why}; remove the line, and the case runs again") from None
        self._file.truncate(whole)  # the file is open to append: writing continues at its end


def _check_identity(folder: Path, identity: dict[str, Any]) -> None:
    """Write the identity of a study, or check that the folder has the same identity."""
    path = folder / _HEAD
    if not path.exists():
        write_json(path, identity)
        return
    try:
        stored = from_json(file_text(path))
    except ValueError:
        raise StudyError(f"--out: {path} is damaged; choose another folder") from None
    if stored != identity:
        why = f"--out: {folder} has another study ({_difference(stored, identity)})"
        helps = "continue that study with its own options, or choose another folder"
        raise StudyError(f"{why}; {helps}")


def _difference(kept: Any, wanted: dict[str, Any]) -> str:
    """The differences of the identity `kept` from `wanted`, such as `seed: 1, not 2`."""
    if not isinstance(kept, dict):
        return "its parameters cannot be read"
    if kept.get("code") != wanted.get("code"):  # then other parts may differ too
        return f"code of another version: {kept.get('code')}, not {wanted.get('code')}"
    parts = []
    for key in sorted({*kept, *wanted}):
        there, here = kept.get(key), wanted.get(key)
        if isinstance(there, dict) and isinstance(here, dict):
            parts.append(_difference(there, here))
        elif there != here:
            parts.append(f"{key.replace('_', ' ')}: {there}, not {here}")
    return "; ".join(filter(None, parts))


def _client(scheduler: str) -> Any:
    """A dask client of the scheduler at an address, such as `tls://10.0.0.7:8786`.

    Raises a StudyError if no scheduler answers, there is no worker, or a worker has other code than
    this process or lacks a module. The certificates for `tls://` come from dask's configuration.
    """
    # Imported here: without --scheduler nothing of dask is loaded, and no port is open.
    from distributed import Client

    for name in ("distributed", "tornado"):  # their errors arrive as exceptions
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = Client(scheduler, timeout=_PATIENCE)
    except (OSError, TimeoutError, TypeError, ValueError) as error:  # TypeError: no certificate
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        why = f"--scheduler: no dask scheduler answers at {scheduler} ({reason})"
        helps = "start one by `dask scheduler`, and workers by `dask worker ADDRESS`"
        raise StudyError(f"{why}; {helps} with this project installed") from None
    with ExitStack() as stack:
        stack.callback(client.close)  # closes it after an error
        with suppress(TimeoutError):
            client.wait_for_workers(1, timeout=30.0)
        try:
            digests = client.run(code_digest) if client.nthreads() else {}
        except ImportError as error:
            raise StudyError(f"--scheduler: a worker of {scheduler} lacks {error.name}") from None
        if not digests:
            why = f"--scheduler: {scheduler} has no workers"
            raise StudyError(f"{why}; start some by `dask worker {scheduler}`")
        if strange := [worker for worker, digest in digests.items() if digest != code_digest()]:
            names = ", ".join(strange)
            raise StudyError(f"--scheduler: {names} of {scheduler} runs code of another version")
        stack.pop_all()  # no error: the client stays connected
    return client


def _map(
    client: Any, make_context: Task, function: Task, jobs: Sequence[int], *, lost: Task
) -> Iterator[Row]:
    """As `Workers.map`, but yields the results in the order in which the jobs end. Each job calls
    `make_context`, which has to cache the data that the jobs share. `lost` makes the result of a
    job whose worker ended in each attempt.
    """
    from distributed import as_completed
    from distributed.scheduler import KilledWorker

    run = partial(_run, function, make_context)
    jobs_of = dict(zip(client.map(run, jobs, pure=False), jobs, strict=True))
    for future in as_completed(jobs_of):
        try:
            yield future.result()
        except KilledWorker:
            yield lost(jobs_of[future])


def _run(function: Task, make_context: Task, job: int) -> Row:
    return function(make_context(), job)
