"""What moves in a snapshot, as robots' tools name it: frames of links, and states of joints."""

from typing import NamedTuple

import numpy as np
import pinocchio as pin

from app.robot.model import RobotModel, whole_model
from app.simulation.trace.snapshot import Snapshot

WORLD = "world"  # the frame in which base and links are


class JointReading(NamedTuple):
    """A joint at one instant; None is not known."""

    name: str
    position: float
    """[rad or m] about or along the joint's axis in the URDF."""
    velocity: float | None = None
    """[rad/s or m/s]"""
    effort: float | None = None
    """[N m or N]"""


class Frames:
    """Where the links are, each in the one that carries it; wheels turn."""

    def __init__(self, model: RobotModel) -> None:
        self._model, self._whole = model, whole_model(model.description)
        self._data = self._whole.createData()
        frames = self._whole.frames
        self._links = [i for i, f in enumerate(frames) if f.type == pin.FrameType.BODY]
        hand = model.pin.frames[model.ee_frame]
        link = model.pin.frames[hand.parentFrame]
        self._hand = link.name, hand.name, link.placement.actInv(hand.placement)

    def _carrier(self, number: int) -> int | None:
        """The link that carries another one; None is the world."""
        frames = self._whole.frames
        while number := frames[number].parentFrame:
            if frames[number].type == pin.FrameType.BODY:
                return number
        return None

    def at(self, s: Snapshot) -> list[tuple[str, str, pin.SE3]]:
        """Parent, child and T_parent_child of each link at a snapshot."""
        whole, turned = self._whole, np.zeros(self._whole.nv)
        for joint in joints_of(s, self._model):
            turned[whole.joints[whole.getJointId(joint.name)].idx_v] = joint.position
        q = pin.integrate(whole, pin.neutral(whole), turned)
        q[:4] = self._model.configuration(s.base_pose, s.q_m)[:4]
        pin.framesForwardKinematics(whole, self._data, q)
        return [*map(self._place, self._links), self._hand]

    def _place(self, link: int) -> tuple[str, str, pin.SE3]:
        oMf, name, carrier = self._data.oMf, self._whole.frames[link].name, self._carrier(link)
        if carrier is None:
            return WORLD, name, oMf[link].copy()
        return self._whole.frames[carrier].name, name, oMf[carrier].actInv(oMf[link])


def joints_of(s: Snapshot, model: RobotModel) -> list[JointReading]:
    """The joints of arm and wheels at a snapshot."""
    arm = model.description.arm.joints
    speeds = [None] * len(arm) if s.qd_m is None else s.qd_m.tolist()
    moving = zip(arm, s.q_m.tolist(), speeds, s.u_a.tolist(), strict=True)
    wheels = model.wheel_positions(s.wheel_angles)
    return [*map(JointReading._make, moving), *(JointReading(*each) for each in wheels.items())]


def nanoseconds(t: float) -> int:
    """A time [s] as logs have it."""
    return round(1e9 * t)
