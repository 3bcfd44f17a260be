"""pybullet, MuJoCo and pinocchio agree on every robot whose meshes are installed."""

from __future__ import annotations

import logging
import re
from pathlib import Path

import numpy as np
import pytest

import app.robot.assets
from app.cli.options import Setup, fields_of
from app.errors import AssetError, ConfigError
from app.robot.assets import resolved_urdf, robot_names
from app.robot.description import load_robot
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation import plants
from app.simulation.plants import PLANTS, chosen_plant, default_plant, make_physics
from app.simulation.plants.planar import SAME_DEPTH, SAME_PICTURE, Planar, compare_engines
from tests.robots import husky_panda

NOBODY = np.zeros(3)


def installed(name: str) -> RobotModel:
    """The model of a robot; skip the test if the robot's meshes are not installed."""
    description = load_robot(name)
    try:
        resolved_urdf(description)
    except AssetError as error:
        pytest.skip(str(error))
    return RobotModel(description)


@pytest.mark.parametrize("name", robot_names())
def test_engines_agree_on_pictures_and_contacts(name: str):
    found = compare_engines(installed(name), postures=100, pictures=2)
    assert found.picture < SAME_PICTURE
    assert found.depth < SAME_DEPTH  # [m] depth of contacts in one engine alone
    assert found.contacts > 0


@pytest.mark.parametrize("name", robot_names())
@pytest.mark.parametrize("engine", ["mujoco", "pybullet"])
def test_mass_matrix_and_bias_forces_agree_with_pinocchio(name: str, engine: str):
    model, rng = installed(name), np.random.default_rng(1)
    state, n_b = RobotState(model), model.n_b
    other = Planar(engine, model)
    for _ in range(20):
        q_m, qd = rng.uniform(model.q_lower, model.q_upper), rng.uniform(-1, 1, model.n)
        state.update(Measurement(NOBODY, model.J_m @ qd[:n_b], q_m, qd[n_b:]))
        M, h = other.mass_and_bias(q_m, qd)
        assert np.abs(M - state.M).max() < 1e-8 * np.abs(state.M).max()
        assert np.abs(h - state.h).max() < 1e-8 * np.abs(state.h).max()
    other.close()


@pytest.mark.parametrize("name", robot_names())
def test_step_from_rest_obeys_the_equation_of_motion_with_a_fixed_base(name: str):
    """One step of dt from rest gives the velocity q̈_a dt."""
    model, rng = installed(name), np.random.default_rng(2)
    plant, state, n_b = Planar("mujoco", model), RobotState(model), model.n_b
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


def test_default_engine_is_pybullet_if_installed_else_mujoco(monkeypatch):
    monkeypatch.setattr(plants, "find_spec", lambda name: name == "pybullet")
    assert default_plant() == chosen_plant(None) == "planar"
    monkeypatch.setattr(plants, "find_spec", lambda name: None)
    assert default_plant() == chosen_plant(None) == "mujoco"
    with pytest.raises(ConfigError, match=r"planar needs pybullet.*--physics mujoco"):
        make_physics("planar", husky_panda())


def test_former_name_of_the_contact_plant_still_works():
    assert chosen_plant("contact") == "mujoco-contact" in PLANTS


def test_contacts_without_meshes_use_the_convex_bodies_and_log_a_warning(monkeypatch, caplog):
    """The case of a machine without the packages that contain the meshes."""

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
        assert 0.0 < deepest < 0.005  # [m] contact with little penetration
        plant.close()


def test_warnings_of_mujoco_are_logged_and_leave_no_file(tmp_path, monkeypatch, caplog):
    monkeypatch.chdir(tmp_path)
    plant = make_physics("mujoco", husky_panda())
    with caplog.at_level(logging.WARNING):
        plant.step(np.full(7, np.nan), np.zeros(2), NOBODY)
    assert "MuJoCo: Nan" in caplog.text
    assert not list(tmp_path.iterdir())


def test_help_of_a_run_names_every_plant() -> None:
    help_text = dict(fields_of(Setup))["physics"].help
    assert all(re.search(rf"\b{name}\b(?!-)", help_text) for name in PLANTS)
