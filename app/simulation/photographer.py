"""Pictures of the robot by pybullet's software renderer, without display or graphics card."""

import math
from collections.abc import Iterable, Sequence
from contextlib import ExitStack
from typing import NamedTuple

import numpy as np
import trimesh
from typing_extensions import Self

from app.robot.assets import PLANAR_JOINTS, planar_urdf
from app.robot.model import RobotModel
from app.simulation.plants.bullet_world import BulletWorld, pybullet
from app.simulation.session import DT
from app.strict import Array

Rgba = tuple[float, float, float, float]
_FINER = 2  # [-] rendered pixels per pixel of the picture, along width and height
_NEAR, _FAR = 0.1, 30.0  # [m] smallest and largest drawn distance from the camera
_LIGHT = (2.0, -2.5, 5.0)  # [m] vector to the light at yaw 0; it turns with the camera's yaw


class Camera(NamedTuple):
    target: Array  # (3,) [m] point in the world at the centre of the picture
    distance: float  # [m] distance from the target
    yaw: float  # [rad] horizontal angle from the world's x axis to the camera, seen from `target`
    pitch: float  # [rad] elevation of the camera, seen from `target`
    width: int = 480  # [px] width of the picture
    height: int = 480  # [px] height of the picture
    fov: float = 0.35  # [rad] vertical field of view; if small, vertical edges are almost parallel

    @property
    def eye(self) -> Array:
        """(3,) [m] position of the camera in the world."""
        flat = math.cos(self.pitch)
        towards = [flat * math.cos(self.yaw), flat * math.sin(self.yaw), math.sin(self.pitch)]
        return np.asarray(self.target) + self.distance * np.array(towards)

    def framing(self, points: Array, margin: float = 0.06) -> Self:
        """A copy of the camera, moved so that points (N, 3) [m] in the world fill the picture. At
        each edge, at least the share `margin` [-] of the picture's width or height remains empty.
        """
        camera = self
        for _ in range(8):  # the perspective changes a little each time
            view, projection = camera.matrices()
            at = _project(points, projection @ view)
            middle = (at.max(axis=0) + at.min(axis=0)) / 2
            half = (at.max(axis=0) - at.min(axis=0)) / 2
            right, up = view[:2, :3]
            reach = camera.distance * math.tan(self.fov / 2)
            aspect = self.width / self.height
            shift = middle[0] * reach * aspect * right + middle[1] * reach * up
            distance = camera.distance * float(half.max()) / (1 - 2 * margin)
            camera = camera._replace(target=camera.target + shift, distance=distance)
        return camera

    def matrices(self) -> tuple[Array, Array]:
        """The matrices (4, 4) of view and projection, for column vectors."""
        view = pybullet.computeViewMatrix(self.eye.tolist(), list(self.target), [0, 0, 1])
        projection = pybullet.computeProjectionMatrixFOV(
            math.degrees(self.fov), self.width / self.height, _NEAR, _FAR
        )
        return np.reshape(view, (4, 4), order="F"), np.reshape(projection, (4, 4), order="F")


class Solid(NamedTuple):
    mesh: trimesh.Trimesh  # surface of an additional body in the picture, in the world
    rgba: Rgba


class Picture(NamedTuple):
    """A picture, with the data that a caller needs to draw further elements over it."""

    rgb: Array  # (height, width, 3) colours, uint8
    floor: Array  # (height, width) whether a pixel shows no body: floor or background
    to_clip: Array  # (4, 4) transform from the world to the clip space

    def pixels(self, points: Array) -> Array:
        """(N, 2) [px] column and row of points (N, 3) [m] in the world."""
        height, width = self.floor.shape
        at = _project(np.atleast_2d(points), self.to_clip)
        return (at * [1, -1] + 1) / 2 * [width, height] - 0.5

    def unhidden(self, points: Array) -> Array:
        """(N,) whether points (N, 3) [m] on the floor are visible in the picture."""
        height, width = self.floor.shape
        column, row = np.rint(self.pixels(points)).astype(int).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return inside & self.floor[row.clip(0, height - 1), column.clip(0, width - 1)]


class Photographer:
    """Takes pictures of one robot in a separate pybullet client."""

    def __init__(self, model: RobotModel) -> None:
        """Load the robot's visual meshes; raises the errors of `planar_urdf` and `BulletWorld`."""
        self._world = BulletWorld(planar_urdf(model.description), DT)
        self._client = self._world.client
        self._client.removeBody(self._world.floor)
        names = (*PLANAR_JOINTS, *model.description.arm.joints)
        self._joints = [self._world.joints[name] for name in names]

    def close(self) -> None:
        self._world.close()

    def take(
        self,
        base_pose: Sequence[float] | Array,
        q_m: Sequence[float] | Array,
        camera: Camera,
        solids: Iterable[Solid] = (),
        *,
        robot: bool = True,
    ) -> Picture:
        """Take a picture of the `solids` and, if `robot`, of the robot. `base_pose` is x, y [m] and
        heading [rad], `q_m` (n_m,) [rad or m] the joint positions.
        """
        away = 0.0 if robot else 1000.0  # [m] far outside of every picture
        positions = [base_pose[0] + away, *base_pose[1:], *q_m]
        for joint, position in zip(self._joints, positions, strict=True):
            self._client.resetJointState(self._world.robot, joint, float(position))
        with ExitStack() as after:
            for solid in solids:
                after.callback(self._client.removeBody, self._add(solid))
            return self._render(camera)

    def _render(self, camera: Camera) -> Picture:
        view, projection = camera.matrices()
        c, s = math.cos(camera.yaw), math.sin(camera.yaw)
        x, y, z = _LIGHT
        width, height = _FINER * camera.width, _FINER * camera.height
        image = self._client.getCameraImage(
            width,
            height,
            view.T.ravel().tolist(),
            projection.T.ravel().tolist(),
            lightDirection=[c * x - s * y, s * x + c * y, z],
            lightColor=[1, 1, 1],
            lightDistance=10,
            shadow=0,
            lightAmbientCoeff=0.6,
            lightDiffuseCoeff=0.45,
            lightSpecularCoeff=0.08,
            renderer=pybullet.ER_TINY_RENDERER,
        )
        empty = np.reshape(image[4], (height, width, 1)) < 0
        rgb = np.where(empty, 255.0, np.reshape(image[2], (height, width, 4))[..., :3])
        floor = _smaller(empty.astype(float))[..., 0] > 0.5
        return Picture(_smaller(rgb).round().astype(np.uint8), floor, projection @ view)

    def _add(self, solid: Solid) -> int:
        # Each face has its own vertices; otherwise pybullet would draw a box with rounded edges.
        flat = solid.mesh.copy()
        flat.unmerge_vertices()
        shape = self._client.createVisualShape(
            pybullet.GEOM_MESH,
            vertices=flat.vertices.tolist(),
            indices=flat.faces.ravel().tolist(),
            normals=flat.vertex_normals.tolist(),
            rgbaColor=list(solid.rgba),
        )
        return self._client.createMultiBody(0, -1, shape)


def _smaller(image: Array) -> Array:
    """The means (h, w, c) of blocks of f by f pixels of an image (h f, w f, c); f is `_FINER`."""
    h, w, c = image.shape
    return image.reshape(h // _FINER, _FINER, w // _FINER, _FINER, c).mean(axis=(1, 3))


def _project(points: Array, to_clip: Array) -> Array:
    """(N, 2) [-] picture coordinates, right and up, of points (N, 3) [m]; −1 and 1 at the edges."""
    clip = np.column_stack([points, np.ones(len(points))]) @ to_clip.T
    return clip[:, :2] / clip[:, 3:]
