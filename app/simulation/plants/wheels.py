"""Where a differential base stands on the floor: its driven wheels and its casters."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import product

import numpy as np
import pinocchio as pin

from app.robot.description import differential
from app.robot.meshes import shape_mesh
from app.robot.model import RobotModel
from app.robot.urdf import bare_urdf

Array = np.ndarray

_LEAST_MASS = 0.005  # [-] of a wheel that has none in the URDF, in masses of the base


class Wheels:
    """The driven wheels in the frame of the root, which stands on the floor.

    Attributes:
        radius: [m] of each.
        centres: (n, 3) [m]
        right: (n,) whether they are on the right side.
        inertias: Of each, in a frame at its centre; the root's contains them.
        links: Names of the links that turn with them.
        spans: Whether the base stands on them; else it needs casters.
    """

    def __init__(self, model: RobotModel) -> None:
        """Read them from the URDF; without wheels there, two at the half track."""
        base = differential(model.description)
        self.radius = r = base.wheel_radius_m
        full = pin.buildModelFromXML(bare_urdf(model.description))
        data = full.createData()
        pin.forwardKinematics(full, data, pin.neutral(full))
        ids = [full.getJointId(n) for n in (*base.right_wheel_joints, *base.left_wheel_joints)]
        self.links = {
            frame.name
            for frame in full.frames
            if frame.parentJoint in ids and frame.type == pin.FrameType.BODY
        }
        places = [data.oMi[i] for i in ids] or [
            pin.SE3(np.eye(3), np.array([0.0, y, r]))
            for y in (-base.half_track_m, base.half_track_m)
        ]
        self.centres = np.array([[*place.translation[:2], r] for place in places])
        self.right = self.centres[:, 1] < 0.0
        own = [pin.SE3(data.oMi[i].rotation, np.zeros(3)).act(full.inertias[i]) for i in ids]
        least = pin.Inertia.FromSphere(_LEAST_MASS * model.pin.inertias[1].mass, r)
        self.inertias = [I if I.mass > 0.0 else least for I in own] or [least] * len(places)
        self.spans = bool(np.ptp(self.centres[:, 0]) > r)

    def root_without(self, whole: pin.Inertia) -> pin.Inertia:
        """The root's inertia that is left of the whole without the wheels."""
        for centre, inertia in zip(self.centres, self.inertias, strict=True):
            whole = whole - pin.SE3(np.eye(3), centre).act(inertia)
        return whole


def corner_casters(model: RobotModel, r: float) -> list[Array]:
    """Centres (3,) [m] of four casters of radius r [m] in the corners of l_m's footprint."""
    body = model.description.mobile_body
    placed = [model.geometry.geometryObjects[i].placement for i in model.shape_ids[body.name]]
    bounds = [
        shape_mesh(shape).apply_transform(T.homogeneous).bounds[:, :2]
        for shape, T in zip(body.shapes, placed, strict=True)
    ]
    low, high = np.min(bounds, axis=(0, 1)) + r, np.max(bounds, axis=(0, 1)) - r
    corners: Iterable[tuple[float, float]] = product((low[0], high[0]), (low[1], high[1]))
    return [np.array([x, y, r]) for x, y in corners]
