"""The report of a run has the numbers of the log, and its page needs no other file."""

from __future__ import annotations

import json
import re
from dataclasses import MISSING, fields, replace
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq
import pytest

from app.cli.main import main
from app.config import Config
from app.errors import LogError
from app.simulation.trace.log_file import read_trace, write_trace
from app.simulation.trace.metrics import verdict
from app.simulation.trace.snapshot import QUANTITIES, Snapshot
from app.simulation.trace.trace import Trace
from app.studies.run_report import config_changes, key_numbers, run_report, spans
from tests.logs import random_snapshots, trace_of

pytestmark = pytest.mark.slow


def moving_log() -> Trace:
    """The base drives a left quarter circle of 2 m radius; distances fall from 0.3 m to 0."""
    snapshots = []
    for k, s in enumerate(random_snapshots(2, 101)):
        angle = np.pi / 2 * k / 100
        snapshots.append(
            replace(
                s,
                t=0.02 * k,
                config=Config(),
                in_contact=30 <= k < 40,
                arm_in_contact=False,
                base_pose=np.array([2 * np.sin(angle), 2 - 2 * np.cos(angle), angle]),
                pairs=tuple(pair._replace(d=0.3 - 0.003 * k, beta=k / 100) for pair in s.pairs),
                u_a=np.full(7, -float(k)),
                ee_error=0.5 * k,
                activation=0.25,
                door=None,
                hand_force=np.array([3.0, 4.0, 0.0]),
            )
        )
    return trace_of(snapshots)


def few_rows() -> Trace:
    """Every tenth row of `moving_log`, for tests that read a log many times."""
    return trace_of(moving_log().snapshots[::10])


def test_key_numbers_equal_those_of_the_motion():
    log = moving_log()
    numbers = key_numbers(log)
    assert numbers["duration_s"] == pytest.approx(2.0)
    assert numbers["base_path_m"] == pytest.approx(np.pi, rel=1e-4)
    assert numbers["base_displacement_m"] == pytest.approx(np.sqrt(8.0))
    assert numbers["base_yaw_rad"] == pytest.approx(np.pi / 2)
    assert numbers["min_distance_m"] == pytest.approx(dict.fromkeys(log.meta.pairs, 0.0))
    assert numbers["activation_max"] == 0.25  # of the inserted rows, independent of the pairs' β
    assert (numbers["ee_error_max_m"], numbers["ee_error_final_m"]) == (50.0, 50.0)
    assert numbers["hand_force_max_n"] == pytest.approx(5.0)
    assert numbers["effort_max"] == {f"u_panda_joint{i}_nm": 100.0 for i in range(1, 8)}
    assert numbers["contacts"] == 10
    assert numbers["torque_jump_max_nm"] is None  # its rows are not control steps


def test_spans_cover_exactly_the_flagged_samples():
    t = np.arange(8.0)
    flags = np.array([1, 1, 0, 0, 1, 0, 1, 1], dtype=bool)
    assert spans(flags, t) == [(0.0, 2.0), (4.0, 5.0), (6.0, 7.0)]
    assert spans(np.zeros(8, dtype=bool), t) == []


def test_every_changed_parameter_is_listed_with_all_its_values():
    first = Config().replace("border.d_b", 0.2)
    second = first.replace("force.f_max", 100.0).replace("border.kind", "points")
    assert config_changes([Config()]) == []
    assert config_changes([first, second]) == [
        ("border.d_b", 0.15, 0.2),
        ("border.kind", "surface", ["surface", "points"]),
        ("force.f_max", 300.0, [300.0, 100.0]),
    ]


def test_the_page_is_self_contained_with_numbers_changes_and_figures(tmp_path):
    log = moving_log()
    changed = log.snapshots[0].config.replace("border.d_b", 0.2).replace("border.kind", "points")
    rows = (replace(log.snapshots[0], config=changed, controller="<none>"), *log.snapshots[1:])
    page = run_report(trace_of(rows))
    assert not re.findall(r"""(?:src|href)=["'](?!data:|#)""", page)
    assert "http" not in re.sub(r'src="data:[^"]*"', "", page)
    assert page.count('src="data:image/png;base64,') == 5
    assert "Smallest distance, end-effector – base [m]" in page
    assert "Largest torque or force, panda_joint1 [N m]" in page
    assert "border.d_b" in page
    assert "0.2, then 0.15" in page
    assert "points, then surface" in page  # a choice, which has no unit
    assert "&lt;none&gt;" in page
    assert "<none>" not in page


def test_dbb_report_writes_the_page_and_prints_the_numbers(tmp_path, capsys):
    log = moving_log()
    write_trace(tmp_path / "log.csv", log)
    page = tmp_path / "new" / "report.html"
    main(["report", str(tmp_path / "log.csv"), "--out", str(page), "--json"])
    numbers = json.loads(capsys.readouterr().out)
    assert numbers["base_path_m"] == key_numbers(log)["base_path_m"]
    assert page.read_text(encoding="utf-8").startswith("<!doctype html>")


def test_dbb_report_reports_wrong_files_in_one_error(tmp_path, capsys):
    for args, words in (
        ([str(tmp_path / "none.csv")], "no such file"),
        ([str(tmp_path / "log.csv"), "--out", str(tmp_path / "a.pdf")], ".html"),
    ):
        with pytest.raises(SystemExit) as end:
            main(
                ["report", *args, *(["--out", str(tmp_path / "a.html")] if len(args) == 1 else [])]
            )
        assert end.value.code == 2
        err = capsys.readouterr().err
        assert err.startswith("dbb: error: ")
        assert words in err


def test_values_that_are_not_finite_are_missing(tmp_path, monkeypatch):
    monkeypatch.setattr("app.studies.style.DPI", 20)
    bad = (np.nan, [-1]), (-np.inf, [-1]), (np.inf, slice(None))
    log, path = few_rows(), tmp_path / "log.parquet"
    write_trace(path, log)
    whole = pq.read_table(path)
    numbers = {f.name for f in whole.schema if str(f.type) == "double" and f.name != "t_s"}
    alone = [
        next(([column.name] for column in each.columns(log.meta) if column.name in numbers), [])
        for each in QUANTITIES.values()
    ]
    for k, names in enumerate([*filter(None, alone), sorted(numbers)]):  # one, then all together
        damaged = whole
        for i, name in enumerate(names, start=k):
            cells = np.array(whole[name].to_pylist(), dtype=float)
            value, rows = bad[i % 3]
            cells[rows] = value
            damaged = damaged.set_column(whole.schema.get_field_index(name), name, [cells])
        pq.write_table(damaged, path)
        read = read_trace(path)
        json.dumps(key_numbers(read), allow_nan=False)
        verdict(key_numbers(read))
    page = run_report(read)
    assert "Values are missing in the log, in base_x_m (" in page
    assert "other columns" in page
    pq.write_table(whole, path)
    assert "Values are missing" not in run_report(read_trace(path))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_time_that_is_not_finite_is_refused(value, tmp_path):
    path = tmp_path / "log.parquet"
    write_trace(path, few_rows())
    table = pq.read_table(path)
    times = table["t_s"].to_numpy().copy()
    times[-1] = value
    pq.write_table(table.set_column(0, "t_s", [times]), path)
    with pytest.raises(LogError, match="a time is not a finite number"):
        read_trace(path)


def test_an_older_log_without_newer_quantities_has_numbers_and_a_report(tmp_path: Path):
    log, path = few_rows(), tmp_path / "log.parquet"
    write_trace(path, log)
    table, known = pq.read_table(path), key_numbers(log)
    newer = {each.name for each in fields(Snapshot) if each.default is not MISSING}
    columns = {
        name: [column.name for column in QUANTITIES[name].columns(log.meta)]
        for name in newer & QUANTITIES.keys()
    }
    for dropped in [*columns.values(), [name for names in columns.values() for name in names]]:
        pq.write_table(table.drop_columns(dropped), path)
        older = read_trace(path)
        numbers = key_numbers(older)
        assert numbers.keys() == known.keys(), dropped
        assert all(value in (None, known[key]) for key, value in numbers.items()), dropped
    assert numbers["floor_contacts"] is None
    assert "Key numbers" in run_report(older)
