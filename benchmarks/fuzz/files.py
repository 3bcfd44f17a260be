"""Mutated files of every kind that the project reads.

The project must read a file without an unexpected exception, or refuse it with one error line. A
separate reading process reads the files, because a file may crash it. Files that the project reads
in a child process are read in a fork of the reading process, with the same limits: a fork starts in
milliseconds instead of a second. About 1 % of these files are read in the project's own child
process.
"""

from __future__ import annotations

import io
import itertools
import json
import os
import resource
import shutil
import signal
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from contextlib import suppress
from functools import lru_cache, partial
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import trimesh

from app.border.cache import BorderData, DamagedFileError, read, write
from app.border.dbb import make_cloud
from app.config import Config
from app.config_file import read_config, save_config
from app.errors import DbbError
from app.jobs import bounded
from app.jobs.process import Child, EndedError, run_in_process
from app.jobs.process import Outcome as Done
from app.onboarding.read.links import link_geometry
from app.onboarding.read.package import look_into, open_package
from app.robot.assets import ASSETS, planar_urdf
from app.robot.description import load_description, load_robot
from app.robot.link_pairs import LinkPairs, Pair
from app.robot.model import RobotModel
from app.simulation.case import RunCase, RunSpec, read_case
from app.simulation.scenarios import SCENARIOS
from app.simulation.trace.log_file import read_trace, write_trace
from app.studies.pulls.study import Journal
from app.studies.run_report import key_numbers
from benchmarks.fuzz import Length
from benchmarks.fuzz.expand import expanded
from benchmarks.fuzz.mutate import mutated, mutated_bytes
from benchmarks.memory import peak_memory
from tests.logs import random_snapshots, trace_of

_LONGEST = 20.0  # [s] processor time after which the reading of a file is aborted
_SILENT = 300.0  # [s] time without an answer after which the reading process counts as hanging
_SECONDS = 2.0  # [s] largest accepted processor time for a file
_READER = 4.0  # [s] largest accepted further time of child processes, which import libraries
_GROWTH = 300.0  # [MB] largest accepted growth of the process
_OWN_CHILD = 0.01  # [-] share of files that are read in a child of the project, not in a fork
_EXPANDED = 0.1  # [-] share of files from `expanded`
_MEMORY = 6 * 2**30  # [bytes] limit of the address space; the libraries need half of it
_numbers = itertools.count()
_ROBOT = ASSETS / "husky_panda"
_URDF = """<robot name="r"><link name="base"><visual><geometry><mesh filename="a.stl"/></geometry>
</visual></link><link name="arm"/><joint name="j" type="revolute"><parent link="base"/>
<child link="arm"/><origin xyz="0 0 1" rpy="0 0 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="9" velocity="2"/></joint></robot>"""


class Kind(NamedTuple):
    """A kind of file.

    Attributes:
        name: Name of a file of this kind, with its ending.
        seed: Writes a valid file to a path.
        take: Reads a file and runs the first steps of the commands with it.
        mutate: Writes a mutated file to a path, from the bytes of a valid file.
    """

    name: str
    seed: Callable[[Path], Any]
    take: Callable[[Path], Any]
    mutate: Callable[[Path, bytes, np.random.Generator], Any]


def _mutate_bytes(path: Path, right: bytes, rng: np.random.Generator) -> None:
    path.write_bytes(mutated_bytes(right, rng))


def _mutate_json(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """Mutate the tree of the file, or its text."""
    if rng.random() < 0.3:
        _mutate_bytes(path, right, rng)
        return
    tree = mutated(json.loads(right), rng)
    path.write_text(json.dumps(tree, default=repr), encoding="utf-8")


def _mutate_csv(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """Mutate a cell, the meta data, or any bytes."""
    lines = right.split(b"\n")
    choice = rng.random()
    if choice < 0.4:
        cells = lines[2].split(b",")
        cells[int(rng.integers(len(cells)))] = mutated_bytes(b"1.5", rng)
        lines[2] = b",".join(cells)
    elif choice < 0.7:
        meta = mutated(json.loads(lines[0][2:]), rng)
        lines[0] = b"# " + json.dumps(meta, default=repr).encode()
    else:
        lines = [mutated_bytes(right, rng)]
    path.write_bytes(b"\n".join(lines))


def _mutate_parquet(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """Mutate the bytes; or the meta data, a column or the rows, with valid checksums."""
    if rng.random() < 0.3:
        _mutate_bytes(path, right, rng)
        return
    table = _table(right)
    meta = table.schema.metadata
    k = int(rng.integers(table.num_columns))
    match int(rng.integers(5)):
        case 0 | 1:
            header = mutated(json.loads(meta[b"dbb_log"]), rng)
            meta = {b"dbb_log": json.dumps(header, default=repr).encode()}
        case 2:
            values = mutated(table.column(k).to_pylist(), rng)
            with suppress(pa.ArrowException, OverflowError, TypeError):  # no column can have them
                table = table.set_column(k, table.column_names[k], pa.array(values))
        case 3:
            table = table.remove_column(k)
        case _:
            table = table.slice(int(rng.integers(table.num_rows)), int(rng.integers(9)))
    pq.write_table(table.replace_schema_metadata(meta), path)


@lru_cache(maxsize=1)
def _table(right: bytes) -> pa.Table:
    return pq.read_table(io.BytesIO(right))


def _mutate_border(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """Mutate the bytes; or the header and an array, with valid checksums."""
    if rng.random() < 0.3:
        _mutate_bytes(path, right, rng)
        return
    with np.load(io.BytesIO(right)) as file:
        arrays = {name: file[name] for name in file.files}
    header = json.loads(arrays.pop("header").tobytes())
    if rng.random() < 0.5:
        header = mutated(header, rng)
    name = list(arrays)[int(rng.integers(len(arrays)))]
    match int(rng.integers(4)):
        case 0:
            arrays[name] = arrays[name].astype(float)
        case 1:
            arrays[name] = arrays[name].ravel()[: int(rng.integers(9))]
        case 2:
            arrays[name] = np.frombuffer(rng.bytes(arrays[name].nbytes), np.uint8).reshape(
                arrays[name].shape
            )
        case _:
            del arrays[name]
    write(path, _Header(json.dumps(header, default=repr)), arrays)  # type: ignore[arg-type]


class _Header(str):
    """A header of a border file with any text."""

    def model_dump_json(self) -> str:
        """The text of the header."""
        return self


def _write_zip(path: Path, urdf: bytes = _URDF.encode(), name: str = "robot/r.urdf") -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, urdf)
        archive.writestr("robot/a.stl", b"solid a\nendsolid a\n")


def _mutate_zip(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """Mutate the URDF in the zip, the name of the URDF, or the bytes of the zip."""
    choice = rng.random()
    if choice < 0.6:
        _write_zip(path, mutated_bytes(_URDF.encode(), rng))
    elif choice < 0.7:
        name = mutated_bytes(b"robot/r.urdf", rng).decode("utf-8", "replace")[:60_000]
        _write_zip(path, name=name.replace("\0", "") + ".urdf")  # zipfile ends a name there
    else:
        _mutate_bytes(path, right, rng)


def _open_zip(path: Path) -> None:
    """List the URDFs in a zip, and unpack the zip as a robot with the first one."""
    (first, *_) = look_into(path)
    with tempfile.TemporaryDirectory() as folder:
        open_package(path, Path(folder), first)


def _border(path: Path) -> None:
    """Write a small border as a file of the cache."""
    points = np.random.default_rng(0).integers(0, 500, (60, 3)).astype(np.int16)
    pair = Pair("lm", "lEE")
    distances = np.arange(60, dtype=np.uint16)
    pairs = LinkPairs((pair,), (), (), {pair.name: 0.1}, {pair.name: 0.0}, 10, 0)
    content = BorderData(pairs, {pair.name: make_cloud(pair.name, points, distances)}, "sampled")
    write(path, content, "0" * 32)


def _log(path: Path) -> None:
    write_trace(path, trace_of(random_snapshots(2, 12)))


def _figures(path: Path) -> None:
    json.dumps(key_numbers(read_trace(path)), allow_nan=False)


def _played(path: Path) -> None:
    """Write a valid case."""
    scenario = SCENARIOS["guiding-lateral"]
    case = RunCase.of(RunSpec("husky_panda", scenario, Config(), "dbb", "planar"))
    path.write_text(case.text(), encoding="utf-8")


def _play(path: Path) -> None:
    case = read_case(path)
    case.scenario()
    case.config()
    case.differences()


def _journal(path: Path) -> None:
    path.write_text("".join(json.dumps({"case": k}) + "\n" for k in range(3)), encoding="utf-8")


def _go_on(path: Path) -> None:
    """Open the journal of a study that has this file."""
    folder = path.parent / "study"
    folder.mkdir(exist_ok=True)
    shutil.copyfile(path, folder / "cases.jsonl")
    with Journal(folder, {}):
        pass


def _mine(path: Path) -> None:
    """Load a user's robot with this URDF."""
    folder = path.parent / "robots" / "mine"
    folder.mkdir(parents=True, exist_ok=True)
    os.environ["DBB_ROBOTS"] = str(folder.parent)
    text = (_ROBOT / "robot.toml").read_text(encoding="utf-8")
    (folder / "robot.toml").write_text(text.replace('"husky_panda"', '"mine"'), encoding="utf-8")
    shutil.copyfile(path, folder / "robot.urdf")
    description = load_robot("mine")
    RobotModel(description)
    planar_urdf(description)


def _mesh(path: Path) -> None:
    trimesh.creation.box((1.0, 1.0, 1.0)).export(path)


def _shape(path: Path) -> None:
    """Read the geometry of a link with this mesh.

    Each mesh has its own name, because results are cached by the name.
    """
    mesh = path.with_name(f"{next(_numbers)}.stl")
    path.rename(mesh)
    try:
        text = f'<a><visual><geometry><mesh filename="{mesh}"/></geometry></visual></a>'
        link_geometry(ElementTree.fromstring(text))
    finally:
        mesh.rename(path)


KINDS = {
    "description": Kind(
        "robot.toml",
        lambda path: path.write_bytes((_ROBOT / "robot.toml").read_bytes()),
        lambda path: RobotModel(load_description(path)),
        _mutate_bytes,
    ),
    "config": Kind(
        "a.toml",
        lambda path: path.write_text(save_config(Config(), "a"), encoding="utf-8"),
        read_config,
        _mutate_bytes,
    ),
    "case": Kind("played.json", _played, _play, _mutate_json),
    "journal": Kind("cases.jsonl", _journal, _go_on, _mutate_bytes),
    "urdf": Kind(
        "robot.urdf",
        lambda path: path.write_bytes((_ROBOT / "robot.urdf").read_bytes()),
        _mine,
        _mutate_bytes,
    ),
    "mesh": Kind("a.stl", _mesh, _shape, _mutate_bytes),
    "log csv": Kind("a.csv", _log, _figures, _mutate_csv),
    "log parquet": Kind("a.parquet", _log, _figures, _mutate_parquet),
    "border": Kind("a.npz", _border, partial(read, key="0" * 32), _mutate_border),
    "zip": Kind("a.zip", _write_zip, _open_zip, _mutate_zip),
}


class Outcome(NamedTuple):
    """The outcome for one file.

    Attributes:
        result: `right` (read), `line` (refused with one line) or `finding`.
        text: Description of a finding.
        lost: Whether a new reading process is necessary, because the present one has crashed, does
            not answer, or uses too much memory.
    """

    result: str
    text: str = ""
    lost: bool = False


def fuzz_files(
    length: Length, seed: int, keep: Path, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    """Mutate files of all kinds in turn, and return the results of each kind.

    Args:
        length: Length of the test, without the starts of the reading process.
        seed: Seed of the mutations; file k depends only on the seed and k.
        keep: Folder for the files of findings.
        on_progress: Called with the share that is done.
    """
    tally = {name: Counter[str]() for name in KINDS}
    findings: dict[str, str] = {}
    spent, k, share = 0.0, 0, 0.0
    while share < 1.0:
        with tempfile.TemporaryDirectory() as folder, Child(_take_many, seed, folder) as child:
            _answered(child)
            lost = False
            while share < 1.0 and not lost:
                name = list(KINDS)[k % len(KINDS)]
                begin = time.monotonic()
                child.sender.send((name, k))
                result, text, lost = _answered(child)
                tally[name][result] += 1
                if text and f"{name}: {text}" not in findings:
                    findings[f"{name}: {text}"] = _kept(Path(folder) / KINDS[name].name, keep, k)
                k += 1
                spent += time.monotonic() - begin
                share = length.share(spent, k // len(KINDS))
                on_progress(share)
    return {**{name: dict(counts) for name, counts in tally.items()}, "findings": findings}


def _answered(child: Child) -> Outcome:
    """The answer of the reading process, or the outcome of a timeout."""
    try:
        if child.receiver.poll(_SILENT):
            return child.receiver.recv()
    except EOFError:
        return Outcome("finding", "the process that reads has ended", True)
    return Outcome("finding", "the process that reads hangs", True)


def _kept(path: Path, keep: Path, k: int) -> str:
    """Copy file k to `keep`, the folder of the findings, and return the copy's path."""
    keep.mkdir(parents=True, exist_ok=True)
    copy = keep / f"{k}-{path.name}"
    copy.write_bytes(path.read_bytes() if path.exists() else b"")
    return str(copy)


def _take_many(receiver: Connection, sender: Connection, seed: int, at: str) -> None:
    """Main function of the reading process, which makes and reads file k of a kind on request."""
    folder = Path(at)
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    signal.signal(signal.SIGPROF, _too_long)
    right = {}
    for name, kind in KINDS.items():
        path = folder / f"right-{kind.name}"
        kind.seed(path)
        kind.take(path)
        right[name] = path.read_bytes()
    sender.send(Outcome("right"))
    while True:
        name, k = receiver.recv()
        kind = KINDS[name]
        rng, path = np.random.default_rng([seed, k]), folder / kind.name
        if rng.random() < _EXPANDED:
            path.write_bytes(expanded(name, right[name], rng))
        else:
            kind.mutate(path, right[name], rng)
        bounded.run_in_process = run_in_process if rng.random() < _OWN_CHILD else _forked
        sender.send(_within_budget(kind, path))


def _forked(work: Callable[..., Any], *args: Any, **_: object) -> Any:
    """Do the work in a fork, in place of `run_in_process`; return its result or raise its error."""
    receiver, sender = Pipe(duplex=False)
    child = os.fork()
    if not child:
        try:
            sender.send(Done.of(work, None, *args))
        finally:
            os._exit(0)
    sender.close()
    try:
        done: Done | None = receiver.recv()
    except EOFError:
        done = None
    receiver.close()
    os.waitpid(child, 0)
    if done is None:
        raise EndedError("the fork has ended")
    return done.value()


def _within_budget(kind: Kind, path: Path) -> Outcome:
    """The outcome for a file; too much time or memory is a finding."""
    before, begin = peak_memory(), _times()
    outcome = _outcome(kind, path)
    own, of_children = _times() - begin
    if own > _SECONDS or of_children > _SECONDS + _READER:
        return Outcome("finding", f"more than {_SECONDS:g} s of a core")
    if peak_memory() - before > _GROWTH:
        return Outcome("finding", f"more than {_GROWTH:g} MB", lost=True)
    return outcome


def _times() -> np.ndarray:
    """(2,) [s] processor times: of this process, and of its child processes that have ended."""
    of = (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    return np.array([sum(resource.getrusage(each)[:2]) for each in of])


def _outcome(kind: Kind, path: Path) -> Outcome:
    signal.setitimer(signal.ITIMER_PROF, _LONGEST)
    try:
        kind.take(path)
    except (DbbError, DamagedFileError) as error:
        if "\n" in str(error):
            return Outcome("finding", f"more than one line: {type(error).__name__}")
        return Outcome("line")
    except BaseException as error:  # any exception is a finding
        place = error.__traceback__
        while place is not None and place.tb_next is not None:
            place = place.tb_next
        where = "" if place is None else f" at {place.tb_frame.f_code.co_name}"
        return Outcome("finding", f"{type(error).__name__}: {str(error)[:120]}{where}")
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    return Outcome("right")


def _too_long(*_: object) -> None:
    raise TimeoutError(f"longer than {_LONGEST:g} s")
