"""A robot without monitored pairs runs or is refused with a reason, never with a bare exception."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from app.border.cache import BorderData
from app.config import Config
from app.control.controller import CONTROLLERS
from app.errors import DescriptionError, UnreachableError
from app.robot.model import RobotModel
from app.simulation.case import RunSpec
from app.simulation.run import filmed, run_scenario
from app.simulation.scenarios import SCENARIOS
from app.studies.pulls import case
from app.studies.sweep.sweep import StartFinder
from tests.robots import needs_pybullet

REFUSED = "husky_panda: no monitored part of the arm can meet the base"
FRIDGE = SCENARIOS["refrigerator"].changed(duration=0.05)


@pytest.fixture(scope="module", params=["no pair", "no pair with the base"])
def alone(request, border_data: BorderData) -> BorderData:
    """The border data of a robot without pairs, or with pairs within the arm only."""
    none = {"mobile": (), **({"manipulator": ()} if request.param == "no pair" else {})}
    return replace(border_data, pairs=replace(border_data.pairs, **none), clouds={})


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in SCENARIOS if name != FRIDGE.name])
def test_scenarios_refuse_a_robot_that_has_nothing_to_avoid(
    robot: RobotModel, alone: BorderData, name: str
) -> None:
    with pytest.raises(DescriptionError, match=REFUSED):
        run_scenario(robot, alone, SCENARIOS[name], Config(), physics="kinematic")


@needs_pybullet
@pytest.mark.slow
@pytest.mark.parametrize("controller", CONTROLLERS)
def test_the_door_is_then_the_only_body_that_the_base_avoids(
    robot: RobotModel, alone: BorderData, controller: str
) -> None:
    result = run_scenario(robot, alone, FRIDGE, Config(), controller=controller)
    (pair,) = result.trace.meta.mobile_pairs
    assert pair == "lm-door"
    assert result.figures["min_clearance_m"] == pytest.approx(result.figures["door_min_distance_m"])
    json.dumps(result.figures)
    run = RunSpec("husky_panda", FRIDGE, Config(), controller)
    explanation = filmed(run, robot, alone, [0.0])[-1].explanation
    assert explanation is not None
    assert explanation.nearest[:2] == ("lm", "door")


def test_a_sweep_and_a_study_refuse_it_too(
    robot: RobotModel, alone: BorderData, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(DescriptionError, match=REFUSED):
        StartFinder(robot, alone, 0.15)
    monkeypatch.setattr(case, "load_border_data", lambda *_, **__: alone)
    with pytest.raises(DescriptionError, match=REFUSED):
        case.load_sources.__wrapped__("husky_panda")


def test_a_way_out_within_the_arm_requires_a_pair_within_the_arm(
    robot: RobotModel, border_data: BorderData
) -> None:
    data = replace(border_data, pairs=replace(border_data.pairs, manipulator=()))
    with pytest.raises(UnreachableError, match=r"--begin arm: .* choose --begin buffer"):
        SCENARIOS["way-out"].changed(begin="arm").setting(robot, data, Config(), 0)


@pytest.mark.slow
def test_a_door_requires_the_reachability_of_a_body(
    robot: RobotModel, border_data: BorderData
) -> None:
    bare = RobotModel(robot.description.model_copy(update={"reachability": {}}))
    with pytest.raises(DescriptionError, match="no body has A, B and C"):
        FRIDGE.setting(bare, border_data, Config(), 0)
