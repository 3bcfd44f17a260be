"""Avoidance with a base of several convex parts: the arm avoids each of them."""

from __future__ import annotations

from functools import cache

import numpy as np
import pinocchio as pin
import pytest

from app.avoidance.closest_points import SmoothPoints
from app.border.cache import BorderData
from app.config import Config
from app.control.controller import Controller
from app.control.explanation import explain
from app.control.quantities import ControlStep
from app.control.tasks import Reference
from app.robot.link_pairs import Pair, PairDistances, candidate_pairs
from app.robot.shapes import Box
from app.robot.state import Measurement, RobotState
from tests.nearest import SmoothMonitor, library_nearest, smooth_points
from tests.qps import Limits
from tests.robots import husky_panda, with_mobile_shapes

Array = np.ndarray
Normals = tuple[tuple[float, float, float], tuple[float, float, float]]

AT_ONCE = Config().replace("limit.torque_rate", 1e6)
DECK = Box(type="box", size_m=(0.99, 0.69, 0.3803), xyz_m=(0.0, 0.0, 0.0579))
WALL = Box(type="box", size_m=(0.99, 0.10, 0.50), xyz_m=(0.0, 0.30, 0.50))
"""It stands on the deck's left edge and forms a concave corner beside the arm."""
FRONT, REAR = (
    Box(type="box", size_m=(0.495, 0.69, 0.3803), xyz_m=(x, 0.0, 0.0579)) for x in (0.2475, -0.2475)
)
"""The deck as two adjacent boxes."""
UP, BESIDE = (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)


def near_both(a: Box, b: Box, normals: Normals, seed: int) -> Measurement:
    """A random slow state with the end-effector near two boxes, in the directions `normals`."""
    rng, robot = np.random.default_rng(seed), husky_panda()
    models = [with_mobile_shapes((shape,)) for shape in (a, b)]
    readers = [PairDistances(model, candidate_pairs(model)) for model in models]
    lm_lEE = [pair.name for pair in readers[0].pairs].index("lm-lEE")
    while True:
        q_m = rng.uniform(robot.q_lower + 0.3, robot.q_upper - 0.3)
        for reader, normal in zip(readers, normals, strict=True):
            reader.update(robot.configuration(np.zeros(3), q_m))
            near = reader.closest(lm_lEE)
            others = np.delete(reader.distances(), lm_lEE)
            if not (0.03 < near.d < 0.05 and near.n @ normal > 0.99 and others.min() > 0.08):
                break
        else:
            v = rng.normal(scale=0.02, size=robot.n)
            return Measurement(np.zeros(3), v[:2], q_m, v[2:])


@cache
def in_the_corner(seed: int) -> Measurement:
    return near_both(DECK, WALL, (UP, BESIDE), seed)


def controller_of(data: BorderData, name: str, *shapes: Box) -> Controller:
    return Controller(with_mobile_shapes(shapes), data, AT_ONCE, name=name)


def controlled(controller: Controller, m: Measurement, acceleration: Array) -> ControlStep:
    """The control step for a demanded acceleration (3,) [m/s²] of the end-effector."""
    controller.reset()
    controller.step(m)
    pose = pin.SE3(controller.state.T_world_ee)
    controller.reset()
    return controller.step(m, Reference(pose, np.zeros(6), np.append(acceleration, np.zeros(3))))


def violation(output: ControlStep) -> Array:
    """(k,) [m/s²] violation of each barrier; negative if it is satisfied."""
    C, l, _, _ = barriers(output)
    return l - C @ output.qdd


def barriers(output: ControlStep) -> Limits:
    """The barriers of the arm's QP, whose rows follow those of torques and joints."""
    return Limits(*(each[2 * len(output.q_m) :] for each in Limits.of(output)))


@pytest.mark.parametrize("name", ["dbb", "barrier"])
def test_base_of_two_parts_has_the_barriers_of_both_parts(
    border_data: BorderData, name: str
) -> None:
    def rows_of(*shapes: Box) -> Limits:
        return barriers(controller_of(border_data, name, *shapes).step(in_the_corner(0)))

    n = len(border_data.pairs.mobile)
    for both, deck, wall in zip(rows_of(DECK, WALL), rows_of(DECK), rows_of(WALL), strict=True):
        parts = np.stack([deck[:n], wall[:n]], axis=1)
        np.testing.assert_allclose(both[: 2 * n], parts.reshape(both[: 2 * n].shape), atol=1e-9)
        np.testing.assert_allclose(both[2 * n :], deck[n:], atol=1e-9)  # between links


@pytest.mark.parametrize("name", ["dbb", "barrier"])
@pytest.mark.parametrize("seed", range(2))
def test_both_faces_of_a_corner_limit_the_arm(
    border_data: BorderData, name: str, seed: int
) -> None:
    """The demanded motion enters deck and wall; the explanation lists their pair once."""
    controller = controller_of(border_data, name, DECK, WALL)
    output = controlled(controller, in_the_corner(seed), -20.0 * (np.array(UP) + BESIDE))
    np.testing.assert_allclose(
        violation(output)[:2], 0.0, atol=0.1
    )  # soft, and both at their bound
    assert violation(output).max() < 0.1
    bounds = explain(controller, output, AT_ONCE, np.zeros(2)).bounds
    assert [bound.where for bound in bounds if bound.kind == "barrier"] == ["lm-lEE"]


def reaction(output: ControlStep) -> Array:
    """(n_m,) [N m] reaction of a guided arm to the force on the base, from the step's objective."""
    return output.h[2:] - output.c_low[2:] - output.u_free


def test_normals_and_points_are_continuous_where_the_nearest_face_changes(
    border_data: BorderData,
) -> None:
    """Steps that are ten times smaller change them less than a fifth as much."""
    controller, m = controller_of(border_data, "dbb", DECK, WALL), in_the_corner(0)
    monitor = SmoothMonitor(controller.state, border_data.pairs.mobile)

    def largest_step(steps: int) -> float:
        found = []
        for s in np.linspace(-0.1, 0.1, steps + 1):
            controller.state.update(m._replace(q_m=m.q_m + s * np.array([0, 1, 0, 1, 0, 0, 0])))
            closest = monitor.find_nearest(0.005).closest(0)
            found.append([v for each in (closest, *closest.parts) for v in (each.n, each.core)])
            nearest.add(min(range(2), key=lambda k: closest.parts[k].d))
        return float(np.abs(np.diff(found, axis=0)).max())

    nearest: set[int] = set()
    assert largest_step(2000) < 0.2 * largest_step(200)
    assert nearest == {0, 1}


def test_kernel_agrees_with_the_library_on_the_points_of_each_part() -> None:
    state, blend = RobotState(with_mobile_shapes((DECK, WALL))), 0.005  # [m]
    state.update(in_the_corner(0))
    pairs = [Pair("lm", "lEE"), Pair("lm", "l3")]
    smooth = SmoothPoints(state.model, pairs)
    found = smooth_points(smooth, state, blend)
    assert smooth.rows == [[0, 2, 3], [1, 4, 5]]
    for pair, rows in zip(pairs, smooth.rows, strict=True):
        for row, parts in zip(rows, (slice(2), slice(1), slice(1, 2)), strict=True):
            expected = library_nearest(state, pair, blend, parts)
            np.testing.assert_allclose(found[row], expected, atol=2e-5)


def test_two_halves_of_a_base_act_as_the_whole(border_data: BorderData) -> None:
    """The reaction on a guided arm counts once, and the QP solves the two coplanar rows."""
    whole = controller_of(border_data, "dbb", DECK)
    halves = controller_of(border_data, "dbb", FRONT, REAR)
    for seed in range(2):
        m = near_both(FRONT, REAR, (UP, UP), seed)
        guided = [reaction(controller.step(m)) for controller in (whole, halves)]
        assert np.abs(guided[0]).max() > 0.1
        np.testing.assert_allclose(guided[1], guided[0], atol=0.05 * np.abs(guided[0]).max())
        one, two = (controlled(each, m, -20.0 * np.array(UP)) for each in (whole, halves))
        assert (
            -1.0 < violation(two)[:2].min() <= violation(two).max() < 0.1
        )  # both nearly at their bound
        np.testing.assert_allclose(two.u_cmd, one.u_cmd, atol=0.02 * np.abs(one.u_cmd).max())
        assert two.failures == two.given_up == 0
