"""Tables as files: CSV with a leading comment, or Parquet with schema metadata."""

import io
import re
from pathlib import Path

import pyarrow as pa
import pyarrow.csv
import pyarrow.parquet as pq

from app.errors import LogError
from app.jobs.bounded import SMALL, within_budget
from app.strict import file_text, regular
from app.system import write_whole

_KEY = b"dbb_log"
_COMMENT = "# "

pa.set_memory_pool(pa.system_memory_pool())  # the default pool reserves 1 GB of address space


def read_arrow(path: Path) -> tuple[str, pa.Table]:
    """Read header and table of an untrusted file; a missing or faulty file raises a LogError."""
    try:  # a small Parquet file can contain millions of equal rows
        smallest = 0 if path.suffix.lower() == ".csv" else SMALL + 1
        return within_budget(_read, path, size=max(regular(path).stat().st_size, smallest))
    except FileNotFoundError:
        raise LogError(f"{path}: no such file") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise LogError(f"{path}: the file is not a log, or is damaged: {reason}") from None


def _read(path: Path) -> tuple[str, pa.Table]:
    try:
        return _read_csv(path) if path.suffix.lower() == ".csv" else _read_parquet(path)
    except MemoryError:
        raise
    except pa.ArrowException as error:
        raise ValueError((str(error).strip() or "unreadable").splitlines()[0][:200]) from None


def write_arrow(path: Path, table: pa.Table, header: str = "") -> None:
    """Write a table, completely or not at all: as CSV if the name ends in .csv, else as Parquet. A
    header becomes a comment in CSV, and metadata in Parquet. Equal arguments give equal bytes.
    """
    sink = io.BytesIO()
    if path.suffix.lower() == ".csv":
        sink.write(f"{_COMMENT}{header}\n".encode() if header else b"")
        pyarrow.csv.write_csv(table, sink)
    else:
        table = table.replace_schema_metadata({_KEY: header.encode()} if header else None)
        pq.write_table(table, sink, compression="zstd", write_page_checksum=True)
    write_whole(path, sink.getvalue())


def _read_csv(path: Path) -> tuple[str, pa.Table]:
    first, _, rest = file_text(path).partition("\n")
    rest = re.sub(r"\n[,;\t]+(?=\n|$)", "", rest)  # empty rows of a spreadsheet
    if not first.startswith(_COMMENT):
        changed = "; a spreadsheet has probably changed it: use the original file, or .parquet"
        plain = "; it is a table of the dashboard: save Log (Parquet) there instead"
        more = changed * ("# " in first) + plain * first.startswith(('"t_s"', "t_s,"))
        raise ValueError(f"the first line is not a metadata comment{more}")
    names, _, rows = rest.partition("\n")
    # Spreadsheets write other delimiters; the names of later columns can contain a delimiter.
    first_name = re.match(r'"?\w*"?([,;\t])', names)
    between = first_name[1] if first_name else ","
    point = "," if between != "," and re.search(r"\d,\d", rows[:10_000]) else "."
    # pyarrow then distinguishes only numbers and texts; the caller knows the exact types.
    options = pyarrow.csv.ConvertOptions(
        null_values=[""], strings_can_be_null=False, decimal_point=point
    )
    cells = pyarrow.csv.ParseOptions(delimiter=between)
    alone, content = pyarrow.csv.ReadOptions(use_threads=False), io.BytesIO(rest.encode())
    table = pyarrow.csv.read_csv(content, alone, cells, options)
    names = enumerate(table.column_names)  # a spreadsheet adds empty columns without a name
    table = table.select([k for k, n in names if n or table.column(k).null_count < len(table)])
    return first.removeprefix(_COMMENT).rstrip(",;\t"), table


def _read_parquet(path: Path) -> tuple[str, pa.Table]:
    with pq.ParquetFile(path, page_checksum_verification=True) as file:
        table = file.read(use_threads=False)
    for k, field in enumerate(table.schema):
        if pa.types.is_dictionary(field.type):  # expanded here, where the budget limits the memory
            table = table.set_column(k, field.name, table.column(k).cast(field.type.value_type))
    return (table.schema.metadata or {}).get(_KEY, b"").decode("utf-8"), table
