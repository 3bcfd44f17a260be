"""The key of a reachability map: a hash of all that its counts depend on."""

from __future__ import annotations

from app.border.key import digest, robot_content
from app.border.reach.config import ReachConfig
from app.robot.description import RobotDescription

FORMAT = 1
"""Number of the file's layout and of the way of counting; a new one outdates all files."""


def reach_key(description: RobotDescription, body: str, config: ReachConfig) -> str:
    """32 hexadecimal digits that change whenever the map could.

    It covers the robot as the border's key does (shapes, joints, limits, URDF), the end-effector's
    frame, the body, and the counting; the way in which borders are sampled does not matter.

    Raises:
        AssetError: The URDF or a mesh is not there.
    """
    arm = description.arm
    return digest(
        {
            "format": FORMAT,
            "robot": robot_content(description),
            "end_effector": [
                arm.end_effector_link,
                arm.end_effector_xyz_m,
                arm.end_effector_rpy_rad,
                arm.end_effector_link in description.body(body).covers,
            ],
            "body": body,
            "sampling": config.model_dump(),
        }
    )
