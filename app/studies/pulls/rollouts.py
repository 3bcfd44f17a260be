"""Cases out to the workers, rows back, each as soon as it is there."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from distributed import Client, Future, as_completed
from distributed.scheduler import KilledWorker

from app.errors import StudyError
from app.studies.pulls.cluster import workers_of
from app.studies.pulls.draw import draw_case
from app.studies.pulls.envelope import Envelope
from app.studies.pulls.parameters import StudyParameters
from app.studies.pulls.play import Row, play_case
from app.studies.pulls.sources import load_sources

_AHEAD = 3  # cases a worker has waiting, so that it never waits for the next


def rollouts(client: Client, parameters: StudyParameters, numbers: Iterable[int]) -> Iterator[Row]:
    """The rows of the cases of these numbers, in the order in which they end.

    Raises:
        StudyError: A case cannot be drawn, or takes its worker's process down again and again.
    """
    waiting = iter(numbers)
    text = parameters.model_dump_json()

    def submit(count: int) -> list[Future]:
        taken = [number for _, number in zip(range(count), waiting, strict=False)]
        return [client.submit(row_of, text, n, pure=False, key=f"{client.id}-{n}") for n in taken]

    ahead = (1 + _AHEAD) * max(workers_of(client), 1)
    working = as_completed(submit(ahead))
    for future in working:
        try:
            row = future.result()
        except KilledWorker as error:
            raise StudyError(
                f"case {str(error.args[0]).rpartition('-')[2]} ended its worker's process"
            ) from None
        working.update(submit(1))
        yield row


def row_of(parameters: str, number: int) -> Row:
    """Draw a case and play it, in a worker that keeps the robot from case to case.

    Args:
        parameters: Of the study, as JSON.
        number: Of the case.
    """
    study = StudyParameters.model_validate_json(parameters)
    sources = load_sources(study.robot)
    envelope = Envelope.stated() if study.inside else None
    case = draw_case(study, number, sources, envelope)
    return play_case(case, sources.model, sources.data)
