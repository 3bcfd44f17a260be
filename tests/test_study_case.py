"""A case depends only on its study and its number and can be repeated exactly."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from app.avoidance.closest_points import DistanceMonitor
from app.cli.common import spec_of_case
from app.config import Config
from app.errors import AssetError, CaseError, ConfigError, StudyError, TargetError
from app.robot.state import Measurement, RobotState
from app.simulation.case import RunCase, read_case
from app.simulation.run import run_from_spec
from app.simulation.scenarios.line import StartedLine
from app.studies.pulls.case import (
    COLUMNS,
    SECTORS,
    TIMES,
    draw_case,
    flat,
    load_sources,
    place,
    play_case,
    sector_of,
    spec_of,
)
from app.studies.pulls.envelope import Envelope
from app.studies.pulls.parameters import FAULTS, StudyParameters, StudyRange, code_digest
from app.studies.pulls.parameters import PARAMETERS as DRAWN
from app.studies.runs import Row, rounded

RANGES = StudyRange(duration=0.2, released=0.6, regrasped=0.6)
PARAMETERS = StudyParameters(seed=5, physics="kinematic", ranges=RANGES)
NUMBERS = range(8)


def line_of(case: Row) -> StartedLine:
    """The pull of a case."""
    scenario = spec_of(case, PARAMETERS).scenario
    assert isinstance(scenario, StartedLine)
    return scenario


@pytest.fixture(scope="module")
def sources():
    return load_sources("husky_panda")


@pytest.fixture(scope="module")
def cases(sources) -> list[Row]:
    return [draw_case(PARAMETERS, number, sources) for number in NUMBERS]


@pytest.mark.slow
def test_a_case_does_not_depend_on_earlier_cases(sources, cases):
    play_case(cases[0], PARAMETERS, sources.model, sources.data)
    for number in (7, 2):
        assert draw_case(PARAMETERS, number, sources) == cases[number]


def test_each_number_and_each_seed_gives_another_case(sources, cases):
    other = draw_case(PARAMETERS.model_copy(update={"seed": 6}), 0, sources)
    drawn = [
        tuple(case[name] for name in ("start_x_m", "move_x_m", "speed_mps", "seed"))
        for case in [*cases, other]
    ]
    assert len(set(drawn)) == len(drawn)


def test_a_case_starts_at_its_place_with_every_pair_outside_its_buffer(sources, cases):
    state = RobotState(sources.model)
    pairs = sources.data.pairs
    monitor = DistanceMonitor(state, [*pairs.mobile, *pairs.manipulator])
    for case in cases:
        line = line_of(case)
        q_m = np.array(line.q_m)
        state.update(Measurement(np.zeros(3), np.zeros(2), q_m, np.zeros(len(q_m))))
        np.testing.assert_allclose(state.T_world_ee.translation, line.start, atol=1e-4)
        assert min(c.d for c in monitor.find_closest_points()) > Config().border.d_b


def test_the_largest_pull_speed_is_that_of_the_case(cases):
    for case in cases:
        line = line_of(case)
        times = np.linspace(0.0, line.duration, 2001)
        speeds = [np.linalg.norm(line.reference(t, np.eye(3)).velocity[:3]) for t in times]
        assert max(speeds) == pytest.approx(case["speed_mps"], rel=1e-3)
        assert line.duration <= PARAMETERS.ranges.duration + 1e-9
        assert line.place(line.duration) == pytest.approx(np.add(line.start, line.move))


def test_drawn_values_are_in_their_intervals_and_in_the_configuration(cases):
    ranges = PARAMETERS.ranges
    for case in cases:
        config = spec_of(case, PARAMETERS).config
        for name in ("speed", *DRAWN):
            value = case[COLUMNS[name]]
            low, high = getattr(ranges, name)
            assert low <= value <= high
            if name in DRAWN:
                assert config.value(DRAWN[name]) == value
        assert config.disturbance.begins == case["fault_at_s"]


def test_a_case_has_at_most_three_faults_that_start_during_the_pull(sources, cases):
    healthy = {name: Config().value(DRAWN[name]) for name in FAULTS}
    counts = []
    for case in cases:
        counts.append(sum(case[COLUMNS[name]] != healthy[name] for name in FAULTS))
        assert 0.0 <= case["fault_at_s"] <= 0.5 * case["moving"] * case["duration_s"]
    assert 0 in counts
    assert max(counts) in (1, 2, 3)
    never = RANGES.model_copy(update={"faulty": 0.0})
    case = draw_case(PARAMETERS.model_copy(update={"ranges": never}), 0, sources)
    assert {name: case[COLUMNS[name]] for name in FAULTS} == healthy


def test_soft_and_stiff_springs_are_equally_likely(sources):
    """Half of the draws are below the geometric mean of the interval."""
    rng = np.random.default_rng(0)
    draws = [PARAMETERS.ranges.draw("hand_stiffness", rng) for _ in range(400)]
    middle = np.sqrt(np.prod(PARAMETERS.ranges.hand_stiffness))
    assert 160 < sum(k < middle for k in draws) < 240
    assert min(draws) < 350.0 < 2500.0 < max(draws)


def test_a_release_is_during_the_motion_and_a_new_grasp_before_the_end(cases):
    lines = [line_of(case) for case in cases]
    for line in lines:
        pulled, release, regrasp = line.duration * line.moving, line.release_at, line.regrasp_at
        if release is None:
            assert regrasp is None
        else:
            assert 0.3 * pulled <= release <= pulled
            assert regrasp is None or release < regrasp < line.duration
        held = [line.holds(t) for t in np.linspace(0.0, line.duration, 501)[:-1]]
        changes = (release is not None) + (regrasp is not None)
        assert np.count_nonzero(np.diff(held)) == changes
    assert {line.release_at is None for line in lines} == {True, False}
    assert any(line.regrasp_at is not None for line in lines)


def test_directions_cover_the_sphere_and_match_their_sectors(sources):
    rng, lower, upper = np.random.default_rng(0), sources.lower, sources.upper
    ways = []
    for sector in SECTORS:
        for _ in range(200):
            start = place(sector, sources, rng)
            assert sector_of(start.outwards) == sector
            assert ((start.aim > lower) & (start.aim < upper)).all()
            assert ((start.p < lower) | (start.p > upper)).any()
            ways.append(start.outwards)
    for axis in np.vstack([np.eye(3), -np.eye(3)]):
        assert np.max(np.array(ways) @ axis) > 0.95


def test_a_uniform_direction_falls_into_every_sector():
    v = np.random.default_rng(1).standard_normal((3000, 3))
    found = [sector_of(each / np.linalg.norm(each)) for each in v]
    assert set(found) == set(SECTORS)
    assert found.count("above") / 3000 == pytest.approx((1 - 0.5**0.5) / 2, abs=0.03)


def test_a_pull_that_is_not_along_the_base_leads_into_it(sources, cases):
    """The extended line of the pull intersects the box of the base."""
    lower, upper = sources.lower, sources.upper
    for case in cases:
        if "along" in case["kind"]:
            continue
        line = line_of(case)
        way = np.array(line.move) / np.linalg.norm(line.move)
        points = np.array(line.start) + np.linspace(0.0, 2.0, 2001)[:, None] * way
        assert ((points > lower) & (points < upper)).all(axis=1).any()


def test_a_row_of_the_table_contains_its_complete_case(cases):
    """The row is like that of the journal, with results."""
    for case in cases:
        row = json.loads(json.dumps({**case, "nan": False, "min_clearance_m": 0.1}))
        assert spec_of(row, PARAMETERS) == spec_of(case, PARAMETERS)


def test_a_case_from_a_file_gives_the_same_figures(sources, cases, tmp_path):
    """The case runs from memory and, after another case, from the file of a failure."""
    row = play_case(cases[3], PARAMETERS, sources.model, sources.data)
    run = spec_of(cases[3], PARAMETERS)
    file = tmp_path / "case.json"
    file.write_text(RunCase.of(run).text())
    play_case(cases[4], PARAMETERS, sources.model, sources.data)
    again = spec_of_case(file, {})
    assert again == run
    figures = run_from_spec(again, sources.model, sources.data).figures
    again = flat({key: value for key, value in figures.items() if key not in TIMES})
    again = {key: rounded(value) for key, value in again.items()}
    assert {key: row[key] for key in again} == again
    assert row["min_clearance_m"] < 1.0


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, ["cannot read", "No such file"]),
        ("{", ["not JSON"]),
        ("[1]", ["is not a case"]),
        ('{"speed": 1}', ["is not a case", "dbb_case"]),
        ('{"dbb_case": 1, "sped": 1}', ["sped"]),
    ],
)
def test_a_file_that_is_no_case_is_refused_with_its_name(tmp_path, content, words):
    path = tmp_path / "case.json"
    if content is not None:
        path.write_text(content)
    with pytest.raises(CaseError) as caught:
        read_case(path)
    assert all(word in str(caught.value) for word in [str(path), *words])


def test_a_case_of_another_arm_or_with_an_impossible_value_is_refused(sources, cases):
    short = {name: value for name, value in cases[0].items() if name != "q7_rad"}
    with pytest.raises(TargetError, match=r"6 joints.*has 7"):
        run_from_spec(spec_of(short, PARAMETERS), sources.model, sources.data)
    with pytest.raises(ConfigError, match="base_delay"):
        spec_of({**cases[0], "base_delay_s": 9.0}, PARAMETERS)


def test_an_aborted_run_gives_a_row_with_the_reason(sources, cases):
    below = {**cases[0], "move_z_m": -5.0}
    row = play_case(below, PARAMETERS, sources.model, sources.data)
    assert "below the floor" in row["error"]
    assert "min_clearance_m" not in row


@pytest.mark.slow
def test_every_case_of_a_narrowed_study_is_inside_the_envelope(sources):
    envelope = Envelope(
        force=50.0,
        speed=(0.1, 0.9),
        base_delay=(0.0, 0.3),
        v_max=(0.25, 0.9),
        encoder_noise=(0.0, 0.002),
        mass_error=(-0.1, 0.2),
        slip=(0.0, 0.2),
        hand_stiffness=(300.0, 2000.0),
        hand_mass=(0.0, 1.5),
        payload=(0.0, 0.5),
        sensor_delay=(0.0, 0.01),
        sensor_period=(0.0, 0.0),
        dropped=(0.0, 0.2),
        unknown_load=(0.0, 0.0),
        stated_period=(0.001, 0.001),
    )
    study = PARAMETERS.model_copy(update={"ranges": envelope.narrowed(RANGES)})
    for number in range(2):
        case = draw_case(study, number, sources)
        assert envelope.holds(case)
        assert draw_case(PARAMETERS, number, sources) != case
    narrow = envelope.model_copy(update={"hand_mass": (1.0, 1.0), "slip": (0.1, 0.1)})
    inside = narrow.narrowed(RANGES)
    assert (inside.hand_mass, inside.slip) == ((1.0, 1.0), (0.1, 0.1))
    assert (inside.hand_f_max, inside.height) == ((30.0, 50.0), RANGES.height)
    elsewhere = envelope.model_copy(update={"v_max": (1.2, 1.5)})
    with pytest.raises(StudyError, match=r"--v-max: 0\.25 to 1 is outside of the envelope"):
        elsewhere.narrowed(RANGES)
    empty = envelope.model_copy(update={"force": 0.0})
    with pytest.raises(StudyError, match="--hand-f-max: 30 to 100 is outside of the envelope"):
        empty.narrowed(RANGES)


def test_missing_files_end_a_study_with_an_error(sources, cases, monkeypatch):
    def missing(*_: object) -> None:
        raise AssetError("no such mesh")

    monkeypatch.setattr("app.studies.pulls.case.run_from_spec", missing)
    with pytest.raises(AssetError, match="no such mesh"):
        play_case(cases[0], PARAMETERS, sources.model, sources.data)


@pytest.mark.parametrize("file", ["control/controller.py", "studies/sweep/plan.py", "structs.py"])
def test_a_change_of_any_source_file_changes_the_code_digest(file, monkeypatch):
    before, read = code_digest.__wrapped__(), Path.read_bytes
    changed = f"app/{file}"
    monkeypatch.setattr(
        Path, "read_bytes", lambda path: read(path) + b"#" * path.as_posix().endswith(changed)
    )
    assert code_digest.__wrapped__() != before
