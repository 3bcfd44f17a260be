"""The robots that can be chosen, and why some cannot."""

from __future__ import annotations

from typing import NamedTuple

from app.errors import DbbError
from app.robot.assets import load_robot, robot_folder, robot_names, user_robots
from app.robot.urdf import bare_urdf, resolved_urdf
from app.simulation.plants.choice import default_plant

_NEEDED = resolved_urdf if default_plant() == "planar" else bare_urdf
"""pybullet reads every mesh; MuJoCo and the viewer take the convex bodies if one is missing."""


class RobotEntry(NamedTuple):
    """A described robot.

    Attributes:
        name: As commands take it.
        title: As people read it.
        about: Base and arm in a few words.
        problem: Why it cannot be shown, with the command that helps where there is one; or None.
        own: Whether it is one of the user's.
        report: Whether there is a report on how it was made.
    """

    name: str
    title: str
    about: str
    problem: str | None
    own: bool
    report: bool

    @property
    def label(self) -> str:
        """In a list."""
        return self.name if self.problem is None else f"{self.name} (not available)"


def robot_entries() -> list[RobotEntry]:
    """All of them, by name."""
    return [_entry(name) for name in robot_names()]


def _entry(name: str) -> RobotEntry:
    folder = robot_folder(name)
    own, report = folder.parent == user_robots(), (folder / "report.html").is_file()
    try:
        description = load_robot(name)
    except DbbError as error:
        return RobotEntry(name, name, "", str(error), own, report)
    about = f"{description.base.kind} base, arm of {len(description.arm.joints)} joints"
    try:
        _NEEDED(description)
    except DbbError as error:
        return RobotEntry(name, description.title, about, str(error), own, report)
    return RobotEntry(name, description.title, about, None, own, report)
