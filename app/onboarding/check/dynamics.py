"""Checks of joints and dynamics: libraries agree, limits are sane, the ready pose is free."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin

from app.border.cache import BorderData
from app.config import Config
from app.onboarding.check.row import Outcome, Row
from app.onboarding.fit.postures import judge_ready
from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState

if TYPE_CHECKING:
    from app.simulation.plants.bullet_dynamics import BulletDynamics
    from app.simulation.plants.mujoco_dynamics import MujocoDynamics

Array = np.ndarray

_POSES = 20
_AGREE = 1e-6  # [-] of the largest entry
_FASTEST, _STRONGEST = 20.0, 2000.0  # [rad/s or m/s], [N m or N] of a joint
_MARGIN = 0.02  # [-] share of a joint's range between the ready pose and a limit


def bullet_row(model: RobotModel) -> Row:
    """M and C q̇ + g in random states, from pinocchio and from pybullet."""
    if not find_spec("pybullet"):
        return Row("pybullet", "warned", "not installed here: pip install pybullet", {})
    from app.simulation.plants.bullet_dynamics import BulletDynamics

    return _dynamics_row("pybullet", model, BulletDynamics(model))


def mujoco_row(model: RobotModel) -> Row:
    """The same from pinocchio and from MuJoCo."""
    from app.simulation.plants.mujoco_dynamics import MujocoDynamics

    return _dynamics_row("mujoco", model, MujocoDynamics(model))


def engines_row(model: RobotModel) -> Row:
    """What both engines see of the robot in random poses, and what they say touches."""
    if not find_spec("pybullet"):
        return Row("engines", "warned", "pybullet is not installed: nothing to compare with", {})
    from app.simulation.plants.engines import SAME_DEPTH, SAME_PICTURE, compare_engines

    found = compare_engines(model)
    good = found.picture < SAME_PICTURE and found.depth < SAME_DEPTH
    return Row(
        "engines",
        "passed" if good else "failed",
        f"pictures differ in {found.picture:.1%} of their rays; of what touches in {found.poses} "
        f"poses, one engine alone has nothing deeper than {1e3 * found.depth:.1f} mm",
        {"picture_difference": found.picture, "contact_difference_m": found.depth},
    )


def _dynamics_row(name: str, model: RobotModel, engine: MujocoDynamics | BulletDynamics) -> Row:
    rng, state, n_b = np.random.default_rng(0), RobotState(model), model.n_b
    worst_M = worst_h = 0.0
    try:
        for q_m in sample_joints(model, _POSES, rng):
            qd = np.concatenate([rng.uniform(-1, 1, n_b), rng.uniform(-0.5, 0.5, model.n_m)])
            base_velocity = model.J_m @ qd[:n_b]
            state.update(Measurement(np.zeros(3), base_velocity, q_m, qd[n_b:]))
            M, h = engine.mass_and_bias(q_m, qd)
            worst_M = max(worst_M, float(np.abs(M - state.M).max() / np.abs(state.M).max()))
            worst_h = max(worst_h, float(np.abs(h - state.h).max() / np.abs(state.h).max()))
    finally:
        engine.close()
    worst = max(worst_M, worst_h)
    good = worst < _AGREE
    return Row(
        name,
        "passed" if good else "failed",
        f"M and C q̇ + g differ from pinocchio's by {worst:.1e} of the largest entry"
        + ("" if good else "; give every link an <inertial>, 0 for frames"),
        {"M_difference": worst_M, "nle_difference": worst_h},
    )


def limits_row(model: RobotModel) -> Row:
    """Limits that a motor can have, gravity that it can hold, inertia that the step can take."""
    arm = model.description.arm
    data = model.pin.createData()
    load, least = np.zeros(model.n_m), np.full(model.n_m, np.inf)
    for q_m in sample_joints(model, 200, np.random.default_rng(0)):
        q = model.configuration((0.0, 0.0, 0.0), q_m)
        gravity = pin.computeGeneralizedGravity(model.pin, data, q)[3:]
        load = np.maximum(load, np.abs(gravity))
        M = pin.crba(model.pin, data, q)
        least = np.minimum(least, np.diag(M)[3:])
    wrong = [
        f"{name} has {speed:g} rad/s (or m/s) and {effort:g} N m (or N)"
        for name, speed, effort in zip(arm.joints, model.qd_max, model.tau_max, strict=True)
        if speed > _FASTEST or effort > _STRONGEST
    ]
    wrong += [
        f"{name} moves no inertia" for name, m in zip(arm.joints, least, strict=True) if m <= 1e-9
    ]
    weak = [
        f"{name} holds {effort:g} of {most:.3g} N m (or N)"
        for name, effort, most in zip(arm.joints, model.tau_max, load, strict=True)
        if effort < most
    ]
    share = float((load / model.tau_max).max())
    if wrong:
        return Row("limits", "failed", "; ".join(wrong), {"gravity_share": share})
    text = f"gravity takes at most {share:.0%} of a joint's torque"
    if weak:
        text = f"gravity is more than a joint holds in some poses: {'; '.join(weak)}"
    return Row("limits", "warned" if weak else "passed", text, {"gravity_share": share})


def ready_row(model: RobotModel, data: BorderData) -> Row:
    """The ready pose: away from the limits and outside of every buffer."""
    d_b = Config().border.d_b
    q_m = np.array(model.description.arm.ready_position)
    span = model.q_upper - model.q_lower
    left = float((np.minimum(q_m - model.q_lower, model.q_upper - q_m) / span).min())
    ready = judge_ready(model, data.pairs, q_m, d_b=d_b)
    if not data.pairs.all:
        return Row("ready pose", "passed", "no bodies can meet", {})
    numbers = {"beyond_buffer_m": ready.clearance, "least_joint_margin": left}
    text = f"{ready.nearest} is {ready.clearance:+.3f} m from its buffer, joints {left:.0%} of "
    text += "their range from a limit at least"
    outcome: Outcome = "passed" if ready.clearance >= 0 and left >= _MARGIN else "warned"
    return Row("ready pose", outcome, text, numbers)
