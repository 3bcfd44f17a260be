"""The second derivative of a pair's distance, compared with differences of the library's distance.

A row of the law has the formula d̈ = J q̈ + J̇ q̇. The bodies move along motions with known q̇ and q̈,
and differences of their distances give the true d̈. The error of this formula is compared with the
errors of two formulas for closest points that are fixed to their bodies. One of these has the term
|v_across|²/d, the other one does not; v_across is the points' relative velocity across the normal.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from app.avoidance.closest_points import ClosestPoints
from app.config import Config
from app.robot.link_pairs import PairDistances
from app.robot.state import RobotState, point_bias
from benchmarks.law.motions import Motion, random_motion
from benchmarks.law.options import Options
from benchmarks.law.postures import posture_in_buffer
from benchmarks.law.report import Report
from benchmarks.law.robot import Robot, load
from benchmarks.law.work import played
from tests.nearest import SmoothMonitor

Array = np.ndarray

_H = 0.002  # [s] step of the differences
_FIVE = np.array([-1.0, 16.0, -30.0, 16.0, -1.0]) / 12.0  # second difference of fourth order
_KINK = 0.05  # [m/s²] and [-] largest change of a difference with the step; more means a kink
_MIN_D = 0.02  # [m] smallest divisor d of the term |v_across|²/d
_MIN_ROWS = 5  # [-] smallest number of samples of a displayed pair
_MODELS = "law", "without_term", "with_term"


class Posture(NamedTuple):
    """The number of a posture, and the largest speed [m/s] of the end-effector around it."""

    options: Options
    number: int
    speed: float


class Sample(NamedTuple):
    """Errors of one pair at one instant.

    Attributes:
        pair: Name of the pair.
        errors: [m/s²] errors of `_MODELS`; None if the distance has a kink.
    """

    pair: str
    errors: tuple[float, float, float] | None


def curvature(options: Options, count: int = 400, speed: float = 0.5) -> Report:
    """Compare d̈ of the law's rows with differences of distances along smooth motions.

    Args:
        options: See `Options`.
        count: Number of postures inside the buffer.
        speed: [m/s] largest speed of the end-effector.
    """
    postures = [Posture(options, k, speed) for k in range(count)]
    samples = [each for row in played(_samples, postures, options.jobs, "postures") for each in row]
    rows = []
    for pair in load(options.robot).pair_names:
        errors = [s.errors for s in samples if s.pair == pair and s.errors is not None]
        if len(errors) >= _MIN_ROWS:
            rows.append(_row(pair, np.array(errors)))
    smooth = np.array([s.errors for s in samples if s.errors is not None])
    summary = {
        "samples": len(samples),
        "kinks_left_out": sum(s.errors is None for s in samples),
        **{
            f"{name}_error_95_mps2": float(np.quantile(np.abs(e), 0.95))
            for name, e in zip(_MODELS, smooth.T, strict=True)
        },
    }
    return Report("curvature", rows, summary)


def _row(pair: str, errors: Array) -> dict[str, Any]:
    found: dict[str, Any] = {"pair": pair, "samples": len(errors)}
    for name, e in zip(_MODELS, errors.T, strict=True):
        size = np.abs(e)
        found[f"{name}: median, 95 %, max"] = [
            float(np.median(size)),
            float(np.quantile(size, 0.95)),
            float(size.max()),
        ]
        found[f"{name}: bias"] = float(e.mean())
    return found


def _samples(posture: Posture) -> list[Sample]:
    """Errors of all pairs inside the buffer: d̈ of each of `_MODELS` minus the true d̈."""
    robot = load(posture.options.robot)
    rng = np.random.default_rng([posture.options.seed, posture.number])
    motion = random_motion(robot.model, posture_in_buffer(robot, rng), posture.speed, rng, 1.0)
    t, state = 0.5, RobotState(robot.model)
    measured, vd, qdd = motion.at(t)
    state.update(measured)
    qdd_all = np.concatenate([robot.model.J_m_inv @ vd, qdd])
    fine, coarse = _differences(robot, motion, t, _H), _differences(robot, motion, t, 2 * _H)
    reader = PairDistances(robot.model, robot.data.pairs.all)
    reader.update_from(state.data)
    config = Config()
    monitor = SmoothMonitor(state, robot.data.pairs.all)
    nearest = monitor.find_nearest(config.activation.closest_point_smoothing)
    found = []
    for i, pair in enumerate(reader.pairs):
        closest = nearest.closest(i)
        if not 0.0 < closest.d < Config().border.d_b:
            continue
        if abs(fine[i] - coarse[i]) > _KINK * (1.0 + abs(fine[i])):
            found.append(Sample(pair.name, None))
            continue
        joints = np.array([[state.model.body_joints[body] for body in closest.pair]])
        (J,), (Jdqd,), _ = state.distance_motions(joints, closest.core[None], closest.n[None])
        bias, across = _fixed_points(state, closest)
        without = float(J @ qdd_all) + bias - float(fine[i])
        law = float(J @ qdd_all) + Jdqd - float(fine[i])
        term = across / max(closest.d, _MIN_D)
        found.append(Sample(pair.name, (law, without, without + term)))
    return found


def _fixed_points(state: RobotState, closest: ClosestPoints) -> tuple[float, float]:
    """Terms of d̈ for closest points that are fixed to their bodies.

    Returns:
        nᵀ(J̇_b - J̇_a) q̇ [m/s²], and the square [m²/s²] of the points' relative speed across n.
    """
    model, n = state.model, closest.n
    a, b = model.body_joints[closest.pair.a], model.body_joints[closest.pair.b]
    bias = _point_bias(state, b, closest.p_b) - _point_bias(state, a, closest.p_a)
    v = state.point_velocity(b, closest.p_b) - state.point_velocity(a, closest.p_a)
    across = v - (v @ n) * n
    return float(n @ bias), float(across @ across)


def _point_bias(state: RobotState, joint: int, p: Array) -> Array:
    """(3,) [m/s²] acceleration at q̈ = 0 of the point at p (3,) of the body on a joint."""
    return np.array(point_bias(state.twists[joint], state.biases[joint], p))


def _differences(robot: Robot, motion: Motion, t: float, h: float) -> Array:
    """(pairs,) [m/s²] d̈ of each pair at t [s], from the library's distances in steps of h [s]."""
    reader = PairDistances(robot.model, robot.data.pairs.all)
    d = np.empty((len(_FIVE), len(reader.pairs)))
    for k in range(len(_FIVE)):
        q = motion.at(t + (k - 2) * h)[0].q_m
        reader.update(robot.model.configuration((0.0, 0.0, 0.0), q))
        d[k] = reader.distances()
    return _FIVE @ d / h**2
