"""Files of every kind that the project reads, mutated: one line or a right result, nothing else.

They are read in a process of its own, because one of them may end it.
"""

from __future__ import annotations

import io
import json
import resource
import signal
import tempfile
import time
import zipfile
from collections import Counter
from collections.abc import Callable
from functools import partial
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from app.border.cache import Content, DamagedFileError, pack, read, unpack, write
from app.border.dbb import make_cloud
from app.cli.common import as_json
from app.config import Config
from app.config_file import read_config, save_config
from app.errors import DbbError
from app.jobs.process import follow_parent, starting_children
from app.onboarding.read.package import look_into
from app.robot.assets import ASSETS
from app.robot.description import load_description
from app.robot.link_pairs import LinkPairs, Pair
from app.robot.model import RobotModel
from app.simulation.trace.trace import read_trace
from app.studies.pulls.case import Case, read_case
from app.studies.run_report import key_numbers
from app.system import SPAWN
from benchmarks.fuzz.mutate import mutated, mutated_bytes
from tests.logs import random_snapshots, trace_of

_LONGEST = 20.0  # [s] for one file
_STARTING = 300.0  # [s] for the process that reads: it imports much
_MEMORY = 6 * 2**30  # [bytes] of address space, of which the libraries take one half
_ROBOT = ASSETS / "husky_panda"
_URDF = """<robot name="r"><link name="base"><visual><geometry><mesh filename="a.stl"/></geometry>
</visual></link><link name="arm"/><joint name="j" type="revolute"><parent link="base"/>
<child link="arm"/><origin xyz="0 0 1" rpy="0 0 0"/><axis xyz="0 0 1"/>
<limit lower="-1" upper="1" effort="9" velocity="2"/></joint></robot>"""


class Kind(NamedTuple):
    """A kind of file.

    Attributes:
        name: Of a file of it, with its ending.
        seed: Writes a right one to a path.
        take: Reads it and does with it what commands do first.
        mutate: Writes a mutated one to a path, from the bytes of a right one.
    """

    name: str
    seed: Callable[[Path], Any]
    take: Callable[[Path], Any]
    mutate: Callable[[Path, bytes, np.random.Generator], Any]


def _mutate_bytes(path: Path, right: bytes, rng: np.random.Generator) -> None:
    path.write_bytes(mutated_bytes(right, rng))


def _mutate_json(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """The tree, or its text."""
    if rng.random() < 0.3:
        _mutate_bytes(path, right, rng)
        return
    tree = mutated(json.loads(right), rng)
    path.write_text(json.dumps(tree, default=repr), encoding="utf-8")


def _mutate_csv(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """A cell, the meta data, or any bytes."""
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


def _mutate_border(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """Its bytes, or its arrays under a checksum that holds."""
    if rng.random() < 0.3:
        _mutate_bytes(path, right, rng)
        return
    with np.load(io.BytesIO(right)) as file:
        arrays = {name: file[name] for name in file.files}
    del arrays["checksum"]
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
    write(path, _Told(json.dumps(header, default=repr)), arrays)  # type: ignore[arg-type]


class _Told(str):
    """A header of any content."""

    def model_dump_json(self) -> str:
        """The text itself."""
        return self


def _write_zip(path: Path, urdf: bytes = _URDF.encode(), name: str = "robot/r.urdf") -> None:
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr(name, urdf)
        archive.writestr("robot/a.stl", b"solid a\nendsolid a\n")


def _mutate_zip(path: Path, right: bytes, rng: np.random.Generator) -> None:
    """Its URDF, the name of its URDF, or its bytes."""
    choice = rng.random()
    if choice < 0.6:
        _write_zip(path, mutated_bytes(_URDF.encode(), rng))
    elif choice < 0.7:
        name = mutated_bytes(b"robot/r.urdf", rng).decode("utf-8", "replace")[:60_000]
        _write_zip(path, name=name + ".urdf")
    else:
        _mutate_bytes(path, right, rng)


def _border(path: Path) -> None:
    """A small border in the form of a cache."""
    points = np.random.default_rng(0).integers(0, 500, (60, 3)).astype(np.int16)
    pair = Pair("lm", "lEE")
    distances = np.arange(60, dtype=np.uint16)
    pairs = LinkPairs((pair,), (), (), {pair.name: 0.1}, {pair.name: 0.0}, 10, 0)
    content = Content(pairs, {pair.name: make_cloud(pair.name, points, distances)})
    write(path, *pack(content, "0" * 32))


def _log(path: Path) -> None:
    trace_of(random_snapshots(2, 12)).write(path)


def _figures(path: Path) -> None:
    as_json(key_numbers(read_trace(path)))


def _case(path: Path) -> None:
    case = Case(
        study_seed=0,
        number=1,
        kind="front",
        redraws=0,
        robot="husky_panda",
        controller="dbb",
        physics="kinematic",
        start=(0.9, 0.0, 0.8),
        move=(-0.4, 0.0, 0.0),
        q_m=(0.0, -0.5, 0.0, -2.0, 0.0, 1.5, 0.7),
        moving=0.5,
        release_at=None,
        regrasp_at=None,
        base_delay=0.01,
        encoder_noise=0.0,
        seed=3,
        speed=0.2,
        duration=2.0,
        mass_error=0.0,
        slip=0.0,
        v_max=0.5,
        hand_f_max=40.0,
        hand_stiffness=300.0,
        hand_mass=2.0,
    )
    path.write_text(case.model_dump_json(), encoding="utf-8")


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
    "case": Kind(
        "case.json",
        _case,
        lambda path: (lambda case: (case.scenario(), case.config()))(read_case(path)),
        _mutate_json,
    ),
    "log csv": Kind("a.csv", _log, _figures, _mutate_csv),
    "log parquet": Kind("a.parquet", _log, _figures, _mutate_bytes),
    "border": Kind(
        "a.npz", _border, partial(read, unpack=partial(unpack, key="0" * 32)), _mutate_border
    ),
    "zip": Kind("a.zip", _write_zip, look_into, _mutate_zip),
}


class Outcome(NamedTuple):
    """What became of one file.

    Attributes:
        result: `right`, `line` or `finding`.
        text: Of a finding, what came instead of a line.
    """

    result: str
    text: str = ""


def fuzz_files(
    seconds: float, seed: int, keep: Path, on_progress: Callable[[float], None]
) -> dict[str, Any]:
    """Mutate files of all kinds in turn; figures of each kind.

    Args:
        seconds: [s] for all of them, beside the starts of the process that reads.
        seed: Of the mutations; file k of a kind follows from it alone.
        keep: Folder for the files of findings.
        on_progress: Called with the time that has gone [s].
    """
    tally = {name: Counter[str]() for name in KINDS}
    findings: dict[str, str] = {}
    spent, k = 0.0, 0
    while spent < seconds:
        here, there = SPAWN.Pipe()
        with tempfile.TemporaryDirectory() as folder:
            process = SPAWN.Process(target=_take_many, args=(there, seed, Path(folder)))
            with starting_children():
                process.start()
            there.close()
            _answered(here, _STARTING)
            text = ""
            while spent < seconds and not text:
                name = list(KINDS)[k % len(KINDS)]
                begin = time.monotonic()
                here.send((name, k))
                result, text, ended = *_answered(here, _LONGEST + 5.0), not process.is_alive()
                tally[name][result] += 1
                if text and f"{name}: {text}" not in findings:
                    findings[f"{name}: {text}"] = _kept(Path(folder) / KINDS[name].name, keep, k)
                text = text if ended else ""
                k += 1
                spent += time.monotonic() - begin
                on_progress(spent)
            process.kill()
            process.join()
    return {**{name: dict(counts) for name, counts in tally.items()}, "findings": findings}


def _answered(connection: Connection, patience: float) -> Outcome:
    """What the process that reads says, or that it says nothing."""
    try:
        if connection.poll(patience):
            return connection.recv()
    except EOFError:
        return Outcome("finding", "the process that reads has ended")
    return Outcome("finding", "the process that reads hangs")


def _kept(path: Path, keep: Path, k: int) -> str:
    """A copy of a file beside those of other findings; its name."""
    keep.mkdir(parents=True, exist_ok=True)
    copy = keep / f"{k}-{path.name}"
    copy.write_bytes(path.read_bytes() if path.exists() else b"")
    return str(copy)


def _take_many(connection: Connection, seed: int, folder: Path) -> None:
    """Main function of the process that reads: file k of a kind at a time, as it is asked."""
    follow_parent()
    resource.setrlimit(resource.RLIMIT_AS, (_MEMORY, _MEMORY))
    signal.signal(signal.SIGALRM, _too_long)
    right = {}
    for name, kind in KINDS.items():
        path = folder / f"right-{kind.name}"
        kind.seed(path)
        kind.take(path)
        right[name] = path.read_bytes()
    connection.send(Outcome("right"))
    while True:
        name, k = connection.recv()
        kind = KINDS[name]
        kind.mutate(folder / kind.name, right[name], np.random.default_rng([seed, k]))
        connection.send(_outcome(kind, folder / kind.name))


def _outcome(kind: Kind, path: Path) -> Outcome:
    signal.setitimer(signal.ITIMER_REAL, _LONGEST)
    try:
        kind.take(path)
    except (DbbError, DamagedFileError) as error:
        if "\n" in str(error):
            return Outcome("finding", f"more than one line: {type(error).__name__}")
        return Outcome("line")
    except BaseException as error:  # whatever it is, it is a finding
        place = error.__traceback__
        while place is not None and place.tb_next is not None:
            place = place.tb_next
        where = "" if place is None else f" at {place.tb_frame.f_code.co_name}"
        return Outcome("finding", f"{type(error).__name__}: {str(error)[:120]}{where}")
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0.0)
    return Outcome("right")


def _too_long(*_: object) -> None:
    raise TimeoutError(f"longer than {_LONGEST:g} s")
