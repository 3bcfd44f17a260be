"""What a study has done: a line a case, kept at once, and the table that they become at the end."""

from __future__ import annotations

import json
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from app.errors import StudyError
from app.studies.rows import Row, write_json
from app.system import claim, write_whole

_LINES, _HEAD = "cases.jsonl", "parameters.json"


class Journal:
    """Rows of a study in a folder, by the number of their case.

    Each row is one line of JSON, on the disk before `add` returns. A line that was cut off when
    the process was killed is dropped, and its case is done again.

    Attributes:
        rows: By the number of the case.
    """

    def __init__(self, folder: Path, identity: dict[str, Any]) -> None:
        """Open the journal of a folder, or begin one; use it in a `with`.

        Args:
            folder: An existing folder.
            identity: What the study's cases follow from, as JSON has it.

        Raises:
            StudyError: The folder holds another study, or somebody works on this one, or a row
                cannot be read.
        """
        self.rows: dict[int, Row] = {}
        self._folder = folder
        self._file = (folder / _LINES).open("a+b")
        try:
            if not claim(self._file):
                raise StudyError(
                    f"--out: another dbb study works in {folder}; wait for it, or choose another"
                )
            self._claim(identity)
            self._read()
        except BaseException:
            self._file.close()
            raise

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def add(self, row: Row) -> None:
        """Keep the row of a case; a second one of the same case is ignored."""
        if row["case"] in self.rows:
            return
        self._file.write(json.dumps(row, allow_nan=False).encode() + b"\n")
        self._file.flush()
        os.fsync(self._file.fileno())
        self.rows[row["case"]] = row

    def _claim(self, identity: dict[str, Any]) -> None:
        """Write down which study this is, or see that it is the same."""
        path = self._folder / _HEAD
        if not path.exists():
            write_json(path, identity)
            return
        try:
            kept = json.loads(path.read_text(encoding="utf-8"))
        except ValueError:
            raise StudyError(f"--out: {path} is damaged; choose another folder") from None
        if kept != identity:
            raise StudyError(
                f"--out: {self._folder} holds another study ({_difference(kept, identity)}); "
                "go on with that one's options, or choose another folder"
            )

    def _read(self) -> None:
        self._file.seek(0)
        content = self._file.read()
        whole = content.rfind(b"\n") + 1
        for number, line in enumerate(content[:whole].splitlines(), start=1):
            try:
                row = json.loads(line)
                self.rows.setdefault(row["case"], row)
            except (ValueError, KeyError, TypeError):
                raise StudyError(
                    f"line {number} of {self._folder / _LINES} is damaged; remove it, and its case "
                    "is done again"
                ) from None
        self._file.truncate(whole)  # it is opened to append: writing goes on at its end


def _difference(kept: Any, wanted: dict[str, Any]) -> str:
    """Which parts differ, as in `seed 1, not 2`."""
    if not isinstance(kept, dict):
        return "its parameters cannot be read"
    if kept.get("code") != wanted.get("code"):  # then all else may differ as well
        return f"code of another version: {kept.get('code')}, not {wanted.get('code')}"
    parts = []
    for key in sorted({*kept, *wanted}):
        there, here = kept.get(key), wanted.get(key)
        if there == here:
            continue
        if isinstance(there, dict) and isinstance(here, dict):
            parts.append(_difference(there, here))
        else:
            parts.append(f"{key.replace('_', ' ')}: {there}, not {here}")
    return "; ".join(parts)


def write_table(path: Path, rows: Sequence[Row]) -> None:
    """Write the rows, sorted by case, as Parquet; the same rows give the same bytes.

    What a row does not have is null.
    """
    # Imported here: it is not needed before all cases are done.
    import pyarrow as pa
    import pyarrow.parquet as pq

    ordered = sorted(rows, key=lambda row: row["case"])
    names = dict.fromkeys(name for row in ordered for name in row)
    columns = {name: pa.array([row.get(name) for row in ordered]) for name in names}
    empty = {
        name: each.cast(pa.float64()) for name, each in columns.items() if each.type == pa.null()
    }
    sink = pa.BufferOutputStream()
    pq.write_table(pa.table(columns | empty), sink, compression="zstd")
    write_whole(path, sink.getvalue().to_pybytes())
