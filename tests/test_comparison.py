"""Ghosts run the robot's input on their own plants; scores equal the figures of the steps."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.errors import ConfigError
from app.robot.model import RobotModel
from app.simulation.loop.commands import Compare, Pull
from app.simulation.loop.ensemble import Ensemble
from app.simulation.plants.interface import Contacts
from app.simulation.scenarios import LINES, SCENARIOS
from app.simulation.scenarios.start import StartSolver
from app.simulation.session import DT, Session, Step
from app.simulation.trace.snapshot import Score
from tests.steps import kept

pytestmark = pytest.mark.slow

LATERAL = LINES["guiding-lateral"]
PULL = Pull((LATERAL.start[0], LATERAL.start[1] - 0.25, LATERAL.start[2]))
ELBOW = Pull((0.3, 0.4, 1.0), "panda_link4", (0.0, 0.05, 0.0), who=2)


@pytest.fixture(scope="module")
def q_start(robot: RobotModel, border_data: BorderData) -> np.ndarray:
    return StartSolver(robot, border_data.pairs, Config().border.d_b).solve(LATERAL.start)


@pytest.fixture
def make(robot: RobotModel, border_data: BorderData, q_start) -> Iterator:
    made: list[Ensemble] = []

    def make(physics: str = "kinematic") -> Ensemble:
        made.append(Ensemble(Session(robot, border_data, Config(), physics=physics), q_start))
        return made[-1]

    yield make
    for ensemble in made:
        ensemble.close()


def run(ensemble: Ensemble, seconds: float) -> list[Step]:
    return [kept(ensemble.step()) for _ in range(round(seconds / DT))]


def apart(ensemble: Ensemble, i: int = 0) -> float:
    """Largest difference between the measurements of ghost i and of the robot, in any entry."""
    ghost, main = ensemble.ghosts[i].session.state, ensemble.main.state
    there, here = (np.concatenate(s.measurement[:5]) for s in (ghost, main))
    return float(np.abs(there - here).max())


@pytest.mark.parametrize(
    ("physics", "same", "seconds"), [("planar", "path", 2.0), ("kinematic", "force", 1.2)]
)
def test_a_ghost_with_the_same_controller_moves_like_the_robot(make, physics, same, seconds):
    ensemble = make(physics)
    ensemble.pull(PULL)
    run(ensemble, 0.2)  # the robot moves; the comparison starts at rest
    ensemble.compare(Compare(("dbb",), same))
    ensemble.pull(PULL)
    ensemble.pull(ELBOW)
    steps = run(ensemble, seconds)
    assert max(step.control.activation for step in steps) > 0.05
    assert apart(ensemble) == 0.0
    main, ghost = ensemble.scores()
    np.testing.assert_allclose(main[1:], ghost[1:], atol=1e-5)


def test_a_comparison_starts_at_rest_at_the_robots_pose_and_ends_cleanly(make):
    ensemble = make()
    ensemble.pull(PULL)
    run(ensemble, 1.2)
    truth = ensemble.main.physics.measure()
    assert np.abs(truth.base_pose).max() > 1e-3
    ensemble.compare(Compare(("none", "barrier")))
    for session in (ensemble.main, *(ghost.session for ghost in ensemble.ghosts)):
        begun = session.physics.measure()
        np.testing.assert_array_equal(begun.base_pose, truth.base_pose)
        np.testing.assert_array_equal(begun.q_m, truth.q_m)
        np.testing.assert_array_equal(begun.qd_m, 0.0)
    assert [ghost.session.controller.name for ghost in ensemble.ghosts] == ["none", "barrier"]
    run(ensemble, 0.1)
    t = ensemble.main.t
    ensemble.compare(Compare())
    assert (ensemble.ghosts, ensemble.scores(), ensemble.main.t) == ([], (), t)


def test_ghosts_share_the_force_or_have_separate_persons_on_the_same_path(make):
    for same in ("path", "force"):
        ensemble = make()
        ensemble.compare(Compare(("none",), same))
        ensemble.pull(PULL)
        ensemble.pull(ELBOW)
        ghost, taken = ensemble.ghosts[0].session, []
        step_of_ghost = ghost.step
        ghost.step = lambda *a, _step=step_of_ghost, _to=taken, **k: (
            _to.append(_step(*a, **k)) or _to[-1]
        )
        steps = run(ensemble, 0.8)
        assert apart(ensemble) > 1e-4  # the base of one of them gives way
        ours, theirs = steps[-1].person, taken[-1].person
        equal = np.array_equal(ours.hand, theirs.hand) and all(
            a.joint == b.joint and np.array_equal(a.force, b.force)
            for a, b in zip(ours.pushes, theirs.pushes, strict=True)
        )
        assert equal == (same == "force")
        assert taken[-1].ee_error == pytest.approx(
            float(np.linalg.norm(ghost.state.T_world_ee.translation - PULL.target))
        )


def test_scores_equal_the_figures_of_the_steps(make):
    ensemble = make()
    ensemble.compare(Compare(("none",)))
    ensemble.pull(PULL)
    steps = run(ensemble, 1.2)
    score = ensemble.scores()[0]
    poses = np.array([step.truth.base_pose for step in steps])
    commanded = np.array([step.control.a_base_cmd for step in steps])
    torques = np.array([step.control.u_cmd for step in steps])
    mobile = [
        d
        for step in steps
        for pair, d in zip(step.control.pairs, step.distances, strict=True)
        if pair.a == "lm"
    ]
    expected = Score(
        "dbb",
        min(mobile),
        steps[-1].ee_error,
        max(step.ee_error for step in steps),
        sum(float(np.hypot(*(b - a)[:2])) for a, b in pairwise(poses)),
        *np.abs(np.diff(commanded, axis=0)).max(axis=0),
        np.abs(np.diff(torques, axis=0)).max(),
        sum(any(step.contacts) for step in steps),
    )
    assert score == pytest.approx(expected)
    assert score.base_path > 1e-3
    assert ensemble.scores()[1].base_path < score.base_path


@pytest.mark.parametrize("kind", Contacts._fields)
def test_a_contact_of_any_kind_counts(make, monkeypatch, kind):
    ensemble = make()
    ensemble.compare(Compare(("none",)))
    run(ensemble, 0.002)
    monkeypatch.setattr(ensemble.main.physics, "contacts", lambda: Contacts.of([kind]))
    run(ensemble, 0.003)
    assert [score.contacts for score in ensemble.scores()] == [3, 0]


def test_scenarios_resets_and_parameters_apply_to_all_ghosts(make, q_start):
    ensemble = make()
    ensemble.play(SCENARIOS["tracking"])
    run(ensemble, 0.1)
    ensemble.compare(Compare(("dbb", "none")))
    assert (ensemble.main.t, ensemble.leading) == (0.0, "tracking")
    run(ensemble, 0.5)
    assert apart(ensemble) == 0.0
    sessions = [ghost.session for ghost in ensemble.ghosts]
    config = Config().replace("border.d_b", 0.25)
    ensemble.configure(config)
    assert [session.config for session in sessions] == [config, config]
    ensemble.reset()
    assert [ghost.session for ghost in ensemble.ghosts] == sessions  # reused
    for session in sessions:
        np.testing.assert_array_equal(session.physics.measure().q_m, q_start)
    step = ensemble.step()
    assert (step.control.tracking, step.t) == (0.0, 0.0)
    assert ensemble.scores()[0].error_max == 0.0  # the scores start again
    reading = ensemble.ghosts[1].reading()
    assert reading.controller == "none"
    assert reading.clearance == pytest.approx(min(step.distances[:2]), abs=1e-6)
    np.testing.assert_allclose(reading.p_ee, LATERAL.start, atol=1e-4)


def test_a_refused_comparison_changes_nothing(make, monkeypatch):
    ensemble = make()
    ensemble.compare(Compare(("none",)))
    ghosts, t = ensemble.ghosts, ensemble.main.t
    monkeypatch.setattr(
        "app.simulation.loop.ensemble.begin",
        lambda *_, **__: (_ for _ in ()).throw(ConfigError("no")),
    )
    with pytest.raises(ConfigError):
        ensemble.compare(Compare(("none", "barrier"), "force"))
    assert (ensemble.ghosts, ensemble.main.t) == (ghosts, t)
    assert ensemble.comparison == Compare(("none",))


def test_a_pull_after_a_scenario_does_not_change_the_scores(make):
    ensemble = make()
    ensemble.compare(Compare(("none",)))
    ensemble.play(SCENARIOS["guiding-lateral"])
    run(ensemble, 0.5)
    before = ensemble.scores()
    ensemble.pull(PULL)
    steps = run(ensemble, 0.5)
    assert ensemble.scores() == before
    ghost = ensemble.ghosts[0].reading().clearance
    assert ghost != before[1].clearance, "the ghost's reading has stopped"
    assert steps[-1].t > 0.9
