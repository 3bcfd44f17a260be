"""The table behind the plots."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.dashboard.record import KEPT, PERIOD, Curve, Record
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda

CURVES = (Curve("time", lambda s: s.t), Curve("off", lambda s: s.ee_error))


@pytest.fixture(scope="module")
def snapshot():
    return ScriptedLoop(husky_panda()).latest()


def run(snapshot, begin, end, every=0.02):
    times = np.arange(round(begin / every), round(end / every) + 1) * every
    return [replace(snapshot, t=float(t), ee_error=2.0 * float(t)) for t in times]


def test_columns_are_the_curves_over_time(snapshot):
    record = Record(CURVES)
    record.extend(run(snapshot, 0.0, 10.0), 10.0)
    table = record.columns(8.0, 3.0)
    assert table[0, 0] == pytest.approx(5.0)
    assert table[0, -1] == pytest.approx(8.0)
    np.testing.assert_allclose(table[1], table[0])
    np.testing.assert_allclose(table[2], 2.0 * table[0])
    np.testing.assert_allclose(np.diff(table[0]), PERIOD, atol=1e-9)


def test_it_is_bounded_in_memory_and_keeps_the_newest(snapshot):
    record = Record(CURVES)
    record.extend(run(snapshot, 0.0, 200.0), 200.0)
    table = record.columns(200.0, 1e9)
    assert table.shape[1] <= KEPT / PERIOD + 2
    assert table[0, -1] == pytest.approx(200.0)
    assert np.ptp(table[0]) == pytest.approx(KEPT, abs=2 * PERIOD)


def test_snapshots_told_twice_are_taken_once(snapshot):
    record = Record(CURVES)
    record.extend(run(snapshot, 0.0, 5.0), 5.0)
    record.extend(run(snapshot, 3.0, 6.0), 6.0)
    times = record.columns(6.0, 60.0)[0]
    assert (np.diff(times) > 0.5 * PERIOD).all()
    assert record.last == pytest.approx(6.0)


def test_a_restart_of_the_simulation_empties_it(snapshot):
    record = Record(CURVES)
    record.extend(run(snapshot, 0.0, 5.0), 5.0)
    record.extend(run(snapshot, 0.0, 0.1), 0.1)
    assert record.columns(10.0, 60.0)[0, -1] == pytest.approx(0.1, abs=PERIOD)


def test_an_empty_table_and_an_empty_stretch_still_have_a_row(snapshot):
    record = Record(CURVES)
    assert record.columns(1.0, 1.0).shape == (3, 1)
    record.extend(run(snapshot, 0.0, 1.0), 1.0)
    assert record.columns(50.0, 1.0).shape == (3, 1)
