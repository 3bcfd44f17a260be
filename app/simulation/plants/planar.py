"""The planar plant, with pybullet or MuJoCo, and the comparison of these engines for a robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from contextlib import closing
from itertools import product
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from app.robot.link_pairs import sample_joints
from app.robot.model import RobotModel
from app.robot.state import Measurement, RobotState
from app.simulation.plants.door import OpenDoor
from app.simulation.plants.interface import Contacts, Drive, Physics, Push
from app.strict import Array

if TYPE_CHECKING:
    from app.simulation.plants.bullet_world import BulletRobot
    from app.simulation.plants.mujoco_world import MujocoWorld

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


class Planar(Physics):
    """A plant whose base cannot tip; motors of limited force move its joints x, y and yaw."""

    def __init__(
        self,
        engine: Literal["pybullet", "mujoco"],
        model: RobotModel,
        *,
        dt: float = 0.001,
        door: OpenDoor | None = None,
    ) -> None:
        """Load the robot into an engine; arguments, posture and errors as in `make_physics`."""
        # Imported here, because each engine must work without the other engine's library.
        if engine == "pybullet":
            from app.simulation.plants.bullet_world import BulletRobot

            self.world: BulletRobot | MujocoWorld = BulletRobot(model, dt, door)
        else:
            from app.simulation.plants.mujoco_world import MujocoWorld, RobotSpec

            self.world = MujocoWorld(RobotSpec(model, dt), door)
        self.dt, self.door, self._S = dt, self.world.door, model.S
        base = model.description.base
        self._drive, self._T = Drive(base, dt), base.T
        self.reset(np.zeros(3), np.array(model.description.arm.ready_position))

    def reset(self, base_pose: Array, q_m: Array) -> None:
        self.world.reset(np.concatenate([base_pose, q_m]))
        self._drive.reset()
        self._heading: float | None = None  # [rad] heading, if measured since the last step

    def measure(self) -> Measurement:
        pose, v, q_m, qd_m = self.world.read()
        self._heading = heading = pose.item(2)
        c, s = math.cos(heading), math.sin(heading)
        x, y, w = v
        velocity = np.array([c * x + s * y, c * y - s * x, w]) @ self._T
        return Measurement(pose, velocity, q_m, qd_m, self._drive.state)

    def step(
        self, u_a: Array, base_velocity: Array, hand_force: Array, pushes: Sequence[Push] = ()
    ) -> None:
        heading = self.world.read()[0].item(2) if self._heading is None else self._heading
        twist = (self._T @ self._drive.step(base_velocity)).tolist()
        self.world.step(u_a, world_twist(twist, heading, self.dt), hand_force, pushes)
        self._heading = None

    def contacts(self) -> Contacts:
        return self.world.contacts()

    def mass_and_bias(self, q_m: Array, qd: Array) -> tuple[Array, Array]:
        """M (n, n) and C q̇ + g (n,) of (26) from the engine, at q_m and q̇, with the heading 0."""
        S = self._S
        v = S @ qd  # at heading 0 the axes of base and world coincide
        M, h = self.world.mass_and_bias(np.concatenate([np.zeros(3), q_m]), v)
        # The world's axes do not turn with the base: v̇ = S q̈ + (-ω v_y, ω v_x, 0).
        turning = np.zeros(len(v))
        turning[:2] = -v[2] * v[1], v[2] * v[0]
        return S.T @ M @ S, S.T @ (h + M @ turning)

    def close(self) -> None:
        self.world.close()


def world_twist(twist: Sequence[float], heading: float, dt: float) -> list[float]:
    """The mean twist (3,) in the world during a step of `dt` [s], for a constant `twist` (3,) in
    the base's frame: v_x, v_y [m/s] and ω [rad/s]. `heading` [rad] is that of the base at the start
    of the step; the mean uses the heading in the middle of the step.
    """
    x, y, w = twist
    phi = heading + 0.5 * w * dt
    c, s = math.cos(phi), math.sin(phi)
    return [x * c - y * s, x * s + y * c, w]


class Difference(NamedTuple):
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
