"""Records of a new robot: the content of its URDF, and the robot that is made from it."""

from dataclasses import dataclass, field
from typing import Any

from app.onboarding.fit.bodies import FittedBody
from app.onboarding.fit.grouping import Detection, Verdict
from app.onboarding.fit.meetings import Meetings
from app.onboarding.fit.postures import Place, Ready
from app.onboarding.numbers import Limits, Reach
from app.onboarding.read.links import Geometry, LinkInertia
from app.onboarding.read.tree import Arm, Tree
from app.onboarding.read.wheels import Wheels
from app.onboarding.request import Request
from app.robot.model import RobotModel


@dataclass(frozen=True)
class Parsed:
    """The content of the URDF."""

    tree: Tree
    arm: Arm
    geometry: Geometry
    wheels: Wheels
    inertias: dict[str, LinkInertia]
    limits: Limits
    changes: tuple[str, ...] = ()
    """Sentences on removed shapes, telescopes with one joint, and a reduced buffer distance."""


@dataclass(frozen=True)
class Fitted:
    """A robot with fitted bodies."""

    request: Request  # with the final buffer distance
    parsed: Parsed  # with the final joint limits
    model: RobotModel
    meetings: Meetings
    bodies: list[FittedBody]
    verdict: Verdict  # quality of the grouping
    detection: Detection


@dataclass(frozen=True)
class NewRobot(Fitted):
    """All data for the files of a new robot; warnings and guiding lines are added last."""

    urdf: str  # text of the new URDF
    content: dict[str, Any]  # description in the form of `RobotDescription`
    ready: Ready
    reach: dict[str, Reach]  # reachability by the name of the body
    held: str  # warning that the arm cannot hold its end-effector in place, or empty
    places: dict[str, Place] = field(default_factory=dict)  # lines, by scenario
    lacking: dict[str, str] = field(default_factory=dict)  # reasons for missing lines, by scenario
    warnings: list[str] = field(default_factory=list)  # warnings; each is one sentence
