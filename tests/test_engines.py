"""pybullet, MuJoCo and pinocchio have the same robot: each that is delivered and installed."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest

import app.robot.assets
from app.errors import AssetError, ConfigError
from app.robot.assets import resolved_urdf, robot_names
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation import plants
from app.simulation.plants import chosen_plant, default_plant, make_physics
from app.simulation.plants.engines import SAME_DEPTH, SAME_PICTURE, compare_engines
from app.simulation.plants.planar import planar_plant
from tests.robots import husky_panda

NOBODY = np.zeros(3)


def installed(name: str) -> RobotModel:
    """A robot whose meshes are there; else the test is skipped."""
    description = load_robot(name)
    try:
        resolved_urdf(description)
    except AssetError as error:
        pytest.skip(str(error))
    return RobotModel(description)


@pytest.mark.parametrize("name", robot_names())
def test_both_engines_see_the_same_robot_and_the_same_contacts(name: str):
    found = compare_engines(installed(name), poses=100, pictures=2)
    assert found.picture < SAME_PICTURE
    assert found.depth < SAME_DEPTH  # [m] depth of contacts in one engine alone
    assert found.contacts > 0


@pytest.mark.parametrize("name", robot_names())
@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_mass_matrix_and_bias_forces_are_pinocchios(name: str, engine: str):
    model, rng = installed(name), np.random.default_rng(1)
    state, n_b = RobotState(model), model.n_b
    other = planar_plant(engine, model)
    for _ in range(20):
        q_m, qd = rng.uniform(model.q_lower, model.q_upper), rng.uniform(-1, 1, model.n)
        state.update(Measurement(NOBODY, model.J_m @ qd[:n_b], q_m, qd[n_b:]))
        M, h = other.mass_and_bias(q_m, qd)
        assert np.abs(M - state.M).max() < 1e-8 * np.abs(state.M).max()
        assert np.abs(h - state.h).max() < 1e-8 * np.abs(state.h).max()
    other.close()


@pytest.mark.parametrize("name", robot_names())
def test_one_step_from_rest_is_the_equation_of_motion_with_the_base_held(name: str):
    """Torques of a tenth of a joint's gravity scale; one step of dt gives q̈_a dt."""
    model, rng = installed(name), np.random.default_rng(2)
    plant, state, n_b = planar_plant("mujoco", model), RobotState(model), model.n_b
    free = 0
    while free < 5:
        q_m = model.q_lower + rng.uniform(0.1, 0.9, model.n_m) * (model.q_upper - model.q_lower)
        plant.reset(np.array([0.3, -0.2, 0.7]), q_m)
        state.update(plant.measure())
        M_aa = state.M[n_b:, n_b:]
        expected = 1e-3 * rng.uniform(-5, 5, model.n_m)
        plant.step(state.g[n_b:] + M_aa @ expected / plant.dt, np.zeros(n_b), NOBODY)
        if any(plant.contacts()):
            continue
        free += 1
        m = plant.measure()
        np.testing.assert_allclose(m.qd_m, expected, atol=1e-5)
        np.testing.assert_allclose(m.q_m - q_m, m.qd_m * plant.dt, atol=1e-12)


def test_pybullet_is_the_default_where_it_is_installed_else_mujoco(monkeypatch):
    monkeypatch.setattr(plants, "find_spec", lambda name: name == "pybullet")
    assert default_plant() == chosen_plant(None) == "planar"
    monkeypatch.setattr(plants, "find_spec", lambda name: None)
    assert default_plant() == chosen_plant(None) == "mujoco"
    with pytest.raises(ConfigError, match=r"planar needs pybullet.*--physics mujoco"):
        make_physics("planar", husky_panda())


def test_without_meshes_the_bodies_touch_instead_and_the_log_says_so(monkeypatch, caplog):
    """As on a machine without the packages that hold the meshes; dynamics do not change."""

    def missing(reference: str, folder: Path) -> Path:
        raise AssetError(f"{reference}: not installed")

    monkeypatch.setattr(app.robot.assets, "_mesh", missing)
    model = RobotModel(load_robot("husky_panda"))
    ready = np.array(model.description.arm.ready_position)
    for kind in ("mujoco", "mujoco-contact"):
        with caplog.at_level(logging.WARNING):
            plant = make_physics(kind, model)
        assert "husky_panda: contacts are computed with the convex bodies" in caplog.text
        state, deepest = RobotState(model), 0.0
        plant.reset(NOBODY, ready)
        for _ in range(1500):
            state.update(plant.measure())
            pull = 400.0 * (np.array([0.45, 0.0, 0.15]) - state.T_world_ee.translation)
            pull *= min(1.0, 40.0 / np.linalg.norm(pull))
            plant.step(state.g[2:] - 2.0 * state.qd[2:], (0.0, 0.0), pull)
            deepest = max(deepest, plant.world.depths().get("arm_base", 0.0))
        assert 0.0 < deepest < 0.005  # [m] they touch, and do not enter each other
        plant.close()


def test_what_mujoco_warns_of_is_logged_and_leaves_no_file(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    plant = make_physics("mujoco", husky_panda())
    with caplog.at_level(logging.WARNING):
        plant.step(np.full(7, np.nan), np.zeros(2), NOBODY)
    assert "MuJoCo: Nan" in caplog.text
    assert not list(tmp_path.iterdir())
