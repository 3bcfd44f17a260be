"""A scenario in the dashboard gives the same run as on the command line."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import count

import numpy as np
import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control import contract
from app.errors import ConfigError, TargetError
from app.robot.model import RobotModel
from app.simulation.loop import ensemble as module
from app.simulation.loop.commands import Compare, Pull
from app.simulation.loop.ensemble import MAX_PULLS, Ensemble
from app.simulation.loop.pacing import Pacer
from app.simulation.run import begin
from app.simulation.scenarios import SCENARIOS
from app.simulation.scenarios.leading import Setting
from app.simulation.scenarios.refrigerator import RefrigeratorScenario
from app.simulation.session import DT, Session, Step
from app.simulation.trace.snapshot import make_snapshot

LATERAL = SCENARIOS["guiding-lateral"]
TRACKING = SCENARIOS["tracking"]
FRIDGE = SCENARIOS["refrigerator"]


@pytest.fixture(scope="module")
def fridge_setting(robot: RobotModel, border_data: BorderData) -> Setting:
    return FRIDGE.setting(robot, border_data, Config(), 0)


@pytest.fixture
def known_fridge(monkeypatch: pytest.MonkeyPatch, fridge_setting: Setting) -> None:
    """Search the grasp once for all tests, because the search takes seconds."""
    monkeypatch.setattr(
        RefrigeratorScenario, "setting", lambda self, model, data, config, seed: fridge_setting
    )


@pytest.fixture
def make(robot: RobotModel, border_data: BorderData) -> Iterator:
    made: list[Ensemble] = []

    def make(physics: str = "kinematic", controller: str = "dbb") -> Ensemble:
        free = Session(robot, border_data, Config(), physics=physics, controller=controller)
        made.append(Ensemble(free, np.array(robot.description.arm.ready_position)))
        return made[-1]

    yield make
    for ensemble in made:
        ensemble.close()


def numbers(step: Step) -> list[float]:
    """The physical results of a step."""
    return [
        step.t,
        step.ee_error,
        *step.truth.q_m,
        *step.truth.base_pose,
        *step.control.u_cmd,
        *step.hand_force,
        *step.distances,
        *step.contacts,
    ]


def steps(ensemble: Ensemble, seconds: float) -> np.ndarray:
    return np.array([numbers(ensemble.step()) for _ in range(round(seconds / DT))])


@pytest.mark.parametrize("name", ["guiding-lateral", "tracking", "way-out"])
def test_a_scenario_is_the_same_run_as_on_the_command_line(make, robot, border_data, name):
    scenario = SCENARIOS[name]
    ensemble = make()
    steps(ensemble, 0.3)  # earlier steps have no effect
    ensemble.play(scenario)
    played = steps(ensemble, 0.7)
    setting = scenario.setting(robot, border_data, Config(), 0)
    session = begin(setting, robot, controller="dbb", physics="kinematic", seed=0)
    driver = scenario.driver(session)
    run = np.array([numbers(session.step(*driver(session))) for _ in range(700)])
    np.testing.assert_allclose(played, run, atol=1e-9)


@pytest.mark.slow
def test_a_scenario_leads_the_robot_until_its_end(make):
    ensemble = make()
    ensemble.play(TRACKING.changed(duration=0.2))
    assert (ensemble.leading, ensemble.ends) == ("tracking", 0.2)
    taken = [bool(ensemble.step().control.tracking) for _ in range(300)]
    assert taken == [True] * 200 + [False] * 100
    assert (ensemble.leading, ensemble.ends) == ("", None)


def test_a_pull_ends_a_scenario_and_a_restart_repeats_it(make):
    ensemble = make()
    ensemble.play(LATERAL)
    first = steps(ensemble, 0.3)
    ensemble.pull(Pull((0.4, 0.7, 0.4)))
    step = ensemble.step()
    assert ensemble.leading == ""
    np.testing.assert_array_equal(step.hand_target, [0.4, 0.7, 0.4])
    ensemble.restart()
    assert ensemble.leading == "guiding-lateral"
    np.testing.assert_allclose(steps(ensemble, 0.3), first, atol=1e-9)


def test_a_reset_and_a_later_restart_return_to_the_free_start(make, robot):
    ensemble = make()
    ensemble.play(LATERAL)
    ensemble.step()
    for begin_anew in (ensemble.reset, ensemble.restart):
        begin_anew()
        step = ensemble.step()
        assert (ensemble.leading, step.t) == ("", 0.0)
        np.testing.assert_array_equal(step.truth.q_m, robot.description.arm.ready_position)
        steps(ensemble, 0.05)


@pytest.mark.slow
@pytest.mark.usefixtures("known_fridge")
def test_the_refrigerator_adds_its_door_and_a_reset_removes_it(make, fridge_setting):
    ensemble = make("planar", "repulsive")
    free = ensemble.main
    ensemble.configure(Config().replace("force.f_max", 111.0))
    ensemble.play(FRIDGE)
    step = ensemble.step()
    begun = make_snapshot(ensemble.main, step, Pacer(DT), paused=False)
    assert begun.door is not None
    assert begun.door.door == FRIDGE.door
    assert begun.door.angle == pytest.approx(0.0, abs=1e-9)
    handle = begun.door.door.handle(begun.door.angle).translation
    np.testing.assert_allclose(begun.p_ee, handle, atol=1e-3)
    assert (begun.mode, begun.controller) == ("tracking", "repulsive")
    assert "lm-door" in {pair.name for pair in begun.pairs}
    assert begun.config.force.f_max == 111.0
    assert begun.config.task.posture_stiffness == 100.0  # the scenario's own value
    ensemble.configure(Config().replace("force.f_max", 99.0))
    assert ensemble.main.config.task.posture_stiffness == 100.0
    steps(ensemble, 1.5)
    later = make_snapshot(ensemble.main, ensemble.step(), Pacer(DT), paused=False)
    assert later.door.angle > 0.02  # [rad]
    assert np.linalg.norm(later.door.force) > 0.1  # [N]
    ensemble.reset()
    assert ensemble.main is free
    after = make_snapshot(free, ensemble.step(), Pacer(DT), paused=False)
    assert after.door is None
    assert after.config == Config().replace("force.f_max", 99.0)
    assert (after.mode, after.controller) == ("guiding", "repulsive")


@pytest.mark.usefixtures("known_fridge")
def test_a_restart_of_the_refrigerator_repeats_its_run(make):
    ensemble = make("planar")
    ensemble.play(FRIDGE)
    first = steps(ensemble, 0.3)
    ensemble.restart()
    np.testing.assert_allclose(steps(ensemble, 0.3), first, atol=1e-9)


@pytest.mark.usefixtures("known_fridge")
def test_a_refused_scenario_changes_nothing(make):
    ensemble = make("kinematic")
    ensemble.play(LATERAL)
    steps(ensemble, 0.1)
    main, t = ensemble.main, ensemble.main.t
    with pytest.raises(ConfigError, match="kinematic has no door"):
        ensemble.play(FRIDGE)
    with pytest.raises(TargetError):
        ensemble.play(LATERAL.changed(move=(0.0, 0.0, -2.0)))
    assert (ensemble.main, ensemble.main.t, ensemble.leading) == (main, t, "guiding-lateral")
    assert ensemble.step().t == t


def second_fails(function: Callable) -> Callable:
    """The function, whose second call raises an error."""
    calls = count(1)

    def counted(*args: object) -> object:
        if next(calls) == 2:
            raise TargetError("the second call fails")
        return function(*args)

    return counted


@pytest.mark.parametrize(("fails", "leads"), [("begin", 0), ("begin", 1), ("driver", 1)])
def test_a_failed_start_of_a_later_robot_changes_nothing(make, monkeypatch, fails, leads):
    ensemble, other = make(), make()
    for each in (ensemble, other):
        each.play(LATERAL)
        steps(each, 0.1)
        if not leads:
            each.pull(Pull((0.5, 0.5, 0.6)))
    begun: list[Session] = []
    closed: list[Session] = []
    monkeypatch.setattr(Session, "close", lambda session: closed.append(session))
    monkeypatch.setattr(module, "begin", lambda *args: begun.append(begin(*args)) or begun[-1])
    of = {"begin": module, "driver": type(LATERAL)}[fails]
    monkeypatch.setattr(of, fails, second_fails(getattr(of, fails)))
    with pytest.raises(TargetError, match="the second call fails"):
        ensemble.compare(Compare(("none", "barrier")))
    assert begun
    assert closed == begun[::-1]
    np.testing.assert_array_equal(steps(ensemble, 0.1), steps(other, 0.1))
    assert (ensemble.comparison, ensemble.ghosts) == (other.comparison, [])


@pytest.mark.parametrize("began", [False, True])
@pytest.mark.usefixtures("known_fridge")
def test_a_scenario_whose_driver_fails_changes_nothing(make, monkeypatch, began):
    ensemble, other = make("planar"), make("planar")
    for each in (ensemble, other):
        if began:
            each.play(TRACKING)
        steps(each, 0.1)
    monkeypatch.setattr(type(FRIDGE), "driver", None)
    with pytest.raises(TypeError):
        ensemble.play(FRIDGE)
    np.testing.assert_array_equal(steps(ensemble, 0.1), steps(other, 0.1))


def test_refused_parameters_change_nothing(make, monkeypatch):
    ensemble, config = make(), Config().replace("force.f_max", 100.0)
    ensemble.play(LATERAL)
    monkeypatch.setattr(contract, "_FASTEST", 1e-9)
    with pytest.raises(ConfigError, match="too large for a control period"):
        ensemble.configure(config)
    monkeypatch.undo()
    assert ensemble.main.config == Config()
    ensemble.restart()
    assert ensemble.main.config == Config()
    ensemble.configure(config)
    ensemble.restart()
    assert ensemble.main.config == config


def test_a_pull_at_another_link_disturbs_a_scenario_without_ending_it(make):
    ensemble = make()
    ensemble.play(TRACKING)
    alone = steps(ensemble, 0.4)
    ensemble.restart()
    ensemble.pull(Pull((0.2, 0.6, 1.0), "panda_link4", who=5))
    disturbed = steps(ensemble, 0.4)
    assert ensemble.leading == "tracking"
    assert np.abs(disturbed - alone).max() > 1e-3
    ensemble.release(5)
    assert (ensemble.leading, ensemble.step().pulls) == ("tracking", ())


def test_each_viewer_releases_its_own_pull_and_pulls_are_limited(make):
    ensemble = make()
    for who in range(MAX_PULLS):
        ensemble.pull(Pull((0.5, 0.1 * who, 0.8), who=who))
    with pytest.raises(TargetError, match="8 people already hold the robot"):
        ensemble.pull(Pull((0.5, 0.0, 0.8), who=99))
    ensemble.pull(Pull((0.6, 0.0, 0.8), "panda_link5", who=2))  # another point
    ensemble.release(0)
    ensemble.release(5)
    ensemble.release(77)
    assert {reading.who for reading in ensemble.step().pulls} == {1, 2, 3, 4, 6, 7}
    ensemble.reset()
    assert ensemble.step().pulls == ()


@pytest.mark.slow
@pytest.mark.usefixtures("known_fridge")
def test_ghosts_have_separate_doors(make):
    ensemble = make("planar")
    ensemble.play(FRIDGE)
    closed = ensemble.main.physics.door.angle()
    ensemble.compare(Compare(("dbb",)))
    steps(ensemble, 0.6)
    ghost, main = ensemble.ghosts[0].session.physics.door, ensemble.main.physics.door
    assert ghost is not main
    assert ghost.angle() == pytest.approx(main.angle(), abs=1e-6)
    assert ghost.angle() > closed + 1e-4  # [rad]
    ensemble.reset()
    assert ensemble.ghosts[0].session.door is None
