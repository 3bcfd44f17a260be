"""Comparison of pybullet and MuJoCo for one robot: depth images and contacts."""

from contextlib import closing
from itertools import product
from typing import NamedTuple

import numpy as np

from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel
from app.robot.state import RobotState
from app.simulation.plants.planar import Planar
from app.strict import Array

SAME_DEPTH = 0.005
"""[m] largest tolerated depth of a contact that exists in only one engine: pybullet rounds its
hulls, and computes the depth of two hulls approximately."""
SAME_PICTURE = 0.002  # [-] share of differing rays below which pictures count as equal
_SAME_PLACE = 0.01  # [m] tolerance of a ray's hit: pybullet adds 1 mm to hulls, more at an angle
_EDGE = 0.003  # [m] distance of parallel rays in each direction: the tolerance at edges
_BESIDE = tuple(product((0, 1, -1), repeat=2))  # offsets of parallel rays, the ray itself first
_HALF, _PIXELS = 1.0, 48  # [m] half side of a picture; number of rays along a side
_MIDDLE, _FAR = 0.6, 3.0  # [m] height of the target, and distance of the viewpoint
_SIDES = ((1.0, 0.3, 0.4), (-0.6, 1.0, 0.3), (-0.5, -1.0, 1.0))  # directions of the viewpoints


class Difference(NamedTuple):
    """Differences between two engines in some postures."""

    picture: float  # [-] share of rays to the robot with different hits, in the worst picture
    depth: float  # [m] of the deepest contact of a kind that only one engine reports in a posture
    contacts: int  # number that both engines report, at most one of each kind in each posture
    postures: int  # number of postures


def compare_engines(
    model: RobotModel, *, postures: int = 30, pictures: int = 3, seed: int = 0
) -> Difference:
    """Put both planar plants into random postures, and compare contacts and depth images. Contacts
    are compared in all `postures`; depth images, one from each of three sides, only in the first
    `pictures` postures. This raises the errors of `make_physics`.
    """
    state, rng = RobotState(model), np.random.default_rng(seed)
    picture, depth, both = 0.0, 0.0, 0
    bullet = Planar("pybullet", model)
    with closing(bullet), closing(Planar("mujoco", model)) as mujoco:
        plants = bullet, mujoco
        for k, q_m in enumerate(sample_joints(model, postures, rng)):
            base = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3)])
            for plant in plants:
                plant.reset(base, q_m)
            state.update(bullet.measure())
            if k < pictures:
                picture = max(picture, *(_picture(plants, base, side) for side in _SIDES))
            for plant in plants:
                plant.step(state.g[model.n_b :], np.zeros(model.n_b), np.zeros(3))
            one, other = (plant.world.depths() for plant in plants)
            both += len(one.keys() & other.keys())
            depth = max([depth, *((one | other)[group] for group in one.keys() ^ other.keys())])
    return Difference(picture, depth, both, postures)


def _picture(plants: tuple[Planar, Planar], base: Array, side: tuple[float, ...]) -> float:
    """[-] share of the rays onto the robot, all from one side, whose hits differ in the engines."""
    forward = -np.array(side) / np.linalg.norm(side)
    right = np.cross(forward, (0.0, 0.0, 1.0))
    right /= np.linalg.norm(right)
    across = np.array([right, np.cross(right, forward)])
    grid = np.linspace(-_HALF, _HALF, _PIXELS)
    begins = np.array([*base[:2], _MIDDLE]) - _FAR * forward
    begins = begins + np.stack(np.meshgrid(grid, grid), axis=-1).reshape(-1, 2) @ across
    way, (bullet, mujoco) = 2 * _FAR * forward, plants
    one = bullet.world.seen(begins, begins + way)
    beside = [begins + _EDGE * (u * across[0] + v * across[1]) for u, v in _BESIDE]
    others = np.array([mujoco.world.seen(each, each + way) for each in beside])
    floor = -begins[:, 2] / forward[2] - _SAME_PLACE
    on_robot = (one < floor) | (others[0] < floor)
    off = (one < others.min(axis=0) - _SAME_PLACE) | (one > others.max(axis=0) + _SAME_PLACE)
    return float((off & on_robot).sum() / on_robot.sum())
