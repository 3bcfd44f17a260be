"""Contacts of the arm with base, itself and floor: they are reported and have an effect."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from app.robot.state import RobotState
from app.simulation.plants import PLANTS, make_physics
from app.simulation.plants.collision_shapes import FLOOR, body_contact_pairs, link_contact_pairs
from app.simulation.plants.interface import Contacts
from tests.hulls import hull_pairs
from tests.robots import husky_panda

MODEL = husky_panda()
DESCRIPTION = MODEL.description
READY = np.array(DESCRIPTION.arm.ready_position)
DAMPING = np.array(DESCRIPTION.arm.joint_damping)
IN_BASE = (0.45, 0.0, 0.15)  # [m] inside the base, below the front of its top
FREE = (0.65, 0.1, 0.5)
COLUMN = (0.30, 0.0, 0.6)  # inside the arm's own shoulder
UNDERGROUND = (0.9, 0.2, -0.2)
ENGINES = [kind for kind in PLANTS if kind != "kinematic"]


def pull(plant, goal, seconds: float = 3.0, most: float = 40.0):
    """Pull the compensated, damped arm by its end-effector; returns contacts and measurements."""
    plant.reset(np.zeros(3), READY)
    state, seen, trace = RobotState(MODEL), Contacts(), []
    for _ in range(round(seconds / plant.dt)):
        m = plant.measure()
        state.update(m)
        trace.append(m)
        force = 400.0 * (np.array(goal) - state.T_world_ee.translation)
        force *= min(1.0, most / np.linalg.norm(force))
        plant.step(state.g[2:] - DAMPING * m.qd_m, (0.0, 0.0), force)
        seen = Contacts(*np.logical_or(seen, plant.contacts()))
    return seen, trace


@cache
def pulled(kind: str, goal):
    """The result of `pull` for a new plant, computed once for all tests."""
    plant = make_physics(kind, MODEL)
    result = pull(plant, goal)
    plant.close()
    return result


def end_effector_of(m) -> np.ndarray:
    """(3,) [m] position of the end-effector in the world."""
    state = RobotState(MODEL)
    state.update(m)
    return state.T_world_ee.translation.copy()


@pytest.mark.slow
@pytest.mark.parametrize("kind", PLANTS)
@pytest.mark.parametrize(
    ("goal", "field"),
    [(IN_BASE, "arm_base"), (COLUMN, "arm_arm"), (UNDERGROUND, "arm_floor"), (FREE, None)],
    ids=["base", "column", "floor", "free"],
)
def test_contact_is_reported_only_where_the_arm_is_pulled(kind, goal, field):
    seen, _ = pulled(kind, goal)
    if field is None:
        assert not any(seen)
    else:
        assert getattr(seen, field)
    if field == "arm_floor" and kind != "kinematic":  # the kinematic arm passes through the base
        assert not seen.arm_base


@pytest.mark.slow
@pytest.mark.parametrize("kind", ENGINES)
@pytest.mark.parametrize("goal", [IN_BASE, COLUMN, UNDERGROUND], ids=["base", "column", "floor"])
def test_arm_cannot_penetrate_the_body_that_it_touches(kind, goal):
    """The hulls of the links, measured by another library, never overlap by more than 3 mm."""
    hulls, data = hull_pairs(MODEL), MODEL.pin.createData()
    _, trace = pulled(kind, goal)
    at_home = np.zeros(3)
    depths = [hulls.least_distance(data, MODEL.configuration(at_home, m.q_m)) for m in trace[::10]]
    assert min(depths) > -0.003  # [m]
    places = np.array([end_effector_of(m) for m in trace])
    assert places[:, 2].min() > -0.01
    assert np.linalg.norm(places[-1] - goal) > 0.05
    assert np.ptp(places[-500:], axis=0).max() < 0.02  # at rest, without bouncing


@pytest.mark.slow
@pytest.mark.parametrize("kind", ENGINES)
def test_lifting_the_arm_ends_the_contact(kind):
    plant = make_physics(kind, MODEL)
    pull(plant, IN_BASE)
    assert plant.contacts().arm_base
    state = RobotState(MODEL)
    for _ in range(1000):
        m = plant.measure()
        state.update(m)
        lift = np.array([20.0, 0.0, 40.0])
        plant.step(state.g[2:] - DAMPING * m.qd_m, (0.0, 0.0), lift)
    assert not any(plant.contacts())
    plant.close()


@pytest.mark.slow
@pytest.mark.parametrize("kind", ENGINES)
def test_neighbouring_links_never_push_each_other(kind):
    """Within the limits only gravity and motor torques act on an arm without contact."""
    plant, rng = make_physics(kind, MODEL), np.random.default_rng(3)
    state, tried = RobotState(MODEL), 0
    while tried < 40:
        plant.reset(np.zeros(3), rng.uniform(MODEL.q_lower, MODEL.q_upper))
        state.update(plant.measure())
        q = state.measurement.q_m
        plant.step(state.g[2:], (0.0, 0.0), np.zeros(3))
        if any(plant.contacts()):
            continue
        tried += 1
        limit = 5e-3 if kind == "mujoco-contact" else 1e-9  # [rad/s]; its wheels are compliant
        assert np.abs(plant.measure().qd_m).max() < limit, q
    plant.close()


@pytest.mark.slow
def test_kinematic_plant_reports_every_contact_of_the_planar_plant():
    """A contact of hulls in pybullet is an overlap of the larger bodies in the kinematic plant."""
    planar, kinematic = make_physics("planar", MODEL), make_physics("kinematic", MODEL)
    rng, found = np.random.default_rng(0), np.zeros(len(Contacts._fields), dtype=int)
    state, on_floor = RobotState(MODEL), pulled("planar", UNDERGROUND)[1][-1].q_m
    for k in range(1500):
        q = rng.uniform(MODEL.q_lower, MODEL.q_upper)
        if k % 10 == 0:  # hardly any random posture reaches the floor
            q = on_floor + rng.normal(0, 0.05, MODEL.n_m)
        planar.reset(np.zeros(3), q)
        state.update(planar.measure())
        planar.step(state.g[2:], (0.0, 0.0), np.zeros(3))
        real = np.array(planar.contacts())
        kinematic.reset(np.zeros(3), q)
        kinematic.step(state.g[2:], (0.0, 0.0), np.zeros(3))
        assert not (real & ~np.array(kinematic.contacts())).any(), (q, real)
        found += real
    assert min(Contacts(*found)[:3]) > 5  # there is no door
    planar.close()
    kinematic.close()


def test_contact_pairs_of_links_follow_from_their_bodies():
    bodies, links = body_contact_pairs(DESCRIPTION), link_contact_pairs(DESCRIPTION)
    assert bodies == {
        **dict.fromkeys([("lm", "l3"), ("lm", "lEE")], "arm_base"),
        **dict.fromkeys([("l1", "l3"), ("l1", "lEE"), ("l2", "lEE")], "arm_arm"),
        **dict.fromkeys([(FLOOR, "l3"), (FLOOR, "lEE")], "arm_floor"),
    }
    assert links["base_link", "panda_hand"] == "arm_base"
    assert links["panda_link0", "panda_link5"] == "arm_arm"
    assert links[FLOOR, "panda_hand"] == "arm_floor"
    near_base = [pair for pair, group in links.items() if group == "arm_base"]
    assert not any("panda_link2" in pair for pair in near_base)


def test_links_of_an_unmonitored_pair_touch_the_base_but_not_another_part_of_the_arm():
    pairs = {"lm-l2": "", "lm-l3": "", "l1-l3": ""}
    hidden = DESCRIPTION.model_copy(update={"unwatched": pairs})
    links = link_contact_pairs(hidden)
    assert links["base_link", "panda_link2"] == links["base_link", "panda_link5"] == "arm_base"
    assert ("panda_link0", "panda_link5") not in links
    assert ("lm", "l2") not in body_contact_pairs(hidden)


def test_nested_links_are_no_contact_pair_and_other_pairs_stay():
    nested = DESCRIPTION.bodies[-1].model_copy(update={"nested": {"panda_hand": ("panda_link0",)}})
    built = DESCRIPTION.model_copy(update={"bodies": (*DESCRIPTION.bodies[:-1], nested)})
    links = link_contact_pairs(DESCRIPTION)
    assert links.pop(("panda_link0", "panda_hand")) == "arm_arm"
    assert link_contact_pairs(built) == links
    assert body_contact_pairs(built) == body_contact_pairs(DESCRIPTION)
