"""History of the page: paths, results of scenarios, and the timeline."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from app.config import Config
from app.dashboard.job import write_log, write_report
from app.dashboard.panels import save
from app.dashboard.panels.run import course_html
from app.dashboard.panels.save import SavePanel
from app.dashboard.record import BIN, HISTORY, SPACING, Course, Strip, Track
from app.dashboard.shared import SharedState
from app.errors import UnreachableError
from app.robot.description import load_robot
from app.simulation.case import RunCase, RunSpec
from app.simulation.people import PullReading
from app.simulation.scenarios import scenario_of
from tests.fakes import ScriptedLoop
from tests.robots import husky_panda


@pytest.fixture(scope="module")
def snapshot():
    return ScriptedLoop(husky_panda()).latest()


def shown_html(course, busy=""):
    return course_html(course, busy, husky_panda().description)


class Past:
    """The history of a loop with one recorder of its snapshots."""

    def __init__(self, snapshot, recorder):
        self._snapshots = [snapshot]
        self._data = SharedState(self, husky_panda(), {}, parts=object())
        self._data.keepers = [recorder]

    def extend(self, snapshots):
        self._snapshots = snapshots
        self._data.update()

    @property
    def last(self):
        return self._data.last

    def latest(self):
        return self._snapshots[-1]

    def history(self, after):
        return [snapshot for snapshot in self._snapshots if snapshot.t > after]


def run(snapshot, begin, end, every=0.02):
    times = np.arange(round(begin / every), round(end / every) + 1) * every
    return [replace(snapshot, t=float(t), ee_error=2.0 * float(t)) for t in times]


@pytest.fixture
def track():
    """A path along the line x = error."""
    return Track(lambda s: np.array([s.ee_error, 0.0, 0.0]))


def test_a_path_has_points_at_least_a_spacing_apart_in_bounded_memory(snapshot, track):
    past = Past(snapshot, track)
    past.extend(run(snapshot, 0.0, 100.0, every=0.5 * SPACING))
    points = track.until(100.0)[:, 0]
    assert len(points) == 1500
    assert (np.diff(points) >= SPACING).all()
    assert points[-1] == pytest.approx(200.0, abs=2 * SPACING)
    np.testing.assert_array_equal(track.until(99.0)[:, 0], points[points <= 198.0])


@pytest.mark.parametrize(("before", "after"), [(0.0, 0.0), (0.0, 0.02), (0.3, 0.5)])
def test_a_new_run_is_detected_even_if_its_time_is_not_smaller(snapshot, before, after):
    """For example, a scenario without a door replaces one with a door."""
    strip = Strip(husky_panda().body_names)
    past = Past(snapshot, strip)
    door = snapshot.pairs[0]._replace(name="lm-door")
    past.extend([replace(snapshot, t=before, run=1, pairs=(*snapshot.pairs, door))])
    past.extend([replace(snapshot, t=after, run=2)])
    assert strip.runs == 2
    assert past.last == after


def test_a_run_that_starts_during_a_read_is_recorded_by_the_next_read(snapshot):
    strip = Strip(husky_panda().body_names)
    past = Past(snapshot, strip)
    old, new = replace(snapshot, t=1.0, run=1), replace(snapshot, t=1.5, run=2)
    past.extend([old])
    past.history = lambda after: [new]
    past.extend([old])
    assert past.last == 1.0
    past.extend([new])
    assert (strip.runs, past.last) == (2, 1.5)


def test_repeated_snapshots_count_once_and_a_restart_clears_the_path(snapshot, track):
    past = Past(snapshot, track)
    assert track.until(1.0).shape == (0, 3)
    past.extend(run(snapshot, 0.0, 5.0))
    past.extend(run(snapshot, 3.0, 6.0))
    assert (np.diff(track.until(6.0)[:, 0]) > 0.0).all()
    assert past.last == pytest.approx(6.0)
    past.extend(run(snapshot, 0.0, 0.1))
    assert track.until(10.0)[-1, 0] == pytest.approx(0.2, abs=SPACING)


def at_time(snapshot, t, name, *, x=0.0, d=0.2, pull=0.0):
    first, *others = snapshot.pairs
    return replace(
        snapshot,
        t=t,
        scenario=name,
        scenario_ends=8.0 if name else None,
        base_pose=np.array([x, 0.0, 0.0]),
        pairs=(first._replace(d=d), *others),
        hand_force=np.array([0.0, pull, 0.0]),
    )


@pytest.mark.parametrize(("d", "result"), [(0.03, "no contact"), (-0.004, "overlap")])
def test_a_scenario_shows_its_progress_and_then_its_figures(snapshot, d, result):
    course = Course()
    past = Past(snapshot, course)
    assert shown_html(course) == ""
    run = [
        at_time(snapshot, 2.0, "way-out", x=-0.4, d=d, pull=30.0),
        at_time(snapshot, 4.0, "way-out"),
    ]
    past.extend([at_time(snapshot, 0.0, "way-out"), *run])
    text = shown_html(course)
    assert "The robot starts inside a buffer" in text
    assert "width:50%" in text
    assert "4.0 of 8 s" in text
    past.extend([at_time(snapshot, 7.98, "way-out"), at_time(snapshot, 8.0, "", d=-1.0, x=9.0)])
    text = shown_html(course)
    for part in (
        f"way-out with dbb ended: {result}<",
        f"{1000 * d:.0f} mm".replace("-", "−"),
        "30 N",
        "0.80 m",
    ):
        assert part in text, part


@pytest.mark.parametrize(("farther", "title"), [(1.0, ""), (1.5, " (options changed)")])
def test_result_of_changed_options_says_so(snapshot, farther, title):
    """The demonstration has a longer path than the scenario of its name."""
    robot = husky_panda().description
    scenario = scenario_of(robot, "guiding-lateral")
    scenario = scenario.changed(move=tuple(farther * part for part in scenario.move))
    spec = RunSpec("husky_panda", scenario, Config(), "dbb", "kinematic", 0)
    course = Course()
    run = [at_time(snapshot, 0.0, scenario.name), at_time(snapshot, 8.0, "")]
    Past(snapshot, course).extend([replace(each, case=RunCase.of(spec)) for each in run])
    assert f"guiding-lateral{title} with dbb ended" in course_html(course, "", robot)


def test_saved_case_has_the_changes_during_the_run_also_after_its_end(snapshot):
    scenario = scenario_of(husky_panda().description, "guiding-lateral")
    case = RunCase.of(RunSpec("husky_panda", scenario, Config(), "dbb", "kinematic", 0))
    wide = Config().replace("border.d_b", 0.2)
    run = [
        at_time(snapshot, 0.0, scenario.name),
        replace(at_time(snapshot, 4.0, scenario.name), controller="none", config=wide),
        at_time(snapshot, 8.0, ""),
    ]
    course, sent = Course(), []
    Past(snapshot, course).extend([replace(each, case=case) for each in run])
    client = SimpleNamespace(send_file_download=lambda _, data, **__: sent.append(json.loads(data)))
    panel = SimpleNamespace(_shared=SimpleNamespace(course=course))
    SavePanel._case(panel, SimpleNamespace(client=client))
    assert sent[0]["controller"] == "none"
    assert sent[0]["parameters"]["border.d_b"] == 0.2


@pytest.mark.parametrize(("write", "last"), [(write_log, 8.1), (write_report, 8.0)])
def test_a_saved_interval_has_seed_and_plant_and_a_report_ends_with_its_scenario(
    snapshot, write, last
):
    """After a scenario, the end-effector's target is its own position."""
    traces = []

    def run(_, trace, path):
        traces.append(trace)
        path.write_bytes(b"")

    known = replace(snapshot, physics="kinematic", seed=7)
    times = {5.0: "guiding-lateral", 8.0: "guiding-lateral", 8.1: ""}
    late = [at_time(known, t, scenario) for t, scenario in times.items()]
    viewer = SimpleNamespace(
        timeline=SimpleNamespace(interval=lambda: late), shared=SimpleNamespace(model=husky_panda())
    )
    panel = SimpleNamespace(_viewer=viewer, _job=SimpleNamespace(run=run))
    SavePanel._of_interval(panel, "log.csv", write)
    meta = traces[0].meta
    assert (meta.scenario, meta.seed, meta.physics) == ("guiding-lateral", 7, "kinematic")
    assert traces[0].t[-1] == last


def test_caption_of_a_picture_is_that_of_the_drawn_posture(snapshot, monkeypatch):
    captions = []
    monkeypatch.setattr(
        save, "captioned", lambda _, shown, *__, posed, **___: captions.append((shown, posed))
    )
    monkeypatch.setattr(save, "png", lambda _: b"")
    posed, past = at_time(snapshot, 2.0, ""), at_time(snapshot, 1.0, "")
    grip = SimpleNamespace(reach=lambda _: None)  # the gizmo moves the posture
    panel = SimpleNamespace(
        _viewer=SimpleNamespace(grip=grip, view=SimpleNamespace(dark=True)),
        _scene=lambda *_: None,
        _size=lambda: (64, 64),
        _drawn=(past, False),
    )
    SavePanel._picture(panel)
    SavePanel.update(panel, SimpleNamespace(shown=posed))
    SavePanel._picture(panel)
    grip.reach = None
    SavePanel.update(panel, SimpleNamespace(shown=past))
    SavePanel._picture(panel)
    assert captions == [(past, False), (posed, True), (past, False)]


def test_result_on_a_robot_without_a_line_for_the_scenario(snapshot):
    """The case has its own line, so its options differ from those of the robot."""
    robot = load_robot("stretch_se3")
    with pytest.raises(UnreachableError):
        scenario_of(robot, "guiding-front")
    scenario = scenario_of(husky_panda().description, "guiding-front")
    case = RunCase.of(RunSpec("stretch_se3", scenario, Config(), "dbb", "kinematic", 0))
    course = Course()
    run = [at_time(snapshot, 0.0, scenario.name), at_time(snapshot, 8.0, "")]
    Past(snapshot, course).extend([replace(each, case=case) for each in run])
    assert "guiding-front (options changed) with dbb ended" in course_html(course, "", robot)


@pytest.mark.parametrize(
    ("distances", "result"),
    [
        ((-0.02, -0.01), "overlap"),
        ((-0.02, 0.3), "recovered from the initial contact"),
        ((-0.02, 0.3, -0.01, 0.3), "overlap"),
        ((0.3, -0.01, 0.3), "overlap"),
    ],
)
def test_leaving_an_initial_contact_is_not_an_overlap(snapshot, distances, result):
    course = Course()
    shown = [at_time(snapshot, float(t), "way-out", d=d) for t, d in enumerate(distances)]
    Past(snapshot, course).extend([*shown, at_time(snapshot, 8.0, "")])
    assert f": {result}<" in shown_html(course)


def test_contact_is_reported_by_the_plant(snapshot):
    course = Course()
    touching = replace(at_time(snapshot, 1.0, "way-out"), floor_contact=True)
    Past(snapshot, course).extend([at_time(snapshot, 0.0, "way-out"), touching])
    assert course.outcome == "contact"


def test_an_unlisted_scenario_has_no_description(snapshot):
    course = Course()
    Past(snapshot, course).extend([at_time(snapshot, 1.0, "of-a-case")])
    assert ">.<" not in shown_html(course)


@pytest.mark.parametrize("missing", [0.02, 0.3])
def test_a_scenario_whose_last_snapshots_are_missing_has_ended(snapshot, missing):
    """A busy machine skips snapshots; only an earlier one without a scenario means a stop."""
    course = Course()
    past = Past(snapshot, course)
    past.extend([at_time(snapshot, 8.0 - missing, "guiding-front"), at_time(snapshot, 8.0, "")])
    assert "guiding-front with dbb ended: no contact" in shown_html(course)


def test_an_early_end_is_reported_as_a_stop_and_cleared_by_a_reset(snapshot):
    course = Course()
    past = Past(snapshot, course)
    past.extend([at_time(snapshot, 3.0, "guiding-front"), at_time(snapshot, 3.02, "")])
    assert "guiding-front with dbb stopped at 3.0 s" in shown_html(course)
    assert "Preparing refrigerator" in course_html(
        course, "preparing refrigerator", husky_panda().description
    )
    past.extend([at_time(snapshot, 0.0, "")])
    assert shown_html(course) == course.name == ""


def near(snapshot, t, d, **more):
    """The snapshot at t [s] with the first pair at distance d [m]; its buffer is 0.15 m."""
    first, *others = snapshot.pairs
    pair = first._replace(d=d, beta=max(0.0, 1.0 - d / 0.15))
    return replace(snapshot, t=t, pairs=(pair, *others), **more)


def test_the_timeline_stores_extremes_and_each_event_once(snapshot):
    strip = Strip(husky_panda().body_names)
    past = Past(snapshot, strip)
    tuned = snapshot.config.replace("force.f_max", 200.0)
    pull = PullReading(0, None, np.zeros(3), np.zeros(3), np.array([0.0, 9.0, 0.0]))
    run = [
        near(snapshot, 0.0, 0.2),
        near(snapshot, 0.02, 0.1, pulls=(pull,)),
        near(snapshot, 0.04, 0.2),  # out and in again at once is still the same event
        near(snapshot, 0.06, -0.01),
        near(snapshot, 0.08, 0.2, config=tuned),
        near(snapshot, 3.0, 0.1, scenario="way-out"),
        near(snapshot, 3.1, 0.1, scenario="way-out"),
    ]
    past.extend(run)
    assert strip.rows[0] == (0.0, -0.01, pytest.approx(1.0, abs=0.1), 0.15)
    assert len(strip.rows) == 2
    assert strip.nearest is run[3]
    assert strip.hardest is run[1]
    [stored] = strip.past
    assert (stored.t, stored.run) == (run[3].t, run[3].run)
    assert stored.snapshot.nearest.d == run[3].nearest.d
    assert stored.snapshot.config is run[3].config
    assert stored.snapshot is stored.snapshot
    events = [(event.t, event.kind, event.text) for event in strip.events.values()]
    assert events == [
        (0.02, "person", "a person pulls the robot"),
        (0.02, "buffer", "end-effector – base inside the buffer"),
        (0.04, "person", "a person releases the robot"),
        (0.06, "contact", "end-effector – base overlap by 10 mm"),
        (0.08, "parameter", "Force at contact f_max [N]: 200"),
        (3.0, "scenario", "way-out starts"),
        (3.0, "parameter", "Force at contact f_max [N]: 300"),
        (3.0, "buffer", "end-effector – base inside the buffer"),
    ]
    past.extend([near(snapshot, 0.0, 0.2)])
    assert (len(strip.rows), len(strip.events), strip.runs) == (0, 0, 1)


def test_the_timeline_is_bounded_in_memory(snapshot):
    strip = Strip(husky_panda().body_names)
    past = Past(snapshot, strip)
    for k in range(8000):
        past.extend([near(snapshot, k * BIN, 0.2 if k // 8 % 2 else 0.1)])
    assert len(strip.rows) == HISTORY / BIN < strip.closed
    assert len(strip.events) == 400
    assert len(strip.past) <= HISTORY / BIN / 2
