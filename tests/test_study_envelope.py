"""The envelope contains no failed case, and finds a known limit."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from app.errors import StudyError
from app.studies.pulls import envelope as module
from app.studies.pulls.envelope import (
    MARGIN,
    NEAR,
    Envelope,
    as_toml,
    fit_envelope,
    rate_bound,
    tally,
    tally_by_halves,
)
from app.studies.pulls.parameters import StudyParameters, StudyRange
from app.studies.pulls.report import PICTURES, draw_clearance, draw_errors, summary_of
from app.studies.runs import Row
from app.studies.style import png_of

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

RANGES = StudyRange()


STRONGEST = 100.0  # [N]


def row(case: int, force: float, speed: float, delay: float, contacts: int) -> Row:
    return {
        "case": case,
        "speed_mps": speed,
        "base_delay_s": delay,
        "v_max_mps": 0.5,
        "encoder_noise_rad": 0.0,
        "mass_error": 0.0,
        "slip": 0.0,
        "hand_stiffness_npm": 500.0,
        "hand_mass_kg": 1.0,
        "payload_kg": 0.0,
        "sensor_delay_s": 0.0,
        "sensor_period_s": 0.0,
        "dropped": 0.0,
        "unknown_load_kg": 0.0,
        "stated_period_s": 0.001,
        "hand_f_max_n": 100.0,
        "hand_force_clear_max_n": force,
        "contacts": contacts,
        "arm_contacts": 0,
        "solver_failures": 0,
        "nan": False,
        "error": None,
    }


def rows_by(law, count: int, seed: int = 0) -> list[Row]:
    """Random cases that fail if their force exceeds a limit that depends on speed and delay."""
    rng = np.random.default_rng(seed)
    rows = []
    for case in range(count):
        force, speed = rng.uniform(0.0, STRONGEST), rng.uniform(*RANGES.speed)
        delay = rng.uniform(*RANGES.base_delay)
        rows.append(row(case, force, speed, delay, int(force > law(speed, delay))))
    return rows


def test_envelope_without_failures_extends_to_the_exerted_force():
    rows = rows_by(lambda speed, delay: 1e3, 2000)
    assert STRONGEST - 5.0 < fit_envelope(rows, RANGES).force <= STRONGEST
    weak = [row for row in rows if row["hand_force_clear_max_n"] < 50]
    assert 47.0 <= fit_envelope(weak, RANGES).force <= 49.0
    assert fit_envelope([], RANGES).force == 0.0


def test_known_limit_is_found_from_below_within_the_margin():
    """The true limit is that of the largest speed and delay within the intervals."""

    def law(speed: float, delay: float) -> float:
        return 100.0 - 40.0 * speed - 50.0 * delay

    found = fit_envelope(rows_by(law, 20_000), RANGES).force
    worst = law(RANGES.speed[1], RANGES.base_delay[1])
    assert MARGIN * worst - 1.0 <= found <= worst


cases = st.builds(
    row,
    st.integers(0, 10**6),
    st.floats(0.0, STRONGEST),
    st.floats(*RANGES.speed),
    st.floats(*RANGES.base_delay),
    st.integers(0, 1),
)


@given(st.lists(cases, max_size=40))
def test_failed_cases_are_outside_the_envelope(rows):
    fitted = fit_envelope(rows, RANGES)
    assert not [r for r in rows if r["contacts"] and fitted.holds(r)]


@given(st.lists(cases, max_size=20), cases)
def test_failure_never_widens_and_success_never_narrows_the_envelope(rows, further):
    before, after = (fit_envelope(each, RANGES).force for each in (rows, [*rows, further]))
    assert after <= before if further["contacts"] else after >= before


def test_case_with_too_little_clearance_limits_the_envelope():
    near = {**row(0, 50.0, 0.5, 0.1, 0), "min_clearance_m": NEAR - 1e-6}
    assert not fit_envelope([near], RANGES).holds(near)
    clear = {**near, "min_clearance_m": NEAR}
    assert fit_envelope([clear], RANGES).holds({**clear, "hand_force_clear_max_n": 49.0})


def test_exerted_force_counts_rather_than_the_limit_of_the_spring():
    """A weak pull, successful or not, does not extend the envelope to strong pulls."""
    weak = row(0, 20.0, 0.5, 0.1, 0)
    assert fit_envelope([weak], RANGES).force == 20.0
    assert fit_envelope([{**weak, "contacts": 1}], RANGES).force == 0.0
    strong = row(1, 80.0, 0.5, 0.1, 0)
    assert fit_envelope([{**weak, "contacts": 1}, strong], RANGES).force == 18.0


def test_aborted_run_counts_with_the_largest_force_of_its_spring():
    broken = {**row(0, 0.0, 0.5, 0.1, 0), "hand_force_clear_max_n": None, "error": "it broke"}
    fitted = fit_envelope([broken, row(1, 95.0, 1.2, 0.4, 0)], RANGES)
    assert fitted.force == MARGIN * 100.0


def test_values_beyond_the_drawn_ranges_are_outside_the_envelope():
    hardest = row(0, STRONGEST, RANGES.speed[1], RANGES.base_delay[1], 0)
    fitted = fit_envelope([hardest], RANGES)
    assert fitted.holds(row(1, 99.0, 0.4, 0.1, 0))
    assert not fitted.holds(row(1, 101.0, 0.4, 0.1, 0))
    for column, value in {
        "speed_mps": 1.3,
        "base_delay_s": 0.5,
        "v_max_mps": 0.2,
        "encoder_noise_rad": 0.004,
        "mass_error": 0.25,
        "slip": 0.4,
        "hand_stiffness_npm": 250.0,
        "hand_mass_kg": 3.0,
        "sensor_delay_s": 0.03,
        "unknown_load_kg": 4.0,
    }.items():
        assert not fitted.holds({**row(1, 1.0, 0.4, 0.1, 0), column: value}), column


def test_rate_bound_is_binomial_and_three_over_n_without_failures():
    for n in (50, 300, 2000):
        assert (1 - rate_bound(0, n)) ** n == pytest.approx(0.05)
        assert rate_bound(0, n) == pytest.approx(3 / n, rel=0.04)
    p = rate_bound(2, 100)
    lower_tail = sum(math.comb(100, k) * p**k * (1 - p) ** (100 - k) for k in range(3))
    assert lower_tail == pytest.approx(0.05)
    assert rate_bound(0, 0) == rate_bound(4, 4) == 1.0


def test_each_half_is_tested_with_the_envelope_of_the_other_half():
    """A failure among the odd cases is inside the envelope of the even cases."""
    even = [row(2 * k, 50.0, 0.5, 0.1, 0) for k in range(10)]
    odd = [row(1, 50.0, 0.5, 0.1, 1)]
    halves, whole = tally_by_halves([*even, *odd], RANGES), tally([*even, *odd])
    assert (halves["cases"], halves["failed"]) == (1, 1)
    assert (whole["cases"], whole["failed"]) == (11, 1)


def test_envelope_survives_its_file():
    fitted = fit_envelope(rows_by(lambda v, d: 90.0 - 20.0 * v, 300), RANGES)
    text = as_toml(fitted, {"seed": 3, "about": 'a "test"', "inside": True})
    content = tomllib.loads(text)
    assert Envelope.model_validate(content["envelope"]) == fitted
    assert content["source"] == {"seed": 3, "about": 'a "test"', "inside": True}


def test_stated_envelope_is_readable_and_states_its_source():
    stated = Envelope.stated()
    assert stated.force > 0.0
    source = tomllib.loads(module.STATED.read_text(encoding="utf-8"))["source"]
    assert {"seed", "code", "cases", "failed", "inside_cases", "inside_failed"} <= set(source)
    assert source["inside_failed"] == 0


def test_damaged_envelope_error_names_the_file(tmp_path, monkeypatch):
    path = tmp_path / "envelope.toml"
    monkeypatch.setattr(module, "STATED", path)
    for text in (
        "",
        "[envelope]\n",
        as_toml(fit_envelope([], RANGES), {}).replace("3000.0", '"x"'),
    ):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(StudyError, match=r"envelope\.toml"):
            Envelope.stated()


def test_values_beyond_the_axes_are_drawn_at_their_ends():
    rows = [
        {**row(k, 20.0, 0.5, 0.1, 0), "kind": "side", "min_clearance_m": value}
        | {"ee_error_final_m": value}
        for k, value in enumerate((-0.1, 1e-9, 0.2, 0.9, 5.0))
    ]
    for draw in (draw_errors.draw, draw_clearance.draw):
        left, right = draw(rows, Envelope.stated(), 0.15).axes[:2]
        assert sum(bar.get_height() for bar in left.patches) >= len(rows)
        drawn = right.collections[0].get_offsets()[:, 0]
        low, high = right.get_xlim()
        assert ((low <= drawn) & (drawn <= high)).all()


def test_pictures_of_a_study_without_any_results_can_be_drawn():
    drawn = row(0, 20.0, 0.5, 0.1, 0)
    results = ("min_clearance_m", "ee_error_final_m", "hand_force_clear_max_n")
    broken = drawn | dict.fromkeys(results) | {"kind": "side", "error": "it broke"}
    for each in PICTURES.values():
        png_of(each.draw([broken], Envelope.stated(), 0.15))


@pytest.mark.parametrize(
    ("report_s", "counts"),
    [(None, (1, 0, 0)), (0.9, (1, 0, 0)), (0.9995, (1, 1, 1)), (1.1, (1, 1, 1)), (2.0, (1, 1, 0))],
)
def test_a_report_counts_only_after_the_fault_begins(report_s, counts):
    events = {"kind": "side", "redraws": 0, "release_at_s": None, "regrasp_at_s": None}
    fault = {"sensor_delay_s": 0.1, "fault_at_s": 1.0, "fault_lag_s": report_s}
    rows = [{**row(0, 20.0, 0.5, 0.1, 0), **events, **fault}]
    summary, _ = summary_of(rows, StudyParameters(), 0.15)
    assert tuple(summary["faults"]["sensor_delay"].values()) == counts


def test_entry_into_the_buffer_is_judged_by_the_robots_d_b():
    events = {"kind": "side", "redraws": 0, "release_at_s": None, "regrasp_at_s": None}
    rows = [{**row(0, 20.0, 0.5, 0.1, 0), **events, "min_clearance_m": 0.17}]
    for d_b, entered in ((0.15, 0), (0.2, 1)):
        summary, _ = summary_of(rows, StudyParameters(), d_b)
        assert summary["entered_buffer_share"] == entered
        assert sum(band["entered_buffer"] for band in summary["by_force"]) == entered
