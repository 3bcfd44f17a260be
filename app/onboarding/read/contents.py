"""What a zip holds, as far as one chooses from it: URDFs, links, joints that may be wheels."""

from __future__ import annotations

import tempfile
from pathlib import Path
from typing import NamedTuple
from xml.etree.ElementTree import Element

from app.errors import RobotFileError
from app.onboarding.read.package import LARGEST_URDF, chosen_urdf, urdfs
from app.onboarding.read.source import read_source
from app.onboarding.read.tree import make_tree
from app.onboarding.read.unpack import unpack

_MOST_URDFS = 20  # [-] that are looked into
_MOST_NAMES = 500  # [-] links or joints in a list


class Contents(NamedTuple):
    """Names in a URDF.

    Attributes:
        links: All, in the order of the file.
        endless: Joints that turn without end.
        root: The first link that no joint moves: perhaps the base.
        last: The link that is farthest from the root by joints: perhaps the tip.
    """

    links: tuple[str, ...]
    endless: tuple[str, ...]
    root: str
    last: str


def look_into(archive: Path) -> dict[str, Contents]:
    """The URDFs of a zip, by their path in it; nothing is kept.

    Raises:
        RobotFileError: The zip cannot be trusted, or no URDF in it can be read.
    """
    with tempfile.TemporaryDirectory() as folder:
        names = unpack(archive, Path(folder))
        found = urdfs(names)
        if not found:
            chosen_urdf(names, archive.name, None)  # says why
        contents, problem = {}, ""
        for name in found[:_MOST_URDFS]:
            try:
                contents[name] = _contents(Path(folder) / name)
            except RobotFileError as error:
                problem = str(error).replace(f"{folder}/", "")
        if not contents:
            raise RobotFileError(problem)
        return contents


def _contents(path: Path) -> Contents:
    if path.stat().st_size > LARGEST_URDF:
        raise RobotFileError(f"{path.name}: a URDF may have {LARGEST_URDF / 1e6:.0f} MB")
    robot = read_source(path)
    _not_too_many(robot, path)
    make_tree(robot)  # what is wrong with the whole is told before anything is asked
    links = tuple(str(link.get("name")) for link in robot.findall("link"))
    above = {_link(joint, "child"): _link(joint, "parent") for joint in robot.findall("joint")}
    endless = tuple(
        str(joint.get("name"))
        for joint in robot.findall("joint")
        if joint.get("type") == "continuous"
    )
    root = next((link for link in links if link not in above), links[0])
    return Contents(links, endless, root, max(links, key=lambda l: _depth(l, above)))


def _not_too_many(robot: Element, path: Path) -> None:
    """Look at nothing more closely that is too large for a list: it is done in the server."""
    for tag, least in (("link", 1), ("joint", 0)):
        count = len(robot.findall(tag))
        if not least <= count <= _MOST_NAMES:
            raise RobotFileError(
                f"{path.name}: it has {count} {tag}s; {least} to {_MOST_NAMES} are taken"
            )


def _link(joint: Element, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else str(found.get("link"))


def _depth(link: str, above: dict[str, str]) -> int:
    """Joints between a link and its root; a ring ends after as many as there are."""
    depth = 0
    while link in above and depth < len(above):
        link, depth = above[link], depth + 1
    return depth
