"""The geometry of a refrigerator's door, and a door as a body of the arm (§4.2.3)."""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np
import pinocchio as pin

from app.border.cache import BorderData
from app.border.dbb import make_cloud
from app.errors import DescriptionError
from app.robot.description import ArmDescription, BodyDescription
from app.robot.link_pairs import Pair
from app.robot.model import RobotModel
from app.robot.shapes import Superquadric, around_box
from app.strict import Array

BODY = "door"
_E = 0.2  # [-] exponents e1 and e2 of the hyper-ellipsoid; its curved faces have one closest point
_MASS = 60.0  # [kg] mass of the refrigerator without its door
_DEPTH = 0.60  # [m] depth of the cabinet
_GAP = 0.005  # [m] distance between the cabinet and the closed door
_HANDLE = 0.03, 0.025, 0.24  # [m] depth, width and height of the drawn handle
_SINKING = 1e-5  # [m] depth of the resting cabinet in the floor


@dataclass(frozen=True)
class Door:
    """A vertical board on a hinge. The door's frame turns with the board; its origin is on the
    floor under the hinge's axis, and z is up. x of the closed door points into the refrigerator.
    """

    hinge: Literal["left", "right"]  # side of the hinge for a person in front of the closed door
    hinge_position: tuple[float, float]  # [m] x and y of the hinge's axis in the world
    yaw: float  # [rad] direction of the closed door's x axis in the world
    width: float  # [m] distance from the hinge's axis to the free edge
    friction: float  # [N m] dry friction of the hinge
    height: float = 1.70  # [m] height of the board
    thickness: float = 0.06  # [m] thickness of the board
    bottom: float = 0.05  # [m] height of the board's lower edge above the floor
    mass: float = 8.0  # [kg] mass of the board
    handle_inset: float = 0.06  # [m] distance from the handle to the free edge
    handle_reach: float = 0.05  # [m] distance from the door's face to the handle
    handle_height: float = 1.10  # [m] height of the handle above the floor

    @property
    def side(self) -> float:
        """+1 for a hinge on the left, -1 on the right."""
        return 1.0 if self.hinge == "left" else -1.0

    @property
    def size(self) -> tuple[float, float, float]:
        """[m] thickness, width and height of the board."""
        return self.thickness, self.width, self.height

    @property
    def handle_radius(self) -> float:
        """[m] distance from the hinge's axis to the handle."""
        return math.hypot(self.width - self.handle_inset, self.thickness / 2 + self.handle_reach)

    @property
    def centre(self) -> Array:
        """(3,) [m] centre of the board in the door's frame."""
        return np.array([0.0, -self.side * self.width / 2, self.bottom + self.height / 2])

    @property
    def joint_range(self) -> tuple[float, float]:
        """[rad] limits of the hinge's joint, whose position is -side times the opening angle."""
        stops = self.side * _GAP / self.width, -self.side * math.pi
        return min(stops), max(stops)

    def pose(self, angle: float) -> pin.SE3:
        """T_world_door at an opening angle [rad]."""
        turn = pin.rpy.rpyToMatrix(0.0, 0.0, self.yaw - self.side * angle)
        return pin.SE3(turn, np.array([*self.hinge_position, 0.0]))

    def handle(self, angle: float) -> pin.SE3:
        """T_world_ee at the handle, at an opening angle [rad]: z points into the door, x up."""
        x = -self.thickness / 2 - self.handle_reach
        y = -self.side * (self.width - self.handle_inset)
        axes = np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]])
        return self.pose(angle) * pin.SE3(axes, np.array([x, y, self.handle_height]))

    def radial(self, p_ee: Array) -> Array:
        """(2,) horizontal unit vector in the world from a point `p_ee` (3,) [m] to the hinge."""
        to_hinge = np.subtract(self.hinge_position, p_ee[:2])
        return to_hinge / np.linalg.norm(to_hinge)

    def superquadric(self, T: pin.SE3) -> Superquadric:
        """The hyper-ellipsoid through the board's corners, in a frame F; T is T_F_door."""
        at = T * pin.SE3(np.eye(3), self.centre)
        x, y, z = at.translation.tolist()
        roll, pitch, yaw = pin.rpy.matrixToRpy(at.rotation).tolist()
        return Superquadric(
            type="superquadric",
            xyz_m=(x, y, z),
            rpy_rad=(roll, pitch, yaw),
            semi_axes_m=around_box(self.size, _E, _E),
            e1=_E,
            e2=_E,
        )


class DoorView(NamedTuple):
    """A door that the end-effector holds; after the scenario, both radial values are NaN."""

    door: Door  # the door's constant geometry; `door.pose(angle)` is T_world_door
    angle: float  # [rad] opening angle
    force: Array  # (3,) [N] of the end-effector on the door, in the world; 0 after the scenario
    radial_force: float = math.nan  # [N] component of `force` towards the true hinge
    radial_error: float = math.nan  # [rad] of the estimated direction, positive counter-clockwise
    contact: bool = False  # whether the door touches the base

    @property
    def numbers(self) -> Array:
        """(7,) the fields after `door` in their units; `contact` is 1 or 0."""
        return np.array([self.angle, *self.force, *self[3:]])


NO_DOOR = np.full(7, math.nan)  # `DoorView.numbers` without a door


class OpenDoor(NamedTuple):
    door: Door
    angle: float  # [rad] its opening angle at the plant's reset


class Cabinet:
    """The cabinet of a refrigerator: a box that stands on the floor and is not fixed."""

    def __init__(self, door: Door) -> None:
        self.size = _DEPTH, door.width, door.bottom + door.height  # [m] depth, width and height
        self.inertia = pin.Inertia.FromBox(_MASS, *self.size)  # in the frame of the box's centre
        back = door.thickness / 2 + _GAP + _DEPTH / 2
        place = np.array([back, door.centre[1], self.size[2] / 2 - _SINKING])
        self.T_world = door.pose(0.0) * pin.SE3(np.eye(3), place)  # pose of the box's centre
        self.T_hinge = self.T_world.inverse() * door.pose(0.0)  # the closed door in the box's frame
        self.T_centre = pin.SE3(np.eye(3), door.centre)  # the board's centre in the door's frame
        # Inertia of the board in the door's frame.
        self.door_inertia = self.T_centre.act(pin.Inertia.FromBox(door.mass, *door.size))


def drawn_parts(door: Door, angle: float) -> dict[str, tuple[tuple[float, float, float], pin.SE3]]:
    """Size [m] and pose of each box of a refrigerator, in the world, at an opening angle [rad]."""
    cabinet, opened = Cabinet(door), door.pose(angle)
    handle = door.pose(0.0).actInv(door.handle(0.0)).translation
    return {
        "case": (cabinet.size, cabinet.T_world),
        "board": (door.size, opened * cabinet.T_centre),
        "handle": (_HANDLE, opened * pin.SE3(np.eye(3), handle)),
    }


def T_link_ee(arm: ArmDescription) -> pin.SE3:
    """Pose of the end-effector in the frame of its link."""
    R = pin.rpy.rpyToMatrix(*arm.end_effector_rpy_rad)
    return pin.SE3(R, np.array(arm.end_effector_xyz_m))


def with_door(
    model: RobotModel, data: BorderData, door: Door, T_ee_door: pin.SE3
) -> tuple[RobotModel, BorderData]:
    """Model and data of a robot whose last body is a held door (Figure 16b); ⟨l_m, door⟩ is in L_m.
    `T_ee_door` is the constant pose of the door in the end-effector's frame. The door gets the
    reachability coefficients of the last body that has any; if no body has any, this raises a
    DescriptionError. The pair's acting points are on the exact offset surface of l_m, not samples.
    """
    description = model.description
    link = description.arm.end_effector_link
    body = BodyDescription(
        source="a hyper-ellipsoid through the corners of the door (Figure 16b)",
        name=BODY,
        frame=link,
        shapes=(door.superquadric(T_link_ee(description.arm) * T_ee_door),),
        covers=(link,),
    )
    known = description.reachability
    if not (tips := [b.name for b in description.bodies if b.name in known]):
        why = "no body has A, B and C of (9), which a held door requires; `dbb reach` computes them"
        raise DescriptionError(f"{description.name}/robot.toml: reachability: {why}")
    reachability = {**known, BODY: known[tips[-1]]}
    pair = Pair(description.mobile_body.name, BODY)
    holding = description.model_copy(
        update={"bodies": (*description.bodies, body), "reachability": reachability}
    )
    nothing = make_cloud(pair.name, np.empty((0, 3), np.int16), np.empty(0, np.uint16))
    pairs = replace(data.pairs, mobile=(*data.pairs.mobile, pair))
    clouds = {**data.clouds, pair.name: nothing}
    return RobotModel(holding), BorderData(pairs, clouds, data.origin)
