"""The envelope: it holds no failed case, shrinks with difficulty, and finds a known limit."""

from __future__ import annotations

import math
import sys

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from app.errors import StudyError
from app.study import envelope as module
from app.study.envelope import (
    BASE_STEP,
    DELAY_STEP,
    MARGIN,
    RESERVE,
    Envelope,
    as_toml,
    fit_envelope,
    rate_bound,
    tally,
    tally_by_halves,
)
from app.study.play import Row
from app.study.study_range import StudyRange

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

RANGES = StudyRange()


def row(case: int, speed: float, delay: float, base_speed: float, contacts: int) -> Row:
    return {
        "case": case, "speed_mps": speed, "delay_s": delay, "base_speed_mps": base_speed,
        "noise_rad": 0.0, "mass_error": 0.0, "slip": 0.0, "strength_n": 40.0, "contacts": contacts,
        "arm_contacts": 0, "solver_failures": 0, "nan": False, "error": None,
    }  # fmt: skip


def rows_by(law, count: int, seed: int = 0) -> list[Row]:
    """Random cases that fail where they are faster than a law of delay and v_max allows."""
    rng = np.random.default_rng(seed)
    rows = []
    for case in range(count):
        speed, delay = rng.uniform(*RANGES.speed), rng.uniform(*RANGES.delay)
        base_speed = rng.uniform(*RANGES.base_speed)
        rows.append(row(case, speed, delay, base_speed, int(speed > law(delay, base_speed))))
    return rows


def test_without_a_failure_it_goes_as_far_as_was_drawn_and_no_farther():
    rows = rows_by(lambda delay, base_speed: 9.0, 2000)
    v = np.array(fit_envelope(rows, RANGES).speed)
    assert (v <= RANGES.speed[1]).all()
    assert (v > RANGES.speed[1] - 0.05).all()
    slow = [row for row in rows if row["speed_mps"] < 0.5 and row["delay_s"] < 0.29]
    fitted = fit_envelope(slow, RANGES)
    assert fitted.limit(0.1, 0.5) == pytest.approx(0.49, abs=0.0101)
    assert fitted.limit(0.35, 0.5) == 0.0


def test_a_known_limit_is_found_from_below_within_bands_and_margin():
    def law(delay: float, base_speed: float) -> float:
        return 0.4 + 0.5 * base_speed - delay

    fitted = fit_envelope(rows_by(law, 20_000), RANGES)
    for delay in np.linspace(0.01, 0.39, 12):
        for base_speed in np.linspace(0.26, 0.99, 9):
            found = fitted.limit(delay, base_speed)
            worst = law(delay + DELAY_STEP, base_speed - BASE_STEP)
            assert MARGIN * worst - 0.02 <= found <= law(delay, base_speed)


cases = st.builds(
    row, st.integers(0, 10**6), st.floats(*RANGES.speed), st.floats(*RANGES.delay),
    st.floats(*RANGES.base_speed), st.integers(0, 1),
)  # fmt: skip


@settings(max_examples=200, deadline=None)
@given(st.lists(cases, max_size=40))
def test_no_failed_case_is_inside_and_v_star_falls_with_delay_and_rises_with_v_max(rows):
    fitted = fit_envelope(rows, RANGES)
    assert not [r for r in rows if r["contacts"] and fitted.holds_row(r)]
    v = np.array(fitted.speed)
    assert (np.diff(v, axis=0) <= 0).all()
    assert (np.diff(v, axis=1) >= 0).all()


@settings(max_examples=100, deadline=None)
@given(st.lists(cases, max_size=20), cases)
def test_a_further_failure_never_widens_the_envelope_and_a_success_never_narrows_it(rows, further):
    before = np.array(fit_envelope(rows, RANGES).speed)
    after = np.array(fit_envelope([*rows, further], RANGES).speed)
    assert (after <= before).all() if further["contacts"] else (after >= before).all()


def test_a_case_that_came_too_near_bounds_the_envelope_too():
    near = {**row(0, 0.5, 0.1, 0.5, 0), "min_clearance_m": RESERVE - 1e-6}
    assert not fit_envelope([near], RANGES).holds_row(near)
    clear = {**near, "min_clearance_m": RESERVE}
    slower = {**clear, "speed_mps": 0.48}
    assert fit_envelope([clear], RANGES).holds_row(slower)


def test_beyond_what_was_drawn_nothing_is_inside():
    hardest = row(0, RANGES.speed[1], RANGES.delay[1], RANGES.base_speed[0], 0)
    fitted = fit_envelope([hardest], RANGES)
    good = {"speed": 0.1, "delay": 0.1, "base_speed": 0.5, "noise": 0.0, "mass_error": 0.0,
            "slip": 0.0, "strength": 40.0}  # fmt: skip
    assert fitted.holds(good)
    for name, value in {
        "speed": 1.1, "delay": 0.5, "base_speed": 0.2, "noise": 0.004, "mass_error": 0.25,
        "slip": 0.4, "strength": 41.0,
    }.items():  # fmt: skip
        assert not fitted.holds({**good, name: value}), name


def test_the_bound_of_a_rate_is_that_of_the_binomial_and_three_over_n_without_a_failure():
    for n in (50, 300, 2000):
        assert (1 - rate_bound(0, n)) ** n == pytest.approx(0.05)
        assert rate_bound(0, n) == pytest.approx(3 / n, rel=0.04)
    p = rate_bound(2, 100)
    lower_tail = sum(math.comb(100, k) * p**k * (1 - p) ** (100 - k) for k in range(3))
    assert lower_tail == pytest.approx(0.05)
    assert rate_bound(0, 0) == rate_bound(4, 4) == 1.0


def test_each_half_is_held_against_the_envelope_of_the_other():
    """A failure that only the odd cases know is found inside of the even ones' envelope."""
    even = [row(2 * k, 0.5, 0.1, 0.5, 0) for k in range(10)]
    odd = [row(1, 0.5, 0.1, 0.5, 1)]
    assert tally_by_halves([*even, *odd], RANGES)[:2] == (1, 1)
    assert tally([*even, *odd])[:2] == (11, 1)


def test_an_envelope_survives_its_file():
    fitted = fit_envelope(rows_by(lambda d, b: 0.7 - d, 300), RANGES)
    text = as_toml(fitted, {"seed": 3, "about": 'a "test"', "inside": True})
    content = tomllib.loads(text)
    assert Envelope.model_validate(content["envelope"]) == fitted
    assert content["source"] == {"seed": 3, "about": 'a "test"', "inside": True}


def test_the_stated_envelope_can_be_read_and_says_where_it_comes_from():
    stated = Envelope.stated()
    assert min(v for band in stated.speed for v in band) > 0.0
    source = tomllib.loads(module.STATED.read_text(encoding="utf-8"))["source"]
    assert {"seed", "code", "cases", "failed", "inside_cases", "inside_failed"} <= set(source)
    assert source["inside_failed"] == 0


def test_a_damaged_envelope_is_refused_by_name(tmp_path, monkeypatch):
    path = tmp_path / "envelope.toml"
    monkeypatch.setattr(module, "STATED", path)
    for text in ("", "[envelope]\n", as_toml(fit_envelope([], RANGES), {}).replace("1.0", '"x"')):
        path.write_text(text, encoding="utf-8")
        with pytest.raises(StudyError, match=r"envelope\.toml"):
            Envelope.stated()
