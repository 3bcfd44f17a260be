"""What a base stands on in MuJoCo: driven wheels, casters where it needs them, its hull at last."""

from __future__ import annotations

import coal
import mujoco
import numpy as np
import pinocchio as pin

from app.robot.bases.differential import DifferentialBase
from app.simulation.plants.collision_shapes import CollisionShape
from app.simulation.plants.mujoco_robot import RobotSpec
from app.simulation.plants.mujoco_spec import FLOOR, GRAVITY
from app.simulation.plants.wheels import Wheels, corner_casters

Array = np.ndarray

_TREAD = 0.25  # [-] half width of a wheel in radii: an ellipsoid, which touches in one point
_LOAD_RESERVE = 2.0
"""[-] Friction of two wheels over that of the traction limit under the whole weight, of which
casters carry a part; of more wheels, the motors' torque over its share of that limit."""
_SPRING = 0.02, 1.0  # [s] time constant and [-] damping ratio of casters, and of tyres that skid
_TYRE = {"solimp": [0.5, 0.5, 0.001, 0.5, 2.0], "solreffriction": [0.2, 1.0]}
"""A tyre that gives by a millimetre and whose drag builds up within 0.1 s. MuJoCo lifts what slides
the more, the stiffer it is and the quicker its friction: firm wheels hop, and turn in jerks."""
_AT_FLOOR = 0.01  # [m] below which a part of the base stands on the floor, or would drag on it
_GEOM = mujoco.mjtGeom


def add_wheels(robot: RobotSpec, wheels: Wheels, base: DifferentialBase) -> None:
    """The driven wheels, on motors; friction and motors hold the base's traction limit."""
    weight = GRAVITY * pin.computeTotalMass(robot.model.pin)  # [N]
    mu, torque = base.traction_limit_n / weight, base.traction_limit_n * wheels.radius
    torque /= len(wheels.centres)
    if wheels.spans:
        torque *= _LOAD_RESERVE
    else:
        mu *= _LOAD_RESERVE
    r = wheels.radius
    for i, (centre, inertia) in enumerate(zip(wheels.centres, wheels.inertias, strict=True)):
        name = f"wheel_{i}"
        wheel = robot.add_body(robot.root, name, pin.SE3(np.eye(3), centre), inertia)
        robot.add_motor(wheel, name, mujoco.mjtJoint.mjJNT_HINGE, (0, 1, 0), torque)
        robot.add_geom(wheel, name, _GEOM.mjGEOM_ELLIPSOID, (r, _TREAD * r, r))
        tyre = {"firmness": _SPRING, **_TYRE} if wheels.spans else {}
        robot.allow(None, [FLOOR], [name], friction=mu, **tyre)


def add_casters_and_hull(robot: RobotSpec, wheels: Wheels) -> None:
    """Casters where they are needed; the hull of the base meets the floor when it tips."""
    casters: list[tuple[float, Array]] = []
    for i, shape in enumerate(robot.shapes):
        if shape.part not in robot.mobile or shape.part in wheels.links:
            continue
        if _lowest(shape) > _AT_FLOOR:
            robot.allow(None, [FLOOR], [f"{shape.part}/{i}"])
        elif isinstance(shape.geometry, coal.Sphere):
            casters.append((shape.geometry.radius, shape.T.translation))
    if not wheels.spans:
        corners = [(wheels.radius, c) for c in corner_casters(robot.model, wheels.radius)]
        for i, (r, centre) in enumerate(casters or corners):
            name = f"caster_{i}"
            place = pin.SE3(np.eye(3), np.array([*centre[:2], r]))
            robot.add_geom(robot.root, name, _GEOM.mjGEOM_SPHERE, (r,), place)
            robot.allow(None, [FLOOR], [name], friction=0.0, firmness=_SPRING)


def _lowest(shape: CollisionShape) -> float:
    """[m] height of the box around a shape of the root."""
    geometry = shape.geometry
    geometry.computeLocalAABB()
    low, high = geometry.aabb_local.min_, geometry.aabb_local.max_
    corner = shape.T.act((low + high) / 2)[2]
    return float(corner - np.abs(shape.T.rotation[2]) @ (high - low) / 2)
