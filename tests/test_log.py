"""Logs return the written content; damaged logs are rejected."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import fields, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from app.border.cache import BorderData
from app.config import Config
from app.errors import LogError, OutputError
from app.robot.model import RobotModel
from app.simulation.run import run_scenario
from app.simulation.scenarios import scenario_by_name
from app.simulation.trace.columns import number
from app.simulation.trace.log_file import read_trace, write_trace
from app.simulation.trace.snapshot import QUANTITIES, Snapshot
from tests.logs import difference, random_snapshots, trace_of

FORMATS = ("csv", "parquet")
NOT_LOGGED = ("run", "busy", "refusal", "explanation", "case", "changing")
CONSTANT = ("physics", "seed")  # logged once, in the data of the run


@pytest.mark.parametrize("ending", FORMATS)
@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6))
def test_log_round_trip_preserves_content(tmp_path, ending, seed, count):
    snapshots = random_snapshots(seed, count)
    path = tmp_path / f"log.{ending}"
    write_trace(path, trace_of(snapshots))
    log = read_trace(path)
    assert log.meta == trace_of(snapshots).meta
    assert difference(log.snapshots, tuple(snapshots)) == ""
    assert not log.snapshots[0].q_m.flags.writeable


@pytest.mark.parametrize("ending", FORMATS)
def test_same_snapshots_give_identical_bytes(tmp_path, ending):
    snapshots = random_snapshots(1, 20)
    files = [tmp_path / f"{name}.{ending}" for name in "ab"]
    for file in files:
        write_trace(file, trace_of(snapshots))
    assert files[0].read_bytes() == files[1].read_bytes()


def test_difference_detects_a_single_bit():
    a, b = random_snapshots(3, 1)[0], random_snapshots(3, 1)[0]
    assert difference(a, b) == ""
    q = b.q_m.copy()
    q[6] = np.nextafter(q[6], 1e300)
    object.__setattr__(b, "q_m", q)
    assert difference(a, b).startswith(".q_m")


def test_every_snapshot_field_is_logged_or_listed_as_not_logged():
    assert sorted([*QUANTITIES, *NOT_LOGGED, *CONSTANT]) == sorted(f.name for f in fields(Snapshot))


@pytest.fixture(scope="module")
def taken(robot: RobotModel, border_data: BorderData):
    """One second of a pull that enters the buffer."""
    scenario = scenario_by_name("guiding-front").changed(duration=1.0)
    run = (robot, border_data, scenario, Config())
    return run_scenario(*run, physics="kinematic", seed=5, drawn=True).trace


@pytest.mark.slow
@pytest.mark.parametrize("ending", FORMATS)
def test_run_log_has_every_step_and_50_snapshots_per_second(taken, tmp_path, ending):
    path = tmp_path / f"run.{ending}"
    write_trace(path, taken)
    log = read_trace(path)
    np.testing.assert_array_equal(log.table, taken.table)
    np.testing.assert_allclose(log.t, np.arange(1000) * 0.001, atol=1e-9)
    assert difference(log.meta, taken.meta) == ""
    default = {f.name: f.default for f in fields(Snapshot) if f.name in NOT_LOGGED}
    kept = tuple(replace(s, **default) for s in taken.snapshots)
    assert difference(log.snapshots, kept) == ""
    np.testing.assert_allclose([s.t for s in log.snapshots], np.arange(50) * 0.02, atol=1e-9)
    assert (log.meta.scenario, log.meta.physics, log.meta.seed) == ("guiding-front", "kinematic", 5)
    assert max(s.beta_m for s in log.snapshots) > 0.1
    assert any(s.acting for s in log.snapshots)
    assert log.at(0.431).t == pytest.approx(0.44)


def test_snapshots_of_a_run_name_their_scenario(taken):
    assert {(s.scenario, s.scenario_ends) for s in taken.snapshots} == {("guiding-front", 1.0)}
    assert np.isnan([s.step_time_us for s in taken.snapshots]).all()


def test_trace_rejects_unordered_inconsistent_or_no_snapshots():
    a, b = random_snapshots(4, 2)
    with pytest.raises(LogError, match="follows one at"):
        trace_of([b, a])
    with pytest.raises(LogError, match="no snapshots"):
        trace_of([])
    object.__setattr__(b, "pairs", b.pairs[1:])
    with pytest.raises(LogError, match="link pairs"):
        trace_of([a, b])


def test_error_names_an_invalid_log_path(tmp_path):
    snapshots = random_snapshots(5, 1)
    with pytest.raises(LogError, match=r"log\.xlsx: a log ends in \.csv or \.parquet"):
        write_trace(tmp_path / "log.xlsx", trace_of(snapshots))
    with pytest.raises(OutputError, match="cannot write"):
        write_trace(tmp_path / "none" / "log.csv", trace_of(snapshots))
    with pytest.raises(LogError, match="no such file"):
        read_trace(tmp_path / "log.csv")


@pytest.fixture
def csv_lines(tmp_path):
    """The lines of a valid CSV, and a function that writes and reads changed lines."""
    snapshots = random_snapshots(6, 4)
    path = tmp_path / "log.csv"
    write_trace(path, trace_of(snapshots))

    def read(lines: list[str]):
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return read_trace(path)

    return path.read_text(encoding="utf-8").splitlines(), read


def changed_header(line: str, change) -> str:
    data = json.loads(line[2:])
    change(data)
    return "# " + json.dumps(data)


def test_error_explains_a_damaged_csv(csv_lines):
    lines, read = csv_lines
    head, names, *rows = lines
    assert len(read(lines).snapshots) == 4
    for broken, words in (
        (lines[1:], "first line is not a metadata comment"),
        (["# {}", *lines[1:]], "no metadata"),
        (["# {", *lines[1:]], "no metadata"),
        (["# " + "[" * 100_000, *lines[1:]], "no metadata"),
        ([head, names, *rows[:2]], "the file has 2 rows, but its metadata state 4"),
        ([head, names, *rows[:3], rows[3][:40]], "damaged"),
        ([head, names, rows[1], rows[0], *rows[2:]], "not in order"),
        (
            [head, names.replace("base_x_m", "base_y"), *rows],
            "unknown column 'base_y'.*newer version",
        ),
        ([head, names.replace('"base_x_m"', '"base_x_ft"'), *rows], "did you mean 'base_x_m'"),
        ([head, names, "x" + rows[0], *rows[1:]], "column t_s"),
    ):
        with pytest.raises(LogError, match=words) as caught:
            read(broken)
        assert "log.csv" in str(caught.value)
        assert "\n" not in str(caught.value)


def test_error_names_missing_columns_and_empty_cells(csv_lines):
    (head, names, *rows), read = csv_lines
    with pytest.raises(LogError, match="column 't_s' is missing"):
        read([head, *(line.partition(",")[2] for line in (names, *rows))])
    with pytest.raises(LogError, match="column 't_s' appears twice"):
        read([head, *(f"{line},{line.partition(',')[0]}" for line in (names, *rows))])
    cells = rows[1].split(",")
    cells[1] = ""
    with pytest.raises(LogError, match=r"column base_x_m: \d+ cells have a value"):
        read([head, names, rows[0], ",".join(cells), *rows[2:]])


def test_missing_newer_quantity_gets_its_default(csv_lines):
    (head, names, *rows), read = csv_lines
    k = names.replace('"', "").split(",").index("activation")
    lines = list(csv.reader([names, *rows]))
    text = io.StringIO()
    csv.writer(text, lineterminator="\n").writerows(line[:k] + line[k + 1 :] for line in lines)
    trace = read([head, *text.getvalue().splitlines()])
    assert {snapshot.activation for snapshot in trace.snapshots} == {0.0}


def test_metadata_are_checked_field_by_field(csv_lines):
    (head, *rest), read = csv_lines
    for change, words in (
        (lambda d: d["dbb_log"].update(robto="x"), "robto: unknown field .did you mean 'robot'"),
        (lambda d: d["dbb_log"].update(format=3), "format is 3, .* reads 2; a newer version"),
        (lambda d: d["dbb_log"].update(format=1), "format is 1, .* reads 2; an older version"),
        (lambda d: d["dbb_log"].update(format=1, old=0), "format is 1, .*; an older version"),
        (lambda d: d["dbb_log"].update(format="x"), "format: Input should be 2"),
        (lambda d: d["dbb_log"].pop("joints"), "joints: missing"),
        (lambda d: d["dbb_log"]["config"]["border"].update(d_b=9.0), r"config\.border\.d_b"),
        (lambda d: d["dbb_log"]["joint_units"].pop(), "joint_units"),
        (lambda d: d["dbb_log"]["mobile_pairs"].append("x"), "mobile_pairs"),
        (lambda d: d.update(rows=True), "rows"),
    ):
        with pytest.raises(LogError, match=words):
            read([changed_header(head, change), *rest])


def test_parameter_changes_out_of_range_are_rejected(tmp_path):
    first, *others = random_snapshots(8, 12)
    path = tmp_path / "log.csv"
    write_trace(path, trace_of([replace(first, config=Config()), *others]))
    text = path.read_text(encoding="utf-8")
    assert '""border.d_b"": 0.2' in text
    path.write_text(text.replace('""border.d_b"": 0.2', '""border.d_b"": 7.2'), encoding="utf-8")
    with pytest.raises(LogError, match=r"config_changes: border\.d_b"):
        read_trace(path)


def test_damaged_parquet_is_rejected_or_has_the_same_content(tmp_path):
    snapshots = random_snapshots(9, 30)
    path = tmp_path / "log.parquet"
    write_trace(path, trace_of(snapshots))
    whole = path.read_bytes()
    for at in np.linspace(4, len(whole) - 9, 60).astype(int):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            log = read_trace(path)
        except LogError:
            continue
        # The other bytes are names and statistics that no reader uses.
        assert difference(log.snapshots, tuple(snapshots)) == ""
    for end in (0, 3, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:end])
        with pytest.raises(LogError):
            read_trace(path)


def test_other_parquet_file_is_rejected(tmp_path):
    import pyarrow as pa

    path = Path(tmp_path) / "log.parquet"
    pq.write_table(pa.table({"t_s": [0.0]}), path)
    with pytest.raises(LogError, match="no metadata of a log"):
        read_trace(path)


@pytest.mark.parametrize("source", [None, lambda step, observation: 0.0])
def test_a_quantity_of_each_control_step_has_an_attribute_or_one_number(source: object) -> None:
    template = "x_m" if source is None else "x_{xyz}_m"
    with pytest.raises(ValueError, match="attribute of `Step`"):
        number(template, source)  # type: ignore[arg-type]
