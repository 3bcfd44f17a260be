"""A broken or huge file or a full disk gives one line of error and leaves no partial file."""

from __future__ import annotations

import json
import re
import resource
import shutil
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import trimesh

from app.border.cache import DamagedFileError, read
from app.cli.main import main
from app.cli.options import make_folder
from app.config_file import decode_config
from app.dashboard.robots import robot_entries
from app.errors import (
    AssetError,
    CaseError,
    ConfigError,
    DescriptionError,
    LogError,
    OutputError,
    RobotFileError,
)
from app.jobs.bounded import SMALL, Budget, within_budget
from app.onboarding.new_robot import finish
from app.onboarding.read.links import is_foreign
from app.onboarding.request import Request
from app.robot.assets import ASSETS, refuse_entities
from app.robot.description import load_description, load_robot
from app.robot.model import RobotModel
from app.robot.shapes import ConvexMesh
from app.simulation.case import read_case
from app.simulation.plants.collision_shapes import collision_shapes
from app.simulation.trace import log_file
from app.simulation.trace.arrow import read_arrow
from app.simulation.trace.log_file import read_trace, write_trace
from app.strict import LARGEST_DATA, file_text, from_toml, parsed
from app.studies.run_report import key_numbers
from app.system import write_whole
from tests.logs import random_snapshots, trace_of
from tests.onboarding import arm, cart, with_mesh, write
from tests.onboarding import robot as toy

pytestmark = pytest.mark.budget

PROJECT = Path(__file__).resolve().parent.parent
HOSTILE = {
    "deep": "[" * 100_000 + "]" * 100_000,
    "long": "9" * 5000,
    "hexadecimal": "0x" + "9" * 9000,
}
"""Values for which parsers of TOML or JSON raise errors outside their own classes."""


@pytest.mark.parametrize("value", HOSTILE.values(), ids=HOSTILE)
def test_hostile_values_in_description_case_and_configuration_are_refused(value, tmp_path):
    path = tmp_path / "any"
    good = (ASSETS / "husky_panda" / "robot.toml").read_text(encoding="utf-8")
    assert "mass_kg = 60.0" in good
    path.write_text(good.replace("mass_kg = 60.0", f"mass_kg = {value}"), encoding="utf-8")
    with pytest.raises(DescriptionError, match=str(path)):
        load_description(path)
    path.write_text(f'{{"dbb_case": 1, "seed": {value}}}', encoding="utf-8")
    with pytest.raises(CaseError, match=str(path)):
        read_case(path)
    with pytest.raises(ConfigError):
        decode_config(f"[border]\nd_b = {value}"[:60_000].encode())


def test_huge_text_file_is_refused(tmp_path):
    long = tmp_path / "robot.toml"
    long.write_bytes(b" " * 10_000_001)
    with pytest.raises(ValueError, match="more than"):
        file_text(long)


def test_plain_array_is_refused_as_a_border_file(tmp_path):
    path = tmp_path / "border.npz"
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(DamagedFileError):
        read(path, lambda arrays: arrays)


def test_list_reports_a_broken_robot_and_shows_the_others(monkeypatch, tmp_path, capsys):
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "robot.toml").write_text("name = ", encoding="utf-8")
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    main(["robots"])
    printed = capsys.readouterr().out
    assert "\nhusky_panda " in printed
    assert "\nbroken               cannot be used: " in printed


def test_control_characters_in_names_are_escaped_on_the_terminal(monkeypatch, tmp_path, capsys):
    mine = tmp_path / "mine"
    shutil.copytree(ASSETS / "husky_panda", mine)
    text = (mine / "robot.toml").read_text(encoding="utf-8")
    text = re.sub('title = ".*"', r'title = "\\u001b]0;owned\\u0007\\u202e"', text)
    (mine / "robot.toml").write_text(text.replace('"husky_panda"', '"mine"'), encoding="utf-8")
    (tmp_path / "\x1b[2J").mkdir()
    (tmp_path / "\x1b[2J" / "robot.toml").touch()
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    main(["robots"])
    printed = capsys.readouterr().out
    assert r"\x1b]0;owned\x07\u202e" in printed
    assert r"\x1b[2J" in printed
    assert all(c.isprintable() or c == "\n" for c in printed)


def test_report_that_is_a_symbolic_link_is_ignored(monkeypatch, tmp_path):
    shutil.copytree(ASSETS / "husky_panda", tmp_path / "mine")
    (tmp_path / "secret").touch()
    (tmp_path / "mine" / "report.html").symlink_to(tmp_path / "secret")
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    (mine,) = [each for each in robot_entries() if each.name == "mine"]
    assert not mine.report


def test_robot_with_more_than_200_joints_is_refused_before_modelling(monkeypatch, tmp_path):
    """For a chain of 500 joints, pinocchio's model takes half a minute and gigabytes."""
    mine = tmp_path / "mine"
    shutil.copytree(ASSETS / "husky_panda", mine)
    joints = "".join(f'<joint name="j{k}" type="revolute"/>' for k in range(201))
    (mine / "robot.urdf").write_text(f"<robot>{joints}</robot>")
    text = (mine / "robot.toml").read_text(encoding="utf-8")
    (mine / "robot.toml").write_text(text.replace('"husky_panda"', '"mine"'), encoding="utf-8")
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    (entry,) = [each for each in robot_entries() if each.name == "mine"]
    assert "201 moving joints; the limit is 200" in str(entry.problem)


@pytest.mark.parametrize(
    "urdf",
    [
        b"\xff\xfe",
        b"<robot",
        b"<!DOCTYPE r [<!ENTITY a 'b'>]><robot name='&a;'/>",
        b"<a>" * 200 + b"</a>" * 200,
        b"<robot a:b:c='1'/>",
    ],
    ids=["no text", "no XML", "entity", "depth", "colons"],
)
def test_page_reports_the_fault_of_a_broken_urdf(urdf, monkeypatch, tmp_path):
    good = (ASSETS / "husky_panda" / "robot.toml").read_text(encoding="utf-8")
    mine = good.replace('"husky_panda"', '"broken"').replace("robot.urdf", "mine.urdf")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken" / "robot.toml").write_text(mine, encoding="utf-8")
    (tmp_path / "broken" / "mine.urdf").write_bytes(urdf)
    monkeypatch.setenv("DBB_ROBOTS", str(tmp_path))
    entries = {entry.name: entry for entry in robot_entries()}
    assert entries["husky_panda"].problem is None
    assert entries["broken"].own
    assert "mine.urdf: " in str(entries["broken"].problem)


def test_replacing_a_file_is_atomic(tmp_path):
    path = tmp_path / "page.html"
    write_whole(path, "old")
    with full_disk(), pytest.raises(OutputError, match=r"page\.html: File too large"):
        write_whole(path, b"new" * 1000)
    assert path.read_text() == "old"
    write_whole(path, "new")
    assert [each.name for each in tmp_path.iterdir()] == ["page.html"]
    assert path.read_text() == "new"


def test_same_folder_can_be_made_concurrently(tmp_path):
    with ThreadPoolExecutor(8) as threads:
        assert list(threads.map(make_folder, [tmp_path / "out"] * 400)) == [None] * 400
    assert list((tmp_path / "out").iterdir()) == []


def test_full_disk_gives_one_line_and_leaves_no_page(tmp_path, capsys, monkeypatch):
    log, page = tmp_path / "log.csv", tmp_path / "page.html"
    write_trace(log, trace_of(random_snapshots(2, 12)))
    monkeypatch.setattr("app.studies.run_report.run_report", lambda _: "a long page" * 1000)
    with full_disk(), pytest.raises(SystemExit) as end:
        main(["report", str(log), "--out", str(page)])
    assert end.value.code == 2
    assert capsys.readouterr().err == f"dbb: error: cannot write {page}: File too large\n"
    assert [each.name for each in tmp_path.iterdir()] == ["log.csv"]


@pytest.mark.parametrize("cut", [1, 2])
def test_a_log_without_rows_is_refused(cut, tmp_path, capsys):
    log = tmp_path / "log.csv"
    write_trace(log, trace_of(random_snapshots(2, 3)))
    lines = log.read_text(encoding="utf-8").splitlines(keepends=True)
    log.write_text("".join(lines[:cut]).replace('"rows":3', '"rows":1'), encoding="utf-8")
    with pytest.raises(SystemExit) as end:
        main(["report", str(log), "--out", str(tmp_path / "page.html")])
    assert end.value.code == 2
    assert capsys.readouterr().err.startswith(f"dbb: error: {log}: ")


def test_log_with_doubled_axes_or_a_broken_column_name_gives_one_line(tmp_path):
    path = tmp_path / "log.csv"
    write_trace(path, trace_of(random_snapshots(2, 3)))
    right = path.read_text(encoding="utf-8")
    axes = json.dumps(read_trace(path).meta.velocities, separators=(",", ":"))
    twice = right.replace(axes, f"{axes[:-1]},{axes[1:]}", 1)
    broken = right.replace('"t_s"', '"t\ns"', 1)
    for text in (twice, broken):
        assert text != right
        path.write_text(text, encoding="utf-8")
        with pytest.raises(LogError) as refused:
            read_trace(path)
        assert len(str(refused.value).splitlines()) == 1


def test_log_with_a_column_name_outside_utf8_is_refused(tmp_path):
    path = tmp_path / "log.csv"
    write_trace(path, trace_of(random_snapshots(2, 3)))
    path.write_bytes(path.read_bytes().replace(b'"t_s"', b'"t\xff_s"', 1))
    with pytest.raises(LogError, match=r"log\.csv: .*UTF-8"):
        read_trace(path)


def expanding(path: Path, rows: int) -> Path:
    """A log of many rows, all drawn, whose file stores one number per column."""
    write_trace(path, trace_of(random_snapshots(2, 2)))
    table = pq.read_table(path).slice(0, 1)
    once, columns = pa.array(np.zeros(rows, np.int8)), {}
    for name in table.column_names:
        (cell,) = (column := table[name].combine_chunks()).to_pylist()
        dictionary = pa.DictionaryArray.from_arrays(once, column) if cell is not None else None
        columns[name] = pa.nulls(rows, column.type) if dictionary is None else dictionary
    header = table.schema.metadata[b"dbb_log"]
    header = re.sub(rb'"rows":\d+', b'"rows":%d' % rows, header)
    pq.write_table(pa.table(columns, metadata={b"dbb_log": header}), path)
    return path


def equal(path: Path) -> Path:
    """A file that is small enough to be read in this process, but takes 400 MB in memory."""
    table = pa.table({"t_s": pa.array(np.zeros(5 * 10**6))})
    with pq.ParquetWriter(path, table.schema, max_rows_per_page=10**8) as writer:
        for _ in range(10):
            writer.write_table(table)
    assert path.stat().st_size < SMALL
    return path


BUDGET = "to read, more than any valid file"
DEEP = f"{BUDGET}|nest too deeply"  # the first limit that is reached depends on Python's version
EXPANDING: dict[str, tuple[Callable[[Path], object], str]] = {
    "a key of many parts": (lambda _: from_toml("a" + ".b" * 30_000 + " = 1"), DEEP),
    "long tables": (
        lambda _: from_toml("".join(f"[a{'.b' * 30_000}{k}]\n" for k in range(9))),
        DEEP,
    ),
    "rows of a log": (lambda at: read_trace(expanding(at / "a.parquet", 300_000)), BUDGET),
    "many equal rows": (lambda at: read_trace(equal(at / "a.parquet")), BUDGET),
    "rows that are drawn": (
        lambda at: read_trace(expanding(at / "a.parquet", 22_000)),
        "22000 snapshots are too many",
    ),
}


def test_rows_that_are_not_drawn_count_towards_the_budget(tmp_path, monkeypatch):
    monkeypatch.setattr(log_file, "_CELL", 1e-9)
    write_trace(tmp_path / "a.csv", trace_of(random_snapshots(2, 3)))
    read = read_arrow(tmp_path / "a.csv")
    log_file._trace(*read, Budget(1.0, 10_000))
    with pytest.raises(LogError, match="3 rows are too many"):
        log_file._trace(*read, Budget(1.0, 1000))


def test_too_many_problems_are_not_listed(tmp_path):
    path = tmp_path / "robot.toml"
    hull = '[[bodies]]\n[[bodies.shapes]]\ntype = "hull"\nvertices_m = ['
    path.write_text(f"{hull}{'0,' * 2000}]")
    with pytest.raises(DescriptionError, match="wrong values, too many to list"):
        load_description(path)
    with pytest.raises(LogError, match="too many to list"):
        log_file.LogHeader.read('{"dbb_log": {"pairs": [' + "1," * 2000 + '1]}, "rows": 1}')
    with pytest.raises(LogError, match="the metadata are too long for a log"):
        log_file.LogHeader.read(" " * (LARGEST_DATA + 1))


@pytest.mark.parametrize("read", [from_toml, partial(parsed, json.loads)])
def test_toml_and_json_over_1_mb_are_refused(read):
    with pytest.raises(ValueError, match="more than 1 MB"):
        read(" " * (LARGEST_DATA + 1))


def test_mesh_of_a_shape_is_read_within_its_budget(tmp_path, monkeypatch):
    mesh = tmp_path / "a.stl"
    trimesh.creation.icosphere(6).export(mesh)
    monkeypatch.setattr("app.robot.shapes.resolve_package_uri", lambda _: mesh)
    shape = ConvexMesh(type="convex_mesh", file="package://a/a.stl", scale=(1.0, 1.0, 2.0))
    assert shape.hull().extents == pytest.approx([2.0, 2.0, 4.0])
    monkeypatch.setattr("app.jobs.bounded.Budget.of", lambda _: Budget(1.0, 10**7))
    with pytest.raises(AssetError, match=f"package://a/a.stl: .*{BUDGET}"):
        shape.hull()


def make_toy(at: Path) -> None:
    trimesh.creation.icosphere(7).export(at / "a.stl")
    urdf = write(at, with_mesh(toy([*cart(), *arm()]), "a.stl"))
    finish(Request(urdf=str(urdf), base="base", tip="hand", out=at / "made"))


@pytest.mark.parametrize(
    "read",
    [make_toy, lambda _: collision_shapes(RobotModel(load_robot("husky_panda")))],
    ids=["of new-robot", "of the engines"],
)
def test_meshes_of_an_untrusted_robot_share_a_budget(read, tmp_path, monkeypatch):
    monkeypatch.setattr("app.simulation.plants.collision_shapes.is_own", lambda _: True)
    monkeypatch.setattr("app.jobs.bounded.Budget.of", lambda _: Budget(9.0, 5 * 10**6))
    with pytest.raises(RobotFileError, match=f"its meshes: .*{BUDGET}"):
        read(tmp_path)


SLOW = {
    "a decimal comma before blanks": (
        from_toml,
        "a = 1,1" + " " * 60_000 + "x",
        "Expected newline",
    ),
    "one in JSON": (partial(parsed, json.loads), "[:1,1" + " " * 60_000 + "x", "Expecting value"),
}
"""Texts in which the search for the fault is slow; each with its parser and message."""


@pytest.mark.parametrize(("read", "text", "why"), SLOW.values(), ids=SLOW)
def test_fault_of_a_text_is_found_within_its_budget(read, text, why):
    with pytest.raises(ValueError, match=why):
        within_budget(read, text, size=SMALL + 1)


def test_unit_of_a_mesh_is_found_within_its_budget(tmp_path):
    path = tmp_path / "a.dae"
    path.write_bytes(b"<unit " * 20_000)
    assert within_budget(is_foreign, path, size=SMALL + 1)


@pytest.mark.parametrize(("read", "why"), EXPANDING.values(), ids=EXPANDING)
def test_data_that_expands_is_refused_within_its_budget(read, why, tmp_path):
    with pytest.raises((ValueError, LogError), match=why):
        read(tmp_path)


@pytest.mark.parametrize("speeds", ["[1.0]", "[0,0,0,0,0,0,0]", "[NaN,1,1,1,1,1,1]"])
def test_log_with_invalid_joint_speeds_is_refused(speeds, tmp_path):
    path = tmp_path / "log.csv"
    write_trace(path, trace_of(random_snapshots(2, 3)))
    right = path.read_text(encoding="utf-8")
    path.write_text(re.sub(r'"joint_speeds":\[[^]]*\]', f'"joint_speeds":{speeds}', right, count=1))
    with pytest.raises(LogError, match="joint_speeds"):
        read_trace(path)


def test_report_has_no_path_length_for_an_infinite_position(tmp_path):
    path = tmp_path / "log.csv"
    write_trace(path, trace_of(random_snapshots(2, 3)))
    head, names, first, *rest = path.read_text(encoding="utf-8").split("\n")
    column, cells = names.split(",").index('"base_x_m"'), first.split(",")
    cells[column] = "-1e999"
    path.write_text("\n".join([head, names, ",".join(cells), *rest]), encoding="utf-8")
    figures = key_numbers(read_trace(path))
    assert figures["base_path_m"] is None
    json.dumps(figures, allow_nan=False)


XML: dict[str, Callable[[int], str]] = {
    "elements": lambda n: "<robot>" + "<a/>" * n + "</robot>",
    "depth": lambda n: "<a>" * n + "</a>" * n,
    "attributes": lambda n: "<a " + " ".join(f"a{k}='x'" for k in range(n)) + "/>",
}


@pytest.mark.parametrize(
    ("kind", "most"), [("elements", 29_999), ("depth", 100), ("attributes", 100)]
)
def test_xml_beyond_the_limits_of_size_and_depth_is_refused(kind, most):
    refuse_entities(XML[kind](most), Path("robot.urdf"))
    with pytest.raises(RobotFileError, match="more than"):
        refuse_entities(XML[kind](most + 1), Path("robot.urdf"))


@contextmanager
def full_disk() -> Iterator[None]:
    """Limit files to 1,000 bytes, as on a full disk."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
