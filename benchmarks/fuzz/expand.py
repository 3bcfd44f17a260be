"""Small files that need much memory or time to read: deep nesting, repetitions, wrong sizes."""

from __future__ import annotations

import io
import json
import struct
import zipfile
from collections.abc import Callable

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

_MIN_POWER, _MAX_POWER = 2.0, 5.0  # [-] bounds of the decimal logarithm of the repetitions

_TOML: tuple[Callable[[int], str], ...] = (
    lambda n: f"a{'.b' * n} = 1",
    lambda n: "".join(f"[a{'.b' * 300}{k}]\n" for k in range(n // 100)),
    lambda n: f"a = {'[' * n}{']' * n}",
    lambda n: f"a = {'{b = ' * n}1{'}' * n}",
    lambda n: f"a = [{'[],' * n}]",
    lambda n: "".join(f"k{k} = 1\n" for k in range(n)),
    lambda n: "".join(f"[[a.b]]\nc.d = {k}\n" for k in range(n // 10)),
    lambda n: f"{'n' * n} = '''{'x' * n}'''",
    lambda n: ".".join(['"="'] * n) + " = 1",
)
_JSON: tuple[Callable[[int], str], ...] = (
    lambda n: "[" * n + "]" * n,
    lambda n: '{"dbb_case": 1, "options": ' + '{"a": ' * n + "0" + "}" * (n + 1),
    lambda n: f'{{"dbb_case": 1, "options": {{"q_m": [{"[]," * n}0]}}}}',
    lambda n: json.dumps({"dbb_case": 1, "parameters": {f"p{k}": 1 for k in range(n)}}),
    lambda n: f'{{"dbb_case": 1, "seed": {"9" * n}}}',
    lambda n: f'{{"dbb_case": 1, "robot": "{"n" * n}"}}',
)
_XML: tuple[Callable[[int], str], ...] = (
    lambda n: "<robot>" + "<a>" * n,
    lambda n: "<robot name='r'>" + "<link name='l'/>" * n + "</robot>",
    lambda n: "<robot " + " ".join(f"a{k}='x'" for k in range(n)) + "/>",
    lambda n: f"<robot name='{'n' * n}'/>",
    lambda n: "<robot name='r'><link name='l0'/>" + "".join(map(_joint, range(n))) + "</robot>",
    lambda n: "<!DOCTYPE r [" + "".join(f"<!ENTITY e{k} 'x'>" for k in range(n)) + "]><robot/>",
)


def _joint(k: int) -> str:
    """A link that turns about the previous link."""
    return (
        f"<link name='l{k + 1}'/><joint name='j{k}' type='revolute'><parent link='l{k}'/>"
        f"<child link='l{k + 1}'/><axis xyz='0 0 1'/>"
        "<limit lower='-1' upper='1' effort='1' velocity='1'/></joint>"
    )


def _csv(right: bytes, n: int, rng: np.random.Generator) -> bytes:
    """A table of n columns, or the valid table `right` with n/10 empty rows or a long name."""
    head, names, *rows = right.splitlines()
    match int(rng.integers(3)):
        case 0:
            return b"\n".join([head, b",".join([b"c"] * n), b",".join([b"1"] * n)])
        case 1:
            return b"\n".join([head, names, *rows, *[b"," * names.count(b",")] * (n // 10)])
        case _:
            return b"\n".join([head, names + b"," + b"n" * n, *(row + b"," for row in rows)])


def _parquet(right: bytes, n: int, _: np.random.Generator) -> bytes:
    """Many equal rows, with a few bytes for each column."""
    table, sink = pq.read_table(io.BytesIO(right)).slice(0, 1), io.BytesIO()
    columns = {}
    for name in table.column_names:
        column = table[name].combine_chunks()
        once = pa.array(np.zeros(n, np.int8))
        empty = column.null_count
        same = None if empty else pa.DictionaryArray.from_arrays(once, column)
        columns[name] = pa.nulls(n, column.type) if same is None else same
    header = json.loads(table.schema.metadata[b"dbb_log"]) | {"rows": n}
    pq.write_table(pa.table(columns, metadata={"dbb_log": json.dumps(header)}), sink)
    return sink.getvalue()


def _npz(_: bytes, n: int, rng: np.random.Generator) -> bytes:
    """Arrays that state, or have, a far larger size than the file."""
    head, sink = io.BytesIO(), io.BytesIO()
    form = {"descr": "|u1", "fortran_order": False, "shape": (1000 * n,)}
    np.lib.format.write_array_header_1_0(head, form)
    content = b"\0" * (1000 * n if rng.random() < 0.5 else n)
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("header.npy", head.getvalue() + content)
    return sink.getvalue()


def _zip(_: bytes, n: int, rng: np.random.Generator) -> bytes:
    """Content with a high compression ratio, or many files."""
    sink = io.BytesIO()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_DEFLATED) as archive:
        if rng.random() < 0.5:
            archive.writestr("robot/r.urdf", b" " * (500 * n))
        else:
            for k in range(min(n, 3000)):
                archive.writestr(f"robot/{k}.urdf", b"<robot/>")
    return sink.getvalue()


def _stl(_: bytes, n: int, rng: np.random.Generator) -> bytes:
    """A number of triangles that the file does not contain, or the same triangle many times."""
    one = struct.pack("<12fH", 0, 0, 1, 0, 0, 0, 1, 0, 0, 0, 1, 0, 0)
    if rng.random() < 0.5:
        return b"\0" * 80 + struct.pack("<I", 2**32 - 1) + one
    return b"\0" * 80 + struct.pack("<I", n) + one * n


_MAKERS: dict[str, Callable[[bytes, int, np.random.Generator], bytes]] = {
    "log csv": _csv,
    "log parquet": _parquet,
    "border": _npz,
    "zip": _zip,
    "mesh": _stl,
}
_TEXTS = {
    "description": _TOML,
    "config": _TOML,
    "case": _JSON,
    "journal": _JSON,
    "urdf": _XML,
}


def expanded(kind: str, right: bytes, rng: np.random.Generator) -> bytes:
    """A file of a kind that could need far more memory or time than its size suggests."""
    n = int(10 ** rng.uniform(_MIN_POWER, _MAX_POWER))
    if kind in _TEXTS:
        texts = _TEXTS[kind]
        return texts[int(rng.integers(len(texts)))](n).encode()
    return _MAKERS[kind](right, n, rng)
