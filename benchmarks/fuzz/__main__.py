"""Send and read mutated input: `python -m benchmarks.fuzz --seconds 60 [--seed 1]`."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any, Literal

import tyro

from app.cli.common import print_json
from app.cli.options import Json
from app.jobs.progress import progress_bar
from benchmarks.fuzz import Length


def main(
    seconds: float = 60.0,
    seed: int = 0,
    what: Literal["both", "messages", "files"] = "both",
    count: int | None = None,
    keep: Path = Path("out/fuzz"),
    json: Json = False,
) -> None:
    """Send mutated messages and read mutated files; the status is 1 after a finding.

    Args:
        seconds: [s] total duration, without the starts of processes. With `what` both, messages and
            files take half each.
        seed: Seed of the mutations.
        what: Messages, files or both.
        count: Number of messages, and number of files of each kind, instead of the duration.
        keep: Folder for the files of findings.
        json: Print one JSON object.
    """
    # Imported here: the processes that read files import this module too.
    from benchmarks.fuzz.files import fuzz_files
    from benchmarks.fuzz.messages import fuzz_messages

    length = Length(seconds / 2 if what == "both" else seconds, count)
    result: dict[str, Any] = {"seed": seed}
    for name, fuzz in (("messages", fuzz_messages), ("files", fuzz_files)):
        if what in ("both", name):
            with progress_bar(name, 1.0) as on_progress:
                result[name] = fuzz(length, seed, keep, lambda done: on_progress(min(done, 1.0)))
    if json:
        print_json(result)
    else:
        for name in ("messages", "files"):
            for key, value in result.get(name, {}).items():
                print(f"{key:14} {value}")
    if found := _found(result):
        sys.exit("\n".join(f"{what} {where}" for what, where in found.items()))


def _found(result: dict[str, Any]) -> dict[str, str]:
    """All findings in a nested result."""
    found = dict(result.get("findings", {}))
    for each in result.values():
        if isinstance(each, dict):
            found |= _found(each)
    return found


if __name__ == "__main__":
    tyro.cli(main)
