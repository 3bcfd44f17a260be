"""Logs: what is read is what was written, and nothing damaged is believed."""

from __future__ import annotations

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
from app.simulation.scenarios.names import scenario_by_name
from app.simulation.trace.log import LogTable, read_log, write_log
from app.simulation.trace.log_columns import NOT_LOGGED, parts
from app.simulation.trace.run_log import RunLog
from app.simulation.trace.snapshot import Snapshot
from app.simulation.trace.tape import Tape
from tests.logs import difference, meta_of, random_snapshots

FORMATS = ("csv", "parquet")
UNITS = ("_s", "_m", "_rad", "_nm", "_n", "_us", "_mps", "_radps", "_mps2", "_radps2")
WITHOUT_UNIT = ("beta_", "q_ee_", "buffer_too_small")


@pytest.mark.parametrize("ending", FORMATS)
@settings(
    max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(1, 6))
def test_a_log_that_is_read_is_the_one_that_was_written(tmp_path, ending, seed, count):
    snapshots = random_snapshots(seed, count)
    path = tmp_path / f"log.{ending}"
    write_log(path, snapshots, meta_of(snapshots))
    log = read_log(path)
    assert log.meta == meta_of(snapshots)
    assert difference(log.snapshots, tuple(snapshots)) == ""
    assert not log.snapshots[0].q_m.flags.writeable


@pytest.mark.parametrize("ending", FORMATS)
def test_the_same_snapshots_give_the_same_bytes(tmp_path, ending):
    snapshots = random_snapshots(1, 20)
    files = [tmp_path / f"{name}.{ending}" for name in "ab"]
    for file in files:
        write_log(file, snapshots, meta_of(snapshots))
    assert files[0].read_bytes() == files[1].read_bytes()


def test_the_comparison_of_these_tests_sees_a_single_bit():
    a, b = random_snapshots(3, 1)[0], random_snapshots(3, 1)[0]
    assert difference(a, b) == ""
    q = b.q_m.copy()
    q[6] = np.nextafter(q[6], 1e300)
    object.__setattr__(b, "q_m", q)
    assert difference(a, b).startswith(".q_m")


def test_every_field_is_logged_or_said_not_to_be():
    logged = [part.field for part in parts(meta_of(random_snapshots(0, 1)))]
    assert sorted([*logged, *NOT_LOGGED]) == sorted(f.name for f in fields(Snapshot))


def test_columns_of_numbers_end_in_their_unit():
    columns = [column for part in parts(meta_of(random_snapshots(0, 1))) for column in part.columns]
    assert len({column.name for column in columns}) == len(columns)
    for column in columns:
        if column.kind == "float" and not column.name.startswith(WITHOUT_UNIT):
            assert column.name.endswith((*UNITS, "realtime_factor", "speed")), column.name


@pytest.fixture(scope="module")
def taken(robot: RobotModel, border_data: BorderData):
    """A second of a person's pull that enters the buffer, taken while it ran."""
    scenario = scenario_by_name("guiding-front").changed(duration=1.0)
    log, seen = RunLog(robot, scenario, "kinematic", 5), []
    tape = Tape(seen.append, scenario)

    def on_step(session, step):
        log.add(session, step)
        tape.add(session, step)

    run_scenario(
        robot, border_data, scenario, Config(), physics="kinematic", seed=5, on_step=on_step
    )
    return log, seen


@pytest.mark.slow
@pytest.mark.parametrize("ending", FORMATS)
def test_a_run_is_logged_fifty_times_a_second_and_comes_back(taken, tmp_path, ending):
    run_log, seen = taken
    path = tmp_path / f"run.{ending}"
    run_log.write(path)
    log = read_log(path)
    default = {f.name: f.default for f in fields(Snapshot) if f.name in NOT_LOGGED}
    kept = [replace(s, **default) for s in seen]
    assert difference(log.snapshots, tuple(kept)) == ""
    np.testing.assert_allclose([s.t for s in log.snapshots], np.arange(50) * 0.02, atol=1e-9)
    assert (log.meta.scenario, log.meta.physics, log.meta.seed) == ("guiding-front", "kinematic", 5)
    assert max(s.beta_m for s in log.snapshots) > 0.1
    assert any(s.acting for s in log.snapshots)


def test_the_snapshots_of_a_run_say_which_scenario_leads_the_hand(taken):
    assert {(s.scenario, s.scenario_ends) for s in taken[1]} == {("guiding-front", 1.0)}


def test_logs_of_the_same_run_are_the_same_to_the_qp_solvers_last_digits(robot, border_data, taken):
    """Nothing of the wall clock is in them."""
    scenario = scenario_by_name("guiding-front").changed(duration=0.1)
    again: list[Snapshot] = []
    tape = Tape(again.append, scenario)
    first = [s for s in taken[1] if s.t == 0.0]
    run_scenario(
        robot, border_data, scenario, Config(), physics="kinematic", seed=5, on_step=tape.add
    )
    np.testing.assert_allclose(again[0].u_a, first[0].u_a, atol=1e-6)
    assert np.isnan([s.step_time_us for s in again]).all()


def test_snapshots_out_of_order_of_other_pairs_or_none_at_all_are_refused(tmp_path):
    a, b = random_snapshots(4, 2)
    meta = meta_of([a])
    with pytest.raises(LogError, match="follows one at"):
        write_log(tmp_path / "log.csv", [b, a], meta)
    with pytest.raises(LogError, match="no snapshots"):
        LogTable(meta).write(tmp_path / "log.csv")
    object.__setattr__(b, "pairs", b.pairs[1:])
    with pytest.raises(LogError, match="link pairs"):
        write_log(tmp_path / "log.csv", [a, b], meta)
    assert list(tmp_path.iterdir()) == []


def test_an_ending_or_a_folder_that_is_no_good_is_named(tmp_path):
    snapshots = random_snapshots(5, 1)
    with pytest.raises(LogError, match=r"log\.xlsx: a log ends in \.csv or \.parquet"):
        write_log(tmp_path / "log.xlsx", snapshots, meta_of(snapshots))
    with pytest.raises(OutputError, match="cannot write"):
        write_log(tmp_path / "none" / "log.csv", snapshots, meta_of(snapshots))
    with pytest.raises(LogError, match="no such file"):
        read_log(tmp_path / "log.csv")


@pytest.fixture
def csv_lines(tmp_path):
    """A good CSV by its lines, and what writes and reads another."""
    snapshots = random_snapshots(6, 4)
    path = tmp_path / "log.csv"
    write_log(path, snapshots, meta_of(snapshots))

    def read(lines: list[str]):
        path.write_text("\n".join(lines) + "\n", encoding="utf-8")
        return read_log(path)

    return path.read_text(encoding="utf-8").splitlines(), read


def changed_header(line: str, change) -> str:
    data = json.loads(line[2:])
    change(data)
    return "# " + json.dumps(data)


def test_a_csv_that_is_not_a_log_says_what_is_wrong(csv_lines):
    lines, read = csv_lines
    head, names, *rows = lines
    assert len(read(lines).snapshots) == 4
    for broken, words in (
        (lines[1:], "first line is no comment"),
        (["# {}", *lines[1:]], "no meta data"),
        (["# {", *lines[1:]], "no meta data"),
        (["# " + "[" * 100_000, *lines[1:]], "no meta data"),
        ([head, names, *rows[:2]], "it has 2 rows, and its meta data say 4"),
        ([head, names, *rows[:3], rows[3][:40]], "damaged"),
        ([head, names, rows[1], rows[0], *rows[2:]], "not in order"),
        ([head, names.replace("base_x_m", "base_y"), *rows], "unknown column 'base_y'"),
        ([head, names.replace('"base_x_m"', '"base_x_ft"'), *rows], "did you mean 'base_x_m'"),
        ([head, names, "x" + rows[0], *rows[1:]], "column t_s"),
    ):
        with pytest.raises(LogError, match=words) as caught:
            read(broken)
        assert "log.csv" in str(caught.value)
        assert "\n" not in str(caught.value)


def test_a_missing_column_and_an_empty_cell_are_named(csv_lines):
    (head, names, *rows), read = csv_lines
    with pytest.raises(LogError, match="column 't_s' is missing"):
        read([head, *(line.partition(",")[2] for line in (names, *rows))])
    with pytest.raises(LogError, match="column 't_s' is there twice"):
        read([head, *(f"{line},{line.partition(',')[0]}" for line in (names, *rows))])
    cells = rows[1].split(",")
    cells[1] = ""
    with pytest.raises(LogError, match="column base_x_m: 1 cells are empty"):
        read([head, names, rows[0], ",".join(cells), *rows[2:]])


def test_meta_data_are_checked_field_by_field(csv_lines):
    (head, *rest), read = csv_lines
    for change, words in (
        (lambda d: d["dbb_log"].update(robto="x"), "robto: unknown field .did you mean 'robot'"),
        (lambda d: d["dbb_log"].update(format=2), "format"),
        (lambda d: d["dbb_log"].pop("joints"), "joints: missing"),
        (lambda d: d["dbb_log"]["config"]["border"].update(d_b=9.0), r"config\.border\.d_b"),
        (lambda d: d["dbb_log"]["joint_units"].pop(), "joint_units"),
        (lambda d: d["dbb_log"]["mobile_pairs"].append("x"), "mobile_pairs"),
        (lambda d: d.update(rows=True), "rows"),
    ):
        with pytest.raises(LogError, match=words):
            read([changed_header(head, change), *rest])


def test_parameters_of_a_row_out_of_their_range_are_refused(tmp_path):
    snapshots = [s for s in random_snapshots(8, 12) if s.config != Config()]
    path = tmp_path / "log.csv"
    write_log(path, snapshots, meta_of(snapshots).model_copy(update={"config": Config()}))
    text = path.read_text(encoding="utf-8")
    assert '""border.d_b"": 0.2' in text
    path.write_text(text.replace('""border.d_b"": 0.2', '""border.d_b"": 7.2'), encoding="utf-8")
    with pytest.raises(LogError, match=r"config_changes: border\.d_b"):
        read_log(path)


def test_a_parquet_file_with_any_byte_of_its_data_changed_is_not_believed(tmp_path):
    snapshots = random_snapshots(9, 30)
    path = tmp_path / "log.parquet"
    write_log(path, snapshots, meta_of(snapshots))
    whole = path.read_bytes()
    for at in np.linspace(4, len(whole) - 9, 60).astype(int):
        path.write_bytes(whole[:at] + bytes([whole[at] ^ 0xFF]) + whole[at + 1 :])
        try:
            log = read_log(path)
        except LogError:
            continue
        # What is left of the file are names and statistics that nobody reads.
        assert difference(log.snapshots, tuple(snapshots)) == ""
    for end in (0, 3, len(whole) // 2, len(whole) - 1):
        path.write_bytes(whole[:end])
        with pytest.raises(LogError):
            read_log(path)


def test_parquet_of_something_else_is_no_log(tmp_path):
    import pyarrow as pa

    path = Path(tmp_path) / "log.parquet"
    pq.write_table(pa.table({"t_s": [0.0]}), path)
    with pytest.raises(LogError, match="no meta data of a log"):
        read_log(path)
