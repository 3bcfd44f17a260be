"""Pictures of the robot without display, browser or graphics card: pybullet's software renderer.

The renderer gives the bodies; the floor, its fine grid and soft shadows are painted analytically,
as a texture would blur. What a figure draws over a picture it places with `Picture.pixels`.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import trimesh
from scipy import ndimage

from app.robot.assets import PLANAR_JOINTS, planar_urdf
from app.robot.model import RobotModel
from app.simulation.plants.bullet_world import BulletWorld, pybullet
from app.simulation.session import DT

Array = np.ndarray
Rgba = tuple[float, float, float, float]

_FINER = 2  # [-] rendered pixels per pixel and direction
_NEAR, _FAR = 0.1, 30.0  # [m] what is drawn of the depth
_LIGHT = (2.0, -2.5, 5.0)  # [m] turned with the camera, so that shadows fall to one side
_FLOOR = np.array([243.0, 245.0, 247.0])
_LINE = np.array([221.0, 225.0, 230.0])
_GRID = 0.25  # [m] between two lines of the floor
_FADE = 1.8, 4.0  # [m] from the target: where the grid begins and ends to fade
_SUN = 20.0  # [m] from the light to the target
_SHADOW_SIZE = 2.5  # [m] around the target in which shadows fall
_SHADOW_PIXELS = 400
_SOFTNESS = 2.0  # [px] of a shadow's edge
_SHADOW = 0.20  # [-] how much darker a shadow is


class Camera(NamedTuple):
    """Where a picture is taken from.

    Attributes:
        target: (3,) [m] what it looks at, in the world.
        distance: [m] from the target.
        yaw: [rad] direction in plan from the target to the camera, from the world's x axis.
        pitch: [rad] height of the camera over the horizon, seen from the target.
        width: [px] of the picture.
        height: [px] of the picture.
        fov: [rad] vertical field of view; a small one keeps upright edges upright.
    """

    target: Array
    distance: float
    yaw: float
    pitch: float
    width: int = 480
    height: int = 480
    fov: float = 0.35

    @property
    def eye(self) -> Array:
        """(3,) [m] the camera's place in the world."""
        flat = math.cos(self.pitch)
        towards = [flat * math.cos(self.yaw), flat * math.sin(self.yaw), math.sin(self.pitch)]
        return np.asarray(self.target) + self.distance * np.array(towards)

    def framing(self, points: Array, margin: float = 0.06) -> Camera:
        """The same camera moved so that points (N, 3) [m] of the world just fill the picture.

        The margin [-] of the picture stays free on each side.
        """
        camera = self
        for _ in range(8):  # the perspective's share of the place changes a little each time
            at = _project(points, *camera.matrices())
            middle = (at.max(axis=0) + at.min(axis=0)) / 2
            half = (at.max(axis=0) - at.min(axis=0)) / 2
            right, up = camera.matrices()[0][:2, :3]
            reach = camera.distance * math.tan(self.fov / 2)
            aspect = self.width / self.height
            shift = middle[0] * reach * aspect * right + middle[1] * reach * up
            camera = camera._replace(
                target=camera.target + shift,
                distance=camera.distance * float(half.max()) / (1 - 2 * margin),
            )
        return camera

    def matrices(self) -> tuple[Array, Array]:
        """(4, 4) view and (4, 4) projection, for column vectors."""
        view = pybullet.computeViewMatrix(self.eye.tolist(), list(self.target), [0, 0, 1])
        projection = pybullet.computeProjectionMatrixFOV(
            math.degrees(self.fov), self.width / self.height, _NEAR, _FAR
        )
        return _matrix(view), _matrix(projection)


class Solid(NamedTuple):
    """A body beside the robot.

    Attributes:
        mesh: Its surface, in the world.
        rgba: Its colour.
    """

    mesh: trimesh.Trimesh
    rgba: Rgba


class Picture(NamedTuple):
    """A picture with what is needed to draw over it.

    Attributes:
        rgb: (height, width, 3) uint8.
        floor: (height, width) bool, where nothing stands before the floor or the background.
        view: (4, 4) from the world to the camera.
        projection: (4, 4) from the camera to the clip space.
    """

    rgb: Array
    floor: Array
    view: Array
    projection: Array

    def pixels(self, points: Array) -> Array:
        """(N, 2) [px] column and row of points (N, 3) [m] in the world."""
        height, width = self.floor.shape
        at = _project(np.atleast_2d(points), self.view, self.projection)
        return (at * [1, -1] + 1) / 2 * [width, height] - 0.5

    def unhidden(self, points: Array) -> Array:
        """(N,) bool, whether points (N, 3) [m] on the floor are in the picture and unhidden."""
        height, width = self.floor.shape
        column, row = np.rint(self.pixels(points)).astype(int).T
        inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
        return inside & self.floor[row.clip(0, height - 1), column.clip(0, width - 1)]


class Photographer:
    """Takes pictures of one robot, in a pybullet client of its own, until it is closed."""

    def __init__(self, model: RobotModel) -> None:
        """Load the robot's visual meshes.

        Raises:
            AssetError: A mesh is missing, or pybullet cannot load the robot.
        """
        self._world = BulletWorld(planar_urdf(model.description), DT)
        self._client = self._world.client
        self._client.removeBody(self._world.floor)  # it is painted
        names = (*PLANAR_JOINTS, *model.description.arm.joints)
        self._joints = [self._world.joints[name] for name in names]

    def close(self) -> None:
        """End the client; may be called twice."""
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
        """A picture of the robot.

        Args:
            base_pose: (3,) x, y [m] and heading [rad] of the base.
            q_m: (n_m,) [rad or m] the arm's joints.
            camera: Where from.
            solids: What else is to be seen.
            robot: Whether the robot itself is; without it only the solids are.
        """
        away = 0.0 if robot else 1000.0  # [m] far outside of any picture
        pose = [base_pose[0] + away, *base_pose[1:], *q_m]
        for joint, position in zip(self._joints, pose, strict=True):
            self._client.resetJointState(self._world.robot, joint, float(position))
        bodies = [self._add(solid) for solid in solids]
        try:
            return self._render(camera)
        finally:
            for body in bodies:
                self._client.removeBody(body)

    def _render(self, camera: Camera) -> Picture:
        fine = camera._replace(width=_FINER * camera.width, height=_FINER * camera.height)
        rgb, seen = self._shoot(fine)
        background = seen < 0
        floor = _floor_points(fine)
        lit = _painted_floor(fine, floor) * self._sunlight(fine, floor)[..., None]
        rgb = np.where(background[..., None], lit, rgb)
        return Picture(
            _smaller(rgb).round().astype(np.uint8),
            _smaller(background[..., None].astype(float))[..., 0] > 0.5,
            *camera.matrices(),
        )

    def _sunlight(self, camera: Camera, floor: Array) -> Array:
        """(height, width) how bright the floor is: what the light does not see lies in shadow."""
        x, y, z = _LIGHT
        sun = Camera(
            camera.target,
            _SUN,
            camera.yaw + math.atan2(y, x),
            math.atan2(z, math.hypot(x, y)),
            _SHADOW_PIXELS,
            _SHADOW_PIXELS,
            2 * math.atan(_SHADOW_SIZE / _SUN),
        )
        covered = ndimage.gaussian_filter((self._shoot(sun)[1] >= 0).astype(float), _SOFTNESS)
        at = _project(floor.reshape(-1, 3), *sun.matrices())
        row, column = (1 - at[:, 1]) / 2 * _SHADOW_PIXELS, (at[:, 0] + 1) / 2 * _SHADOW_PIXELS
        shadow = ndimage.map_coordinates(covered, [row - 0.5, column - 0.5], order=1, cval=0.0)
        return 1.0 - _SHADOW * shadow.reshape(floor.shape[:2])

    def _shoot(self, camera: Camera) -> tuple[Array, Array]:
        """(height, width, 3) colours and (height, width) bodies, -1 where there is none."""
        view, projection = camera.matrices()
        c, s = math.cos(camera.yaw), math.sin(camera.yaw)
        x, y, z = _LIGHT
        image = self._client.getCameraImage(
            camera.width,
            camera.height,
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
        shape = camera.height, camera.width
        rgb = np.reshape(image[2], (*shape, 4))[..., :3].astype(float)
        return rgb, np.reshape(image[4], shape)

    def _add(self, solid: Solid) -> int:
        """Show a solid; its body."""
        # Corners of their own for each face: pybullet would round the edges of a box.
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


def _floor_points(camera: Camera) -> Array:
    """(height, width, 3) [m] where the camera's rays meet the floor; NaN above the horizon."""
    view, projection = camera.matrices()
    column = (np.arange(camera.width) + 0.5) / camera.width * 2 - 1
    row = 1 - (np.arange(camera.height) + 0.5) / camera.height * 2
    x, y = np.meshgrid(column / projection[0, 0], row / projection[1, 1])
    rays = np.stack([x, y, -np.ones_like(x)], axis=-1) @ view[:3, :3]
    eye = camera.eye
    way = -eye[2] / np.where(rays[..., 2] < 0, rays[..., 2], np.nan)
    return (eye + way[..., None] * rays) * [1.0, 1.0, 0.0]


def _painted_floor(camera: Camera, floor: Array) -> Array:
    """(height, width, 3) colours of the floor with its grid, white from where the grid has faded.

    `floor` (height, width, 3) [m] is its place in each pixel.
    """
    pixel = np.gradient(floor[..., :2], axis=0), np.gradient(floor[..., :2], axis=1)
    size = np.hypot(*pixel)  # [m] a pixel's reach along x and along y
    off = np.abs((floor[..., :2] / _GRID + 0.5) % 1 - 0.5) * _GRID  # [m] from the next line
    line = (1.2 - off / np.maximum(size, 1e-9)).clip(0, 1).max(axis=-1)
    far = np.hypot(*np.moveaxis(floor[..., :2] - np.asarray(camera.target)[:2], -1, 0))
    fade = ((_FADE[1] - far) / (_FADE[1] - _FADE[0])).clip(0, 1)
    colour = _FLOOR + line[..., None] * (_LINE - _FLOOR)
    painted = 255 + (colour - 255) * fade[..., None]
    return np.where(np.isnan(painted), 255.0, painted)


def _smaller(image: Array) -> Array:
    """(h, w, c) mean of blocks of an image (h f, w f, c) of finer pixels."""
    h, w, c = image.shape
    return image.reshape(h // _FINER, _FINER, w // _FINER, _FINER, c).mean(axis=(1, 3))


def _project(points: Array, view: Array, projection: Array) -> Array:
    """(N, 2) right and up from the picture's middle, in halves of it."""
    clip = np.column_stack([points, np.ones(len(points))]) @ (projection @ view).T
    return clip[:, :2] / clip[:, 3:]


def _matrix(columns: Sequence[float]) -> Array:
    return np.reshape(columns, (4, 4), order="F")
