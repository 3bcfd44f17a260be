"""The key of a robot's border: a hash of all that its points depend on, equal on all machines."""

from __future__ import annotations

import hashlib
import json
from xml.etree import ElementTree

from app.border.sampling.config import SamplingConfig
from app.robot.assets import urdf_path
from app.robot.description import RobotDescription
from app.robot.packages import resolve_package_uri
from app.robot.shapes import ConvexMesh

FORMAT = 2
"""Number of the file's layout and of the way of sampling; a new one outdates all files."""


def border_key(description: RobotDescription, sampling: SamplingConfig) -> str:
    """32 hexadecimal digits that change whenever the border could.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    return digest(
        {"format": FORMAT, **robot_content(description), "sampling": sampling.model_dump()}
    )


def robot_content(description: RobotDescription) -> dict[str, object]:
    """All of a robot that the places of its bodies depend on.

    Of the description count the bodies' shapes, the arm's joints and limits and the base's link; of
    the URDF its joints; of a mesh its bytes. Sources, colours, masses, gains and the place where
    packages are installed do not.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    arm = description.arm
    return {
        "base": description.base.link,
        "mount": arm.mount_link,
        "joints": [arm.joints, arm.position_lower, arm.position_upper],
        "bodies": [
            [body.name, body.frame, [shape.model_dump() for shape in body.shapes]]
            for body in description.bodies
        ],
        "meshes": [
            hashlib.blake2b(resolve_package_uri(shape.file).read_bytes()).hexdigest()
            for body in description.bodies
            for shape in body.shapes
            if isinstance(shape, ConvexMesh)
        ],
        "kinematics": _kinematics(urdf_path(description).read_text(encoding="utf-8")),
    }


def digest(content: dict[str, object]) -> str:
    """32 hexadecimal digits of what can be written as JSON."""
    text = json.dumps(content, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.blake2b(text.encode(), digest_size=16).hexdigest()


def _kinematics(urdf: str) -> list[str]:
    """The joints of a URDF in canonical XML, without comments and layout."""
    return [
        ElementTree.canonicalize(ElementTree.tostring(joint, encoding="unicode"), strip_text=True)
        for joint in ElementTree.fromstring(urdf).iterfind("joint")
    ]
